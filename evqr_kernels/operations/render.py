"""Operations from a planar code to what its motion makes events of, and back."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from evqr_kernels.operation import (
    IMAGE,
    Arrays,
    Operation,
    Sizes,
    Variant,
    floats,
    overwritten,
    scratch,
    setting,
)


def _not_negative(mask: NDArray[Any]) -> None:
    if mask.size and not mask.min() >= 0.0:
        raise ValueError(f"mask must be at least 0.0, got {float(mask.min())}")


CODE = (
    floats("grid", "B", "G", "H"),
    floats("to_grid", "B", "P", choices=(6, 8)),
    floats("outside", "B"),
    setting("sigma"),
)
LUMINANCE = floats("luminance", "B", "Y", "X")
MOTION = floats("motion", "B", 2)
RESIDUAL = (LUMINANCE, floats("events_image", "B", "Y", "X"), MOTION)
PIXELS = (
    Variant(tile=16, device="cpu"),
    Variant(tile=4, backend="taichi"),
    Variant(),
)
"""Neighbours in a row whose sums a thread has the registers for."""

COST = (*RESIDUAL, floats("mask", "B", "Y", "X", default=1.0, check=_not_negative))


def _blur(arrays: Arrays, sizes: Sizes) -> None:
    sigma = sizes["sigma"]
    if not (sigma == 0.0 or 0.02 <= sigma <= 1.0):
        raise ValueError(f"sigma must be 0, or 0.02 to 1, got {sigma}")
    if not sizes["G"] * sizes["H"]:
        raise ValueError(f"grid must have at least one node, got shape {tuple(arrays['grid'].shape)}")


OPERATIONS = (
    Operation(
        name="render_code",
        file="render",
        arguments=(*CODE, overwritten("image_out", "B", "Y", "X")),
        parameters=(IMAGE,),
        adjoint="render_code_adjoint",
        check=_blur,
    ),
    Operation(
        name="render_code_adjoint",
        file="render_adjoint",
        arguments=(
            *CODE,
            floats("adj_image", "B", "Y", "X"),
            scratch("rows_out", "B", "Y", "P"),
            overwritten("adj_grid_out", "B", "G", "H"),
            overwritten("adj_to_grid_out", "B", "P"),
        ),
        check=_blur,
    ),
    Operation(
        name="brightness_residual",
        file="residual",
        arguments=(*RESIDUAL, overwritten("residual_out", "B", "Y", "X")),
        variants=PIXELS,
        adjoint="brightness_residual_adjoint",
        passes_on=("events_image",),
    ),
    Operation(
        name="brightness_residual_adjoint",
        file="residual",
        arguments=(
            LUMINANCE,
            MOTION,
            floats("adj_residual", "B", "Y", "X"),
            scratch("rows_out", "B", "Y", 2),
            overwritten("adj_luminance_out", "B", "Y", "X"),
            overwritten("adj_motion_out", "B", 2),
        ),
        variants=PIXELS,
    ),
    Operation(
        name="brightness_cost",
        file="cost",
        arguments=(*COST, scratch("rows_out", "B", "Y"), overwritten("cost_out", "B")),
        variants=PIXELS,
        adjoint="brightness_cost_adjoint",
    ),
    Operation(
        name="brightness_cost_adjoint",
        file="cost",
        arguments=(
            *COST,
            floats("adj_cost", "B"),
            scratch("rows_out", "B", "Y", 2),
            overwritten("adj_luminance_out", "B", "Y", "X"),
            overwritten("adj_events_image_out", "B", "Y", "X"),
            overwritten("adj_motion_out", "B", 2),
        ),
        variants=(Variant(tile=32, device="cpu", backend="warp"), *PIXELS),
    ),
)
