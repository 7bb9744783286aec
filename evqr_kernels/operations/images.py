"""Operations from images to motion and to places of templates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels.operation import (
    Arrays,
    Operation,
    Sizes,
    Variant,
    floats,
    in_part,
    in_place,
    ints,
    overwritten,
    scratch,
    setting,
    size,
)

NEWTON_STEPS = 6
"""From the highest entry of a surface to the peak beside it: two, and then with the middle entry mended."""

SHIFTS = "2 * radius + 1"
RESPONSE = ("B", "max(0, Y - N + 1)", "max(0, X - N + 1)")


def taps_beside(half: float) -> int:
    """Give how many entries a window of that half width reaches to on one side."""
    return math.ceil(half) - 1


def _odd_surface(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["N"] < 3 or sizes["N"] % 2 == 0:
        raise ValueError(f"surface must have an odd size of at least 3, got {sizes['N']}")
    most = (sizes["N"] + 1) // 2
    if sizes["half"] > most:
        raise ValueError(f"half must be at most {most} for {sizes['N']} entries, got {sizes['half']}")


def _within(arrays: Arrays, height: int, width: int) -> None:
    """Refuse levels that do not lie in the response, where the host can read where they lie."""
    rows, extent = arrays["rows"], arrays["extent"]
    if not (isinstance(rows, np.ndarray) and isinstance(extent, np.ndarray)):
        return
    levels = extent.shape[1]
    if rows[:, 0].max(initial=-1) >= levels:
        raise ValueError(f"rows must be of levels up to {levels - 1}, got {rows[:, 0].max()}")
    for k in range(levels):
        of_level = rows[rows[:, 0] == k, 1]
        if (of_level != np.arange(len(of_level))).any():
            raise ValueError(f"rows of level {k} must be 0, 1, ..., got {of_level.tolist()}")
        if extent[:, k, 0].max(initial=0) > len(of_level):
            raise ValueError(f"extent must be at most {len(of_level)} rows of level {k}")
    if extent.min(initial=0) < 0 or extent[..., 1].max(initial=0) > width:
        raise ValueError(f"extent must be 0 to {width} columns")


def _levels(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["A"] < 1:
        raise ValueError(f"mix must have at least one template, got shape {tuple(arrays['mix'].shape)}")
    high, wide = (max(0, sizes[side] - sizes["N"] + 1) for side in "YX")
    if sizes["R"] != high:
        raise ValueError(f"rows must have shape (R, 2) with R = {high}, got {tuple(arrays['rows'].shape)}")
    _within(arrays, high, wide)


def _levels_of_response(arrays: Arrays, sizes: Sizes) -> None:
    _within(arrays, sizes["Y"], sizes["X"])


def _spans(spans: NDArray[Any]) -> None:
    n = len(spans)
    if n and not (spans.min() >= 0 and spans.max() <= n and (spans[:, 0] <= spans[:, 1]).all()):
        raise ValueError(f"spans must be 0 to {n} and not decrease, got {spans.min()} to {spans.max()}")


OPERATIONS = (
    Operation(
        name="motion_correlation",
        file="motion",
        arguments=(
            in_place("images_inout", "B", 2, "Y", "X", start="images", returned=False),
            floats("quiet", "B", 2, default=0.0),
            setting("clip", 0.0),
            setting("radius", 0),
            scratch("found_out", "B", "Y", "X", integer=True),
            scratch("rows_out", "B", "Y", SHIFTS, f"up({SHIFTS}, tile)"),
            scratch("energy_rows_out", "B", "Y", 4),
            scratch("busy_out", "B", integer=True),
            overwritten("correlation_out", "B", SHIFTS, SHIFTS),
            overwritten("energy_out", "B", 2),
        ),
        variants=(
            Variant(tile=16, rows=4, device="cpu"),
            Variant(tile=16, backend="taichi"),
            Variant(tile=4, rows=2),
        ),
    ),
    Operation(
        name="surface_peak",
        file="motion",
        arguments=(
            floats("surface", "B", "N", "N"),
            setting("half", 1.0),
            scratch("filled_out", "B", "N", "N"),
            scratch("rows_out", "B", "N + 3", "N"),
            overwritten("peak_out", "B", 3),
        ),
        check=_odd_surface,
    ),
    Operation(
        name="clip_outliers",
        file="images",
        arguments=(
            floats("image", "B", "Y", "X"),
            setting("factor", 0.0),
            scratch("rows_out", "B", "Y", 2),
            scratch("limit_out", "B"),
            overwritten("image_out", "B", "Y", "X"),
            overwritten("busy_out", "B"),
        ),
    ),
    Operation(
        name="reduce_image",
        file="images",
        arguments=(
            floats("image", "B", "Y", "X"),
            setting("ratio", 1.0),
            scratch("rows_out", "B", "ceil(Y / ratio)", "X"),
            overwritten("image_out", "B", "ceil(Y / ratio)", "ceil(X / ratio)"),
        ),
        variants=(Variant(rows=8, device="cpu"), Variant()),
    ),
    Operation(
        name="mix_images",
        file="images",
        arguments=(
            floats("images", "M", "K", "Y", "X", single=True),
            ints("image_idx", "N", index="M", default=0),
            floats("weight", "N", "K"),
            overwritten("images_out", "N", "Y", "X"),
        ),
        variants=(
            Variant(tile=16, width=16, device="cpu"),
            Variant(tile=16, width=16, backend="warp"),
            Variant(tile=4, width=4),
            Variant(),
        ),
    ),
    Operation(
        name="correlate_templates",
        file="templates",
        arguments=(
            floats("image", "B", "Y", "X"),
            floats("busy", "B"),
            floats("basis", "B", "N", "N", 5),
            floats("mix", "B", "A", 5),
            ints("spans", "N", 2, check=_spans),
            ints("rows", "R", 2),
            ints("extent", "B", "K", 2),
            floats("quiet", "K"),
            setting("first", 0.0),
            setting("least", 0.0),
            scratch("squares_out", "B", "Y + 1", "X"),
            scratch("floor_out", "B", "K"),
            scratch("sums_out", "B", 6, *RESPONSE[1:]),
            in_part("response_out", *RESPONSE),
            in_part("angle_out", *RESPONSE, integer=True),
        ),
        # the first term alone has few sums to keep, so that more neighbours are taken together on a CPU
        variants=(Variant(tile=16, rows=4, width=16, device="cpu"), Variant(tile=4, width=4), Variant()),
        check=_levels,
    ),
    Operation(
        name="local_maxima",
        file="peaks",
        arguments=(
            floats("response", "B", "Y", "X"),
            ints("angle", "B", "Y", "X"),
            ints("rows", "Y", 2),
            ints("extent", "B", "K", 2),
            floats("levels", "K", 2),
            floats("origin", "B", 2),
            setting("least", 0.0),
            setting("turn"),
            overwritten("maxima_out", "B", "Y", "most", 5),
        ),
        parameters=(size("most", least=1),),
        # passed over together where all of them are 0, as most are; a GPU's registers do not hold them
        variants=(Variant(tile=8, device="cpu"), Variant()),
        check=_levels_of_response,
    ),
    Operation(
        name="merge_maxima",
        file="peaks",
        arguments=(
            floats("maxima", "B", "N", 5),
            setting("apart", 0.0),
            setting("log_ratio", 0.0),
            scratch("strength_out", "B", "N"),
            scratch("index_out", "B", "N", integer=True),
            overwritten("peaks_out", "B", "most", 5),
        ),
        parameters=(size("most", least=1),),
    ),
    Operation(
        name="match_corners",
        file="peaks",
        arguments=(
            floats("peaks", "B", "P", 5),
            floats("tolerances", 5),
            scratch("ends_out", "B", "P", "P", integer=True),
            scratch("legs_out", "B", "P", "P", 3),
            overwritten("triples_out", "B", "P", "most", 4),
        ),
        parameters=(size("most", least=1),),
    ),
    Operation(
        name="line_runs",
        file="runs",
        arguments=(
            floats("image", "B", "Y", "X"),
            floats("slope", "A"),
            ints("steep", "A"),
            floats("threshold", "B", "A"),
            setting("most", 1.0),
            overwritten("runs_out", "B", "A", 2, "lines"),
        ),
        parameters=(size("lines", least=1),),
        variants=(Variant(tile=16, device="cpu"), Variant(tile=1)),
    ),
)
