"""HDF5: ``events/{t,x,y,p}`` (ours, DSEC), ``CD/events`` (Prophesee), ``raw_events/...``, flat, nested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from ..errors import MissingExtra, RecordingError
from .columns import find_columns, require_columns, require_equal_lengths
from .source import DeclaredUnit, RawChunks, RawColumns, Source, TimeUnit, explained

ECF_FILTER = 0x8ECF  # Prophesee's own compression; no free Python package decodes it
MAX_CHUNK_BYTES = 1 << 28  # a larger one is damage: it could not be read in bounded memory

# Where an event recording is looked for first; only then anywhere else in the file.
USUAL_PLACES = ("events", "CD/events", "raw_events", "/")

UNIT_NAMES: dict[str, TimeUnit] = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "microsecond", "microseconds", "µs"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), "ns"),
}


@dataclass(frozen=True)
class _Layout:
    """The four columns: a dataset each, or a field each of one compound dataset."""

    words: str
    place: str
    columns: Mapping[str, tuple[h5py.Dataset, str | None]]

    @property
    def datasets(self) -> list[h5py.Dataset]:
        return list({_name(dataset): dataset for dataset, _ in self.columns.values()}.values())


class Hdf5Source(Source):
    """An HDF5 file, read a slice at a time."""

    def __init__(self, path: str) -> None:
        with explained(path, "HDF5 file"):
            self._file = h5py.File(path, "r")
        try:
            with explained(path, "HDF5 file"):
                self._layout = _find_layout(self._file, path)
                for dataset in self._layout.datasets:
                    _check_readable(dataset, path)
                self._length = require_equal_lengths(
                    {column: dataset.shape[0] for column, (dataset, _) in self._layout.columns.items()}, path
                )
                super().__init__(
                    path,
                    f"HDF5 {self._layout.words}",
                    sensor=_sensor(self._file, self._layout, path),
                    n_events=self._length,
                    unit=_unit(self._file, self._layout, path),
                    t_offset_us=_dsec_offset(self._file),
                )
        except BaseException:
            self._file.close()
            raise

    def raw_chunks(self, chunk_events: int) -> RawChunks:
        """Read slices of the datasets."""
        for first in range(0, self._length, chunk_events):
            yield self._read(first, first + chunk_events)

    def raw_tail(self, count: int) -> RawColumns:
        """Read the last slice."""
        return self._read(max(0, self._length - count), self._length)

    def _read(self, first: int, last: int) -> RawColumns:
        with explained(self.name, "HDF5 file"):
            # A compound dataset holds all columns and is read once.
            slices = {_name(dataset): dataset[first:last] for dataset in self._layout.datasets}
            columns = (self._layout.columns[column] for column in "txyp")
            return RawColumns(
                *(slices[_name(dataset)][... if field is None else field] for dataset, field in columns)
            )

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _find_layout(file: h5py.File, path: str) -> _Layout:
    for place in USUAL_PLACES:
        if place in file and (layout := _layout_at(file[place], place)):
            return layout
    nested: list[_Layout] = []

    def visit(name: str, thing: Any) -> None:
        if layout := _layout_at(thing, name):
            nested.append(layout)

    file.visititems(visit)
    if len(nested) == 1:
        return nested[0]
    if nested:
        places = ", ".join(layout.place for layout in nested)
        raise RecordingError(
            f"{path}: holds several recordings ({places}); export the one to read into its own file"
        )
    events = file.get("events")
    group = events if isinstance(events, h5py.Group) else file
    require_columns(list(group), path, f"HDF5 group {group.name}")
    raise RecordingError(
        f"{path}: no event columns in this HDF5 file; it needs events/t, events/x, events/y, events/p"
    )


def _layout_at(thing: Any, place: str) -> _Layout | None:
    """Return the layout, if ``thing`` is a group or compound dataset with all four columns."""
    if isinstance(thing, h5py.Dataset):
        found = find_columns(thing.dtype.names or ())
        columns = {column: (thing, field) for column, field in found.items()}
        words = f"{place} compound"
    elif isinstance(thing, h5py.Group):
        datasets = {
            name: child for name in map(str, thing) if isinstance(child := thing.get(name), h5py.Dataset)
        }
        found = find_columns(datasets)
        columns = {column: (datasets[name], None) for column, name in found.items()}
        prefix = "" if place == "/" else f"{place}/"
        words = f"{prefix}{{{','.join(found.values())}}}"
    else:
        return None
    return _Layout(words, place, columns) if len(columns) == 4 else None


def _check_readable(dataset: h5py.Dataset, path: str) -> None:
    """Refuse what would fail, or fill up memory, or silently give zeros when read."""
    name = _name(dataset)
    if dataset.ndim != 1 or dataset.dtype.hasobject:
        raise RecordingError(
            f"{path}: {name} must be one-dimensional numbers, got {dataset.dtype} of shape {dataset.shape};"
            " export the recording again"
        )
    creation = dataset.id.get_create_plist()
    for i in range(creation.get_nfilters()):
        _require_filter(creation.get_filter(i)[0], name, path)

    stored, length = dataset.id.get_storage_size(), dataset.shape[0]
    if dataset.chunks:
        if dataset.chunks[0] * dataset.dtype.itemsize > MAX_CHUNK_BYTES:
            raise RecordingError(
                f"{path}: {name} has chunks of {dataset.chunks[0]:,} events, too large to stream;"
                " repack it with h5repack"
            )
        # HDF5 gives zeros for chunks that were never written: that is an interrupted recording.
        complete = dataset.id.get_num_chunks() * dataset.chunks[0] >= length
    else:
        complete = stored >= length * dataset.dtype.itemsize
    if not complete:
        raise RecordingError(
            f"{path}: {name} is truncated: {length:,} events declared, {stored:,} bytes stored; copy it again"
        )


def _require_filter(number: int, dataset: str, path: str) -> None:
    if h5py.h5z.filter_avail(number):
        return
    if number == ECF_FILTER:
        raise RecordingError(
            f"{path}: {dataset} is compressed with Prophesee's ECF codec (filter 0x8ECF), which evqr cannot"
            " decode; convert it to RAW or DAT with the vendor's tools, or repack it without compression"
        )
    try:
        import hdf5plugin  # noqa: F401  (importing it registers its filters)
    except ImportError as error:
        raise MissingExtra(
            f'{path}: {dataset} needs HDF5 filter {number}: pip install "evqr[formats]" ({error})'
        ) from error
    if not h5py.h5z.filter_avail(number):
        raise RecordingError(
            f"{path}: {dataset} needs the unknown HDF5 filter {number}; repack it with gzip compression"
        )


def _attributes(file: h5py.File, layout: _Layout) -> dict[str, Any]:
    """Attributes of the root, of the group and of the columns' place, and scalar datasets beside them."""
    place = file[layout.place]
    group = place if isinstance(place, h5py.Group) else place.parent
    found: dict[str, Any] = {}
    for thing in (file, group, place):
        found |= dict(thing.attrs)
        if isinstance(thing, h5py.Group):
            scalars = {key: _scalar(thing, key) for key in ("width", "height")}
            found |= {key: value for key, value in scalars.items() if value is not None}
    return found


def _scalar(group: h5py.Group, key: str) -> Any:
    """Value of a scalar dataset, or None."""
    thing = group.get(key)
    return thing[()] if isinstance(thing, h5py.Dataset) and thing.shape == () else None


def _sensor(file: h5py.File, layout: _Layout, path: str) -> tuple[int, int] | None:
    attributes = _attributes(file, layout)
    if "width" in attributes and "height" in attributes:
        pair = attributes["width"], attributes["height"]
    elif "geometry" in attributes:  # Prophesee: "1280x720"
        pair = tuple(_text(attributes["geometry"]).lower().split("x"))
    else:
        return None
    try:
        width, height = (int(np.asarray(side).item()) for side in pair)
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"{path}: sensor size {pair!r} is no pair of whole numbers; pass --sensor WxH"
        ) from error
    return width, height


def _unit(file: h5py.File, layout: _Layout, path: str) -> DeclaredUnit | None:
    times, field = layout.columns["t"]
    for key in ("unit", "units", "time_unit"):
        if field is None and key in times.attrs:
            text = _text(times.attrs[key])
            if text.lower() not in UNIT_NAMES:
                raise RecordingError(
                    f"{path}: attribute {key} of {_name(times)} is {text!r}, no known unit;"
                    " pass --time-unit us|ms|s|ns"
                )
            return DeclaredUnit(UNIT_NAMES[text.lower()], f"attribute {key} of {_name(times)} says {text}")
    if "ms_to_idx" in file or "t_offset" in file:
        return DeclaredUnit("us", "DSEC layout (ms_to_idx, t_offset) is in us")
    if layout.place == "CD/events":
        return DeclaredUnit("us", "Prophesee CD/events is in us")
    return None


def _dsec_offset(file: h5py.File) -> int:
    offset = _scalar(file, "t_offset")
    return 0 if offset is None else int(offset)


def _name(dataset: h5py.Dataset) -> str:
    return dataset.name or "unnamed dataset"


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
