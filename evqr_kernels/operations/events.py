"""Operations from events to images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.operation import (
    IMAGE,
    SPLAT,
    Arrays,
    Input,
    Operation,
    Sizes,
    Variant,
    accumulated,
    floats,
    ints,
    overwritten,
    scratch,
    setting,
    size,
)


def _positive_side(frame: NDArray[Any]) -> None:
    if not (frame[:, 2] > 0).all():
        raise ValueError(f"frame must have a positive scale, got {frame[:, 2].min()}")


FAR = 100.0
"""A reference time that many times as far away as events are apart is none of theirs."""


def _relative_times(arrays: Arrays, sizes: Sizes) -> None:
    """Refuse absolute times, which would bring all events to where no image is."""
    t = arrays["t"]
    if len(t) < 2 or t[0] <= 0 <= t[-1]:
        return
    first, last, motion, frame = float(t.min()), float(t.max()), arrays["motion"], arrays.get("frame")
    away = max(first, -last)
    if motion.size and away > FAR * (last - first):
        side = 1.0 if frame is None else float(frame[:, 2].max())
        if away * float(np.abs(motion[:, :2]).max()) > (sizes["Y"] + sizes["X"]) * side:
            raise ValueError(
                f"t must be relative to the window's reference time, got {first} to {last}: subtract it, in "
                "the clock's own integers or in float64"
            )


CHUNK = 64
"""Events of a window that one thread takes, or more where the window has more than most."""

PARTS = "parts(E, tile * max(B, 1))"
"""Threads that the events of a window are shared out among."""

CHUNKED = (Variant(tile=CHUNK),)
WINDOWS = ints("window_ptr", "B + 1", ascending=True)
FRAME = floats("frame", "B", 3, default=(0.0, 0.0, 1.0), check=_positive_side)
COLUMNS = (floats("x", "E"), floats("y", "E"), floats("t", "E"), floats("weight", "E"), WINDOWS)
SPLATTED = (*COLUMNS, floats("motion", "B", "P", choices=(2, 6)), floats("lag", "B", 2, default=0.0), FRAME)
DEPOSITED = (*COLUMNS, floats("motion", "B", 2), FRAME)

PACKED = (
    ints("x", "E", integers=np.uint16),
    ints("y", "E", integers=np.uint16),
    ints("stamp", "E", integers=np.uint32),
    ints("window_ptr", "B", 2, ranges="E"),
)
BLOCKED = (
    Variant(tile=8, width=8, device="cpu", backend="taichi"),
    Variant(tile=CHUNK, width=CHUNK, device="cpu"),
    Variant(device="cpu"),
    Variant(threads=512),
)

BLURRED: tuple[Input, ...] = (
    ints("deposit_idx", "N", index="B"),
    floats("direction", "N", 2),
    floats("lag", "N", 2),
    floats("taps", 2, "K"),
)


def _extent(rows: str) -> Input:
    """Rows and columns of each image that are its own: by default all."""
    return ints("extent", rows, 2, default=("Y", "X"), most=("Y", "X"))


def _odd_taps(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["K"] < 3 or sizes["K"] % 2 == 0:
        raise ValueError(
            f"taps must have shape (2, K) with K odd and at least 3, got {tuple(arrays['taps'].shape)}"
        )


OPERATIONS = (
    Operation(
        name="bin_events",
        file="splat",
        arguments=(
            floats("x", "E"),
            floats("y", "E"),
            floats("weight", "E"),
            WINDOWS,
            setting("reduction", 1e-6),
            accumulated("image_out", "B", "Y", "X"),
        ),
        parameters=(IMAGE,),
        variants=CHUNKED,
    ),
    Operation(
        name="splat_events",
        file="splat",
        arguments=(*SPLATTED, accumulated("image_out", "B", "Y", "X"), SPLAT),
        parameters=(IMAGE,),
        variants=CHUNKED,
        adjoint="splat_events_adjoint",
        check_values=_relative_times,
    ),
    Operation(
        name="splat_events_adjoint",
        file="splat_adjoint",
        arguments=(
            *SPLATTED,
            floats("adj_image", "B", "Y", "X"),
            scratch("chunks_out", "B", PARTS, "P"),
            overwritten("adj_weight_out", "E"),
            overwritten("adj_motion_out", "B", "P"),
            overwritten("adj_x_out", "E"),
            overwritten("adj_y_out", "E"),
            SPLAT,
        ),
        variants=CHUNKED,
        check_values=_relative_times,
    ),
    Operation(
        name="deposit_events",
        file="lag",
        arguments=(*DEPOSITED, accumulated("deposit_out", "B", 2, "Y", "X")),
        parameters=(IMAGE,),
        variants=CHUNKED,
        adjoint="deposit_events_adjoint",
        check_values=_relative_times,
    ),
    Operation(
        name="deposit_events_adjoint",
        file="lag_adjoint",
        arguments=(
            *DEPOSITED,
            floats("adj_deposit", "B", 2, "Y", "X"),
            scratch("chunks_out", "B", PARTS, 2),
            overwritten("adj_weight_out", "E"),
            overwritten("adj_motion_out", "B", 2),
            overwritten("adj_x_out", "E"),
            overwritten("adj_y_out", "E"),
        ),
        variants=CHUNKED,
        check_values=_relative_times,
    ),
    Operation(
        name="bin_packed_events",
        file="packed",
        arguments=(*PACKED, setting("reduction", 1e-6), accumulated("image_out", "B", "Y", "X")),
        parameters=(IMAGE,),
        variants=BLOCKED,
    ),
    Operation(
        name="deposit_packed_events",
        file="packed",
        arguments=(
            *PACKED,
            ints("t_ref", "B"),
            floats("motion", "B", 2),
            FRAME,
            _extent("B"),
            accumulated("deposit_out", "B", 2, "Y", "X"),
        ),
        parameters=(IMAGE,),
        variants=BLOCKED,
    ),
    Operation(
        name="lag_operator",
        file="lag",
        arguments=(
            floats("deposit", "B", 2, "Y", "X"),
            *BLURRED,
            _extent("N"),
            scratch("rows_out", "N", 2, "Y", "X"),
            overwritten("image_out", "N", "Y", "X"),
        ),
        # of more than eight Taichi's compiler makes no vectors
        variants=(
            Variant(tile=8, width=8, device="cpu", backend="taichi"),
            Variant(tile=16, width=16, device="cpu"),
            Variant(tile=4, width=4),
            Variant(),
        ),
        adjoint="lag_operator_adjoint",
        check=_odd_taps,
    ),
    Operation(
        name="lag_operator_adjoint",
        file="lag_adjoint",
        arguments=(
            *BLURRED,
            _extent("N"),
            floats("adj_image", "N", "Y", "X"),
            scratch("rows_out", "N", 2, "Y", "X"),
            overwritten("adj_deposit_out", "B", 2, "Y", "X"),
        ),
        parameters=(size("deposits", "B", least=0),),
        # on a GPU the sums of more than one cell do not fit its registers
        variants=(Variant(tile=16, width=16, device="cpu"), Variant()),
        check=_odd_taps,
    ),
)
