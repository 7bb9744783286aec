"""Logs of a service: a JSON object a line on standard error, for whatever collects them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from evqr.clock import utc_text
from evqr.values import json_line


class JsonFormatter(logging.Formatter):
    """Writes time, level, logger and message."""

    def format(self, record: logging.LogRecord) -> str:
        """Give the line of a log record."""
        line = {
            "t_utc": utc_text(record.created),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": " ".join(record.getMessage().split()),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json_line(line)


@contextmanager
def logged_as_json() -> Iterator[None]:
    """Log so inside: our packages from information on, others from warnings on, and nothing twice."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    root, *ours = (logging.getLogger(name) for name in ("", "evqr", "evqr_kernels"))
    before = [(logger, logger.handlers[:], logger.level) for logger in ours]
    root.addHandler(handler)
    for logger in ours:
        logger.handlers.clear()
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        root.removeHandler(handler)
        for logger, handlers, level in before:
            logger.handlers[:] = handlers
            logger.setLevel(level)
