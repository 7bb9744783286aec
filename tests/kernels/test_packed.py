"""Events of eight bytes: the same images as of their float columns, on the part that is a window's own."""

import numpy as np
import pytest

from . import cases
from .helpers import assert_close, filled


def columns(call, dtype, reference=0):
    """Give the float columns of a call's events: x, y, t since a reference [us], weight."""
    x, y, stamp = call.inputs[:3]
    time = (stamp >> 1).astype(np.int64) - reference
    return [column.astype(dtype) for column in (x, y, time, 2 * (stamp & 1).astype(int) - 1)]


def of_floats(placed, op, arrays, b, call, *others):
    """Run the operation on floats for one window of a call."""
    first, last = call.inputs[3][b]
    arrays = [np.ascontiguousarray(array[first:last]) for array in arrays]
    return placed(op, [*arrays, np.array([0, last - first], np.int32), *others], [call.outputs[0][b : b + 1]])


def test_bins_are_those_of_floats(placed, dtype, rng):
    call = cases.bin_packed_events(rng, dtype)
    (images,) = call.run(placed)
    x, y, _, weight = columns(call, dtype)
    for b in range(cases.B):
        (image,) = of_floats(placed, "bin_events", [x, y, weight], b, call, 2.0)
        np.testing.assert_array_equal(images[b : b + 1], image)


def test_deposits_are_those_of_floats(placed, dtype, rng):
    """In the window that moves, to its own part; beyond, what was there stays."""
    call, b = cases.deposit_packed_events(rng, dtype), 2
    t_ref, motion, frame, extent = (array[b : b + 1] for array in call.inputs[4:])
    (height, width), (images,) = extent[0], call.run(placed)
    call.outputs[0] = call.outputs[0][:, :, :height, :width].copy()
    arrays = columns(call, dtype, int(t_ref[0]))
    (image,) = of_floats(placed, "deposit_events", arrays, b, call, motion, frame)
    assert_close(images[b : b + 1, :, :height, :width].copy(), image)
    images[b, :, :height, :width] = 0.5
    np.testing.assert_array_equal(images[b], 0.5)


@pytest.mark.parametrize("extent", [(0, 0), (1, 9), (9, 1), (2, 2), (12, 17)])
def test_an_extent_is_as_an_image_of_that_size(extent, placed, dtype, rng):
    call = cases.deposit_packed_events(rng, dtype)
    call.inputs[7][:] = extent
    (images,) = call.run(placed)
    own = np.s_[..., : extent[0], : extent[1]]
    call.outputs[0] = call.outputs[0][own].copy()
    (alone,) = call.run(placed)
    if placed.device == "cpu":
        np.testing.assert_array_equal(images[own], alone)
    else:
        assert_close(images[own].copy(), alone)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 127, 200])
@pytest.mark.parametrize("first", [0, 1, 99])
def test_any_number_of_events(first, count, placed, spec, dtype, rng):
    """Windows end where the columns do, and before."""
    for make in (cases.bin_packed_events, cases.deposit_packed_events):
        call = make(rng, dtype)
        call.inputs[:3] = [column[: first + count].copy() for column in call.inputs[:3]]
        call.inputs[3] = np.array([[first, first + count], [first, first], [0, first + count]], np.int32)
        assert_close(*call.run(placed), *call.run(spec))


@pytest.mark.parametrize("reference", [0, 12, (1 << 31) - 1000])
def test_times_are_exact_however_late(reference, placed, dtype, rng):
    """A microsecond moves an event by a pixel, close to the last time that a stamp can say."""
    time = np.array([0, 1, 5, 499], np.int64) + reference
    x, y = np.full((2, 4), 3, np.uint16)
    stamp = (2 * time + 1).astype(np.uint32)
    window_ptr, t_ref = np.array([[0, 4]], np.int32), np.array([reference], np.int32)
    motion, frame = np.array([[-1, 0]], dtype), np.array([[0, 0, 1]], dtype)
    inputs = [x, y, stamp, window_ptr, t_ref, motion, frame, np.array([[8, 510]], np.int32)]
    (deposit,) = placed("deposit_packed_events", inputs, [filled((1, 2, 8, 510), dtype, 0)])
    np.testing.assert_array_equal(np.argwhere(deposit), [[0, 0, 3, 3 + k] for k in (0, 1, 5, 499)])


@pytest.mark.parametrize("since", [0, 1 << 31, (1 << 32) - 1, 3 << 50])
def test_clocks_that_have_run_for_long(since, placed, dtype, rng):
    """Stamps of times modulo 2^32 tell what times say: windows may cross where they begin anew."""
    call = cases.deposit_packed_events(rng, dtype)
    time = np.sort(rng.integers(-1500, 1500, len(call.inputs[2])))
    call.inputs[4][:] = since % (1 << 31)
    on = rng.integers(0, 2, len(time))
    call.inputs[2] = ((2 * (time + since) + on) % (1 << 32)).astype(np.uint32)
    (deposit,) = call.run(placed)
    call.inputs[4][:] = 1500
    call.inputs[2] = (2 * (time + 1500) + on).astype(np.uint32)
    assert_close(deposit, call.run(placed)[0], 1e-15 if placed.device == "cpu" else None)


def test_polarities_are_counted_apart(placed, dtype):
    x, y = np.array([[1, 1, 1, 65535], [2, 2, 2, 65535]], np.uint16)
    stamp = np.array([0, 1, 3, 4], np.uint32)
    window_ptr = np.array([[0, 4], [0, 1], [1, 3], [3, 3]], np.int32)
    (image,) = placed("bin_packed_events", [x, y, stamp, window_ptr, 1.0], [filled((4, 5, 5), dtype, 0)])
    np.testing.assert_array_equal(image[:, 2, 1], [1, -1, 2, 0])
    assert np.count_nonzero(image) == 3
    still, frame = np.zeros((4, 2), dtype), np.tile(np.array([0, 0, 1], dtype), (4, 1))
    extent, zeros = np.full((4, 2), 5, np.int32), np.zeros(4, np.int32)
    inputs = [x, y, stamp, window_ptr, zeros, still, frame, extent]
    (deposit,) = placed("deposit_packed_events", inputs, [filled((4, 2, 5, 5), dtype, 0)])
    np.testing.assert_array_equal(deposit[:, :, 2, 1], [[2, -1], [0, -1], [2, 0], [0, 0]])
    assert np.count_nonzero(deposit) == 4


def test_no_events_at_all(placed, dtype):
    none, stamp = np.zeros(0, np.uint16), np.zeros(0, np.uint32)
    window_ptr, out = np.zeros((2, 2), np.int32), filled((2, 4, 4), dtype, 7)
    np.testing.assert_array_equal(
        placed("bin_packed_events", [none, none, stamp, window_ptr, 1.0], [out])[0], 7
    )


def test_not_a_number_of_a_motion_drops_the_events(placed, dtype, rng):
    call = cases.deposit_packed_events(rng, dtype)
    call.inputs[5][:] = np.nan
    np.testing.assert_array_equal(call.run(placed)[0], 0.5)
