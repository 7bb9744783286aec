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
TERMS = (ints("terms", "P + 2", 4, index="C"), ints("factors", "P + 2", 4))
LATTICE = (
    floats("image", "B", "Y", "X"),
    floats("pose", "B", 9),
    floats("lattice_u", "S"),
    floats("lattice_v", "T"),
    floats("profile", "P"),
    floats("slope", "P"),
    floats("gain", "B", 2),
    setting("samples_a_module", 1),
    scratch("samples_out", "B", "T", "S"),
    scratch("rows_out", "B", 2, "T", "S // samples_a_module"),
)
RHS = overwritten("rhs_out", "B", "T // samples_a_module", "S // samples_a_module")
SYSTEM = (floats("stencil", "B", "K", "K"), floats("damping", "B"), ints("free", "V", "U"))
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


def _alignable(arrays: Arrays, sizes: Sizes) -> None:
    for name in ("centre", "scale"):
        if np.shape(sizes[name]) != (2,):
            raise ValueError(f"{name} must be two numbers, along u and v, got {sizes[name]}")
    _parameters(arrays, sizes)


def _odd_stencil(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["K"] % 2 == 0:
        raise ValueError(f"stencil must have an odd side, got {tuple(arrays['stencil'].shape)}")


def _finite(arrays: Arrays, sizes: Sizes) -> None:
    if sizes["certainty"] == np.inf:  # times zero, of modules that lean nowhere
        raise ValueError("certainty must be finite, got inf")


def _gram(given: Sizes, dtype: np.dtype[Any]) -> Any:
    return given["table"].T @ given["table"]


def _packed(given: Sizes, dtype: np.dtype[Any]) -> Any:
    return np.array(
        [*given["centre"], *given["scale"], *(given[name] for name in ("ridge", "damping", "tolerance"))],
        dtype,
    )


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
            floats("points", "S", 2),
            floats("table", "S", "C"),
            floats("gram", "C", "C", made=_gram),
            *TERMS,
            floats("settings", 7, made=_packed),
            setting("max_iterations", 0),
            in_place("pose_inout", "N", 9, start="pose"),
            overwritten("result_out", "N", 5),
        ),
        parameters=tuple(map(setting, ("centre", "scale", "ridge", "damping", "tolerance"))),
        check=_alignable,
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
            *SYSTEM,
            setting("max_iterations", 0),
            setting("tolerance"),
            scratch("residual_out", "B", "V", "U"),
            scratch("direction_out", "B", "V", "U"),
            scratch("next_direction_out", "B", "V", "U"),
            scratch("product_out", "B", "V", "U"),
            scratch("sums_out", "B", 4, "V"),
            scratch("next_sums_out", "B", 4, "V"),
            SOLUTION,
            overwritten("iterations_out", "B", integer=True),
        ),
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
