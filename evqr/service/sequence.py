"""The number of the next record, kept in a file, so that numbers go on when a program is started again."""

from __future__ import annotations

import os
from os import PathLike

from evqr.errors import UsageError

DIGITS = 20


class SequenceFile:
    """A file with one number.

    Parameters
    ----------
    path : path
        The file; made where there is none.

    Attributes
    ----------
    next : int
        Number of the next record.

    Raises
    ------
    UsageError
        It cannot be written, or holds something else.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        try:
            self._file = open(path, "r+b" if os.path.exists(path) else "w+b", buffering=0)
            held = self._file.read(4 * DIGITS).strip()
        except OSError as error:
            raise UsageError(f"{path}: cannot be written ({error.strerror}); name another file") from error
        if held and not held.isdigit():
            self.close()
            raise UsageError(f"{path}: holds {held!r}, no number; name another file, or remove it")
        self.next = int(held or b"0")

    def keep(self, next_number: int) -> None:
        """Write the number of the next record, in place: a kill leaves the old one or the new one."""
        self.next = next_number
        self._file.seek(0)
        self._file.write(b"%0*d\n" % (DIGITS, next_number))

    def close(self) -> None:
        """Close the file."""
        self._file.close()
