"""Events to images: laws, adjoints and edges."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import evqr_kernels
from evqr_kernels import SplatConfig, get_backend, make_scratch

from . import cases
from .helpers import assert_adjoint, assert_close, assert_differences, filled

SUM_RIPPLE = 0.02
"""Pixels sample the splat: the sum over pixels differs so much, at most, from the integral, which is 1."""

coordinate = st.floats(-8, 40, width=32)
event_lists = st.lists(st.tuples(coordinate, coordinate, st.floats(-1, 1, width=32)), max_size=12)


def splat(x, y, weight=None, **options):
    x, y = (np.atleast_1d(np.ascontiguousarray(array, float)) for array in (x, y))
    weight = np.ones(len(x)) if weight is None else np.ascontiguousarray(weight, float)
    options = {"motion": np.zeros((1, 2)), "t": np.zeros(len(x)), "shape": (24, 32), **options}
    ptr = np.array([0, len(x)], np.int32)
    return evqr_kernels.splat_events(x, y, options.pop("t"), weight, ptr, options.pop("motion"), **options)


@pytest.mark.parametrize("cfg", [SplatConfig(), SplatConfig(epsilon_px=0.4), SplatConfig(epsilon_px=2.0)])
def test_profile_integrates_to_one(cfg):
    """Averaged over offsets in steps of 1/16 px the ripple of the pixels is gone."""
    y, x = np.mgrid[:16, :16].reshape(2, -1) / 16
    assert abs(splat(16 + x, 12 + y, cfg=cfg).sum() / 256 - 1.0) < 1e-4


@given(x=st.floats(4, 27), y=st.floats(4, 19), weight=st.floats(-3, 3, allow_subnormal=False))
def test_mass_inside_the_image(x, y, weight):
    assert abs(splat(x, y, [weight]).sum() - weight) <= SUM_RIPPLE * abs(weight)


def test_splat_is_highest_at_its_event_and_symmetric():
    image = splat(16, 12)[0]
    assert image.argmax() == 12 * 32 + 16
    np.testing.assert_allclose(image[9:16, 13:20], image[9:16, 13:20].T, rtol=1e-14)
    np.testing.assert_allclose(image[9:16, 13:20], image[15:8:-1, 19:12:-1], rtol=1e-14)


@given(events=event_lists, shift_x=st.integers(-5, 5), shift_y=st.integers(-5, 5))
def test_whole_pixels_move_the_image(events, shift_x, shift_y):
    """In a frame that moves along the image is the same: nothing depends on where the image's corner is."""
    x, y, weight = np.array(events).reshape(-1, 3).T
    moved = splat(x + shift_x, y + shift_y, weight, frame=np.array([[shift_x, shift_y, 1.0]]))
    # the sum x + shift rounds, and a splat's slope is at most 1 a pixel
    np.testing.assert_allclose(moved, splat(x, y, weight), rtol=0, atol=1e-12)


@given(events=event_lists)
def test_linear_in_the_weights(events):
    x, y, weight = np.array(events).reshape(-1, 3).T
    both = splat(np.r_[x, x], np.r_[y, y], np.r_[weight, 2 * weight])
    np.testing.assert_allclose(both, 3 * splat(x, y, weight), rtol=0, atol=1e-12)


def test_without_motion_time_does_not_matter(placed, dtype, rng):
    call = cases.splat_events(rng, dtype)
    call.inputs[5][:] = 0
    first = call.run(placed)
    call.inputs[2][:] *= 7
    np.testing.assert_array_equal(call.run(placed), first)


def test_motion_transports_to_the_reference_time():
    at_rest = splat(10.25, 8.5)
    moving = splat(
        10.25 + 0.004 * 1000, 8.5 - 0.004 * 500, t=np.array([0.004]), motion=np.array([[1e3, -5e2]])
    )
    np.testing.assert_allclose(moving, at_rest, atol=1e-12)


def test_lag_is_the_derivative_along_the_motion():
    """G - lag d.grad G, by differences of splats; ON and OFF events have a lag each.

    Moving the event by s moves the splat: d.grad G is minus the derivative in s.
    """
    motion, h = np.array([[300.0, -400.0]]), 1e-5
    direction = motion[0] / 500

    def at(s, weight):
        return splat(14.3 + s * direction[0], 11.55 + s * direction[1], [weight], motion=motion)

    lag = np.array([[1.5, 2.5]])
    for weight, lag_px in ((1.0, 1.5), (-1.0, 2.5)):
        expected = at(0, weight) + lag_px * (at(h, weight) - at(-h, weight)) / (2 * h)
        got = splat(14.3, 11.55, [weight], motion=motion, lag=lag)
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8)


def test_coarse_cells_have_their_centres_where_their_pixels_are():
    """A cell of 4 px covers pixels 0 to 3: an event at 1.5 px is in its middle."""
    image = splat(1.5 + 4 * 5, 1.5 + 4 * 3, frame=np.array([[0.0, 0.0, 4.0]]))
    np.testing.assert_allclose(image, splat(5, 3), atol=1e-14)


def test_order_of_events_does_not_matter(placed, dtype, rng):
    call = cases.splat_events(rng, dtype)
    first = call.run(placed)
    x, y, t, weight, ptr, *others = call.inputs
    order = np.concatenate([rng.permutation(np.arange(a, b)) for a, b in pairwise(ptr)])
    call.inputs = [x[order], y[order], t[order], weight[order], ptr, *others]
    assert_close(*call.run(placed), *first)


def test_adjoint_in_the_weights(placed, dtype, rng):
    """Linear in the weights while their signs stay: ON and OFF lag differently."""
    call, back = cases.splat_events(rng, dtype), cases.splat_events_adjoint(rng, dtype)
    call.inputs[3] = np.abs(call.inputs[3])
    call.outputs[0][:] = 0
    back.inputs[:8] = call.inputs
    adj_weight, *_ = back.run(placed)
    (image,) = call.run(placed)
    assert_adjoint(image, back.inputs[8], call.inputs[3], adj_weight)


@pytest.mark.parametrize("affine", [False, True], ids=["uniform", "affine"])
@pytest.mark.parametrize("lag", [0.0, 1.7])
def test_adjoint_in_the_motion(lag, affine, placed, rng):
    """The direction of the motion is a parameter of the lag: with a lag, only along the motion."""
    back = cases.splat_events_adjoint(rng, np.float64)
    *inputs, adj_image = back.inputs
    inputs[5] = motion = rng.uniform(1000, 3000, (cases.B, 2))
    inputs[6] = np.full((cases.B, 2), lag)
    # 1e-6 px/s would move an event by 1e-9 px: steps in units of pixels over the window
    unit = np.full(2, 1e3)
    if affine:
        inputs[5] = motion = np.hstack([motion, cases.affine_motion(rng, np.float64)])
        unit = np.r_[unit, np.full(4, 1e3 / cases.X)]
        back.outputs[0], back.outputs[2] = (filled(s, np.float64) for s in ((cases.B, 5, 6), (cases.B, 6)))
    back.inputs = [*inputs, adj_image]
    _, adj_motion, *_ = back.run(placed)

    def loss(motion):
        call = cases.splat_events(rng, np.float64)
        call.inputs = [*inputs[:5], motion, *inputs[6:]]
        return np.vdot(call.run(placed)[0], adj_image)

    along = motion / np.linalg.norm(motion, axis=1, keepdims=True)
    directions = [along * 1e3]
    if not lag:
        directions += list(np.eye(len(unit))[:, None, :] * np.ones((cases.B, 1)) * unit)
    assert_differences(loss, motion, adj_motion, directions)


@pytest.mark.parametrize("affine", [False, True], ids=["uniform", "affine"])
@pytest.mark.parametrize("axis", [0, 1])
def test_adjoint_in_the_positions(axis, affine, placed, rng):
    """With a lag too where the motion does not depend on the place; else its direction is a parameter."""
    back = cases.splat_events_adjoint(rng, np.float64)
    if affine:
        back = cases.splat_events_affine_adjoint(rng, np.float64)
        back.inputs[6][:] = 0
        back.inputs[5][:, 2:] *= 10  # so that it tells
    *inputs, adj_image = back.inputs
    gradient = back.run(placed)[2 + axis]

    def loss(places):
        call = cases.splat_events(rng, np.float64)
        call.inputs = [*inputs[:axis], places, *inputs[axis + 1 :]]
        return np.vdot(call.run(placed)[0], adj_image)

    assert_differences(loss, inputs[axis], gradient, rng.normal(size=(3, len(gradient))))


def test_affine_motion_turns_about_the_middle_of_the_image():
    """Events of a point that turns about the middle fall on one place; the middle itself stays."""
    turn, middle, position = 30.0, np.array([15.5, 11.5]), np.array([21.5, 9.5])
    t = np.array([0.0, 4e-4, -4e-4])
    motion = np.array([[0.0, 0.0, 0.0, -turn, turn, 0.0]])
    # where (1 - t A)^-1 takes it: what the transport, first order in t, undoes exactly
    matrix = motion[0, 2:].reshape(2, 2)
    seen = np.array([middle + np.linalg.solve(np.eye(2) - s * matrix, position - middle) for s in t])
    image = splat(*seen.T, t=t, motion=motion)
    np.testing.assert_allclose(image, 3 * splat(*position), rtol=0, atol=1e-12)
    still = splat(*np.tile(middle, (3, 1)).T, t=t, motion=motion)
    np.testing.assert_allclose(still, 3 * splat(*middle), rtol=0, atol=1e-12)


def test_affine_motion_without_a_field_is_uniform(placed, dtype, rng):
    call = cases.splat_events(rng, dtype)
    expected = call.run(placed)
    call.inputs[5] = np.hstack([call.inputs[5], np.zeros((cases.B, 4), dtype)])
    assert_close(*call.run(placed), *expected)


def test_adjoint_of_events_that_miss_the_image_is_zero(placed, dtype, rng):
    back = cases.splat_events_adjoint(rng, dtype)
    back.inputs[0][:] = 500
    for adjoint in back.run(placed):
        np.testing.assert_array_equal(adjoint, 0)


@pytest.mark.parametrize("op", [cases.bin_events, cases.splat_events, cases.deposit_events])
@pytest.mark.parametrize("bad", [-1e9, 1e9, np.nan, np.inf])
def test_events_off_the_image_add_nothing(op, bad, placed, dtype, rng):
    call = op(rng, dtype)
    call.inputs[1][:] = bad
    (image,) = call.run(placed)
    np.testing.assert_array_equal(image, call.outputs[0])


@pytest.mark.parametrize("op", [cases.bin_events, cases.splat_events, cases.deposit_events])
def test_no_events(op, placed, dtype, rng):
    call = op(rng, dtype)
    ptr = 3 if op is cases.bin_events else 4
    call.inputs[:ptr] = [column[:0] for column in call.inputs[:ptr]]
    call.inputs[ptr] = np.zeros(cases.B + 1, np.int32)
    np.testing.assert_array_equal(call.run(placed)[0], call.outputs[0])


def test_adjoint_without_events(placed, dtype, rng):
    back = cases.splat_events_adjoint(rng, dtype)
    back.inputs[:5] = [*(column[:0] for column in back.inputs[:4]), np.zeros(cases.B + 1, np.int32)]
    back.outputs[1], *back.outputs[3:] = (filled(0, dtype) for _ in range(3))
    adj_weight, adj_motion, *_ = back.run(placed)
    assert adj_weight.shape == (0,)
    np.testing.assert_array_equal(adj_motion, 0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3), (5, 5)])
def test_images_smaller_than_a_splat(shape, placed, spec, dtype, rng):
    call = cases.splat_events(rng, dtype)
    call.inputs[0] = (call.inputs[0] / 6).astype(dtype)
    call.inputs[1] = (call.inputs[1] / 6).astype(dtype)
    call.outputs = [filled((cases.B, *shape), dtype, 0.5)]
    assert_close(*call.run(placed), *call.run(spec))


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3), (3, 4), (5, 5)])
def test_adjoint_in_images_smaller_than_a_splat(shape, placed, spec, dtype, rng):
    call = cases.splat_events_adjoint(rng, dtype)
    call.inputs[:2] = rng.uniform(
        -3, np.maximum(shape[::-1], 1)[:, None] + 2, (2, len(call.inputs[0]))
    ).astype(dtype)
    call.inputs[-1] = filled((cases.B, *shape), dtype, 0.5)
    for found, expected in zip(call.run(placed), call.run(spec), strict=True):
        assert_close(found, expected)


@pytest.mark.parametrize("shape", [(0, 4), (4, 0)])
def test_adjoint_in_images_without_a_pixel(shape, placed, dtype, rng):
    call = cases.splat_events_adjoint(rng, dtype)
    call.inputs[-1] = np.zeros((cases.B, *shape), dtype)
    for found in call.run(placed):
        assert not np.any(found)


@pytest.mark.parametrize("op", [cases.splat_events, cases.splat_events_adjoint])
@pytest.mark.parametrize("epsilon_px", [0.3, 0.8])
@pytest.mark.parametrize("deviations", [1.0, 8.0])
def test_splats_cut_as_early_and_as_late_as_can_be(op, epsilon_px, deviations, placed, spec, dtype, rng):
    call = op(rng, dtype)
    call.tail = (SplatConfig(epsilon_px=epsilon_px, radius_px=deviations * epsilon_px),)
    for found, expected in zip(call.run(placed), call.run(spec), strict=True):
        assert_close(found, expected)


@pytest.mark.parametrize("most", [1, 4, 4000])
def test_adjoint_of_windows_of_a_size_is_that_of_each(most, placed, dtype, rng):
    """Bit for bit: how a window's events are shared out among threads does not depend on the others."""
    count, windows = 150, 3
    call = cases.splat_events_adjoint(rng, dtype)
    x, y, t, weight = (rng.uniform(0, 9, count * windows).astype(dtype) for _ in range(4))
    ptr = count * np.arange(windows + 1, dtype=np.int32)
    rest = [array[:windows] for array in call.inputs[5:]]
    outputs = [
        np.zeros((windows, most, 2), dtype),
        np.zeros(count * windows, dtype),
        np.zeros((windows, 2), dtype),
        *np.zeros((2, count * windows), dtype),
    ]
    call.inputs, call.outputs = [x, y, t, weight, ptr, *rest], outputs
    together = call.run(placed)[1]
    for b in range(windows):
        events = slice(ptr[b], ptr[b + 1])
        call.inputs = [array[events] for array in (x, y, t, weight)] + [
            ptr[:2],
            *(a[b : b + 1] for a in rest),
        ]
        call.outputs = [np.zeros((1, most, 2), dtype), np.zeros(count, dtype), np.zeros((1, 2), dtype)]
        call.outputs += [*np.zeros((2, count), dtype)]
        np.testing.assert_array_equal(call.run(placed)[1][0], together[b])


def test_scratch_of_the_adjoint_grows_with_the_events_alone():
    for windows in (1, 7, 10_000):
        for events in (0, 63, 6400, 640_000):
            given = {"B": windows, "E": events, "P": 2}
            (chunks,) = make_scratch(get_backend("numpy"), "cpu", "splat_events_adjoint", **given)
            assert windows * chunks.shape[1] <= events / 64 + windows


def test_binning_counts():
    x = np.array([0.0, 1.0, 1.49, 1.5, 5.0, -0.51], np.float32)
    y = np.zeros(6, np.float32)
    weight = np.array([1, 2, 4, 8, 16, 32], np.float32)
    image = evqr_kernels.bin_events(x, y, weight, np.array([0, 6], np.int32), reduction=2, shape=(1, 3))
    # pixels 0 and 1 make the first cell, which ends at 1.5; -0.51 is off the image
    np.testing.assert_array_equal(image, [[[7, 8, 16]]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"epsilon_px": 0.2}, "epsilon_px must be 0.3 to 8, got 0.2"),
        ({"epsilon_px": float("nan")}, "epsilon_px must be 0.3 to 8, got nan"),
        ({"epsilon_px": 1.0, "radius_px": 0.5}, "radius_px must be epsilon_px to 8, got 0.5"),
        ({"epsilon_px": 0.3, "radius_px": 20.0}, "radius_px must be epsilon_px to 2.4, got 20.0"),
        ({"epsilon_px": 8.0, "radius_px": 33.0}, "radius_px must be epsilon_px to 32, got 33.0"),
        ({"kind": "box"}, 'kind must be "gaussian" or "bilinear", got \'box\''),
        ({"kind": "bilinear", "epsilon_px": 1.0}, "a bilinear splat has no width: leave epsilon_px"),
    ],
)
def test_bad_splat(options, message):
    with pytest.raises(ValueError, match=message):
        SplatConfig(**options)
