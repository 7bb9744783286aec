"""The table of operations: backends, adjoints and documentation are as it says."""

import inspect

import numpy as np
import pytest
from backends import BACKENDS

from evqr_kernels import OPERATIONS, get_backend, ops
from evqr_kernels.differentiable import adjoint_of
from evqr_kernels.operation import Input, Output, Scratch, Variant, Written, buffers_behind, size_of

from .test_documentation import entries, resolved

every_operation = pytest.mark.parametrize("op", OPERATIONS)


@pytest.mark.parametrize("name", BACKENDS)
@every_operation
def test_launchers_take_the_arguments_of_the_table(name, op):
    parameters = inspect.signature(getattr(get_backend(name), op)).parameters
    assert list(parameters) == [argument.name for argument in OPERATIONS[op].arguments]


@every_operation
def test_arguments_are_in_order(op):
    """Inputs, then scratch, then outputs; what is written says so."""
    arguments = OPERATIONS[op].arguments
    order = Input, Scratch, Output
    kinds = [order.index(type(a)) for a in arguments if isinstance(a, order)]
    if op != "motion_correlation":  # whose images are clipped in place
        assert kinds == sorted(kinds)
    for argument in arguments:
        written = isinstance(argument, (Scratch, Output))
        in_place = isinstance(argument, Output) and argument.written is Written.IN_PLACE
        assert argument.name.endswith("_inout") == in_place
        assert argument.name.endswith(("_out", "_inout")) == written


@every_operation
def test_an_adjoint_is_in_inputs_of_its_operation(op):
    operation = OPERATIONS[op]
    if operation.adjoint is None:
        return
    adjoint, (output,) = OPERATIONS[operation.adjoint], operation.outputs
    inputs = {array.name: array for array in operation.inputs}
    for result in adjoint.outputs:
        assert result.shape == inputs[adjoint_of(result)].shape
    (given,) = (array for array in adjoint.inputs if array.name not in inputs)
    assert given.name == f"adj_{output.name.removesuffix('_out')}" and given.shape == output.shape


@every_operation
def test_documented_shapes_are_those_of_the_table(op):
    documented = entries(getattr(ops, op).__doc__, "Parameters")
    for array in OPERATIONS[op].inputs:
        if array.made or array.choices:
            continue
        shape = ", ".join(map(str, array.shape)) + "," * (len(array.shape) == 1)
        kind = resolved(array.name, documented[array.name]).kind
        if array.single:
            rest = [str(extent) for extent in array.shape[1:]]
            shape += f") or ({', '.join(rest)}" + "," * (len(rest) == 1)
        assert kind.startswith(f"({shape}) {array.integers.__name__ if array.integer else 'float'}"), (
            array.name
        )


@pytest.mark.parametrize(
    ("extent", "expected"),
    [(3, 3), ("B", 2), ("2 * radius + 1", 7), ("up(2 * radius + 1, tile)", 16), ("ceil(B / 1.5)", 2),
     ("parts(B, tile)", 1), ("parts(0, tile)", 1), ("max(0, B - 5)", 0), ("P + 2", 9)],
)  # fmt: skip
def test_sizes(extent, expected):
    assert size_of(extent, {"B": 2, "radius": 3, "tile": 16, "P + 2": 9}) == expected


def test_a_size_without_a_value_is_named():
    with pytest.raises(KeyError, match="K"):
        size_of("K // 2", {"B": 2})


def test_the_first_variant_that_suits_is_taken():
    operation = OPERATIONS["lag_operator"]
    assert [operation.variant("warp", "cpu", width=w).tile for w in (40, 16, 15, 4, 3)] == [16, 16, 4, 4, 1]
    assert [operation.variant("warp", "cuda", 90, w).tile for w in (40, 3)] == [4, 1]
    assert operation.variant("taichi", "cpu").tile == 8
    newer = Variant(tile=2, device="cuda", architecture=100)
    assert newer.suits("warp", "cuda", 120, 1) and not newer.suits("warp", "cuda", 90, 1)
    assert not newer.suits("warp", "cpu", 120, 1)


def test_what_a_launcher_writes_follows_from_its_first_arguments():
    image = np.zeros((2, 7, 9))
    rows, out = buffers_behind(OPERATIONS["reduce_image"], [image, 2.0], {}, tile=1)
    assert (rows.shape, out.shape, out.dtype) == ((2, 4, 9), (2, 4, 5), np.float64)
