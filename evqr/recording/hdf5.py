"""HDF5 files, read a slice at a time with h5py; where the events are in them is found by `hdf5_layout`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from evqr_kernels.extras import install_command

from ..errors import MissingExtra, RecordingError, StreamChoice
from .columns import require_equal_lengths, unit_in_name
from .declared import DeclaredSensor, DeclaredUnit, Unclear, find_sensor, find_unit, first_of, plain, whole
from .faults import Faults
from .hdf5_layout import Column, Layout, filters_of, find_layout, is_ecf, length_of, name_of, read_block
from .hdf5_storage import open_file, rows_stored
from .options import Asked
from .source import RawChunks, RawColumns, Source, explained

MAX_CHUNK_BYTES = 1 << 28  # a larger one is damage: it could not be read in bounded memory
MAX_SAID_VALUES = 4  # of a data set that may tell the sensor's size


_CUT = (
    "{}: HDF5 file is truncated after {:,} bytes, and what tells where its events are, or all of a column,"
    " was behind them; copy it again from where it was recorded"
)


class Hdf5Source(Source):
    """One event stream of an HDF5 file."""

    def __init__(self, path: str, asked: Asked) -> None:
        self._file, end, notes = open_file(path)
        try:
            with explained(path, "HDF5 file"):
                self._layout, streams = find_layout(self._file, path, asked)
                columns = self._layout.columns
                for column in columns.values():
                    _check_readable(column, path)
                declared = require_equal_lengths(
                    {c: length_of(column) for c, column in columns.items()}, path
                )
                self._length, self._cut = _stored(self._layout, declared, end, path, asked.strict)
                offset, remark = _offset(self._file, self._layout)
                super().__init__(
                    path,
                    f"HDF5 {self._layout.words}",
                    sensor=_sensor(self._file, self._layout),
                    n_events=self._length,
                    unit=_unit(self._file, self._layout),
                    t_offset_us=offset,
                    stream=self._layout.place,
                    streams=streams,
                    notes=[note for note in (*notes, self._layout.note, remark) if note],
                )
        except BaseException as error:
            self._file.close()
            if end is not None and isinstance(error, RecordingError) and not isinstance(error, StreamChoice):
                raise RecordingError(_CUT.format(path, end)) from error
            raise

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Read slices of the data sets."""
        for first in range(0, self._length, chunk_events):
            yield self._read(first, min(first + chunk_events, self._length))
        if self._cut:
            faults.cut(self._cut)

    def raw_tail(self, count: int) -> RawColumns:
        """Read the last slice."""
        return self._read(max(0, self._length - count), self._length)

    def _read(self, first: int, last: int) -> RawColumns:
        layout = self._layout
        with explained(self.name, "HDF5 file"):
            # A data set that holds several columns is read once.
            blocks = {name_of(d): read_block(d, layout.along(d), first, last) for d in layout.datasets}
            columns = (layout.columns[column] for column in "txyp")
            return RawColumns(*(column.of(blocks[name_of(column.dataset)]) for column in columns))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _check_readable(column: Column, path: str) -> None:
    """Refuse what would fail, or fill up memory, when read."""
    dataset, name = column.dataset, name_of(column.dataset)
    flat = dataset.ndim == 1 or (dataset.ndim == 2 and 1 in dataset.shape)
    kind = dataset.dtype if column.field is None else dataset.dtype[column.field]
    if not (flat or column.index is not None) or kind.hasobject or kind.base.kind not in "biuf":
        raise RecordingError(
            f"{path}: {name} must be one-dimensional numbers, got {kind} of shape {dataset.shape};"
            " export the recording again"
        )
    if not is_ecf(dataset):
        for number in filters_of(dataset):
            _require_filter(number, name, path)
    if dataset.chunks and int(np.prod(dataset.chunks)) * dataset.dtype.itemsize > MAX_CHUNK_BYTES:
        raise RecordingError(
            f"{path}: {name} has chunks of {dataset.chunks[column.along]:,} events, too large to stream;"
            " repack it with h5repack"
        )
    if dataset.is_virtual:
        _require_parts(dataset, path)


def _require_parts(dataset: h5py.Dataset, path: str) -> None:
    """Refuse a virtual data set whose files are not there: HDF5 would give zeros for them."""
    folder = Path(path).resolve().parent
    names = {source.file_name for source in dataset.virtual_sources()} - {"."}
    missing = sorted(n for n in names if "%" not in n and not (folder / n).exists() and not Path(n).exists())
    if missing:
        raise RecordingError(
            f"{path}: {name_of(dataset)} is put together from other files, and {', '.join(missing)}"
            " is not there; put it beside this file"
        )


def _stored(layout: Layout, declared: int, end: int | None, path: str, strict: bool) -> tuple[int, str]:
    """How many events are stored, and what is missing or "".

    HDF5 gives zeros for what was never written: that is an interrupted recording.
    """
    stored = [(rows_stored(d, layout.along(d), declared, end), d) for d in layout.datasets]
    shortest, _ = min(stored, key=lambda pair: pair[0])
    if shortest == declared:
        return declared, "" if end is None else f"it ends after {end:,} bytes, behind its last event"
    first = next(dataset for count, dataset in stored if count < declared)
    if end is None and (strict or shortest == 0):
        size = first.id.get_storage_size()
        raise RecordingError(
            f"{path}: {name_of(first)} is truncated: {declared:,} events declared, {size:,} bytes stored;"
            " copy it again"
        )
    if shortest == 0:
        raise RecordingError(f"{path}: of {name_of(first)} nothing is there")
    return shortest, f"{name_of(first)} declares {declared:,} events, and {shortest:,} are stored"


def _require_filter(number: int, dataset: str, path: str) -> None:
    if h5py.h5z.filter_avail(number):
        return
    try:
        import hdf5plugin  # noqa: F401  (importing it registers its filters)
    except ImportError as error:
        raise MissingExtra(
            f"{path}: {dataset} needs HDF5 filter {number}: {install_command('formats')} ({error})"
        ) from error
    if not h5py.h5z.filter_avail(number):
        raise RecordingError(
            f"{path}: {dataset} needs the unknown HDF5 filter {number}; repack it with gzip compression"
        )


def _places(file: h5py.File, layout: Layout) -> Iterator[Any]:
    """Where something may be said of a stream: its place, and the groups around it up to the root."""
    place = file[layout.place]
    yield place
    while place.name != "/":
        place = place.parent
        yield place


def _said(thing: Any) -> dict[str, Any]:
    """Attributes, and small data sets in a group and the groups in it."""
    said = dict(thing.attrs)
    if isinstance(thing, h5py.Group):
        for name in map(str, thing):
            child = thing.get(name)
            if isinstance(child, h5py.Dataset):
                said |= _small(name, child)
            elif isinstance(child, h5py.Group):  # such as M3ED's calib/resolution
                for below in map(str, child):
                    if isinstance(inner := child.get(below), h5py.Dataset):
                        said = _small(below, inner) | said
    return said


def _small(name: str, dataset: h5py.Dataset) -> dict[str, Any]:
    small = dataset.shape is not None and int(dataset.size or 0) <= MAX_SAID_VALUES
    return {name: dataset[()]} if small and dataset.dtype.names is None else {}


def _sensor(file: h5py.File, layout: Layout) -> DeclaredSensor | Unclear | None:
    return first_of(find_sensor(_said(thing)) for thing in _places(file, layout))


def _unit(file: h5py.File, layout: Layout) -> DeclaredUnit | Unclear | None:
    times = layout.columns["t"]
    name = name_of(times.dataset)
    said = find_unit(dict(times.dataset.attrs), name) if times.field is None and times.index is None else None
    if said is not None:
        return said
    column = times.field or name.rsplit("/", 1)[-1]
    if times.index is None and (unit := unit_in_name(column)):
        return DeclaredUnit(unit, f"column {column!r} says so")
    if "ms_to_idx" in file or "t_offset" in file:
        return DeclaredUnit("us", "DSEC layout (ms_to_idx, t_offset) is in us")
    if layout.place == "CD/events":
        return DeclaredUnit("us", "Prophesee CD/events is in us")
    around = (find_unit(dict(thing.attrs), thing.name or "/") for thing in _places(file, layout))
    return next((unit for unit in around if isinstance(unit, DeclaredUnit)), None)


def _offset(file: h5py.File, layout: Layout) -> tuple[int, str]:
    """Return what is to be added to the times [us], as DSEC stores it, and a note where that is not clear."""
    for thing in _places(file, layout):
        offset = thing.get("t_offset") if isinstance(thing, h5py.Group) else None
        if isinstance(offset, h5py.Dataset):
            value = plain(offset[()]) if offset.size == 1 else None
            number = whole(value)
            if number is None:
                return (
                    0,
                    f"t_offset of shape {offset.shape} is no whole number of microseconds, and is not added",
                )
            return number, ""
    return 0, ""
