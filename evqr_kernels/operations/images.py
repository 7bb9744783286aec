"""Operations from images to motion and to places of templates."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from evqr_kernels.operation import (
    Arrays,
    Operation,
    Sizes,
    Variant,
    floats,
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


def _interior(arrays: Arrays, sizes: Sizes) -> None:
    if min(sizes["Y"], sizes["X"]) < 3:
        raise ValueError(f"response must have at least 3 rows and columns, got {sizes['Y']} and {sizes['X']}")


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
            floats("basis", "N", "N", 5),
            floats("mix", "A", 5),
            ints("spans", "N", 2, check=_spans),
            setting("quiet", 0.0),
            setting("least", 0.0),
            scratch("squares_out", "B", "Y + 1", "X"),
            scratch("floor_out", "B"),
            scratch("sums_out", "B", 6, *RESPONSE[1:]),
            overwritten("response_out", *RESPONSE),
            overwritten("angle_out", *RESPONSE, integer=True),
        ),
        variants=(Variant(tile=16, width=16, device="cpu"), Variant(tile=4, width=4), Variant()),
    ),
    Operation(
        name="local_maxima",
        file="peaks",
        arguments=(
            floats("response", "B", "Y", "X"),
            ints("angle", "B", "Y", "X"),
            setting("least", 0.0),
            setting("cell", 0.0),
            setting("size", 0.0),
            setting("turn"),
            overwritten("maxima_out", "B", "Y", "most", 5),
        ),
        parameters=(size("most", least=1),),
        # passed over together where all of them are 0, as most are; a GPU's registers do not hold them
        variants=(Variant(tile=8, device="cpu"), Variant()),
        check=_interior,
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
)
