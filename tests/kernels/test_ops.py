"""The checked functions: what they allocate, what they refuse, and in which words."""

import numpy as np
import pytest
from backends import BACKENDS

import evqr_kernels
from evqr_kernels import OPERATIONS, register_backend, registry

from . import cases

E, B, Y, X = 10, 2, 9, 12


def f32(*shape):
    return np.zeros(shape, np.float32)


def level(height, width):
    """Rows of one level, and all of it each window's own."""
    rows = np.stack([np.zeros(height, np.int32), np.arange(height, dtype=np.int32)], axis=1)
    return rows, np.tile(np.array([height, width], np.int32), (B, 1, 1))


PTR = np.array([0, 4, E], np.int32)
SPAN = np.array([[-1, 1], [-1, 2]], np.float32)
RANGES = np.array([[0, 4], [2, E]], np.int32)
SPANS = np.array([[0, 5]] * 5, np.int32)
PACKED = np.zeros(E, np.uint16), np.zeros(E, np.uint16), np.arange(E, dtype=np.uint32)
TABLE = np.eye(20, 4, dtype=np.float32)
TERMS = np.zeros((8, 4), np.int32), np.full((8, 4), 3, np.int32)

GOOD = {
    "bin_events": ([f32(E), f32(E), f32(E), PTR], {"shape": (Y, X)}),
    "splat_events": ([f32(E), f32(E), f32(E), f32(E), PTR, f32(B, 2)], {"shape": (Y, X)}),
    "splat_events_adjoint": ([f32(E), f32(E), f32(E), f32(E), PTR, f32(B, 2), f32(B, Y, X)], {}),
    "deposit_events": ([f32(E), f32(E), f32(E), f32(E), PTR, f32(B, 2)], {"shape": (Y, X)}),
    "voxel_grid": ([f32(E), f32(E), f32(E), f32(E), PTR, SPAN], {"bins": 3, "shape": (Y, X)}),
    "time_surface": ([f32(E), f32(E), f32(E), f32(E), PTR], {"shape": (Y, X)}),
    "event_histogram": ([f32(E), f32(E), f32(E), PTR], {"shape": (Y, X)}),
    "voxel_grid_adjoint": ([f32(E), f32(E), f32(E), f32(E), PTR, SPAN, f32(B, 3, Y, X)], {}),
    "bin_packed_events": ([*PACKED, RANGES], {"shape": (Y, X)}),
    "deposit_packed_events": ([*PACKED, RANGES, np.zeros(B, np.int32), f32(B, 2)], {"shape": (Y, X)}),
    "lag_operator": ([f32(B, 2, Y, 21), np.zeros(3, np.int32), f32(3, 2), f32(3, 2), f32(2, 5)], {}),
    "deposit_events_adjoint": (
        [f32(E), f32(E), f32(E), f32(E), PTR, f32(B, 2), f32(B, 2, Y, X) + 1],
        {},
    ),
    "lag_operator_adjoint": (
        [np.zeros(3, np.int32), f32(3, 2), f32(3, 2), f32(2, 5) + 1, f32(3, Y, X) + 1],
        {"deposits": B},
    ),
    "motion_correlation": ([f32(B, 2, Y, X)], {"radius": 2, "clip": 1.0}),
    "surface_peak": ([f32(B, 5, 5)], {"half": 2.5}),
    "clip_outliers": ([f32(B, Y, X)], {"factor": 2.0}),
    "reduce_image": ([f32(B, Y, X)], {"ratio": 1.5}),
    "mix_images": ([f32(4, Y, X), f32(3, 4)], {}),
    "correlate_templates": (
        [f32(B, Y, X), f32(B), f32(B, 5, 5, 5), f32(B, 8, 5), SPANS, *level(Y - 4, X - 4), f32(1) + 0.5],
        {},
    ),
    "local_maxima": (
        [f32(B, Y, X), np.zeros((B, Y, X), np.int32), *level(Y, X), f32(1, 2) + 2, f32(B, 2)],
        {"least": 0.1, "turn": 0.2},
    ),
    "merge_maxima": ([f32(B, 9, 5)], {"apart": 2.0, "log_ratio": 0.3, "most": 4}),
    "match_corners": ([f32(B, 6, 5), f32(5)], {}),
    "line_runs": ([f32(B, Y, X), f32(4), np.zeros(4, np.int32), f32(B, 4) + 1], {"most": 3.0, "lines": 9}),
    "sample_moments": ([f32(B, Y, X), np.zeros(3, np.int32), f32(3, 9), f32(20, 2), f32(20, 4)], {}),
    "sample_moments_adjoint": (
        [f32(B, Y, X), np.zeros(3, np.int32), f32(3, 9), f32(20, 2), f32(20, 4), f32(3, 5)],
        {},
    ),
    "score_poses": (
        [
            f32(B, Y, X),
            np.zeros(3, np.int32),
            f32(3, 9) + 1,
            np.zeros(3, np.int32),
            np.array([[0, 6, 20]], np.int32),
            f32(20, 4),
        ],
        {},
    ),
    "align_poses": (
        [f32(B, Y, X), np.zeros(3, np.int32), f32(3, 9) + 1, f32(20, 2), TABLE, *TERMS],
        {"centre": (0.0, 0.0), "scale": (1.0, 1.0)},
    ),
    "code_rhs": (
        [f32(B, Y, X), f32(B, 9), f32(14), f32(6), f32(10), f32(10), f32(B, 2)],
        {"samples_a_module": 2},
    ),
    "solve_code": ([f32(B, 3, 7), f32(B, 5, 5), f32(B) + 1, np.ones((3, 7), np.int32), f32(B, 3, 7)], {}),
    "pose_normal_equations": ([f32(3, 5) + 1, np.eye(4, dtype=np.float32), *TERMS], {}),
    "code_normal_equations": (
        [f32(B, Y, X), f32(B, 9), f32(14), f32(6), f32(10) + 1, f32(10) + 1, f32(B, 2) + 1],
        {"samples_a_module": 2},
    ),
    "code_product": ([f32(B, 3, 7) + 1, f32(B, 5, 5), f32(B) + 1, np.ones((3, 7), np.int32)], {}),
    "sum_equations": (
        [f32(B, 3, 7), f32(B, 2), f32(B) + 1, f32(3, 5, 5), f32(B, 3, 7), f32(B, 5, 5) + 1, f32(3, 7) + 1],
        {"damping": 0.3, "least_damping": 0.1, "most_damping": 2.0},
    ),
    "pull_modules": ([f32(B, 3, 7), f32(B, 3, 7), f32(B) + 1], {"certainty": 2.0}),
    "solve_code_banded": (
        [f32(B, 3, 7) + 1, f32(B, 5, 5), f32(B) + 1, np.ones((3, 7), np.int32), f32(B, 3, 7)],
        {},
    ),
    "render_code": ([f32(B, 6, 5), f32(B, 6), f32(B)], {"shape": (Y, X)}),
    "render_code_adjoint": ([f32(B, 6, 5), f32(B, 6), f32(B), f32(B, Y, X)], {}),
    "brightness_residual": ([f32(B, Y, X), f32(B, Y, X), f32(B, 2)], {}),
    "brightness_residual_adjoint": ([f32(B, Y, X), f32(B, 2), f32(B, Y, X)], {}),
    "brightness_cost": ([f32(B, Y, X), f32(B, Y, X) + 1, f32(B, 2)], {}),
    "brightness_cost_adjoint": ([f32(B, Y, X), f32(B, Y, X) + 1, f32(B, 2), f32(B) + 1], {}),
}


def zeros(op):
    """Arguments of fitting shapes, for an operation that needs no others."""
    sizes = {"E": E, "B": B, "Y": Y, "X": X}
    arrays = [array for array in OPERATIONS[op].inputs if array.default is None]
    shapes = [[sizes.get(n, 5) if isinstance(n, str) else n for n in array.shape] for array in arrays]
    settings = {setting.name: 1 for setting in OPERATIONS[op].settings if setting.default is None}
    given = [np.zeros(shape, a.dtype(np.float32)) for a, shape in zip(arrays, shapes, strict=True)]
    return given, {**settings, **({"shape": (Y, X)} if "shape" in settings else {})}


GOOD |= {op: zeros(op) for op in OPERATIONS if op not in GOOD}


def call(op, *, backend="numpy", **changes):
    """Call with good arguments, some of them changed, by position or by name."""
    arrays, options = GOOD[op]
    arrays = list(arrays)
    for name, value in changes.items():
        if name.startswith("arg"):
            arrays[int(name[3:])] = value
        else:
            options = {**options, name: value}
    return getattr(evqr_kernels, op)(*arrays, backend=backend, **options)


def as_tuple(results):
    return results if isinstance(results, tuple) else (results,)


def test_every_operation_has_a_checked_function():
    assert set(GOOD) == set(OPERATIONS) == set(evqr_kernels.ops.__all__) <= set(evqr_kernels.__all__)


@pytest.mark.parametrize("name", BACKENDS[1:])
@pytest.mark.parametrize("op", OPERATIONS)
def test_good_arguments_pass_on_every_backend(op, name):
    for one, other in zip(as_tuple(call(op)), as_tuple(call(op, backend=name)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("make", [*cases.CALLS, cases.solve_code_banded], ids=lambda make: make.__name__)
def test_results_are_those_of_the_backend(make, rng, spec):
    """The function allocates and passes on: the same numbers as the method of the specification."""
    made = make(rng, np.float64)
    for array, output in zip(made.operation.outputs, made.outputs[made.scratch :], strict=False):
        if not array.start:
            output[:] = 0
    arrays = made.operation.outputs[-len(made.outputs) + made.scratch :]
    expected = [out for array, out in zip(arrays, made.run(spec), strict=True) if array.returned]
    got = getattr(evqr_kernels, made.op)(**made.checked, backend="numpy")
    for one, other in zip(as_tuple(got), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.mark.parametrize("name", BACKENDS)
def test_out_is_accumulated_or_overwritten_in_place(name):
    ones = np.ones(E, np.float32)
    out = np.full((B, Y, X), 2, np.float32)
    image = call("bin_events", arg2=ones, out=out, shape=None, backend=name)
    assert image is out
    np.testing.assert_array_equal(out[:, 0, 0], [6, 8])
    out[:] = np.nan
    assert (
        call("render_code", arg2=f32(B) + 3, arg0=f32(B, 6, 5) + 3, out=out, shape=None, backend=name) is out
    )
    np.testing.assert_array_equal(out, 3)


@pytest.mark.parametrize("name", BACKENDS)
def test_out_that_is_read_only_is_refused(name):
    out = f32(B, Y, X)
    out.flags.writeable = False
    with pytest.raises(ValueError, match="out must be writable, it gets the result: give a copy"):
        call("bin_events", arg2=np.ones(E, np.float32), out=out, shape=None, backend=name)
    np.testing.assert_array_equal(out, 0)


@pytest.mark.parametrize("name", BACKENDS)
def test_inputs_that_are_read_only_are_read(name):
    image = np.ones((B, Y, X), np.float32)
    image.flags.writeable = False
    np.testing.assert_array_equal(call("reduce_image", arg0=image, ratio=1.0, backend=name), image)


@pytest.mark.parametrize("op", ["mix_images", "correlate_templates"])
def test_what_is_cut_out_of_a_wider_result_can_be_given_on(op):
    narrow = dict(zip(("arg5", "arg6"), level(Y - 4, 3), strict=True))
    given = {"arg0": f32(4, Y, 7)} if op == "mix_images" else {"arg0": f32(B, Y, 7), **narrow}
    assert all(result.flags.c_contiguous for result in as_tuple(call(op, **given)))


def test_without_a_mask_all_pixels_count(rng):
    arrays = [rng.normal(size=shape) for shape in ((B, Y, X), (B, Y, X), (B, 2))]
    cost = evqr_kernels.brightness_cost(*arrays, backend="numpy")
    residual = evqr_kernels.brightness_residual(*arrays, backend="numpy")
    np.testing.assert_allclose(cost, 0.5 * np.square(residual).sum(axis=(1, 2)), rtol=1e-14)
    options = {"mask": np.ones((B, Y, X)), "backend": "numpy"}
    np.testing.assert_array_equal(cost, evqr_kernels.brightness_cost(*arrays, **options))


def test_inputs_are_left_alone():
    start = np.ones((B, 3, 7), np.float32)
    q, iterations = call("solve_code", arg0=start + 1, arg1=np.ones((B, 1, 1), np.float32), arg4=start)
    np.testing.assert_array_equal(start, 1)
    np.testing.assert_allclose(q, -1)
    np.testing.assert_array_equal(iterations, 1)


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("shape", [(5, 5), (6, 7), (9, 4), (2, 2), (2, 9)])
def test_templates_on_small_images(shape, name):
    expected = tuple(max(0, side - 4) for side in shape)
    rows, extent = level(*expected)
    given = {"arg0": np.ones((B, *shape), np.float32), "arg5": rows, "arg6": extent}
    response, angle = call("correlate_templates", **given, backend=name)
    assert response.shape == angle.shape == (B, *expected)


BAD = [
    (
        "render_code",
        {"arg1": f32(4, 5)},
        ValueError,
        "to_grid must have shape (B, 6) or (B, 8), got (4, 5)",
    ),
    (
        "render_code",
        {"arg1": f32(3, 8)},
        ValueError,
        "to_grid must have shape (B, 8) with B = 2, got (3, 8)",
    ),
    ("render_code", {"arg0": f32(B, 6)}, ValueError, "grid must have shape (B, G, H), got (2, 6)"),
    ("render_code", {"sigma": 0.01}, ValueError, "sigma must be 0, or 0.02 to 1, got 0.01"),
    ("render_code_adjoint", {"sigma": float("nan")}, ValueError, "sigma must be 0, or 0.02 to 1, got nan"),
    ("render_code", {"shape": None}, TypeError, "shape of the image must be given when there is no out"),
    ("render_code", {"out": f32(3, Y, X)}, ValueError, "out must have shape (B, Y, X) with B = 2"),
    ("bin_events", {"arg1": f32(E + 1)}, ValueError, "y must have shape (E,) with E = 10, got (11,)"),
    ("bin_events", {"arg0": f32(2 * E)[::2]}, ValueError, "x must be contiguous, it is not copied"),
    (
        "bin_events",
        {"out": f32(B, Y, 2 * X)[:, :, ::2]},
        ValueError,
        "out must be contiguous, it is not copied: give np.ascontiguousarray(out)",
    ),
    ("render_code", {"shape": (Y, -1)}, ValueError, "result must have no negative size, got (2, 9, -1)"),
    ("splat_events", {"arg4": PTR[:1]}, ValueError, "must have shape (B + 1,), got (1,) for 10 events"),
    ("bin_events", {"arg0": [1.0]}, TypeError, "x must be a NumPy array, got list"),
    ("bin_events", {"arg0": np.zeros(E, int)}, TypeError, "x must be float32 or float64, got int64"),
    (
        "bin_events",
        {"arg2": np.zeros(E)},
        TypeError,
        "weight must be float32 like the arrays before it, got float64",
    ),
    ("bin_events", {"arg3": PTR.astype(np.int64)}, TypeError, "window_ptr must be int32, got int64"),
    ("bin_events", {"arg3": PTR[:2]}, ValueError, "window_ptr must go from 0 to 10, got 0 to 4"),
    ("bin_events", {"arg3": PTR[:0]}, ValueError, "window_ptr must have shape (B + 1,), got (0,)"),
    (
        "bin_events",
        {"arg3": np.array([0, 6, 4, E], np.int32)},
        ValueError,
        "window_ptr must not decrease, got 4 after 6",
    ),
    ("bin_events", {"reduction": 0.0}, ValueError, "reduction must be at least 1e-06, got 0.0"),
    ("splat_events", {"frame": f32(B, 3)}, ValueError, "frame must have a positive scale, got 0.0"),
    ("splat_events", {"lag": f32(B, 3)}, ValueError, "lag must have shape (B, 2) with B = 2, got (2, 3)"),
    (
        "splat_events",
        {"arg5": f32(B, 4)},
        ValueError,
        "motion must have shape (B, 2) or (B, 6), got (2, 4)",
    ),
    (
        "splat_events",
        {"arg5": f32(3, 6)},
        ValueError,
        "motion must have shape (B, 6) with B = 2, got (3, 6)",
    ),
    ("splat_events", {"arg5": None}, TypeError, "motion must be a NumPy array, got NoneType"),
    (
        "deposit_events",
        {"arg5": f32(B, 6)},
        ValueError,
        "motion must have shape (B, 2) with B = 2, got (2, 6)",
    ),
    ("deposit_events", {"frame": f32(B, 3)}, ValueError, "frame must have a positive scale, got 0.0"),
    ("deposit_events", {"out": f32(B, Y, X)}, ValueError, "out must have shape (B, 2, Y, X), got (2, 9, 12)"),
    ("voxel_grid", {"bins": 0}, ValueError, "bins must be at least 1, got 0"),
    ("voxel_grid", {"bins": None}, TypeError, "bins of the image must be given when there is no out"),
    (
        "voxel_grid",
        {"arg5": SPAN[:, ::-1].copy()},
        ValueError,
        "span must end after it begins, got 1.0 to -1.0",
    ),
    ("voxel_grid", {"arg5": SPAN * np.nan}, ValueError, "span must end after it begins, got nan to nan"),
    ("event_histogram", {"out": f32(B, 2, Y, X)}, TypeError, "out must be int32, got float32"),
    ("time_surface", {"decay": -1.0}, ValueError, "decay must be at least 0.0, got -1.0"),
    ("lag_operator", {"arg4": f32(2, 4)}, ValueError, "with K odd and at least 3, got (2, 4)"),
    ("lag_operator", {"arg4": f32(2, 1)}, ValueError, "with K odd and at least 3, got (2, 1)"),
    ("lag_operator", {"arg0": f32(0, 2, Y, 21)}, ValueError, "deposit_idx must have shape (0,)"),
    ("lag_operator", {"extent": np.zeros((2, 2), np.int32)}, ValueError, "extent must have shape (N, 2)"),
    (
        "lag_operator",
        {"extent": np.full((3, 2), 10, np.int32)},
        ValueError,
        "extent must be 0 to (9, 21), got 10 to 10 for 9",
    ),
    (
        "bin_packed_events",
        {"arg0": np.zeros(E, np.int32)},
        TypeError,
        "x must be uint16, got int32",
    ),
    ("bin_packed_events", {"arg3": RANGES + 1}, ValueError, "window_ptr must be 0 to 10, got 1 to 11"),
    ("bin_packed_events", {"arg3": RANGES[:, ::-1].copy()}, ValueError, "must not end before it begins"),
    ("bin_packed_events", {"arg3": PTR}, ValueError, "window_ptr must have shape (B, 2), got (3,)"),
    (
        "bin_packed_events",
        {"shape": None},
        TypeError,
        "shape of the image must be given when there is no out",
    ),
    ("deposit_packed_events", {"arg4": f32(B)}, TypeError, "t_ref must be int32, got float32"),
    ("deposit_packed_events", {"frame": f32(B, 3)}, ValueError, "frame must have a positive scale, got 0.0"),
    ("lag_operator", {"arg1": PTR}, ValueError, "deposit_idx must be 0 to 1, got 0 to 10"),
    (
        "deposit_events_adjoint",
        {"arg6": f32(B, Y, X)},
        ValueError,
        "adj_deposit must have shape (B, 2, Y, X)",
    ),
    ("lag_operator_adjoint", {"arg3": f32(2, 1)}, ValueError, "with K odd and at least 3, got (2, 1)"),
    ("lag_operator_adjoint", {"arg4": f32(B, Y, X)}, ValueError, "adj_image must have shape (N, Y, X)"),
    ("lag_operator_adjoint", {"deposits": -1}, ValueError, "deposits must be at least 0, got -1"),
    ("lag_operator_adjoint", {"arg0": PTR}, ValueError, "deposit_idx must be 0 to 1, got 0 to 10"),
    ("motion_correlation", {"radius": -1}, ValueError, "radius must be at least 0, got -1"),
    ("motion_correlation", {"arg0": f32(B, 3, Y, X)}, ValueError, "images must have shape (B, 2, Y, X)"),
    ("motion_correlation", {"clip": -1.0}, ValueError, "clip must be at least 0.0, got -1.0"),
    ("surface_peak", {"arg0": f32(B, 4, 4)}, ValueError, "odd size of at least 3, got 4"),
    ("surface_peak", {"half": 0.5}, ValueError, "half must be at least 1.0, got 0.5"),
    ("surface_peak", {"half": 3.5}, ValueError, "half must be at most 3 for 5 entries, got 3.5"),
    ("mix_images", {"arg1": f32(3, 5)}, ValueError, "(N, K) with N = 3, K = 4, got (3, 5)"),
    ("clip_outliers", {"factor": -0.5}, ValueError, "factor must be at least 0.0, got -0.5"),
    ("local_maxima", {"arg2": level(Y - 1, X)[0]}, ValueError, "rows must have shape (Y, 2)"),
    ("local_maxima", {"arg2": level(Y, X)[0] + 1}, ValueError, "rows must be of levels up to 0, got 1"),
    ("local_maxima", {"arg2": level(Y, X)[0][::-1].copy()}, ValueError, "rows of level 0 must be 0, 1, ..."),
    ("local_maxima", {"arg3": level(Y, X + 1)[1]}, ValueError, f"extent must be 0 to {X} columns"),
    ("local_maxima", {"arg3": level(Y + 1, X)[1]}, ValueError, f"extent must be at most {Y} rows of level 0"),
    ("local_maxima", {"most": 0}, ValueError, "most must be at least 1, got 0"),
    ("merge_maxima", {"arg0": f32(B, 9, 4)}, ValueError, "maxima must have shape (B, N, 5)"),
    ("match_corners", {"arg1": f32(4)}, ValueError, "tolerances must have shape (5,), got (4,)"),
    ("line_runs", {"most": 0.5}, ValueError, "most must be at least 1.0, got 0.5"),
    ("line_runs", {"arg3": f32(B, 5)}, ValueError, "threshold must have shape (B, A)"),
    ("reduce_image", {"ratio": 0.5}, ValueError, "ratio must be at least 1.0, got 0.5"),
    ("reduce_image", {"ratio": float("nan")}, ValueError, "ratio must be at least 1.0, got nan"),
    ("correlate_templates", {"arg2": f32(B, 5, 5, 7)}, ValueError, "basis must have shape (B, N, N, 5)"),
    ("correlate_templates", {"arg6": level(Y, X)[1]}, ValueError, "extent must be at most"),
    ("correlate_templates", {"arg4": SPANS[:4]}, ValueError, "spans must have shape (N, 2) with N = 5"),
    (
        "correlate_templates",
        {"arg4": SPANS + 1},
        ValueError,
        "spans must be 0 to 5 and not decrease, got 1 to 6",
    ),
    ("correlate_templates", {"least": -1.0}, ValueError, "least must be at least 0.0, got -1.0"),
    (
        "sample_moments",
        {"arg1": np.array([0, 1, 2], np.int32)},
        ValueError,
        "image_idx must be 0 to 1, got 0 to 2",
    ),
    ("sample_moments", {"arg0": f32(0, Y, X)}, ValueError, "image_idx must have shape (0,)"),
    ("sample_moments", {"arg4": f32(20, 0)}, ValueError, "C must be at least 1, got 0"),
    ("sample_moments", {"active": np.ones(3)}, TypeError, "active must be int32, got float64"),
    (
        "sample_moments_adjoint",
        {"arg5": f32(3, 4)},
        ValueError,
        "adj_moments must have shape (N, 5) with N = 3",
    ),
    ("score_poses", {"arg3": np.ones(3, np.int32)}, ValueError, "model_idx must be 0 to 0, got 1 to 1"),
    (
        "score_poses",
        {"arg4": np.array([[0, 6, 21]], np.int32)},
        ValueError,
        "rows of model_ptr must be 0 to 20 and not decrease",
    ),
    (
        "align_poses",
        {"image_part": np.array([[0, Y, X], [2, Y - 1, X], [0, Y, X]], np.int32)},
        ValueError,
        f"image_part must end within the {Y} rows of an image",
    ),
    ("align_poses", {"arg5": np.zeros((9, 4), np.int32)}, ValueError, "factors must have shape (P + 2, 4)"),
    ("align_poses", {"arg5": np.full((8, 4), 4, np.int32)}, ValueError, "terms must be 0 to 3, got 4 to 4"),
    (
        "align_poses",
        {"centre": 0.5},
        ValueError,
        "centre must be two numbers, along u and v, a table, got 0.5",
    ),
    (
        "align_poses",
        {"scale": (1.0,)},
        ValueError,
        "scale must be two numbers, along u and v, a table, got (1.0,)",
    ),
    ("code_rhs", {"arg2": f32(7, 2, 1)}, ValueError, "lattice_u must have shape (M, S), got (7, 2, 1)"),
    ("code_rhs", {"arg3": f32(3, 2)}, ValueError, "lattice_v must have shape (M, T) with M = 1, got (3, 2)"),
    (
        "solve_code",
        {"arg3": np.ones((7, 3), np.int32)},
        ValueError,
        "free must have shape (M, V, U) with M = 1, V = 3, U = 7",
    ),
    (
        "align_poses",
        {"table_ptr": np.array([[0, 21]], np.int32)},
        ValueError,
        "table_ptr must be 0 to 20, got 0 to 21",
    ),
    (
        "align_poses",
        {"table_idx": np.array([0, 1, 0], np.int32)},
        ValueError,
        "table_idx must be 0 to 0, got 0 to 1",
    ),
    ("code_rhs", {"sides": np.array([[3, 8]], np.int32)}, ValueError, "sides must be 0 to (3, 7)"),
    ("code_rhs", {"space_idx": np.full(B, 1, np.int32)}, ValueError, "space_idx must be 0 to 0, got 1 to 1"),
    (
        "solve_code",
        {"bounds": np.array([[0, 4, 0, 7]], np.int32)},
        ValueError,
        "bounds must be 0 to (3, 3, 7, 7), got 4 to 4 for 3",
    ),
    ("mix_images", {"image_idx": np.ones(3, np.int32)}, ValueError, "image_idx must be 0 to 0, got 1 to 1"),
    ("code_rhs", {"samples_a_module": 0}, ValueError, "samples_a_module must be at least 1, got 0"),
    (
        "pose_normal_equations",
        {"arg0": f32(3, 4)},
        ValueError,
        "moments must have shape (N, 5) with N = 3,",
    ),
    (
        "pose_normal_equations",
        {"arg2": np.zeros((9, 4), np.int32), "arg3": np.zeros((9, 4), np.int32)},
        ValueError,
        "terms must have shape (8, 4) or (10, 4), got (9, 4)",
    ),
    (
        "pose_normal_equations",
        {"arg2": np.full((8, 4), 4, np.int32)},
        ValueError,
        "terms must be 0 to 3, got 4 to 4",
    ),
    ("code_normal_equations", {"reach": -1}, ValueError, "reach must be at least 0, got -1"),
    ("code_product", {"arg1": f32(B, 4, 4)}, ValueError, "stencil must have an odd side, got (2, 4, 4)"),
    (
        "sum_equations",
        {"arg3": f32(3, 4, 4), "arg5": f32(B, 4, 4)},
        ValueError,
        "products must have odd sides, got (3, 4, 4)",
    ),
    ("sum_equations", {"damping": -1.0}, ValueError, "damping must be at least 0.0, got -1.0"),
    ("pull_modules", {"certainty": -1.0}, ValueError, "certainty must be at least 0.0, got -1.0"),
    ("pull_modules", {"certainty": np.inf}, ValueError, "certainty must be finite, got inf"),
    ("solve_code_banded", {"arg1": f32(B, 2, 2)}, ValueError, "stencil must have an odd side, got (2, 2, 2)"),
    ("solve_code", {"arg1": f32(B, 4, 4)}, ValueError, "stencil must have an odd side, got (2, 4, 4)"),
    ("solve_code", {"max_iterations": -1}, ValueError, "max_iterations must be at least 0, got -1"),
    (
        "brightness_residual",
        {"arg2": f32(3, 2)},
        ValueError,
        "motion must have shape (B, 2) with B = 2, got (3, 2)",
    ),
    ("brightness_cost", {"mask": f32(Y, X)}, ValueError, "mask must have shape (B, Y, X), got (9, 12)"),
    ("brightness_cost", {"mask": f32(B, Y, X) - 1}, ValueError, "mask must be at least 0.0, got -1.0"),
    ("brightness_cost", {"mask": f32(B, Y, X) + np.nan}, ValueError, "mask must be at least 0.0, got nan"),
    (
        "brightness_cost",
        {"mask": np.ones((B, Y, X), bool)},
        TypeError,
        "mask must be float32 or float64, got bool",
    ),
    (
        "brightness_cost_adjoint",
        {"arg3": f32(3)},
        ValueError,
        "adj_cost must have shape (B,) with B = 2, got (3,)",
    ),
    ("brightness_residual", {"backend": "nothing"}, ValueError, "backend must be one of auto"),
    (
        "brightness_residual",
        {"device": "cuda:99"},
        ValueError,
        "device of numpy must be one of cpu, got 'cuda:99'",
    ),
]


@pytest.mark.parametrize(("op", "changes", "error", "message"), BAD)
def test_bad_arguments(op, changes, error, message):
    with pytest.raises(error) as info:
        call(op, **changes)
    assert message in str(info.value)
    assert "\n" not in str(info.value)


def test_refused_operation_gives_the_reason(monkeypatch):
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_loaded", dict(registry._loaded))
    register_backend("choosy", f"{__name__}:Choosy")
    with pytest.raises(evqr_kernels.OperationRefused, match="choosy refuses reduce_image: out of order"):
        call("reduce_image", backend="choosy")


class Choosy:
    name = "choosy"

    def devices(self):
        return ("cpu",)

    def supports(self, op, dtype, device):
        return "out of order"
