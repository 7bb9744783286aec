"""Logs of a service: a JSON object a line on standard error, for whatever collects them."""

from __future__ import annotations

import logging
import sys
from datetime import datetime, timezone

from evqr.values import json_line


class JsonFormatter(logging.Formatter):
    """Writes time, level, logger and message."""

    def format(self, record: logging.LogRecord) -> str:
        """Give the line of a log record."""
        at = datetime.fromtimestamp(record.created, timezone.utc)
        line = {
            "t_utc": at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": " ".join(record.getMessage().split()),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json_line(line)


def log_as_json() -> None:
    """Let our packages log so, from information on; others from warnings on."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    for name in ("evqr", "evqr_kernels"):
        ours = logging.getLogger(name)
        ours.handlers.clear()
        ours.setLevel(logging.INFO)
