"""Calls of the differentiable operations on NumPy arrays, and what computes the same from the definition."""

from dataclasses import dataclass, field

import numpy as np

from evqr_kernels import SplatConfig

from . import cases, references, test_ops

SHAPE = cases.Y, cases.X


@dataclass
class Case:
    op: str
    arrays: dict
    varied: tuple[str, ...]
    options: dict = field(default_factory=dict)
    reference_options: dict = field(default_factory=dict)
    uses_erf: bool = False

    @property
    def reference(self):
        return getattr(references, self.op)


def splat_events(rng, dtype, parameters=2):
    names = ("x", "y", "t", "weight", "window_ptr", "motion")
    arrays = dict(zip(names, cases.splat_inputs(rng, dtype)[:6], strict=True))
    if parameters == 6:
        arrays["motion"] = np.hstack([arrays["motion"], cases.affine_motion(rng, dtype)])
    cfg = SplatConfig(epsilon_px=1.1)
    return Case("splat_events", arrays, ("weight", "motion", "x", "y"), {"shape": SHAPE, "cfg": cfg})


def splat_events_affine(rng, dtype):
    return splat_events(rng, dtype, 6)


def splat_events_bilinear(rng, dtype):
    case = splat_events(rng, dtype)
    case.options["cfg"] = SplatConfig(kind="bilinear")
    return case


def splat_events_lagging(rng, dtype):
    """In a frame of its own, with pixels that lag."""
    case = splat_events(rng, dtype)
    *_, case.arrays["lag"], case.arrays["frame"] = cases.splat_inputs(rng, dtype)
    motion = case.arrays["motion"]
    speed = np.linalg.norm(motion, axis=1, keepdims=True)
    case.reference_options["direction"] = motion / np.where(speed > 0, speed, 1)
    return case


def deposit_events(rng, dtype):
    case = splat_events(rng, dtype)
    x, y = case.arrays["x"], case.arrays["y"]
    # between cells all of them, and none on a line
    x[:], y[:] = (4.013 + (column % 1.0) * 0.97 + np.floor(column % 14) for column in (x, y))
    return Case("deposit_events", case.arrays, ("weight", "motion", "x", "y"), {"shape": SHAPE})


def deposit_events_in_a_frame(rng, dtype):
    case = deposit_events(rng, dtype)
    case.arrays["frame"] = np.tile(np.array([-4.25, 1.5, 1.3], dtype), (cases.B, 1))
    for axis, corner in (("x", -4.25), ("y", 1.5)):
        case.arrays[axis] = ((case.arrays[axis] + 0.5) * 1.3 - 0.5 + corner).astype(dtype)
    return case


def voxel_grid(rng, dtype):
    names = ("x", "y", "t", "weight", "window_ptr", "span")
    arrays = dict(zip(names, cases.voxel_grid(rng, dtype).inputs, strict=True))
    return Case("voxel_grid", arrays, ("weight", "t"), {"bins": 5, "shape": SHAPE})


def lag_operator(rng, dtype):
    names = ("deposit", "deposit_idx", "direction", "lag", "taps")
    arrays = dict(zip(names, cases.lag_operator(rng, dtype).inputs, strict=False))
    return Case("lag_operator", arrays, ("deposit",))


def lag_operator_on_a_part(rng, dtype):
    case = lag_operator(rng, dtype)
    case.arrays["extent"] = cases.lag_operator(rng, dtype).inputs[5]
    return case


def render_code(rng, dtype, parameters=6, sigma=0.0):
    grid, to_grid, outside, _ = cases.render_code(rng, dtype, parameters).inputs
    to_grid[:, 6:] *= 0.1  # in front of all of the image
    arrays = {"grid": grid, "to_grid": to_grid, "outside": outside}
    options = {"shape": SHAPE, "sigma": sigma}
    return Case("render_code", arrays, ("grid", "to_grid"), options, uses_erf=True)


def render_code_smooth(rng, dtype):
    return render_code(rng, dtype, sigma=0.23)


def render_code_tilted_smooth(rng, dtype):
    return render_code(rng, dtype, 8, 0.3)


def brightness_residual(rng, dtype):
    names = ("luminance", "events_image", "motion")
    arrays = dict(zip(names, cases.brightness_residual(rng, dtype).inputs, strict=True))
    return Case("brightness_residual", arrays, names)


def brightness_cost(rng, dtype):
    names = ("luminance", "events_image", "motion", "mask")
    arrays = dict(zip(names, cases.brightness_cost(rng, dtype).inputs, strict=True))
    return Case("brightness_cost", arrays, names[:3])


def sample_moments(rng, dtype):
    image, image_idx, pose, _, points, table = cases.sample_moments(rng, dtype).inputs
    arrays = {"image": image, "image_idx": image_idx, "pose": pose, "points": points, "table": table}
    return Case("sample_moments", arrays, ("image",))


def sample_moments_of_some(rng, dtype):
    """Only some poses are active."""
    case = sample_moments(rng, dtype)
    case.arrays["active"] = (np.arange(len(case.arrays["pose"])) % 2).astype(np.int32)
    return case


CASES = [
    splat_events,
    splat_events_affine,
    splat_events_bilinear,
    splat_events_lagging,
    deposit_events,
    deposit_events_in_a_frame,
    voxel_grid,
    lag_operator,
    lag_operator_on_a_part,
    render_code,
    render_code_smooth,
    render_code_tilted_smooth,
    brightness_residual,
    brightness_cost,
    sample_moments,
    sample_moments_of_some,
]

NOT_DIFFERENTIABLE = [cases.time_surface, cases.event_histogram]

TOLERANCE = {np.float32: 2e-4, np.float64: 1e-11}
"""Relative to the largest value: sums of thousands of terms, in another order."""


def assert_like(got, expected, dtype):
    got, expected = np.asarray(got), np.asarray(expected)
    assert got.dtype == expected.dtype == dtype
    np.testing.assert_allclose(got, expected, rtol=0, atol=TOLERANCE[dtype] * np.abs(expected).max())


OF_CHECKED_FUNCTIONS = {"out", "backend", "device"}
OF_OUT = ("no out",)
OF_FRAMEWORKS = ("got bool",)


OPERATIONS = {make.__name__ for make in CASES} & set(test_ops.GOOD)

BAD_CALLS = [
    (op, changes, error, message)
    for op, changes, error, message in test_ops.BAD
    if op in OPERATIONS and not set(changes) & OF_CHECKED_FUNCTIONS
    if not any(words in message for words in OF_OUT + OF_FRAMEWORKS)
]
"""What the checked functions refuse and differentiable ones do too, on the CPU."""


def bad_arguments(op, changes, array):
    """Arguments of such a call, made into arrays by ``array``."""

    def made(value):
        return array(value) if isinstance(value, np.ndarray) else value

    arrays, options = test_ops.GOOD[op]
    given = {f"arg{k}": value for k, value in enumerate(arrays)} | options | changes
    given = {name: made(value) for name, value in given.items()}
    arrays = [given.pop(f"arg{k}") for k in range(len(arrays))]
    return arrays, given
