"""NumPy files: .npz with columns or one structured array or matrix, .npy structured or a matrix.

Both are streamed from the (compressed) bytes; a memory map would not do for .npz.  Nothing is ever unpickled.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .columns import (
    DEFAULT_ORDER,
    Columns,
    find_columns,
    require_columns,
    require_equal_lengths,
    settle_order,
    unit_in_name,
)
from .declared import DeclaredUnit, Unclear, find_sensor, find_unit
from .faults import Faults
from .options import Asked
from .source import RawChunks, RawColumns, Source, choose_stream, explained

MAX_SAID_BYTES = 4096
SAMPLE_ROWS = 4096

Reader = Callable[[int], NDArray[Any]]


class _Table(NamedTuple):
    """An array that holds all four columns: by names of its fields, or by their order."""

    words: str
    fields: Mapping[str, str] | None
    order: Columns
    note: str = ""

    def columns(self, rows: NDArray[Any]) -> RawColumns:
        if self.fields is not None:
            return RawColumns(*(rows[self.fields[column]] for column in "txyp"))
        return RawColumns(*(rows[:, self.order.index(column)] for column in "txyp"))

    @property
    def unit(self) -> DeclaredUnit | None:
        return None if self.fields is None else _named_unit(self.fields["t"])


class NpySource(Source):
    """One structured array, or a matrix, in an .npy file."""

    def __init__(self, path: str, asked: Asked) -> None:
        with explained(path, "NumPy file"), open(path, "rb") as file:
            read = ArrayReader(file, path, "the array")
            self._table = _table(read, path, "the array", asked)
            if self._table is None:
                require_columns(read.names, path, "the structured array")
                raise AssertionError("unreachable")
        words = f"NumPy {self._table.words} (.npy)"
        super().__init__(
            path,
            words,
            n_events=read.length,
            unit=self._table.unit,
            notes=(self._table.note,) * bool(self._table.note),
        )

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Read row by row."""
        assert self._table is not None
        with open(self.name, "rb") as file:
            with explained(self.name, "NumPy file"):
                read = ArrayReader(file, self.name, "the array", faults)
            while True:
                with explained(self.name, "NumPy file"):
                    rows = read(chunk_events)
                if not len(rows):
                    return
                yield self._table.columns(rows)


class NpzSource(Source):
    """Columns, or one structured array or matrix, in an .npz file."""

    def __init__(self, path: str, asked: Asked) -> None:
        with explained(path, "npz file"), zipfile.ZipFile(path) as archive:
            members = {n.removesuffix(".npy"): n for n in archive.namelist() if n.endswith(".npy")}
            found = find_columns(members)
            self._table: _Table | None = None
            streams: list[str] = []
            stream, note = "", ""
            if len(found) < 4 and (groups := _groups(members)):
                streams = list(groups)
                stream = choose_stream(streams, asked.stream, path, "group")
                found = groups[stream]
            self._columns = {column: members[name] for column, name in found.items()}
            if len(found) < 4:
                tables = _tables(archive, members, path, asked)
                if not tables:
                    require_columns(members, path, "npz file")
                streams = list(tables)
                stream = choose_stream(streams, asked.stream, path, "array")
                self._table, self._member = tables[stream], members[stream]
                note = self._table.note
                with archive.open(self._member) as file:
                    length = ArrayReader(file, path, stream).length
                words, unit = f"npz {self._table.words} {stream}", self._table.unit
            else:
                length = require_equal_lengths(
                    {column: _length(archive, member, path) for column, member in self._columns.items()}, path
                )
                words, unit = f"npz {{{','.join(found.values())}}}", _named_unit(found["t"])
            said = _said(archive, members, path)
        super().__init__(
            path,
            words,
            sensor=find_sensor(said),
            n_events=length,
            unit=_told_unit(said) or unit,
            stream=stream,
            streams=streams,
            notes=(note,) * bool(note),
        )

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Decompress the columns side by side."""
        with ExitStack() as stack:
            with explained(self.name, "npz file"):
                archive = stack.enter_context(zipfile.ZipFile(self.name))
                members = [self._member] if self._table else [self._columns[column] for column in "txyp"]
                readers = [
                    ArrayReader(
                        stack.enter_context(archive.open(member)), self.name, member.removesuffix(".npy")
                    )
                    for member in members
                ]
            for _ in range(0, self.n_events or 0, chunk_events):
                with explained(self.name, "npz file"):
                    parts = [read(chunk_events) for read in readers]
                yield self._table.columns(parts[0]) if self._table else RawColumns(*parts)


class ArrayReader:
    """Reads the rows of an .npy stream one after the other.

    Parameters
    ----------
    file : binary file
        At the start of the array.
    path, what : str
        For messages.
    faults : Faults, optional
        Is told of an array that is cut short, which is an error without it.
    """

    def __init__(self, file: IO[bytes], path: str, what: str, faults: Faults | None = None) -> None:
        self._file, self._path, self._what, self._faults = file, path, what, faults
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, self._fortran, self.dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            shape, self._fortran, self.dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise RecordingError(
                f"{path}: {what} is in NumPy format {version}; save it with plain column names"
            )
        if self.dtype.hasobject:
            raise RecordingError(
                f"{path}: {what} holds pickled objects, which are never loaded; save plain numbers"
            )
        self.shape = shape
        # A column may be stored as a matrix of one row or column.
        flat = len(shape) == 2 and 1 in shape and max(shape) > 1
        self.width = shape[1] if len(shape) == 2 and not flat else 0
        self.length = int(np.prod(shape)) if flat or not self.width else shape[0]
        self.streamable = len(shape) < 2 or flat or (len(shape) == 2 and not self._fortran)
        self.names = self.dtype.names or ()
        self._row_bytes = self.dtype.itemsize * max(self.width, 1)
        self._left = self.length

    def __call__(self, count: int) -> NDArray[Any]:
        """Return the next so many rows, fewer at the end."""
        count = min(count, self._left)
        data = self._file.read(count * self._row_bytes)
        if len(data) < count * self._row_bytes:
            done = self.length - self._left + len(data) // self._row_bytes
            problem = f"{self._what} is truncated after {done:,} of {self.length:,} items"
            if self._faults is None or self._faults.strict or not done:
                raise RecordingError(f"{self._path}: {problem}; copy it again")
            self._faults.cut(problem)
            data = data[: len(data) - len(data) % self._row_bytes]
            self._left = count = len(data) // self._row_bytes
        self._left -= count
        if self._left == 0:
            self._file.read(1)  # lets zipfile meet the end of the member and check its CRC
        rows = np.frombuffer(data, self.dtype)
        return rows.reshape(-1, self.width) if self.width else rows


def _table(read: ArrayReader, path: str, what: str, asked: Asked) -> _Table | None:
    """How an array holds all four columns, or None."""
    fields = find_columns(read.names)
    if len(fields) == 4:
        return _Table("structured array", fields, DEFAULT_ORDER)
    width = 4 if asked.columns is None else len(asked.columns)
    if read.names or read.width != width:
        if len(read.shape) > 1 and not read.names and read.width:
            raise RecordingError(
                f"{path}: {what} has shape {read.shape}, which leaves open which column is which; say so with"
                f" --columns t,x,y,p{',-' * (read.width - 4)}, or save t, x, y, p as named columns"
            )
        return None
    if not read.streamable:
        raise RecordingError(f"{path}: {what} is stored column by column; save it in C order")
    order, told = asked.columns, ""
    if order is None:
        rows = read(SAMPLE_ROWS)
        order, told = (
            settle_order(list(rows.T), asked.sensor, path, what) if len(rows) else (DEFAULT_ORDER, "")
        )
    return _Table(f"array N x {width} ({', '.join(order)})", None, order, told)


def _tables(
    archive: zipfile.ZipFile, members: Mapping[str, str], path: str, asked: Asked
) -> dict[str, _Table]:
    """Arrays that hold all four columns; matrices only where none has names."""
    tables: dict[str, _Table] = {}
    unclear: RecordingError | None = None
    for name, member in members.items():
        with archive.open(member) as file:
            try:
                read = ArrayReader(file, path, name)
                if not read.names and (len(read.shape) != 2 or read.length < 2):
                    continue
                table = _table(read, path, name, asked)
            except RecordingError as error:  # a pickle, or a matrix of something else
                unclear = error
                continue
        if table is not None:
            tables[name] = table
    named = {name: table for name, table in tables.items() if table.fields is not None}
    if not tables and unclear is not None:
        raise unclear
    return named or tables


def _groups(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Find sets of all four columns whose names begin alike, such as left/t, left/x, ... or left_t, ..."""
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        for separator in "/_.":
            prefix, found, column = name.rpartition(separator)
            if found:
                parts.setdefault(prefix, {})[column] = name
    groups = {prefix: (find_columns(columns), columns) for prefix, columns in parts.items()}
    return {
        p: {c: columns[n] for c, n in found.items()}
        for p, (found, columns) in groups.items()
        if len(found) == 4
    }


def _length(archive: zipfile.ZipFile, member: str, path: str) -> int:
    with archive.open(member) as file:
        return ArrayReader(file, path, member).length


def _said(archive: zipfile.ZipFile, members: Mapping[str, str], path: str) -> dict[str, Any]:
    """Small arrays, which may tell the sensor's size or the unit of time."""
    said = {}
    for name, member in members.items():
        if archive.getinfo(member).file_size <= MAX_SAID_BYTES:
            with archive.open(member) as file, suppress(RecordingError):  # a pickle, which is not loaded
                read = ArrayReader(file, path, member)
                if read.length <= 4:
                    said[name] = read(read.length)
    return said


def _told_unit(said: Mapping[str, Any]) -> DeclaredUnit | Unclear | None:
    found = find_unit(said, "the file")
    if isinstance(found, DeclaredUnit):
        return DeclaredUnit(found.unit, found.reason.replace(" of the file", " in the file"))
    return found


def _named_unit(name: str) -> DeclaredUnit | None:
    unit = unit_in_name(name)
    return DeclaredUnit(unit, f"column {name!r} says so") if unit else None
