"""Batches: windows permuted, one by one, by the hundred, on threads, repeated; and batches too large."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import evqr_kernels
from evqr_kernels import OPERATIONS, checks

from . import cases
from .helpers import TOLERANCE, assert_close, filled
from .test_align import SIDES, centre_of, scene, starts

ATOMIC = {op for op, operation in OPERATIONS.items() if operation.accumulates}
"""Operations that add up in no certain order on a GPU."""

ATOMIC_ON_CPU = {("taichi", "sample_moments_adjoint")}
"""Likewise on a CPU: Taichi shares poses out among threads, and some look at one image."""


def rows_of(arrays, letter):
    """Which arrays have a row for each of what a letter counts."""
    return [k for k, array in enumerate(arrays) if letter in array.shape[:1]]


def is_summed(operation):
    """Whether its outputs add up over what looks at one and the same window."""
    return any(array.index == operation.outputs[-1].shape[0] for array in operation.inputs)


def columns_of_events(operation):
    """How many columns of events stand before ``window_ptr``; 0 if there is none."""
    return next((k for k, array in enumerate(operation.inputs) if array.ascending), 0)


def shared(operation):
    """Which arguments are one for all windows."""
    windows = "B" if columns_of_events(operation) else operation.outputs[-1].shape[0]
    arrays = [getattr(argument, "shape", ()) for argument in operation.arguments]
    own = (windows, "B + 1", *(["E"] if columns_of_events(operation) else []))
    return [k for k, shape in enumerate(arrays) if shape and shape[0] not in own]


ALL = [*cases.CALLS, cases.solve_code_banded, cases.solve_code_banded_tall]
SUMS = [make for make in ALL if is_summed(make(np.random.default_rng(0), np.float32).operation)]
WINDOWED = [make for make in ALL if make not in SUMS]

every_operation = pytest.mark.parametrize("make", ALL, ids=lambda make: make.__name__)
every_windowed = pytest.mark.parametrize("make", WINDOWED, ids=lambda make: make.__name__)
every_sum = pytest.mark.parametrize("make", SUMS, ids=lambda make: make.__name__)


def made(make, dtype):
    return make(np.random.default_rng(5), dtype)


def windows_in(call):
    """Windows, or poses, of a call."""
    return len(call.outputs[-1])


def gathered(array, windows, ptr):
    """Take windows of an array of all events, or of one with a row a window."""
    if ptr is not None and array.shape == (ptr[-1],):
        parts = [array[ptr[b] : ptr[b + 1]] for b in windows]
        return np.concatenate(parts) if parts else array[:0]
    return array[windows]


def of_windows(call, windows):
    """Make the call with these of its windows, in this order; and take them from the results of the call."""
    columns = columns_of_events(call.operation)
    ptr = call.inputs[columns] if columns else None
    windows = np.asarray(windows)
    inputs = []
    for k, argument in enumerate(call.inputs):
        if columns and k == columns:
            inputs.append(np.r_[0, np.cumsum(np.diff(ptr)[windows])].astype(np.int32))
        elif isinstance(argument, np.ndarray) and k not in shared(call.operation):
            inputs.append(gathered(argument, windows, ptr))
        else:
            inputs.append(argument)
    outputs = [gathered(output, windows, ptr) for output in call.outputs]
    part = cases.Call(call.op, inputs, outputs, call.tail, call.options)
    return part, lambda results: [gathered(result, windows, ptr) for result in results]


def assert_same(op, placed, got, expected):
    """Bit for bit, but for operations that add up in no certain order."""
    for one, other in zip(got, expected, strict=True):
        atomic = (placed.backend.name, op) in ATOMIC_ON_CPU if placed.device == "cpu" else op in ATOMIC
        if atomic:
            assert_close(one, other)
        else:
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("windows", [[2, 0, 1], [0], [1], [2], [1, 1, 0]], ids=str)
@every_windowed
def test_any_windows_give_what_they_give_in_the_batch(make, windows, placed, dtype):
    """Permuted, one by one (an empty one among them), and twice."""
    call = made(make, dtype)
    together = call.run(placed)
    part, take = of_windows(call, windows)
    assert_same(call.op, placed, part.run(placed), take(together))


@every_windowed
def test_batch_of_512(make, placed, dtype):
    call = made(make, dtype)
    windows = np.arange(512) % (cases.B if columns_of_events(call.operation) else windows_in(call))
    part, take = of_windows(call, windows)
    assert_same(call.op, placed, part.run(placed), take(call.run(placed)))


@every_operation
def test_repeated(make, placed, dtype):
    call = made(make, dtype)
    first = call.run(placed)
    for _ in range(3):
        assert_same(call.op, placed, call.run(placed), first)


@every_windowed
def test_windows_on_threads(make, placed, dtype):
    """Disjoint windows may run on as many threads as one likes."""
    call = made(make, dtype)
    together = call.run(placed)
    parts = [of_windows(call, [b % cases.B]) for b in range(12)]
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(lambda part: part[0].run(placed), parts))
    for (_, take), result in zip(parts, results, strict=True):
        assert_same(call.op, placed, result, take(together))


def of_rows(call, rows):
    """Make the call with these of the poses or images that it adds up over, in this order."""
    arguments, counted = call.operation.arguments, "N"
    ours, theirs = arguments[: len(call.inputs)], arguments[len(call.inputs) :]
    inputs, outputs = (
        [array[rows] if k in rows_of(arrays, counted) else array for k, array in enumerate(values)]
        for arrays, values in ((ours, call.inputs), (theirs, call.outputs))
    )
    return cases.Call(call.op, inputs, outputs, call.tail, call.options)


def sums_of(call, placed):
    """Give what a call adds to its output, which may not be empty before."""
    (result,) = call.run(placed)
    return result - (call.outputs[-1] if call.operation.accumulates else 0)


def rows_in(call):
    return len(call.inputs[rows_of(call.operation.inputs, "N")[0]])


@every_sum
def test_sums_are_those_of_their_rows(make, placed, dtype):
    """Permuted, one by one, and 512 at once."""
    call = made(make, dtype)
    count, together = rows_in(call), sums_of(call, placed)
    assert np.abs(together).max() > 0.1
    assert_close(sums_of(of_rows(call, np.roll(np.arange(count), 1)[::-1]), placed), together)
    assert_close(sum(sums_of(of_rows(call, [k]), placed) for k in range(count)), together)
    many = sums_of(of_rows(call, np.arange(512) % count), placed)
    shares = [len(range(k, 512, count)) for k in range(count)]
    each = [share * sums_of(of_rows(call, [k]), placed) for k, share in enumerate(shares)]
    assert_close(many, sum(each), 8 * TOLERANCE[np.dtype(dtype)])


@every_sum
def test_sums_on_threads(make, placed, dtype):
    call = made(make, dtype)
    together = call.run(placed)
    with ThreadPoolExecutor(3) as pool:
        for result in pool.map(lambda _: made(make, dtype).run(placed), range(9)):
            assert_same(call.op, placed, result, together)


@pytest.mark.parametrize("order", [[2, 0, 1], [1], [0, 2] * 256], ids=["permuted", "one", "512"])
def test_any_poses_align_as_in_the_batch(order, placed, dtype):
    image, points, table, terms, factors = scene(dtype, tilt=True)
    options = {"centre": centre_of(SIDES[0]), "scale": centre_of(SIDES[0]), "max_iterations": 3}
    options |= {"backend": placed.backend.name, "device": placed.device}

    def align(poses):
        idx = np.zeros(len(poses), np.int32)
        return evqr_kernels.align_poses(image, idx, poses, points, table, terms, factors, **options)

    for whole, part in zip(align(starts(dtype)), align(starts(dtype)[order]), strict=True):
        np.testing.assert_array_equal(whole[order], part)


@pytest.mark.parametrize("order", [[2, 0, 1], [1], [0, 2] * 256], ids=["permuted", "one", "512"])
def test_any_codes_are_solved_as_in_the_batch(order, placed, dtype, rng):
    rhs, stencil, damping, free, start = cases.system(rng, dtype)
    where = {"backend": placed.backend.name, "device": placed.device}
    whole = evqr_kernels.solve_code(rhs, stencil, damping, free, start, **where)
    part = evqr_kernels.solve_code(rhs[order], stencil[order], damping[order], free, start[order], **where)
    for one, other in zip(whole, part, strict=True):
        np.testing.assert_array_equal(one[order], other)


def test_poses_and_codes_on_threads_and_repeated(placed, dtype, rng):
    image, points, table, terms, factors = scene(dtype, tilt=True)
    system = cases.system(rng, dtype)
    where = {"backend": placed.backend.name, "device": placed.device}

    def solve(_):
        idx = np.zeros(3, np.int32)
        options = {"centre": centre_of(SIDES[0]), "scale": centre_of(SIDES[0]), "max_iterations": 3, **where}
        poses = evqr_kernels.align_poses(image, idx, starts(dtype), points, table, terms, factors, **options)
        return [*poses, *evqr_kernels.solve_code(*system, **where)]

    first = solve(0)
    with ThreadPoolExecutor(3) as pool:
        for again in [solve(0), *pool.map(solve, range(6))]:
            for one, other in zip(again, first, strict=True):
                np.testing.assert_array_equal(one, other)


def test_more_than_an_index_can_hold_is_refused(monkeypatch):
    """Limits of inputs are lowered here: inputs are in memory.  Results and scratch are refused before."""
    few = np.zeros((1, 2), np.float32)
    grid, outside = filled((1, 3, 3), np.float32, 0), np.zeros(1, np.float32)
    with pytest.raises(ValueError, match="result must have fewer than 2147483648 elements, got 4294967296"):
        evqr_kernels.render_code(grid, np.zeros((1, 6), np.float32), outside, shape=(2**16, 2**16))
    with pytest.raises(ValueError, match="scratch must have fewer than 2147483648 elements"):
        pose, lattice, profile = np.zeros((1, 9), np.float32), np.zeros(2**16, np.float32), few[0].repeat(2)
        evqr_kernels.code_rhs(grid, pose, lattice, lattice, profile, profile, few, samples_a_module=2)
    monkeypatch.setattr(checks, "MOST_ELEMENTS", 99)
    image = np.zeros((1, 10, 10), np.float32)
    with pytest.raises(ValueError, match="luminance must have fewer than 100 elements, got 100"):
        evqr_kernels.brightness_residual(image, image, few)
    monkeypatch.setattr(checks, "MOST_EVENTS", 9)
    column, ptr = np.zeros(10, np.float32), np.array([0, 10], np.int32)
    with pytest.raises(ValueError, match="x must have at most 9 events, got 10"):
        evqr_kernels.bin_events(column, column, column, ptr, reduction=1.0, shape=(2, 2))


def test_limits_are_those_of_the_indices():
    assert checks.MOST_ELEMENTS == np.iinfo(np.int32).max and checks.MOST_EVENTS == 2**30
