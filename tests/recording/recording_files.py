"""Small recordings of every format that evqr reads without an extra."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from evqr.events.array import EventArray
from evqr.recording import save_recording

WIDTH, HEIGHT = 64, 48


def make_events(count: int, *, span_us: int = 20_000, start_us: int = 1_000, seed: int = 0) -> EventArray:
    """Random events in order of time, about 16 a pixel and second for 1000 of them."""
    rng = np.random.default_rng(seed)
    return EventArray(
        t=np.sort(rng.integers(0, span_us, count)) + start_us,
        x=rng.integers(0, WIDTH, count).astype(np.uint16),
        y=rng.integers(0, HEIGHT, count).astype(np.uint16),
        p=rng.choice(np.array([-1, 1], np.int8), count),
        width=WIDTH,
        height=HEIGHT,
    )


def assert_same_events(got: EventArray, expected: EventArray) -> None:
    assert (got.width, got.height) == (expected.width, expected.height)
    for column, dtype in (("t", np.int64), ("x", np.uint16), ("y", np.uint16), ("p", np.int8)):
        assert getattr(got, column).dtype == dtype
        np.testing.assert_array_equal(getattr(got, column), getattr(expected, column), err_msg=column)


def structured(events: EventArray, dtype: list[tuple[str, str]], p: np.ndarray) -> np.ndarray:
    """Structured array with the columns t, x, y, p in the fields of ``dtype``, in this order."""
    array = np.empty(len(events), dtype)
    for (field, _), values in zip(dtype, (events.t, events.x, events.y, p), strict=True):
        array[field] = values
    return array


def write_h5(path: Path, events: EventArray) -> None:
    with path.open("wb") as file, h5py.File(file, "w") as h5:
        h5.attrs["width"], h5.attrs["height"] = WIDTH, HEIGHT
        for column, values in (("t", events.t), ("x", events.x), ("y", events.y), ("p", events.p > 0)):
            h5.create_dataset(f"events/{column}", data=values, chunks=(64,), compression="gzip")


def write_npz(path: Path, events: EventArray) -> None:
    save_recording(path.with_suffix(".npz"), events)
    path.with_suffix(".npz").replace(path)


def write_npy(path: Path, events: EventArray) -> None:
    dtype = [("timestamp", "<i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "i1")]
    with path.open("wb") as file:
        np.save(file, structured(events, dtype, events.p))


def write_text(path: Path, events: EventArray) -> None:
    rows = zip(events.t.tolist(), events.x, events.y, (events.p > 0).astype(int), strict=True)
    lines = [f"{WIDTH} {HEIGHT}", *(f"{t / 1e6:.9g} {x} {y} {p}" for t, x, y, p in rows)]
    path.write_text("\n".join(lines) + "\n")


WRITERS: dict[str, Callable[[Path, EventArray], None]] = {
    "h5": write_h5,
    "npz": write_npz,
    "npy": write_npy,
    "text": write_text,
}
