"""Operations from events to grids of pixels, polarity and time, as networks take them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.operation import (
    IMAGE,
    Operation,
    accumulated,
    floats,
    overwritten,
    setting,
    size,
)
from evqr_kernels.operations.events import CHUNKED, COLUMNS, WINDOWS


def _after(span: NDArray[Any]) -> None:
    bad = ~(np.isfinite(span).all(axis=1) & (span[:, 0] < span[:, 1]))
    if bad.any():
        first, last = span[int(np.argmax(bad))]
        raise ValueError(f"span must end after it begins, got {first} to {last}")


PLANES = (*COLUMNS, floats("span", "B", 2, check=_after))

OPERATIONS = (
    Operation(
        name="voxel_grid",
        file="voxels",
        arguments=(*PLANES, accumulated("grid_out", "B", "K", "Y", "X")),
        parameters=(size("bins", "K", least=1), IMAGE),
        variants=CHUNKED,
        adjoint="voxel_grid_adjoint",
    ),
    Operation(
        name="voxel_grid_adjoint",
        file="voxels",
        arguments=(
            *PLANES,
            floats("adj_grid", "B", "K", "Y", "X"),
            overwritten("adj_weight_out", "E"),
            overwritten("adj_t_out", "E"),
        ),
    ),
    Operation(
        name="time_surface",
        file="pixels",
        arguments=(*COLUMNS, setting("decay", 0.0), overwritten("surface_out", "B", 2, "Y", "X")),
        parameters=(IMAGE,),
        variants=CHUNKED,
    ),
    Operation(
        name="event_histogram",
        file="pixels",
        arguments=(
            floats("x", "E"),
            floats("y", "E"),
            floats("weight", "E"),
            WINDOWS,
            accumulated("counts_out", "B", 2, "Y", "X", integer=True),
        ),
        parameters=(IMAGE,),
        variants=CHUNKED,
    ),
)
