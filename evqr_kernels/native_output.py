"""What native code prints on standard error that a user has no use for."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from typing import IO


@contextlib.contextmanager
def without_lines(*parts: bytes) -> Iterator[None]:
    """Hold back the lines on standard error that contain one of ``parts``; all others are passed on."""
    try:
        sys.stderr.flush()
        caught = _file()
        kept = os.dup(2)
    except (AttributeError, OSError):  # no standard error, as under pythonw, or no temporary files
        yield
        return
    with caught:
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            caught.seek(0)
            others = b"".join(line for line in caught if not any(part in line for part in parts))
            if others:
                os.write(2, others)


def _file() -> IO[bytes]:
    """Make a file that goes when it is closed, in memory where there is no place for temporary files."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        if not hasattr(os, "memfd_create"):
            raise
        return open(os.memfd_create("caught"), "w+b")
