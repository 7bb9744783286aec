"""Operations on a planar code: its pose, and its modules."""

from __future__ import annotations

from typing import Any

import numpy as np

from evqr_kernels.operation import (
    Arrays,
    Operation,
    Sizes,
    Variant,
    accumulated,
    floats,
    in_part,
    in_place,
    ints,
    overwritten,
    scratch,
    setting,
    size,
)

SAMPLED = (
    floats("image", "B", "Y", "X"),
    ints("image_idx", "N", index="B"),
    floats("pose", "N", 9),
    ints("active", "N", default=1),
    floats("points", "S", 2),
    floats("table", "S", "C"),
)
IN_PART = ints("image_part", "N", 3, default=(0, "Y", "X"), most=("Y", "Y", "X"))
"""Of its image what a pose looks at: first row, rows and columns."""
TERMS = (ints("terms", "P + 2", 4, index="C"), ints("factors", "P + 2", 4, most=(3, 3, 3, 3)))
ROWS, COLUMNS = "T // samples_a_module", "S // samples_a_module"
"""Modules of the largest code along each axis of its lattice."""
REACH = "ceil(max(0, P - samples_a_module) / (2 * samples_a_module))"
"""Modules beside a module that its profile covers."""
PHASES = f"samples_a_module * up({COLUMNS} + 2 * {REACH}, 8)"
"""A row of samples: the first of each module, then the second of each, ...; zeros on either side."""


LATTICE = (
    floats("image", "B", "Y", "X"),
    floats("pose", "B", 9),
    ints("space_idx", "B", index="M", default=0),
    floats("lattice_u", "M", "S", single=True),
    floats("lattice_v", "M", "T", single=True),
    ints("sides", "M", 2, default=(ROWS, COLUMNS), most=(ROWS, COLUMNS)),
    floats("profile", "P"),
    floats("slope", "P"),
    floats("gain", "B", 2),
    setting("samples_a_module", 1),
    scratch("samples_out", "B", "T", PHASES),
    scratch("rows_out", "B", 2, ROWS, PHASES),
)
RHS = overwritten("rhs_out", "B", ROWS, COLUMNS)
SYSTEM = (floats("stencil", "B", "K", "K"), floats("damping", "B"), ints("free", "V", "U"))
BLOCKS = Variant(device="cpu"), Variant(lanes=64, backend="taichi"), Variant(lanes=256)
"""A thread for a window or a pose on a CPU, many on a GPU."""

SOLUTION = in_place("q_inout", "B", "V", "U", start="start")


def _some_columns(arrays: Arrays, sizes: Sizes) -> None:
    _at_least("C", sizes["C"], 1)


def _at_least(letter: str, value: int, least: int) -> None:
    if value < least:
        raise ValueError(f"{letter} must be at least {least}, got {value}")


def _parameters(arrays: Arrays, sizes: Sizes) -> None:
    terms = tuple(arrays["terms"].shape)
    if terms[0] not in (8, 10):
        raise ValueError(f"terms must have shape (8, 4) or (10, 4), got {terms}")
    _at_least("C", sizes["C"], 2)


def _in_parts(arrays: Arrays, sizes: Sizes) -> None:
    part = arrays["image_part"]
    if isinstance(part, np.ndarray) and (part[:, 0] + part[:, 1] > sizes["Y"]).any():
        raise ValueError(f"image_part must end within the {sizes['Y']} rows of an image")


def _alignable(arrays: Arrays, sizes: Sizes) -> None:
    _in_parts(arrays, sizes)
    for name in ("centre", "scale"):
        if np.shape(sizes[name]) not in ((2,), (sizes["M"], 2)):
            raise ValueError(f"{name} must be two numbers, along u and v, a table, got {sizes[name]}")
    _parameters(arrays, sizes)


def _odd_stencil(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["K"] % 2 == 0:
        raise ValueError(f"stencil must have an odd side, got {tuple(arrays['stencil'].shape)}")


def _odd_products(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["K"] % 2 == 0:
        raise ValueError(f"products must have odd sides, got {tuple(arrays['products'].shape)}")


def _finite(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["certainty"] == np.inf:  # times zero, of modules that lean nowhere
        raise ValueError("certainty must be finite, got inf")


def _grams(given: Sizes, dtype: np.dtype[Any]) -> Any:
    table, table_ptr = given["table"], given.get("table_ptr")
    parts = [table] if table_ptr is None else [table[first:end] for first, end in table_ptr]
    return np.stack([part.T @ part for part in parts])


def _packed(given: Sizes, dtype: np.dtype[Any]) -> Any:
    """Centre and scale along u and v, ridge, damping and tolerance of each table."""
    table_ptr = given.get("table_ptr")
    settings = np.empty((1 if table_ptr is None else len(table_ptr), 7), dtype)
    for columns, name in ((slice(0, 2), "centre"), (slice(2, 4), "scale"), (4, "ridge"), (5, "damping")):
        settings[:, columns] = given[name]
    settings[:, 6] = given["tolerance"]
    return settings


def _models(arrays: Arrays, sizes: Sizes) -> None:
    _in_parts(arrays, sizes)
    ptr = arrays["model_ptr"]
    if not isinstance(ptr, np.ndarray):
        return
    ends = ptr[:, 0].min(initial=0), ptr[:, 2].max(initial=0)
    if (np.diff(ptr, axis=1) < 0).any() or ends[0] < 0 or ends[1] > sizes["S"]:
        raise ValueError(f"rows of model_ptr must be 0 to {sizes['S']} and not decrease")


OPERATIONS = (
    Operation(
        name="sample_moments",
        file="pose",
        arguments=(
            *SAMPLED,
            scratch("chunks_out", "N", "parts(S, tile)", "C + 1"),
            in_part("moments_out", "N", "C + 1"),
        ),
        variants=(Variant(tile=512),),
        adjoint="sample_moments_adjoint",
        check=_some_columns,
    ),
    Operation(
        name="sample_moments_adjoint",
        file="pose",
        arguments=(
            *SAMPLED,
            floats("adj_moments", "N", "C + 1"),
            accumulated("adj_image_out", "B", "Y", "X"),
        ),
        # points one after another: a CPU looks up once what belongs to the pose, a GPU wants many threads
        variants=(Variant(tile=32, device="cpu"), Variant()),
        check=_some_columns,
    ),
    Operation(
        name="align_poses",
        file="align",
        arguments=(
            floats("image", "B", "Y", "X"),
            ints("image_idx", "N", index="B"),
            IN_PART,
            ints("table_idx", "N", index="M", default=0),
            floats("points", "S", 2),
            floats("table", "S", "C"),
            ints("table_ptr", "M", 2, ranges="S", default=(0, "S")),
            floats("gram", "M", "C", "C", made=_grams),
            *TERMS,
            ints("parameters", "M", default=8),
            floats("settings", "M", 7, made=_packed),
            setting("max_iterations", 0),
            in_place("pose_inout", "N", 9, start="pose"),
            overwritten("result_out", "N", 5),
        ),
        variants=BLOCKS,
        parameters=tuple(map(setting, ("centre", "scale", "ridge", "damping", "tolerance"))),
        check=_alignable,
    ),
    Operation(
        name="score_poses",
        file="pose_score",
        arguments=(
            floats("image", "B", "Y", "X"),
            ints("image_idx", "N", index="B"),
            IN_PART,
            floats("pose", "N", 9),
            ints("model_idx", "N", index="K"),
            ints("model_ptr", "K", 3),
            floats("model", "S", 4),
            setting("ridge", 0.0),
            overwritten("score_out", "N", 3),
        ),
        check=_models,
    ),
    Operation(
        name="pose_normal_equations",
        file="pose_normal",
        arguments=(
            floats("moments", "N", "C + 1"),
            floats("gram", "C", "C"),
            *TERMS,
            setting("ridge"),
            overwritten("gain_out", "N", 2),
            overwritten("matrix_out", "N", "P + 2", "P + 2"),
            overwritten("rhs_out", "N", "P + 2"),
        ),
        check=_parameters,
    ),
    Operation(name="code_rhs", file="code", arguments=(*LATTICE, RHS)),
    Operation(
        name="code_normal_equations",
        file="code_normal",
        arguments=(*LATTICE, overwritten("stencil_out", "B", "2 * reach + 1", "2 * reach + 1"), RHS),
        parameters=(size("reach", least=0),),
    ),
    Operation(
        name="code_product",
        file="code_normal",
        arguments=(floats("q", "B", "V", "U"), *SYSTEM, overwritten("product_out", "B", "V", "U")),
        check=_odd_stencil,
    ),
    Operation(
        name="sum_equations",
        file="equations",
        arguments=(
            floats("rhs", "B", "V", "U"),
            floats("gain", "B", 2),
            floats("noise", "B"),
            floats("products", 3, "K", "K"),
            floats("rhs_before", "B", "V", "U"),
            floats("stencil_before", "B", "K", "K"),
            floats("score", "B", default=1),
            floats("least", "B", default=0),
            ints("space_idx", "B", index="M", default=0),
            floats("known", "M", "V", "U", single=True),
            setting("damping", 0.0),
            setting("least_damping", 0.0),
            setting("most_damping", 0.0),
            overwritten("rhs_out", "B", "V", "U"),
            overwritten("stencil_out", "B", "K", "K"),
            overwritten("peak_out", "B"),
            overwritten("damping_out", "B"),
            overwritten("q_out", "B", "V", "U"),
            overwritten("solved_idx_out", "B", integer=True),
        ),
        check=_odd_products,
    ),
    Operation(
        name="pull_modules",
        file="pull",
        arguments=(
            floats("seen", "B", "V", "U"),
            floats("q", "B", "V", "U"),
            floats("damping", "B"),
            setting("certainty", 0.0),
            overwritten("rhs_out", "B", "V", "U"),
            overwritten("unclear_out", "B", "V", integer=True),
        ),
        check=_finite,
    ),
    Operation(
        name="solve_code",
        file="solve",
        arguments=(
            floats("rhs", "B", "V", "U"),
            *SYSTEM[:2],
            ints("space_idx", "B", index="M", default=0),
            ints("free", "M", "V", "U", single=True),
            ints("bounds", "M", 4, default=(0, "V", 0, "U"), most=("V", "V", "U", "U")),
            ints("unclear", "B", "V", default=1),
            ints("enough", "M", default=0),
            setting("max_iterations", 0),
            setting("tolerance"),
            scratch("fields_out", "B", 5, "V", "U"),
            scratch("direction_out", "B", "V + K - 1", "U + K - 1"),
            SOLUTION,
            overwritten("iterations_out", "B", integer=True),
        ),
        variants=BLOCKS,
        check=_odd_stencil,
    ),
    Operation(
        name="solve_code_banded",
        file="banded",
        arguments=(
            floats("rhs", "B", "V", "U"),
            *SYSTEM,
            scratch("band_out", "B", "V * U", "K // 2 * (min(V, U) + 1) + 1"),
            SOLUTION,
        ),
        variants=(Variant(tile=16, device="cpu"), Variant(tile=4)),
        check=_odd_stencil,
    ),
)
