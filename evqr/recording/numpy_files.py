"""NumPy files: .npz with columns or one structured array, .npy structured.

Both are streamed from the (compressed) bytes; a memory map would not do for .npz.  Nothing is ever unpickled.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .columns import find_columns, require_columns, require_equal_lengths
from .source import DeclaredUnit, RawChunks, RawColumns, Source, explained

MAX_SCALAR_BYTES = 4096


class NpySource(Source):
    """One structured array in an .npy file."""

    def __init__(self, path: str) -> None:
        with explained(path, "NumPy file"), open(path, "rb") as file:
            header = _Header(file, path, "the array")
            self._fields = require_columns(header.names, path, "the structured array")
        super().__init__(path, "NumPy structured array (.npy)", n_events=header.length)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Read record by record."""
        with open(self.name, "rb") as file:
            yield from _structured_chunks(file, self._fields, chunk_events, self.name, "NumPy file")


class NpzSource(Source):
    """Columns, or one structured array, in an .npz file."""

    def __init__(self, path: str) -> None:
        with explained(path, "npz file"), zipfile.ZipFile(path) as archive:
            members = {
                name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")
            }
            found = find_columns(members)
            self._columns = {column: members[name] for column, name in found.items()}
            self._structured: tuple[str, dict[str, str]] | None = None
            if len(found) < 4:
                self._structured = _only_structured(archive, members, path)
                if self._structured is None:
                    require_columns(members, path, "npz file")
            if self._structured is not None:
                with archive.open(self._structured[0]) as file:
                    length = _Header(file, path, self._structured[0]).length
                words = f"npz structured array {self._structured[0].removesuffix('.npy')}"
            else:
                length = require_equal_lengths(
                    {column: _length(archive, member, path) for column, member in self._columns.items()}, path
                )
                words = f"npz {{{','.join(found.values())}}}"
            sensor = None
            if "width" in members and "height" in members:
                sensor = (
                    int(_scalar(archive, members["width"], path)),
                    int(_scalar(archive, members["height"], path)),
                )
            unit = None
            if "time_unit" in members and str(_scalar(archive, members["time_unit"], path)) == "us":
                unit = DeclaredUnit("us", "time_unit in the file says us")
        super().__init__(path, words, sensor=sensor, n_events=length, unit=unit)

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Decompress the columns side by side."""
        with ExitStack() as stack:
            with explained(self.name, "npz file"):
                archive = stack.enter_context(zipfile.ZipFile(self.name))
            if self._structured is not None:
                member, fields = self._structured
                with explained(self.name, "npz file"):
                    file = stack.enter_context(archive.open(member))
                yield from _structured_chunks(file, fields, chunk_events, self.name, "npz file")
                return
            with explained(self.name, "npz file"):
                readers = [
                    _array_reader(stack.enter_context(archive.open(self._columns[column])), self.name, column)
                    for column in "txyp"
                ]
            for _ in range(0, self.n_events or 0, chunk_events):
                with explained(self.name, "npz file"):
                    raw = RawColumns(*(read(chunk_events) for read in readers))
                yield raw


class _Header:
    """Reads the header of an .npy stream, up to the data."""

    def __init__(self, file: IO[bytes], path: str, what: str) -> None:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            self.shape, _, self.dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            self.shape, _, self.dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise RecordingError(
                f"{path}: {what} is in NumPy format {version}; save it with plain column names"
            )
        if self.dtype.hasobject:
            raise RecordingError(
                f"{path}: {what} holds pickled objects, which are never loaded; save plain numbers"
            )
        if len(self.shape) > 1:
            raise RecordingError(
                f"{path}: {what} has shape {self.shape}, which leaves open which column is which;"
                " save t, x, y, p as named columns"
            )
        self.names = self.dtype.names or ()
        self.length = self.shape[0] if self.shape else 1


def _array_reader(file: IO[bytes], path: str, what: str) -> Callable[[int], NDArray[Any]]:
    """Return a function that reads the next so many items of an .npy stream."""
    header = _Header(file, path, what)
    left = header.length

    def read(count: int) -> NDArray[Any]:
        nonlocal left
        count = min(count, left)
        data = file.read(count * header.dtype.itemsize)
        if len(data) < count * header.dtype.itemsize:
            done = header.length - left + len(data) // header.dtype.itemsize
            raise RecordingError(
                f"{path}: {what} is truncated after {done:,} of {header.length:,} items; copy it again"
            )
        left -= count
        if left == 0:
            file.read(1)  # lets zipfile meet the end of the member and check its CRC
        return np.frombuffer(data, header.dtype)

    return read


def _structured_chunks(
    file: IO[bytes], fields: dict[str, str], chunk_events: int, path: str, what: str
) -> Iterator[RawColumns]:
    with explained(path, what):
        read = _array_reader(file, path, "the structured array")
    while True:
        with explained(path, what):
            records = read(chunk_events)
        if len(records) == 0:
            return
        yield RawColumns(*(records[fields[column]] for column in "txyp"))


def _only_structured(
    archive: zipfile.ZipFile, members: dict[str, str], path: str
) -> tuple[str, dict[str, str]] | None:
    """Member and fields of the one structured array with all four columns, if there is one."""
    found = []
    for member in members.values():
        with archive.open(member) as file:
            fields = find_columns(_Header(file, path, member).names)
        if len(fields) == 4:
            found.append((member, fields))
    if len(found) > 1:
        raise RecordingError(
            f"{path}: holds several recordings ({', '.join(member for member, _ in found)});"
            " save the one to read in its own file"
        )
    return found[0] if found else None


def _length(archive: zipfile.ZipFile, member: str, path: str) -> int:
    with archive.open(member) as file:
        return _Header(file, path, member).length


def _scalar(archive: zipfile.ZipFile, member: str, path: str) -> Any:
    with archive.open(member) as file:
        header = _Header(file, path, member)
        if header.length != 1 or header.dtype.itemsize > MAX_SCALAR_BYTES:
            raise RecordingError(
                f"{path}: {member} must be one value, got {header.length}; save the recording again"
            )
        return np.frombuffer(file.read(header.dtype.itemsize), header.dtype)[0]
