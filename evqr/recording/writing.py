"""Write recordings: HDF5 in the layout ``events/{t,x,y,p}`` and npz, with the truth where it is known."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evqr.events.array import EventArray

from ..errors import RecordingError, UsageError

CHUNK_EVENTS = 1 << 16


Truth = Mapping[str, Mapping[str, Any]]


def save_recording(path: str | os.PathLike[str], events: EventArray, *, truth: Truth | None = None) -> None:
    """Write events, so that `open_recording` gives them back exactly.

    Parameters
    ----------
    path     .h5 or .hdf5 (``events/{t,x,y,p}``, p as {0, 1}, attrs width and height) or .npz (the same names)
    events   what to write
    truth    what is true of each code, as `evqr.simulate` tells it: name of a group ("truth", "truth2", ...)
             to its fields.  Scalars become attributes of the group, arrays its datasets; in .npz all become
             arrays ``GROUP/NAME``

    Raises
    ------
    RecordingError   when the file cannot be written
    UsageError       for another suffix
    """
    path = Path(path)
    write = writer_of(path)
    try:
        write(path, events, truth or {})
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be written ({error.strerror or error}); choose another place"
        ) from error


def writer_of(path: Path) -> Callable[[Path, EventArray, Truth], None]:
    """Return what writes a recording of this name; raise `UsageError` for a suffix that is not written."""
    writers = {".h5": _write_hdf5, ".hdf5": _write_hdf5, ".npz": _write_npz}
    if path.suffix not in writers:
        raise UsageError(
            f"{path}: recordings are written as {', '.join(writers)}; end the name in one of them"
        )
    return writers[path.suffix]


def _columns(events: EventArray) -> dict[str, np.ndarray]:
    # The int8 {0, 1} of the development recordings, which most readers take.
    return {"t": events.t, "x": events.x, "y": events.y, "p": (events.p > 0).astype(np.int8)}


def _write_hdf5(path: Path, events: EventArray, truth: Truth) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["width"], file.attrs["height"] = events.width, events.height
        group = file.create_group("events")
        chunks = (min(CHUNK_EVENTS, len(events)),) if len(events) else None
        for name, values in _columns(events).items():
            group.create_dataset(
                name,
                data=values,
                chunks=chunks,
                **({"compression": "gzip", "shuffle": True} if chunks else {}),
            )
        group["t"].attrs["unit"] = "us"
        for code, fields in truth.items():
            told = file.create_group(code)
            for name, value in fields.items():
                if np.ndim(value) == 0:
                    told.attrs[name] = value
                else:
                    told.create_dataset(name, data=np.asarray(value))


def _write_npz(path: Path, events: EventArray, truth: Truth) -> None:
    np.savez_compressed(
        path,
        allow_pickle=False,
        **_columns(events),
        width=events.width,
        height=events.height,
        time_unit="us",
        **{
            f"{code}/{name}": np.asarray(value)
            for code, fields in truth.items()
            for name, value in fields.items()
        },
    )
