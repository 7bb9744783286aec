"""Every operation equals the specification, and overwrites what it says it overwrites."""

import numpy as np
import pytest

from evqr_kernels import OPERATIONS

from . import cases
from .helpers import assert_close, filled


def test_every_operation_has_a_case(rng):
    in_place = {"solve_code", "solve_code_banded", "align_poses"}
    assert {make(rng, np.float32).op for make in cases.CALLS} | in_place == set(OPERATIONS)


@pytest.mark.parametrize("make", cases.CALLS, ids=lambda make: make.__name__)
def test_equals_the_specification(make, placed, spec, dtype, rng):
    call = make(rng, dtype)
    expected = call.run(spec)
    for got, want in zip(call.run(placed), expected, strict=True):
        assert np.isfinite(want).all()
        assert_close(got, want)


@pytest.mark.parametrize("make", cases.CALLS, ids=lambda make: make.__name__)
def test_single_and_double_precision_agree(make, spec):
    """The specification has no float32 step that loses more than rounding: literals, casts, indices."""
    single = make(np.random.default_rng(3), np.float32).run(spec)
    call = make(np.random.default_rng(3), np.float64)
    call.inputs = [
        x.astype(np.float32).astype(x.dtype) if isinstance(x, np.ndarray) and x.dtype.kind == "f" else x
        for x in call.inputs
    ]
    for got, want in zip(single, call.run(spec), strict=True):
        scale = np.abs(want).max()
        np.testing.assert_allclose(got, want, rtol=0, atol=2e-4 * scale)


@pytest.mark.parametrize("make", cases.CALLS, ids=lambda make: make.__name__)
def test_supported(make, placed, dtype, rng):
    op = make(rng, dtype).op
    assert placed.backend.supports(op, dtype, placed.device) is None
    assert "int32" in placed.backend.supports(op, np.int32, placed.device)


@pytest.mark.parametrize("width", [0, 1, 3, 4, 5, 15, 16, 17, 33])
def test_templates_at_any_width(width, placed, spec, dtype, rng):
    call = cases.correlate_templates(rng, dtype, width=width)
    for got, want in zip(call.run(placed), call.run(spec), strict=True):
        assert_close(got, want)


@pytest.mark.parametrize("radius", [0, 1, 3, 8, 30])
@pytest.mark.parametrize("shape", [(23, 31), (5, 9), (40, 90)])
def test_correlation_at_any_radius(radius, shape, placed, spec, dtype, rng):
    call = cases.motion_correlation(rng, dtype, radius=radius, shape=shape)
    for got, want in zip(call.run(placed), call.run(spec), strict=True):
        assert_close(got, want)


@pytest.mark.parametrize(
    "shape", [*((n, n) for n in (1, 3, 7, 8, 9, 25)), (1, 8), (8, 1), (7, 25), (25, 7)], ids=str
)
def test_right_hand_side_at_any_size(shape, placed, spec, dtype, rng):
    call = cases.code_rhs(rng, dtype, shape)
    assert_close(*call.run(placed), *call.run(spec))


@pytest.mark.parametrize("width", [1, 3, 4, 5, 9])
@pytest.mark.parametrize("ratio", [1.0, 1.25, 2.6, 9.5])
@pytest.mark.parametrize("beyond", [0, 3])
def test_reduction_at_any_width(width, ratio, beyond, placed, spec, dtype, rng):
    """Coarse pixels beyond the image are 0."""
    image = rng.normal(size=(2, 7, width)).astype(dtype)
    shape = 2, int(np.ceil(7 / ratio)), int(np.ceil(width / ratio)) + beyond
    outputs = [filled((*shape[:2], width), dtype), filled(shape, dtype)]
    call = cases.Call("reduce_image", [image, ratio], outputs)
    assert_close(*call.run(placed), *call.run(spec))


@pytest.mark.parametrize("width", [0, 1, 3, 4, 15, 16, 17, 33])
def test_mixing_at_any_width(width, placed, spec, dtype, rng):
    call = cases.mix_images(rng, dtype, width=width)
    assert_close(*call.run(placed), *call.run(spec))
