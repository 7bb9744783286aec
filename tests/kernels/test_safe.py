"""What callers get wrong: nothing crashes, nothing outside the arrays is touched, and a line says so."""

import numpy as np
import pytest
from backends import BACKENDS, needs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from evqr_kernels import OPERATIONS, checks

from . import cases, test_ops
from .helpers import assert_close
from .test_solve import solve
from .test_taichi import START, run

OF_EVENTS = [
    cases.bin_events,
    cases.splat_events,
    cases.splat_events_affine,
    cases.splat_events_adjoint,
    cases.deposit_events,
    cases.deposit_events_adjoint,
    cases.voxel_grid,
    cases.voxel_grid_adjoint,
    cases.time_surface,
    cases.event_histogram,
]
INDICES = {"window_ptr", "deposit_idx", "image_idx", "extent"}
GUARD = 1024
NASTY = st.integers(-(2**31), 2**31 - 1) | st.integers(-3, 400)


def named(call):
    return [argument.name for argument in call.operation.arguments[: len(call.inputs)]]


@pytest.mark.parametrize("make", OF_EVENTS, ids=lambda make: make.__name__)
def test_events_that_no_window_names_are_dropped(make, placed, spec, dtype, rng):
    call = make(rng, dtype)
    place = named(call).index("window_ptr")
    before = call.run(spec)
    call.inputs[place] = np.array([7, 120, 120, 281], np.int32)
    expected = call.run(spec)
    assert any((one != other).any() for one, other in zip(before, expected, strict=True))
    for got, want in zip(call.run(placed), expected, strict=True):
        assert_close(got, want)


def guarded(array):
    """A copy of an array between values that nobody may touch, and the whole of it."""
    guard = np.full(GUARD, 7, array.dtype)
    whole = np.concatenate([guard, array.ravel(), guard])
    return whole, whole[GUARD : GUARD + array.size].reshape(array.shape)


@pytest.mark.parametrize(
    "make",
    [
        *OF_EVENTS,
        cases.lag_operator,
        cases.lag_operator_adjoint,
        cases.sample_moments,
        cases.sample_moments_adjoint,
    ],
    ids=lambda make: make.__name__,
)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_index_leads_outside_the_arrays(make, placed, data):
    """Without a check: a launcher may give any result, and nothing else."""
    if placed.device != "cpu":
        pytest.skip("memory beside an array is looked at in the host's")
    call = make(np.random.default_rng(20), np.float32)
    for k, name in enumerate(named(call)):
        if name in INDICES:
            entries = st.lists(NASTY, min_size=call.inputs[k].size, max_size=call.inputs[k].size)
            values = np.array(data.draw(entries), np.int32)
            call.inputs[k] = values.reshape(call.inputs[k].shape)
    wholes, outputs = zip(*map(guarded, call.outputs), strict=True)
    getattr(placed.backend, call.op)(
        *(placed._put(argument) for argument in call.inputs),
        *(placed.backend.from_host(output, "cpu") for output in outputs),
        *call.tail,
    )
    placed.backend.synchronize("cpu")
    for whole in wholes:
        np.testing.assert_array_equal(whole[:GUARD], 7)
        np.testing.assert_array_equal(whole[-GUARD:], 7)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    "make",
    [*OF_EVENTS, cases.deposit_packed_events, cases.clip_outliers, cases.motion_correlation],
    ids=lambda make: make.__name__,
)
def test_what_is_not_finite_goes_where_the_specification_sends_it(make, bad, placed, spec):
    """In one input after the other; the rest of the results is as it is there."""
    for k, argument in enumerate(make(np.random.default_rng(20), np.float32).inputs):
        call = make(np.random.default_rng(20), np.float32)
        if not (isinstance(argument, np.ndarray) and argument.dtype.kind == "f"):
            continue
        if call.op == "splat_events_adjoint" and named(call)[k] == "adj_image":
            continue  # near the sides more pixels are read than a splat reaches, and count 0 times
        call.inputs[k].reshape(-1)[1 :: max(2, argument.size // 3)] = bad
        with np.errstate(all="ignore"):
            expected = call.run(spec)
        for got, want in zip(call.run(placed), expected, strict=True):
            use = np.isfinite(want)
            np.testing.assert_array_equal(np.isfinite(got), use, err_msg=named(call)[k])
            assert_close(np.where(use, got, 0), np.where(use, want, 0))


@pytest.mark.parametrize("place", range(3), ids=["rhs", "stencil", "damping"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_system_that_is_not_finite_is_left_as_it_is(place, bad, placed, spec, dtype, rng):
    system = cases.system(rng, dtype)
    system[place][1] = bad
    q, iterations = solve(placed, system, max_iterations=9)
    with np.errstate(all="ignore"):
        expected, as_often = solve(spec, system, max_iterations=9)
    np.testing.assert_array_equal(q[1], system[-1][1])
    np.testing.assert_array_equal(iterations, as_often)
    assert iterations[1] == 0 and iterations[0] > 0
    np.testing.assert_allclose(q, expected, rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("shape", [(0, 12), (9, 0), (0, 0)])
@pytest.mark.parametrize(
    "op",
    ["bin_events", "splat_events", "splat_events_adjoint", "deposit_events", "deposit_events_adjoint",
     "voxel_grid", "voxel_grid_adjoint", "time_surface", "event_histogram", "bin_packed_events",
     "deposit_packed_events", "clip_outliers", "sample_moments", "sample_moments_adjoint", "score_poses",
     "align_poses", "code_rhs", "brightness_cost"],
)  # fmt: skip
def test_images_of_no_pixels(op, shape, name):
    """Sums over them are 0, and results that are images have none either."""
    arrays, options = test_ops.GOOD[op]
    changes = {"shape": shape} if "shape" in options else {}
    for k, array in enumerate(arrays):
        if array.shape[-2:] == (test_ops.Y, test_ops.X):
            changes[f"arg{k}"] = test_ops.f32(*array.shape[:-2], *shape)
    for one, other in zip(
        test_ops.as_tuple(test_ops.call(op, **changes, backend=name)),
        test_ops.as_tuple(test_ops.call(op, **changes)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


def an_out_that_is_read():
    image = test_ops.f32(1, 20, 20)
    return {
        "arg0": image.reshape(-1)[: test_ops.E],
        "out": image,
        "arg3": np.array([0, test_ops.E], np.int32),
    }


def not_aligned():
    return {"arg0": np.frombuffer(bytearray(4 * test_ops.E + 1), np.float32, test_ops.E, offset=1)}


@pytest.mark.parametrize(
    ("op", "changes", "error", "message"),
    [
        ("bin_events", an_out_that_is_read(), ValueError, "out must not share memory with x, which is read"),
        ("bin_events", not_aligned(), ValueError, "x must be aligned in memory, it is not copied"),
        ("bin_events", {"shape": (20, 20, 3)}, ValueError, "shape must be (Y, X), whole numbers, got (20,"),
        ("bin_events", {"shape": 20}, TypeError, "shape must be (Y, X), whole numbers, got 20"),
        ("bin_events", {"shape": (20.5, 20)}, TypeError, "shape must be (Y, X), whole numbers, got (20.5"),
        (
            "bin_events",
            {"arg3": test_ops.PTR.astype(np.int64)},
            TypeError,
            "window_ptr must be int32, got int64: give window_ptr.astype('int32')",
        ),
        ("local_maxima", {"most": 1.5}, TypeError, "most must be a whole number, got 1.5"),
        (
            "correlate_templates",
            {"arg3": test_ops.f32(2, 0, 5)},
            ValueError,
            "mix must have at least one template, got shape (2, 0, 5)",
        ),
        (
            "splat_events",
            {"arg2": test_ops.f32(test_ops.E) + 1.6e9, "arg5": test_ops.f32(2, 2) + 900},
            ValueError,
            "t must be relative to the window's reference time, got 1600000000.0 to 1600000000.0",
        ),
        (
            "deposit_events",
            {"arg2": np.linspace(40, 40.01, test_ops.E, dtype=np.float32), "arg5": test_ops.f32(2, 2) - 900},
            ValueError,
            "t must be relative to the window's reference time, got 40.0 to 40.0",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(op, changes, error, message):
    test_ops.test_bad_arguments(op, changes, error, message)


def test_shapes_may_be_lists():
    assert test_ops.call("bin_events", shape=[20, 21]).shape == (2, 20, 21)


@pytest.mark.parametrize("t", [0.02, -0.02, 0.0])
def test_times_near_the_reference_are_taken(t):
    """Also of a motion so fast that no event stays in the image, as an optimiser may try."""
    times = np.linspace(t, t + 0.01, test_ops.E, dtype=np.float32)
    image = test_ops.call("splat_events", arg2=times, arg5=test_ops.f32(2, 2) + 1e6)
    assert np.isfinite(image).all()


def test_counts_beyond_what_float32_tells_apart_are_an_error(monkeypatch):
    monkeypatch.setattr(checks, "MOST_COUNTED", 5)
    ones = np.ones(test_ops.E, np.float32)
    with pytest.raises(ValueError, match="images in float32 count to 5, and a window of 6 events got there"):
        test_ops.call("bin_events", arg2=ones)
    with pytest.raises(ValueError, match="a window of 8 events"):
        test_ops.call("bin_packed_events", arg2=np.ones(test_ops.E, np.uint32))
    spread = np.linspace(0, 9, test_ops.E, dtype=np.float32)
    assert test_ops.call("bin_events", arg0=spread, arg2=ones).sum() == test_ops.E
    double = [test_ops.f32(test_ops.E).astype(float) for _ in range(3)]
    assert test_ops.call("bin_events", arg0=double[0], arg1=double[1], arg2=double[2] + 1).max() == 6


@pytest.mark.parametrize("mark", needs("taichi") or [None])
def test_taichi_in_a_forked_process_says_so(mark):
    """It would wait for threads that are not there."""
    code = """
import os
def fork():
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            said = str(many())
        except Exception as error:
            said = f"{type(error).__name__}: {error}"
        os.write(write, said.encode())
        os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    return os.read(read, 999).decode()
def many():
    one, ptr = np.ones(6, np.float32), np.array([0, 2, 6], np.int32)
    return float(bin_events(one, one, one, ptr, shape=(4, 4), backend="taichi").sum())
get_backend("taichi")
print(fork())
many()
print(fork())
"""
    before, after = run(START + code).strip().splitlines()
    assert before == "6.0"
    assert after.startswith("BackendUnavailable: taichi runs in the process that this one was forked from")


def test_every_operation_that_reads_indices_by_event_is_here():
    """A new one with a ``window_ptr`` is to be looked at."""
    reads = {op for op, o in OPERATIONS.items() if any(a.name == "window_ptr" for a in o.inputs)}
    looked_at = {make(np.random.default_rng(0), np.float32).op for make in OF_EVENTS}
    # the checked functions are their only door that does not trust its caller, and look at all values
    assert reads - looked_at == {"bin_packed_events", "deposit_packed_events"}


NEAR = [
    cases.reduce_image,
    cases.pull_modules,
    cases.code_product,
    cases.pose_normal_equations,
    cases.local_maxima,
    cases.sample_moments,
    cases.score_poses,
    cases.code_rhs,
    cases.code_normal_equations,
]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("make", NEAR, ids=lambda make: make.__name__)
def test_what_is_not_finite_stays_where_it_is_used(make, bad, placed, spec):
    """As far as the specification spreads it, and no farther; in one input after the other."""
    for k, argument in enumerate(make(np.random.default_rng(20), np.float32).inputs):
        call = make(np.random.default_rng(20), np.float32)
        if not (isinstance(argument, np.ndarray) and argument.dtype.kind == "f"):
            continue
        call.inputs[k].reshape(-1)[1 :: max(2, argument.size // 3)] = bad
        with np.errstate(all="ignore"):
            expected = call.run(spec)
        for got, want in zip(call.run(placed), expected, strict=True):
            use = np.isfinite(want)
            np.testing.assert_array_equal(np.isfinite(got), use, err_msg=named(call)[k])
            assert_close(np.where(use, got, 0), np.where(use, want, 0))
