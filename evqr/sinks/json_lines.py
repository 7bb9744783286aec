"""Records as JSON lines in a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import IO

from evqr.sinks.sink import JsonRecord
from evqr.values import json_line


class JsonLines:
    """Appends a JSON object a line; what is delivered is on the disk.

    A line that a kill has cut is taken away when the file is opened again: its record comes again.

    Parameters
    ----------
    path : path
        The file; made where there is none. One that is moved away while it is written is made anew.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.name = f"json lines {path}"
        self._path = Path(path)
        self._file: IO[bytes] | None = None

    def open(self) -> None:
        """Open the file."""
        file = open(self._path, "ab+")
        end = file.seek(0, os.SEEK_END)
        whole = end
        while whole > 0:  # back to behind the last whole line
            start = max(0, whole - 4096)
            file.seek(start)
            found = file.read(whole - start).rfind(b"\n")
            if found >= 0:
                whole = start + found + 1
                break
            whole = start
        if whole < end:
            file.truncate(whole)
        self._file = file

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Append lines."""
        if self._moved_away():
            self.close()
            self.open()
        assert self._file is not None
        self._file.write("".join(json_line(record) + "\n" for record in records).encode("ascii"))
        self._file.flush()
        os.fsync(self._file.fileno())
        return ""

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _moved_away(self) -> bool:
        """Whether another program, which rotates logs, has taken the file."""
        if self._file is None:
            return True
        try:
            there = os.stat(self._path)
        except OSError:
            return True
        return not os.path.samestat(there, os.fstat(self._file.fileno()))
