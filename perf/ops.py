"""Problems for every operation, of any size: random inputs, and counts of items and multiply-adds.

The builder of an operation has its name; `PROBLEMS` lists them.  Inputs are of the kind that the reader has:
events within the image, maps that show all of the code, positive definite systems.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from ops_systems import REACH, code_product, pull_modules, solve_code, solve_code_banded, sum_equations
from problems import Problem, Size, problem

from evqr_kernels import KernelBackend, SplatConfig

SPLAT = SplatConfig()
SAMPLES_A_MODULE = 4
PROFILE_MODULES = 5
COLUMNS = 20  # of the table of moments
BINS = 5  # planes of a voxel grid
TEMPLATE = 23  # pixels a side of a finder pattern's template


def _events(size: Size, rng, dtype) -> list:
    """Columns x, y, t, weight and window_ptr."""
    count = size.batch * size.events
    x, y = rng.uniform(0, size.side - 1, (2, count)).astype(dtype)
    t = rng.uniform(-5e-4, 5e-4, count).astype(dtype)
    weight = rng.choice([-1.0, 1.0], count).astype(dtype)
    return [x, y, t, weight, (np.arange(size.batch + 1) * size.events).astype(np.int32)]


def _transported(size: Size, rng, dtype, parameters: int = 2) -> tuple[list, list, list]:
    """Events with motion, lag and frame."""
    velocity = rng.uniform(-3000, 3000, (size.batch, 2))
    turning = rng.uniform(-30, 30, (size.batch, parameters - 2))
    motion = np.hstack([velocity, turning]).astype(dtype)
    lag = rng.uniform(0, 1, (size.batch, 2)).astype(dtype)
    frame = np.tile(np.array([0, 0, 1], dtype), (size.batch, 1))
    return [*_events(size, rng, dtype), motion], [lag], [frame]


def _image(size: Size, rng, dtype, *planes: int) -> np.ndarray:
    return rng.normal(size=(size.batch, *planes, size.side, size.side)).astype(dtype)


def bin_events(size: Size, rng, dtype) -> Problem:
    x, y, _, weight, window_ptr = _events(size, rng, dtype)
    inputs = [x, y, weight, window_ptr, 1.0]
    return problem("bin_events", inputs, len(x), 3 * len(x), "event", shape=(size.side, size.side))


def _splat(size: Size, rng, dtype, parameters: int) -> Problem:
    events, lag, frame = _transported(size, rng, dtype, parameters)
    taps, count = 2 * SPLAT.reach + 1, len(events[0])
    madds = count * (2 * 9 * taps + 2 * taps**2)
    inputs, shape = [*events, *lag, *frame], (size.side, size.side)
    return problem("splat_events", inputs, count, madds, "event", tail=(SPLAT,), shape=shape)


def splat_events(size: Size, rng, dtype) -> Problem:
    return _splat(size, rng, dtype, 2)


def splat_events_affine(size: Size, rng, dtype) -> Problem:
    return _splat(size, rng, dtype, 6)


def _splat_adjoint(size: Size, rng, dtype, parameters: int) -> Problem:
    splat = _splat(size, rng, dtype, parameters)
    taps, count = 2 * SPLAT.reach + 1, splat.items
    inputs = [*splat.inputs, _image(size, rng, dtype)]
    madds = count * (2 * 16 * taps + 3 * taps**2 + 7 * taps)
    return problem("splat_events_adjoint", inputs, count, madds, "event", tail=(SPLAT,))


def splat_events_adjoint(size: Size, rng, dtype) -> Problem:
    return _splat_adjoint(size, rng, dtype, 2)


def splat_events_affine_adjoint(size: Size, rng, dtype) -> Problem:
    return _splat_adjoint(size, rng, dtype, 6)


def deposit_events(size: Size, rng, dtype) -> Problem:
    events, _, frame = _transported(size, rng, dtype)
    inputs, count, shape = [*events, *frame], len(events[0]), (size.side, size.side)
    return problem("deposit_events", inputs, count, 12 * count, "event", shape=shape)


def deposit_events_adjoint(size: Size, rng, dtype) -> Problem:
    events, _, frame = _transported(size, rng, dtype)
    count, adj = len(events[0]), _image(size, rng, dtype, 2)
    inputs = [*events, *frame, adj]
    return problem("deposit_events_adjoint", inputs, count, 12 * count, "event")


def _planes(size: Size, rng, dtype) -> list:
    return [*_events(size, rng, dtype), np.tile(np.array([-5e-4, 5e-4], dtype), (size.batch, 1))]


def voxel_grid(size: Size, rng, dtype) -> Problem:
    inputs, shape = _planes(size, rng, dtype), (size.side, size.side)
    return problem("voxel_grid", inputs, len(inputs[0]), 4 * len(inputs[0]), "event", bins=BINS, shape=shape)


def voxel_grid_adjoint(size: Size, rng, dtype) -> Problem:
    x, *others = _planes(size, rng, dtype)
    inputs = [x, *others, _image(size, rng, dtype, BINS)]
    return problem("voxel_grid_adjoint", inputs, len(x), 5 * len(x), "event")


def time_surface(size: Size, rng, dtype) -> Problem:
    x, *others = _events(size, rng, dtype)
    inputs, shape = [x, *others, 1e-3], (size.side, size.side)
    return problem("time_surface", inputs, len(x), 2 * len(x), "event", shape=shape)


def event_histogram(size: Size, rng, dtype) -> Problem:
    x, y, _, weight, window_ptr = _events(size, rng, dtype)
    inputs, shape = [x, y, weight, window_ptr], (size.side, size.side)
    return problem("event_histogram", inputs, len(x), 3 * len(x), "event", shape=shape)


def _extent(size: Size) -> np.ndarray:
    return np.full((size.batch, 2), size.side, np.int32)


def _packed(size: Size, rng) -> list:
    """Columns x, y, stamp and window_ptr; 1 ms, from 0."""
    count = size.batch * size.events
    x, y = rng.integers(0, size.side, (2, count)).astype(np.uint16)
    stamp = np.sort(rng.integers(0, 2000, (size.batch, size.events)), axis=1).astype(np.uint32).ravel()
    first = np.arange(size.batch) * size.events
    return [x, y, stamp, np.stack([first, first + size.events], axis=1).astype(np.int32)]


def bin_packed_events(size: Size, rng, dtype) -> Problem:
    inputs = [*_packed(size, rng), 1.0]
    made = problem(
        "bin_packed_events", inputs, len(inputs[0]), 3 * len(inputs[0]), "event", shape=(size.side, size.side)
    )
    made.outputs = [output.astype(dtype) for output in made.outputs]  # no input is of floats
    return made


def deposit_packed_events(size: Size, rng, dtype) -> Problem:
    velocity = rng.uniform(-3e-3, 3e-3, (size.batch, 2)).astype(dtype)
    frame = np.tile(np.array([0, 0, 1], dtype), (size.batch, 1))
    t_ref = np.full(size.batch, 500, np.int32)
    inputs = [*_packed(size, rng), t_ref, velocity, frame, _extent(size)]
    count, shape = len(inputs[0]), (size.side, size.side)
    return problem("deposit_packed_events", inputs, count, 12 * count, "event", shape=shape)


def _lag(size: Size, rng, dtype) -> list:
    angle = rng.uniform(0, 6, size.batch)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(dtype)
    lag = rng.uniform(0, 3, (size.batch, 2)).astype(dtype)
    taps = rng.normal(size=(2, 5)).astype(dtype)
    return [np.arange(size.batch, dtype=np.int32), direction, lag, taps, _extent(size)]


def lag_operator(size: Size, rng, dtype) -> Problem:
    deposit = _image(size, rng, dtype, 2)
    pixels = size.batch * size.side**2
    return problem("lag_operator", [deposit, *_lag(size, rng, dtype)], pixels, 20 * pixels)


def lag_operator_adjoint(size: Size, rng, dtype) -> Problem:
    adj, pixels = _image(size, rng, dtype), size.batch * size.side**2
    inputs = [*_lag(size, rng, dtype), adj]
    return problem("lag_operator_adjoint", inputs, pixels, 20 * pixels, deposits=size.batch)


def motion_correlation(size: Size, rng, dtype, radius: int = 12) -> Problem:
    images = 2.0 * _image(size, rng, dtype, 2) * (rng.random((size.batch, 2, size.side, size.side)) < 0.2)
    quiet = np.zeros((size.batch, 2), dtype)
    inputs, pixels = [images.astype(dtype), quiet, 2.0, radius], size.batch * size.side**2
    made = problem("motion_correlation", inputs, pixels, 0)
    made.madds = np.count_nonzero(images[:, 0]) * math.prod(made.outputs[1].shape[2:])
    return made


def surface_peak(size: Size, rng, dtype, side: int = 25) -> Problem:
    half = 3.5
    surface = rng.normal(size=(size.batch, side, side)).astype(dtype)
    return problem("surface_peak", [surface, half], surface.size, round(4 * surface.size * half))


def clip_outliers(size: Size, rng, dtype) -> Problem:
    image = _image(size, rng, dtype) ** 3
    return problem("clip_outliers", [image, 1.7], image.size, 3 * image.size)


def reduce_image(size: Size, rng, dtype, ratio: float = 1.25) -> Problem:
    image = _image(size, rng, dtype)
    return problem("reduce_image", [image, ratio], image.size, 4 * image.size)


def mix_images(size: Size, rng, dtype, results: int = 8) -> Problem:
    images = _image(size, rng, dtype)
    weight = rng.normal(size=(results, size.batch)).astype(dtype)
    inputs = [images[None], np.zeros(results, np.int32), weight]
    return problem("mix_images", inputs, images.size, results * images.size)


def correlate_templates(size: Size, rng, dtype) -> Problem:
    n, side, batch = TEMPLATE, size.side, size.batch
    image = rng.normal(size=(batch, side + n - 1, side + n - 1)).astype(dtype)
    steps = np.arange(n) - n // 2
    disc = (steps[:, None] ** 2 + steps**2) <= (n // 2) ** 2
    spans = np.array([(c.argmax(), n - c[::-1].argmax()) for c in disc.T], np.int32)
    basis, _ = np.linalg.qr((rng.normal(size=(n, n, 5)) * disc[..., None]).reshape(-1, 5))
    mix = rng.normal(size=(8, 5))
    mix /= np.linalg.norm(mix, axis=1, keepdims=True)
    banks = [np.repeat(a[None].astype(dtype), batch, axis=0) for a in (basis.reshape(n, n, 5), mix)]
    inputs = [image, np.zeros(batch, dtype), *banks, spans, *_level(size), np.zeros(1, dtype), 0.0, 0.0]
    pixels = batch * side**2
    madds = pixels * (5 * int(disc.sum()) + 45)
    return problem("correlate_templates", inputs, pixels, madds)


def _level(size: Size) -> tuple[np.ndarray, np.ndarray]:
    """All rows of one level, and all of it each window's own."""
    rows = np.stack([np.zeros(size.side), np.arange(size.side)], axis=1).astype(np.int32)
    return rows, np.full((size.batch, 1, 2), size.side, np.int32)


def local_maxima(size: Size, rng, dtype, most: int = 8) -> Problem:
    response = rng.uniform(-1, 1, (size.batch, size.side, size.side)).astype(dtype)
    angle = rng.integers(0, 8, response.shape).astype(np.int32)
    sizes, origin = np.array([[2.5, 3.125]], dtype), np.zeros((size.batch, 2), dtype)
    inputs = [response, angle, *_level(size), sizes, origin, 0.3, 0.2]
    return problem("local_maxima", inputs, response.size, 8 * response.size, most=most)


def line_runs(size: Size, rng, dtype, angles: int = 32) -> Problem:
    image = rng.normal(size=(size.batch, size.side, size.side)).astype(dtype)
    slope, steep = np.linspace(-1, 1, angles).astype(dtype), (np.arange(angles) % 2).astype(np.int32)
    threshold = np.ones((size.batch, angles), dtype)
    steps = image.size * angles
    return problem(
        "line_runs", [image, slope, steep, threshold, 3.0], steps, 6 * steps, "step", lines=size.side
    )


def merge_maxima(size: Size, rng, dtype, keep: int = 48) -> Problem:
    count = 4 * size.side
    columns = [rng.uniform(-1, 1, (size.batch, count))]
    columns += list(rng.uniform(0, size.side, (2, size.batch, count)))
    columns += [rng.choice([4.0, 5.0, 6.1], (size.batch, count)), rng.uniform(0, 1.5, (size.batch, count))]
    maxima = np.stack(columns, axis=-1).astype(dtype)
    items = size.batch * count
    return problem("merge_maxima", [maxima, 2.0, 0.3], items, 4 * items, "maximum", most=keep)


def match_corners(size: Size, rng, dtype, count: int = 48, most: int = 3) -> Problem:
    peaks = np.stack(
        [
            rng.uniform(0.3, 1, (size.batch, count)),
            *rng.uniform(0, size.side, (2, size.batch, count)),
            4.0 * np.exp(rng.uniform(-0.05, 0.05, (size.batch, count))),
            rng.uniform(0, 1.5, (size.batch, count)),
        ],
        axis=-1,
    ).astype(dtype)
    peaks[:, :3, 1:] = [[20, 20, 4, 0], [76, 20, 4, 0], [20, 76, 4, 0]]  # a code of 21 modules
    tolerances = np.array([0.2, 0.16, 0.24, np.log(14.0), np.log(170.0)], dtype)
    pairs = size.batch * count**2
    return problem("match_corners", [peaks, tolerances], pairs, 20 * pairs, "pair", most=most)


def _points(size: Size) -> np.ndarray:
    """Two samples a module along each axis."""
    axis = (np.arange(2 * size.modules) + 0.5) / 2
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def _poses(size: Size, rng, dtype) -> np.ndarray:
    """Code to image: turned a little, all of the code in the image, slightly tilted."""
    px = 0.7 * size.side / size.modules
    base = np.array([px, -0.1 * px, 0.2 * size.side, 0.1 * px, px, 0.1 * size.side, 2e-5, -1e-5, 1.0])
    return (base * (1 + rng.uniform(-0.002, 0.002, (size.batch, 9)) * (np.arange(9) < 8))).astype(dtype)


def _moments(size: Size, rng, dtype) -> list:
    points = _points(size)
    table = rng.normal(size=(len(points), COLUMNS)).astype(dtype)
    idx = np.arange(size.batch, dtype=np.int32)
    active = np.ones(size.batch, np.int32)
    return [_image(size, rng, dtype), idx, _poses(size, rng, dtype), active, points.astype(dtype), table]


def sample_moments(size: Size, rng, dtype) -> Problem:
    inputs = _moments(size, rng, dtype)
    samples = size.batch * len(inputs[4])
    return problem("sample_moments", inputs, samples, samples * (COLUMNS + 18), "sample")


def sample_moments_adjoint(size: Size, rng, dtype) -> Problem:
    inputs = [*_moments(size, rng, dtype), rng.normal(size=(size.batch, COLUMNS + 1)).astype(dtype)]
    samples = size.batch * len(inputs[4])
    return problem("sample_moments_adjoint", inputs, samples, samples * (COLUMNS + 24), "sample")


def _terms(perspective: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Say what the parameters' derivatives are made of, for a table in the order of `align_poses`."""
    rows = [[(w, 1), (6 + w, 2)] for w in range(3)] + [[(6 + w, 1), (12 + w, 2)] for w in range(3)]
    if perspective:
        rows += [[(3 + k, 1), (9 + k, 2), (10 + k, 1), (16 + k, 2)] for k in range(2)]
    rows += [[(18, 3)], [(19, 3)]]
    padded = np.array([row + [(0, 0)] * (4 - len(row)) for row in rows], np.int32)
    return np.ascontiguousarray(padded[..., 0]), np.ascontiguousarray(padded[..., 1])


def score_poses(size: Size, rng, dtype, count: int = 64, points: int = 300) -> Problem:
    """Score poses a window, each with a model of a few hundred points."""
    idx = np.repeat(np.arange(size.batch, dtype=np.int32), count)
    model = np.hstack([rng.uniform(0, size.modules, (points, 2)), rng.normal(size=(points, 2))])
    ptr = np.array([[0, 240, points]], np.int32)
    poses = np.repeat(_poses(size, rng, dtype), count, axis=0)
    part = np.array([[0, size.side, size.side]] * len(idx), np.int32)
    given = [_image(size, rng, dtype), idx, part, poses, 0 * idx, ptr, model.astype(dtype)]
    return problem("score_poses", [*given, 1e-3], len(idx) * points, 24 * len(idx) * points, "sample")


def align_poses(size: Size, rng, dtype, iterations: int = 5) -> Problem:
    """Take a smooth model seen through known poses, from a third of a module beside them."""
    points, middle = _points(size), size.modules / 2
    u, v = ((points - middle) / middle).T
    table = np.zeros((len(points), COLUMNS))
    images = np.zeros((size.batch, size.side, size.side))
    y, x = np.mgrid[: size.side, : size.side]
    poses = _poses(size, rng, np.float64)
    back = np.linalg.inv(poses.reshape(-1, 3, 3)) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    seen = (back[:, :2] / back[:, 2:]).transpose(0, 2, 1)
    for place, height in zip(rng.uniform(2, size.modules - 2, (12, 2)), rng.normal(size=12), strict=True):
        p, q = (points - place).T / 2
        blob = height * np.exp(-0.5 * (p * p + q * q))
        second = [(p * p - 1) / 4, p * q / 4, (q * q - 1) / 4]
        weights = [np.ones_like(u), u, v, u * u, u * v, v * v]
        columns = [s * w for s in second for w in weights] + [-p / 2, -q / 2]
        table += blob[:, None] * np.stack(columns, axis=1)
        p, q = ((seen - place) / 2).transpose(2, 0, 1)
        images += (height * np.exp(-0.5 * (p * p + q * q)) * (0.4 * p - 0.25 * q)).reshape(images.shape)
    settings = np.array([[*[middle] * 4, 1e-3, 1e-3, 0.0]])
    start = poses + np.array([0, 0, 0.3, 0, 0, -0.2, 0, 0, 0]) * poses[:, :1]
    which, whole = np.arange(size.batch, dtype=np.int32), [[0, size.side, size.side]] * size.batch
    given = [images, which, np.array(whole, np.int32), 0 * which, points, table]
    given += [np.array([[0, len(points)]], np.int32), (table.T @ table)[None], *_terms()]
    given += [np.array([6], np.int32), settings]
    inputs = [array if array.dtype == np.int32 else array.astype(dtype) for array in given]
    samples = size.batch * len(points) * (iterations + 1)
    madds = samples * (COLUMNS + 18)
    start = start.astype(dtype)
    return problem("align_poses", [*inputs, iterations], samples, madds, "sample", start=start)


def pose_normal_equations(size: Size, rng, dtype) -> Problem:
    table = rng.normal(size=(60, COLUMNS)).astype(dtype)
    moments = rng.normal(size=(size.batch, COLUMNS + 1)).astype(dtype)
    terms, factors = _terms(perspective=True)
    n = len(terms)
    inputs = [moments, table.T @ table, terms, factors, 1e-3]
    madds = size.batch * (n * n * 16 + 4 * n)
    return problem("pose_normal_equations", inputs, size.batch, madds, "pose")


def _rhs(size: Size, rng, dtype) -> tuple[list, int, float]:
    """Give inputs, samples and multiply-adds of a right-hand side."""
    per, modules = SAMPLES_A_MODULE, size.modules
    count = modules * per
    lattice = ((np.arange(count) + 0.5) / per).astype(dtype)
    profile, slope = rng.normal(size=(2, PROFILE_MODULES * per)).astype(dtype)
    gain = rng.normal(size=(size.batch, 2)).astype(dtype)
    lattices = [
        np.zeros(size.batch, np.int32),
        lattice[None],
        lattice[None],
        np.full((1, 2), modules, np.int32),
    ]
    inputs = [_image(size, rng, dtype), _poses(size, rng, dtype), *lattices, profile, slope, gain, per]
    samples = size.batch * count**2
    taps = PROFILE_MODULES * per
    madds = 18 * samples + 2 * taps * size.batch * (count * modules + modules**2)
    return inputs, samples, madds


def code_rhs(size: Size, rng, dtype) -> Problem:
    inputs, samples, madds = _rhs(size, rng, dtype)
    return problem("code_rhs", inputs, samples, madds, "sample")


def code_normal_equations(size: Size, rng, dtype) -> Problem:
    inputs, samples, madds = _rhs(size, rng, dtype)
    madds += size.batch * (2 * REACH + 1) ** 2 * 2 * PROFILE_MODULES * SAMPLES_A_MODULE
    return problem("code_normal_equations", inputs, samples, madds, "sample", reach=REACH)


def _code(size: Size, rng, dtype, parameters: int) -> list:
    """Grid, map and outside: the code fills most of the image, turned."""
    scale = 1.2 * size.modules / size.side
    base = scale * np.array([0.96, 0.28, -0.2 * size.side, -0.28, 0.96, 0.1 * size.side])
    maps = base * (1 + rng.uniform(-0.02, 0.02, (size.batch, 6)))
    tilt = rng.uniform(-2e-4, 2e-4, (size.batch, parameters - 6))
    grid = rng.normal(size=(size.batch, size.modules, size.modules)).astype(dtype)
    return [grid, np.hstack([maps, tilt]).astype(dtype), rng.normal(size=size.batch).astype(dtype)]


def _render(size: Size, rng, dtype, parameters: int = 6, sigma: float = 0.0) -> Problem:
    inputs, pixels = [*_code(size, rng, dtype, parameters), sigma], size.batch * size.side**2
    madds = pixels * (4 + 2 * (parameters == 8) + (8 if sigma == 0 else 64))
    return problem("render_code", inputs, pixels, madds, shape=(size.side, size.side))


def render_code(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype)


def render_code_tilted(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype, parameters=8)


def render_code_smooth(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype, sigma=0.2)


def _render_adjoint(size: Size, rng, dtype, parameters: int = 6, sigma: float = 0.0) -> Problem:
    render, adj = _render(size, rng, dtype, parameters, sigma), _image(size, rng, dtype)
    madds = render.madds + adj.size * (22 if sigma == 0 else 60)
    return problem("render_code_adjoint", [*render.inputs, adj], adj.size, madds)


def render_code_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype)


def render_code_tilted_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype, parameters=8)


def render_code_smooth_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype, sigma=0.2)


def brightness_residual(size: Size, rng, dtype) -> Problem:
    luminance, events = _image(size, rng, dtype), _image(size, rng, dtype)
    motion = rng.normal(size=(size.batch, 2)).astype(dtype)
    return problem("brightness_residual", [luminance, events, motion], events.size, 4 * events.size)


def brightness_residual_adjoint(size: Size, rng, dtype) -> Problem:
    luminance, adj = _image(size, rng, dtype), _image(size, rng, dtype)
    motion = rng.normal(size=(size.batch, 2)).astype(dtype)
    return problem("brightness_residual_adjoint", [luminance, motion, adj], adj.size, 8 * adj.size)


def _cost(size: Size, rng, dtype) -> list:
    """Give luminance, image of events, motion, and a mask that leaves some pixels out."""
    inputs = brightness_residual(size, rng, dtype).inputs
    return [*inputs, (rng.random(inputs[0].shape) < 0.7).astype(dtype)]


def brightness_cost(size: Size, rng, dtype) -> Problem:
    inputs = _cost(size, rng, dtype)
    return problem("brightness_cost", inputs, inputs[0].size, 6 * inputs[0].size)


def brightness_cost_adjoint(size: Size, rng, dtype) -> Problem:
    inputs = [*_cost(size, rng, dtype), rng.normal(size=size.batch).astype(dtype)]
    return problem("brightness_cost_adjoint", inputs, inputs[0].size, 12 * inputs[0].size)


def cost(size: Size, rng, dtype) -> Problem:
    """Gradients of half the sum of squared residuals: splat, render, residual and all their adjoints.

    In motion, weights, displacement, map and grid.
    """
    parts = splat_events(size, rng, dtype), splat_events_adjoint(size, rng, dtype)
    parts += render_code(size, rng, dtype), render_code_adjoint(size, rng, dtype)
    parts += brightness_residual(size, rng, dtype), brightness_residual_adjoint(size, rng, dtype)
    splat, splat_adjoint, render, render_adjoint, residual, residual_adjoint = parts
    scratch = [splat.outputs[0], render.outputs[0], residual.outputs[0], residual_adjoint.outputs[1]]
    scratch += [part.outputs[0] for part in (splat_adjoint, render_adjoint, residual_adjoint)]
    scratch += splat_adjoint.outputs[3:]
    results = [*splat_adjoint.outputs[1:3], *render_adjoint.outputs[1:], residual_adjoint.outputs[2]]
    inputs = [*splat.inputs, *render.inputs, residual.inputs[2]]
    madds = sum(part.madds for part in parts)
    return Problem("cost", inputs, [*scratch, *results], splat.items, madds, "event", scratch=9, run=run_cost)


def run_cost(backend: KernelBackend, op: str, problem: Problem, inputs: list, outputs: list) -> None:
    """Launch the operations of the cost; its derivative with respect to a residual is the residual."""
    events, (grid, to_grid, outside, sigma), displacement = inputs[:8], inputs[8:12], inputs[12]
    image, luminance, residual, adj_luminance, chunks, map_rows, rows, adj_x, adj_y = outputs[:9]
    adj_weight, adj_motion, adj_grid, adj_map, adj_displacement = outputs[9:]
    backend.clear(image)
    backend.splat_events(*events, image, SPLAT)
    backend.render_code(grid, to_grid, outside, sigma, luminance)
    backend.brightness_residual(luminance, image, displacement, residual)
    backend.brightness_residual_adjoint(
        luminance, displacement, residual, rows, adj_luminance, adj_displacement
    )
    backend.splat_events_adjoint(*events, residual, chunks, adj_weight, adj_motion, adj_x, adj_y, SPLAT)
    backend.render_code_adjoint(grid, to_grid, outside, sigma, adj_luminance, map_rows, adj_grid, adj_map)


PROBLEMS: dict[str, Callable[..., Problem]] = {
    build.__name__: build
    for build in (
        bin_events,
        splat_events,
        splat_events_adjoint,
        splat_events_affine,
        splat_events_affine_adjoint,
        deposit_events,
        deposit_events_adjoint,
        bin_packed_events,
        deposit_packed_events,
        voxel_grid,
        voxel_grid_adjoint,
        time_surface,
        event_histogram,
        lag_operator,
        lag_operator_adjoint,
        render_code,
        render_code_adjoint,
        render_code_tilted,
        render_code_tilted_adjoint,
        render_code_smooth,
        render_code_smooth_adjoint,
        brightness_residual,
        brightness_residual_adjoint,
        brightness_cost,
        brightness_cost_adjoint,
        cost,
        motion_correlation,
        surface_peak,
        clip_outliers,
        reduce_image,
        mix_images,
        correlate_templates,
        local_maxima,
        merge_maxima,
        match_corners,
        line_runs,
        sample_moments,
        sample_moments_adjoint,
        align_poses,
        score_poses,
        pose_normal_equations,
        code_rhs,
        code_normal_equations,
        code_product,
        sum_equations,
        pull_modules,
        solve_code,
        solve_code_banded,
    )
}


def build(name: str, size: Size, dtype: str = "float32") -> Problem:
    """Make a problem; the same inputs every time."""
    return PROBLEMS[name](size, np.random.default_rng(0), np.dtype(dtype).type)
