"""NumPy files: .npz with columns or one structured array or matrix, .npy structured or a matrix.

Both are streamed from the (compressed) bytes; a memory map would not do for .npz.  Nothing is ever unpickled.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
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

Opener = Callable[[], IO[bytes]]


class _Table(NamedTuple):
    """An array that holds all four columns: as fields with names, or as columns of a matrix.

    Attributes
    ----------
    words : str
        The layout in words.
    length : int
        Rows.
    fields : mapping | None
        Columns to fields; None of a matrix.
    order : Columns
        What each column of a matrix is.
    by_column : bool
        Whether a matrix is stored one column after the other.
    note : str
        What had to be decided, or "".
    """

    words: str
    length: int
    fields: Mapping[str, str] | None
    order: Columns = DEFAULT_ORDER
    by_column: bool = False
    note: str = ""

    @property
    def unit(self) -> DeclaredUnit | None:
        return None if self.fields is None else _named_unit(self.fields["t"])

    def reader(
        self, stack: ExitStack, reopen: Opener, path: str, what: str, faults: Faults | None = None
    ) -> Callable[[int], RawColumns]:
        """Return a function that reads the next so many rows of a newly opened array."""

        def opened(**layout: int) -> ArrayReader:
            return ArrayReader(stack.enter_context(reopen()), path, what, faults, **layout)

        if self.fields is not None:
            fields, read = self.fields, opened()

            def next_fields(count: int) -> RawColumns:
                rows = read(count)
                return RawColumns(*(rows[fields[column]] for column in "txyp"))

            return next_fields
        width = len(self.order)
        columns = [self.order.index(column) for column in "txyp"]
        if self.by_column:
            parts = [opened(width=width, column=index) for index in columns]
            return lambda count: RawColumns(*(part(count) for part in parts))
        matrix = opened(width=width)

        def next_rows(count: int) -> RawColumns:
            rows = matrix(count)
            return RawColumns(*(rows[:, index] for index in columns))

        return next_rows


class NpySource(Source):
    """One structured array, or a matrix, in an .npy file."""

    def __init__(self, path: str, asked: Asked) -> None:
        with explained(path, "NumPy file"):
            table = _table(lambda: open(path, "rb"), path, "the array", asked)
        self._table = table
        notes = (table.note,) * bool(table.note)
        words = f"NumPy {table.words} (.npy)"
        super().__init__(path, words, n_events=table.length, unit=table.unit, notes=notes)

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Read row by row."""
        with ExitStack() as stack:
            with explained(self.name, "NumPy file"):
                read = self._table.reader(
                    stack, lambda: open(self.name, "rb"), self.name, "the array", faults
                )
            while True:
                with explained(self.name, "NumPy file"):
                    raw = read(chunk_events)
                if not len(raw.t):
                    return
                yield raw


class NpzSource(Source):
    """Columns, or one structured array or matrix, in an .npz file."""

    def __init__(self, path: str, asked: Asked) -> None:
        with explained(path, "npz file"), zipfile.ZipFile(path) as archive:
            members = {n.removesuffix(".npy"): n for n in archive.namelist() if n.endswith(".npy")}
            found = find_columns(members)
            self._table: _Table | None = None
            streams: list[str] = []
            stream, notes = "", ()
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
                table = self._table = tables[stream]
                self._member = members[stream]
                notes = (table.note,) * bool(table.note)
                words, length, unit = f"npz {table.words} {stream}", table.length, table.unit
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
            unit=_declared_unit(said) or unit,
            stream=stream,
            streams=streams,
            notes=notes,
        )

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Decompress the columns side by side."""
        with ExitStack() as stack:
            with explained(self.name, "npz file"):
                archive = stack.enter_context(zipfile.ZipFile(self.name))
                if self._table is not None:
                    member = self._member
                    read = self._table.reader(stack, lambda: archive.open(member), self.name, self.stream)
                else:
                    parts = [
                        ArrayReader(stack.enter_context(archive.open(self._columns[c])), self.name, c)
                        for c in "txyp"
                    ]
                    read = partial(_columns, parts)
            for _ in range(0, self.n_events or 0, chunk_events):
                with explained(self.name, "npz file"):
                    raw = read(chunk_events)
                yield raw


def _columns(parts: Sequence[ArrayReader], count: int) -> RawColumns:
    return RawColumns(*(part(count) for part in parts))


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
    width : int, optional
        Columns of a matrix, whose rows are read.
    column : int, optional
        Which one to read instead, of a matrix that is stored one column after the other.
    """

    def __init__(
        self,
        file: IO[bytes],
        path: str,
        what: str,
        faults: Faults | None = None,
        *,
        width: int = 0,
        column: int | None = None,
    ) -> None:
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
        self.names = self.dtype.names or ()
        self.length = matrix_length(shape, width) if width else int(np.prod(shape))
        self._width = width if column is None else 0
        self._row_bytes = self.dtype.itemsize * max(self._width, 1)
        self._left = self.length
        for _ in range(column or 0):
            _pass_over(file, self.length * self.dtype.itemsize)

    @property
    def is_vector(self) -> bool:
        """Whether it is one column, be it stored as a matrix of one row or column."""
        return len(self.shape) < 2 or (len(self.shape) == 2 and 1 in self.shape)

    def stored_by_column(self, width: int) -> bool:
        """Whether a matrix of so many columns is stored one column after the other."""
        return self._fortran == (self.shape[1] == width)

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
        return rows.reshape(-1, self._width) if self._width else rows


def matrix_length(shape: tuple[int, ...], width: int) -> int:
    """Return the rows of a matrix of so many columns, which may be stored transposed; 0 if it is none."""
    if len(shape) != 2 or width not in shape:
        return 0
    length = shape[0] if shape[1] == width else shape[1]
    return length if shape[1] == width or length > width else 0


def _pass_over(file: IO[bytes], count: int) -> None:
    while count > 0 and (data := file.read(min(count, 1 << 20))):
        count -= len(data)


def _table(reopen: Opener, path: str, what: str, asked: Asked) -> _Table:
    """How an array holds all four columns; raises `RecordingError` where it does not."""
    with reopen() as file:
        read = ArrayReader(file, path, what)
    fields = find_columns(read.names)
    if len(fields) == 4:
        return _Table("structured array", read.length, fields)
    width = 4 if asked.columns is None else len(asked.columns)
    length = 0 if read.names else matrix_length(read.shape, width)
    if not length:
        if len(read.shape) == 2 and not read.names:
            raise RecordingError(
                f"{path}: {what} has shape {read.shape}, which leaves open which column is which; say so, as"
                ' columns="t,x,y,p,-" for five of them, or save t, x, y, p as named columns'
            )
        require_columns(read.names, path, f"{what}, structured,")
    table = _Table("", length, None, asked.columns or DEFAULT_ORDER, read.stored_by_column(width))
    order, remark = asked.columns, ""
    if order is None:
        with ExitStack() as stack:
            sample = table.reader(stack, reopen, path, what)(SAMPLE_ROWS)
        order, remark = settle_order(sample, asked.sensor, path, what)
    return table._replace(words=f"array N x {width} ({', '.join(order)})", order=order, note=remark)


def _tables(
    archive: zipfile.ZipFile, members: Mapping[str, str], path: str, asked: Asked
) -> dict[str, _Table]:
    """Arrays that hold all four columns; matrices only where none has names."""
    tables: dict[str, _Table] = {}
    unclear: RecordingError | None = None
    for name, member in members.items():
        try:
            with archive.open(member) as file:
                read = ArrayReader(file, path, name)
            if not read.is_vector or read.names:
                tables[name] = _table(lambda member=member: archive.open(member), path, name, asked)
        except RecordingError as error:  # a pickle, or a matrix of something else
            unclear = error
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


def _declared_unit(said: Mapping[str, Any]) -> DeclaredUnit | Unclear | None:
    found = find_unit(said, "the file")
    if isinstance(found, DeclaredUnit):
        return DeclaredUnit(found.unit, found.reason.replace(" of the file", " in the file"))
    return found


def _named_unit(name: str) -> DeclaredUnit | None:
    unit = unit_in_name(name)
    return DeclaredUnit(unit, f"column {name!r} says so") if unit else None
