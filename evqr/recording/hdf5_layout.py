"""Where the events are in an HDF5 file, and how their columns are stored.

Columns are data sets of a group (``events/{t,x,y,p}``: ours, DSEC; ``prophesee/left/{t,x,y,p}``: M3ED),
fields of a compound data set (``CD/events``: Prophesee), or columns of a matrix without names (``events``:
v2e; ``davis/left/events``: MVSEC).  MATLAB stores a column as a matrix of one row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .columns import DEFAULT_ORDER, Columns, find_columns, require_columns, settle_order
from .ecf import ECF_FILTER, read_ecf
from .options import Asked
from .source import choose_stream

SAMPLE_ROWS = 4096
MOST_COLUMNS = 12
FEW_ROWS = 16  # so few may well be the same
COLUMN_ATTRIBUTES = ("columns", "column_names", "names", "fields", "order", "format")


@dataclass(frozen=True)
class Column:
    """One of t, x, y, p: a data set, or a part of one.

    Attributes
    ----------
    dataset : h5py.Dataset
        Where it is.
    field : str | None
        Field of a compound data set.
    index : int | None
        Column of a matrix.
    along : int
        Axis along which events follow one another.
    """

    dataset: h5py.Dataset
    field: str | None = None
    index: int | None = None
    along: int = 0

    def of(self, block: NDArray[Any]) -> NDArray[Any]:
        """Take this column from a block that `read_block` has read."""
        values = block if self.field is None else block[self.field]
        return values if values.ndim == 1 else values[:, self.index or 0]


@dataclass(frozen=True)
class Layout:
    """The four columns of one event stream.

    Attributes
    ----------
    place : str
        Name of the stream: group or data set.
    words : str
        The layout in words.
    columns : mapping
        "t", "x", "y", "p" to where they are.
    note : str
        What had to be decided, or "".
    """

    place: str
    words: str
    columns: Mapping[str, Column]
    note: str = ""

    @property
    def datasets(self) -> list[h5py.Dataset]:
        """Each data set once."""
        return list({name_of(c.dataset): c.dataset for c in self.columns.values()}.values())

    def along(self, dataset: h5py.Dataset) -> int:
        """Axis of a data set along which events follow one another."""
        return next(c.along for c in self.columns.values() if name_of(c.dataset) == name_of(dataset))


def find_layout(file: h5py.File, path: str, asked: Asked) -> tuple[Layout, list[str]]:
    """Return the event stream to read, and the names of all there are.

    Raises
    ------
    RecordingError
        When there is none, or several and none was asked for.
    """
    named: dict[tuple[int, ...], Layout] = {}
    matrices: dict[tuple[int, ...], Layout] = {}
    width = 4 if asked.columns is None else len(asked.columns)
    for place, thing in _walk(file):
        if layout := _named_columns(thing, place):
            named.setdefault(_addresses(layout), layout)
        elif isinstance(thing, h5py.Dataset) and (layout := _matrix(thing, place, width)):
            matrices.setdefault(_addresses(layout), layout)
    if named:
        layouts = list(named.values())
    else:
        called = [m for m in matrices.values() if "event" in m.place.casefold()]
        layouts = called or [m for m in matrices.values() if asked.columns or _fits(m, asked, path)]
    if not layouts:
        _refuse(file, list(matrices.values()), path, asked)
    names = [layout.place for layout in layouts]
    chosen = layouts[names.index(choose_stream(names, asked.stream, path, "group"))]
    return (_with_note(chosen, asked) if named else _in_order(chosen, asked, path)), names


def read_block(dataset: h5py.Dataset, along: int, first: int, last: int) -> NDArray[Any]:
    """Read events ``first`` to ``last - 1`` of a data set, one a row."""
    if is_ecf(dataset):
        return read_ecf(dataset, first, last)
    return dataset[first:last] if along == 0 else dataset[:, first:last].T


def is_ecf(dataset: h5py.Dataset) -> bool:
    """Whether a data set is compressed as Prophesee does it, and HDF5 has no plugin for that."""
    return filters_of(dataset) == [ECF_FILTER] and not h5py.h5z.filter_avail(ECF_FILTER)


def filters_of(dataset: h5py.Dataset) -> list[int]:
    """Return the numbers of a data set's filters."""
    creation = dataset.id.get_create_plist()
    return [creation.get_filter(i)[0] for i in range(creation.get_nfilters())]


def length_of(column: Column) -> int:
    """Return the number of events."""
    return column.dataset.shape[column.along]


def name_of(dataset: h5py.Dataset) -> str:
    """Path of a data set in its file."""
    return dataset.name or "unnamed dataset"


def _walk(group: h5py.Group, place: str = "/", seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """Give all groups and data sets, each once, also those behind links; the usual place first."""
    seen = set() if seen is None else seen
    address = _address(group)
    if address in seen:
        return
    seen.add(address)
    yield place, group
    for name in sorted(map(str, group), key=lambda name: (name != "events", name)):
        try:
            child = group.get(name)
        except (KeyError, OSError, RuntimeError):  # a link that leads nowhere
            continue
        below = name if place == "/" else f"{place}/{name}"
        if isinstance(child, h5py.Group):
            yield from _walk(child, below, seen)
        elif isinstance(child, h5py.Dataset):
            yield below, child


def _address(thing: h5py.Group | h5py.Dataset) -> int:
    return h5py.h5o.get_info(thing.id).addr  # pyright: ignore[reportAttributeAccessIssue] (not in its stubs)


def _addresses(layout: Layout) -> tuple[int, ...]:
    return tuple(sorted(_address(d) for d in layout.datasets))


def _named_columns(thing: Any, place: str) -> Layout | None:
    """Return the layout of a group or compound data set that has all four columns by name."""
    if isinstance(thing, h5py.Dataset):
        found = find_columns(thing.dtype.names or ())
        columns = {column: _vector(thing, field) for column, field in found.items()}
        words = f"{place} compound"
    else:
        datasets = {
            name: child
            for name in map(str, thing)
            if isinstance(child := _child(thing, name), h5py.Dataset) and child.ndim > 0
        }
        found = find_columns(datasets)
        columns = {column: _vector(datasets[name]) for column, name in found.items()}
        prefix = "" if place == "/" else f"{place}/"
        words = f"{prefix}{{{','.join(found.values())}}}"
    return Layout(place, words, columns) if len(columns) == 4 else None


def _child(group: h5py.Group, name: str) -> Any:
    try:
        return group.get(name)
    except (KeyError, OSError, RuntimeError):
        return None


def _vector(dataset: h5py.Dataset, field: str | None = None) -> Column:
    one_row = dataset.ndim == 2 and dataset.shape[0] == 1
    return Column(dataset, field, along=1 if one_row else 0)


def _matrix(dataset: h5py.Dataset, place: str, width: int) -> Layout | None:
    """Return the layout of a data set that is a matrix of so many columns, in the order of the file."""
    parts: list[Column] = []
    if dataset.ndim == 2 and dataset.dtype.kind in "biuf" and width in dataset.shape:
        along = 0 if dataset.shape[1] == width else 1
        if dataset.shape[along] > width:  # so small a matrix could be either way round
            parts = [Column(dataset, index=i, along=along) for i in range(width)]
    elif dataset.ndim == 1 and dataset.dtype.names:  # as pandas writes tables
        fields = [f for f in dataset.dtype.names if dataset.dtype[f].shape == (width,)]
        parts = [Column(dataset, fields[0], index=i) for i in range(width)] if len(fields) == 1 else []
    if not parts:
        return None
    return Layout(place, f"{place} N x {width}", {str(i): part for i, part in enumerate(parts)})


def _sample(layout: Layout) -> list[NDArray[Any]]:
    first = layout.columns["0"]
    block = read_block(first.dataset, first.along, 0, SAMPLE_ROWS)
    return [column.of(block) for column in layout.columns.values()]


def _require_varied(columns: Columns, table: list[NDArray[Any]], path: str, what: str) -> None:
    """Refuse numbers that could be events, but vary less than those of events do: counts, labels, zeros."""
    values = {column: len(np.unique(part)) for column, part in zip(columns, table, strict=True)}
    if len(table[0]) < FEW_ROWS:
        return
    problem = "all on at most four pixels" if max(values["x"], values["y"]) <= 2 else ""
    problem = "all at one time" if values["t"] == 1 else problem
    if problem:
        raise RecordingError(
            f"{path}: {what} has no column names, and does not look like events: its first {len(table[0]):,}"
            f' would be {problem}; if they are events, say what the columns are: columns="t,x,y,p"'
        )


def _order(layout: Layout, asked: Asked, path: str) -> tuple[Columns, str]:
    what = f"array {layout.place} of shape {layout.datasets[0].shape}"
    if asked.columns is not None:
        return asked.columns, ""
    dataset = layout.datasets[0]
    for key in COLUMN_ATTRIBUTES:
        names = [n.decode() if isinstance(n, bytes) else str(n) for n in np.ravel(dataset.attrs.get(key, ()))]
        names = names[0].replace(",", " ").split() if len(names) == 1 else names
        found = {name: column for column, name in find_columns(names).items()}
        if len(found) == 4 == len(names):
            return tuple(found[name] for name in names), ""
    table = _sample(layout)
    if not len(table[0]):
        return DEFAULT_ORDER, ""
    order, note = settle_order(table, asked.sensor, path, what)
    _require_varied(order, table, path, what)
    return order, note


def _fits(layout: Layout, asked: Asked, path: str) -> bool:
    try:
        _order(layout, asked, path)
    except RecordingError:
        return False
    return True


def _in_order(layout: Layout, asked: Asked, path: str) -> Layout:
    order, remark = _order(layout, asked, path)
    columns = {column: layout.columns[str(i)] for i, column in enumerate(order) if column != "-"}
    return replace(layout, words=f"{layout.words} ({', '.join(order)})", columns=columns, note=remark)


def _with_note(layout: Layout, asked: Asked) -> Layout:
    remark = "columns= is not used: the columns have names" if asked.columns is not None else ""
    return replace(layout, note=remark)


def _refuse(file: h5py.File, matrices: list[Layout], path: str, asked: Asked) -> None:
    """Raise for a file in which no events were found, naming what comes nearest."""
    if len(matrices) == 1:
        _order(matrices[0], asked, path)
    for place, thing in _walk(file):
        wide = isinstance(thing, h5py.Dataset) and thing.ndim == 2 and thing.dtype.kind in "biuf"
        if wide and "event" in place.casefold() and 4 < min(thing.shape) <= MOST_COLUMNS:
            order = ",".join((*DEFAULT_ORDER, *"-" * (min(thing.shape) - 4)))
            raise RecordingError(
                f"{path}: array {place} of shape {thing.shape} has no column names; say what they are, with"
                f' - for what is not read: for example columns="{order}"'
            )
    events = file.get("events")
    group = events if isinstance(events, h5py.Group) else file
    require_columns(map(str, group), path, f"HDF5 group {group.name}")
    raise RecordingError(f"{path}: no event columns in this HDF5 file; it needs events/t, x, y, p")
