"""What others offer for the same computations, on one thread: numba, torch, SciPy, OpenCV, event libraries.

A function prepares a rival for a problem, which is not timed, and gives what runs it; the result is what the
problem's outputs, scratch left out, are after one call.  Where a problem adds to its output a rival may do so
too.  `PEERS` says what each needs to be installed.
"""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import peers_numba
import peers_torch
from problems import Problem

Run = Callable[[], list[Any]]


@dataclass(frozen=True)
class Peer:
    """A rival for an operation.

    Attributes
    ----------
    needs       module to import
    prepare     gives what runs it; raises ValueError where it has not the problem's kind
    tolerance   how far from the specification it may be, relative to the largest value
    """

    op: str
    name: str
    needs: str
    prepare: Callable[[Problem], Run]
    tolerance: float = 1e-4

    @property
    def missing(self) -> str:
        """Say why it cannot run here; empty where it can."""
        return "" if importlib.util.find_spec(self.needs) else f"{self.needs} is not installed"


def _places(to_grid: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Give where each pixel looks, for an affine map."""
    x = np.arange(side, dtype=to_grid.dtype)
    y = x[:, None]
    w = to_grid
    return w[0] * x + (w[1] * y + w[2]), w[3] * x + (w[4] * y + w[5])


def render_scipy(problem: Problem) -> Run:
    from scipy.ndimage import map_coordinates

    grid, to_grid, outside, _ = problem.inputs
    image = np.empty_like(problem.outputs[0])

    def run() -> list[Any]:
        for b, picture in enumerate(image):
            u, v = _places(to_grid[b], len(picture))
            map_coordinates(grid[b], [v, u], output=picture, order=1, mode="grid-constant", cval=outside[b])
        return [image]

    return run


def render_opencv(problem: Problem) -> Run:
    import cv2

    grid, to_grid, outside, _ = problem.inputs
    image = np.empty_like(problem.outputs[0])
    cv2.setNumThreads(1)

    def run() -> list[Any]:
        for b, picture in enumerate(image):
            u, v = _places(to_grid[b], len(picture))
            cv2.remap(
                grid[b],
                u,
                v,
                cv2.INTER_LINEAR,
                dst=picture,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(float(outside[b]),),
            )
        return [image]

    return run


def _integer_events(problem: Problem) -> list[tuple[np.ndarray, ...]]:
    """Give column, row and polarity of each window's events, for libraries of sensors' events."""
    x, y, weight, window_ptr, _ = problem.inputs
    column, row = (np.floor(position + 0.5).astype(np.int16) for position in (x, y))
    parts = itertools.pairwise(window_ptr)
    return [(column[a:b], row[a:b], weight[a:b] > 0) for a, b in parts]


def bin_dv(problem: Problem) -> Run:
    import dv_processing as dv

    side, most = problem.outputs[0].shape[-1], 1e6
    windows = []
    for column, row, positive in _integer_events(problem):
        store = dv.EventStore()
        for t, event in enumerate(zip(column.tolist(), row.tolist(), positive.tolist(), strict=True)):
            store.push_back(t, *event)
        none = dv.Accumulator.Decay.NONE
        accumulator = dv.Accumulator((side, side), none, 1.0, False, 1.0, most, 0.0, -most, False)
        windows.append((accumulator, store))

    def run() -> list[Any]:
        for accumulator, store in windows:
            accumulator.accept(store)
        return [np.stack([accumulator.getPotentialSurface() for accumulator, _ in windows])]

    return run


def bin_eventcv(problem: Problem) -> Run:
    """Take the difference of counts of ON and of OFF events, which are told apart before, untimed."""
    import eventcv

    side = problem.outputs[0].shape[-1]
    windows = []
    for column, row, positive in _integer_events(problem):
        events = np.stack([column, row, np.arange(len(row)), positive], axis=1).astype(np.int64)
        options = {"sensor_size": (side, side), "time_unit": "us"}
        windows.append([eventcv.from_numpy(events[positive == on], **options) for on in (True, False)])

    def run() -> list[Any]:
        counts = [[stream.count().numpy().astype(np.float32) for stream in pair] for pair in windows]
        return [np.stack([(on - off).reshape(side, side) for on, off in counts])]

    return run


def bin_evlib(problem: Problem) -> Run:
    """Make an image of the table of pixels that it gives."""
    import evlib.representations
    import polars

    image = problem.outputs[0]
    side, windows = image.shape[-1], []
    for column, row, positive in _integer_events(problem):
        t = polars.Series(np.arange(len(row))).cast(polars.Duration("us"))
        windows.append(
            polars.DataFrame({"t": t, "x": column, "y": row, "polarity": np.where(positive, 1, -1)})
        )

    def run() -> list[Any]:
        pictures = np.zeros_like(image)
        for picture, events in zip(pictures, windows, strict=True):
            found = evlib.representations.create_stacked_histogram(
                events, side, side, bins=1, window_duration_ms=1e6
            )
            column, row, count, sign = (found[name].to_numpy() for name in ("x", "y", "count", "polarity"))
            np.add.at(picture, (row, column), np.where(sign > 0, count, -count.astype(picture.dtype)))
        return [pictures]

    return run


PEERS = (
    Peer("bin_events", "numba", "numba", peers_numba.bin_events),
    Peer("bin_events", "torch index_put_", "torch", peers_torch.bin_events),
    Peer("bin_events", "dv-processing", "dv_processing", bin_dv),
    Peer("bin_events", "eventcv", "eventcv", bin_eventcv),
    Peer("bin_events", "evlib", "evlib", bin_evlib),
    Peer("splat_events", "numba", "numba", peers_numba.splat_events),
    Peer("splat_events", "torch index_put_", "torch", peers_torch.splat_index_put),
    Peer("splat_events", "torch scatter_add_", "torch", peers_torch.splat_scatter_add),
    Peer("splat_events_adjoint", "torch autograd", "torch", peers_torch.splat_adjoint),
    Peer("render_code", "numba", "numba", peers_numba.render_code),
    Peer("render_code", "torch grid_sample", "torch", peers_torch.render_code),
    Peer("render_code", "SciPy map_coordinates", "scipy", render_scipy),
    # its shares of neighbours are multiples of 1/32
    Peer("render_code", "OpenCV remap", "cv2", render_opencv, tolerance=0.05),
    Peer("render_code_adjoint", "torch autograd", "torch", peers_torch.render_adjoint),
    Peer("cost", "torch autograd", "torch", peers_torch.cost),
)
