"""Problems for every operation, of any size: random inputs, and counts of items and multiply-adds.

The builder of an operation has its name; `PROBLEMS` lists them.  Inputs are of the kind that the reader has:
events within the image, maps that show all of the code, positive definite systems.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from problems import Problem, Size

from evqr_kernels import KernelBackend, SplatConfig
from evqr_kernels.launch import chunks_of

SPLAT = SplatConfig()
CHUNK = 512
"""Samples that one thread of a sum takes."""

SAMPLES_A_MODULE = 4
PROFILE_MODULES = 5
REACH = 4  # of the stencil of the code's normal equations
COLUMNS = 20  # of the table of moments
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
    image = np.zeros((size.batch, size.side, size.side), dtype)
    inputs = [x, y, weight, window_ptr, 1.0]
    return Problem("bin_events", inputs, [image], len(x), 3 * len(x), "event", passes=2)


def _splat(size: Size, rng, dtype, parameters: int) -> Problem:
    events, lag, frame = _transported(size, rng, dtype, parameters)
    image = np.zeros((size.batch, size.side, size.side), dtype)
    taps, count = 2 * SPLAT.reach + 1, len(events[0])
    madds = count * (2 * 9 * taps + 2 * taps**2)
    inputs = [*events, *lag, *frame]
    return Problem("splat_events", inputs, [image], count, madds, "event", tail=(SPLAT,), passes=2)


def splat_events(size: Size, rng, dtype) -> Problem:
    return _splat(size, rng, dtype, 2)


def splat_events_affine(size: Size, rng, dtype) -> Problem:
    return _splat(size, rng, dtype, 6)


def _splat_adjoint(size: Size, rng, dtype, parameters: int) -> Problem:
    problem = _splat(size, rng, dtype, parameters)
    taps, count = 2 * SPLAT.reach + 1, problem.items
    chunks = np.zeros((size.batch, chunks_of(count, size.batch), parameters), dtype)
    outputs = [chunks, np.zeros(count, dtype), np.zeros((size.batch, parameters), dtype)]
    inputs = [*problem.inputs, _image(size, rng, dtype)]
    madds = count * (2 * 16 * taps + 3 * taps**2 + 7 * taps)
    return Problem("splat_events_adjoint", inputs, outputs, count, madds, "event", tail=(SPLAT,), scratch=1)


def splat_events_adjoint(size: Size, rng, dtype) -> Problem:
    return _splat_adjoint(size, rng, dtype, 2)


def splat_events_affine_adjoint(size: Size, rng, dtype) -> Problem:
    return _splat_adjoint(size, rng, dtype, 6)


def deposit_events(size: Size, rng, dtype) -> Problem:
    events, _, frame = _transported(size, rng, dtype)
    count, deposit = len(events[0]), np.zeros((size.batch, 2, size.side, size.side), dtype)
    return Problem("deposit_events", [*events, *frame], [deposit], count, 12 * count, "event", passes=2)


def deposit_events_adjoint(size: Size, rng, dtype) -> Problem:
    events, _, frame = _transported(size, rng, dtype)
    count, adj = len(events[0]), _image(size, rng, dtype, 2)
    inputs = [*events, *frame, adj]
    return Problem("deposit_events_adjoint", inputs, [np.zeros(count, dtype)], count, 12 * count, "event")


def _lag(size: Size, rng, dtype) -> list:
    angle = rng.uniform(0, 6, size.batch)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(dtype)
    lag = rng.uniform(0, 3, (size.batch, 2)).astype(dtype)
    taps = rng.normal(size=(2, 5)).astype(dtype)
    return [np.arange(size.batch, dtype=np.int32), direction, lag, taps]


def lag_operator(size: Size, rng, dtype) -> Problem:
    deposit = _image(size, rng, dtype, 2)
    pixels = size.batch * size.side**2
    outputs = [np.zeros_like(deposit), np.zeros_like(deposit[:, 0])]
    inputs = [deposit, *_lag(size, rng, dtype)]
    return Problem("lag_operator", inputs, outputs, pixels, 20 * pixels, scratch=1)


def lag_operator_adjoint(size: Size, rng, dtype) -> Problem:
    adj, pixels = _image(size, rng, dtype), size.batch * size.side**2
    outputs = [np.zeros((size.batch, 2, size.side, size.side), dtype) for _ in range(2)]
    inputs = [*_lag(size, rng, dtype), adj]
    return Problem("lag_operator_adjoint", inputs, outputs, pixels, 20 * pixels, scratch=1)


def motion_correlation(size: Size, rng, dtype, radius: int = 12) -> Problem:
    images = 2.0 * _image(size, rng, dtype, 2) * (rng.random((size.batch, 2, size.side, size.side)) < 0.2)
    shifts = 2 * radius + 1
    padded = -(-shifts // 16) * 16
    outputs = [
        np.zeros((size.batch, size.side, size.side), np.int32),
        np.zeros((size.batch, size.side, shifts, padded), dtype),
        np.zeros((size.batch, size.side, 2), dtype),
        np.zeros((size.batch, shifts, shifts), dtype),
        np.zeros((size.batch, 2), dtype),
    ]
    pixels = size.batch * size.side**2
    madds = np.count_nonzero(images[:, 0]) * shifts * padded
    inputs = [images.astype(dtype), 2.0, radius]
    return Problem("motion_correlation", inputs, outputs, pixels, madds, scratch=3)


def surface_peak(size: Size, rng, dtype, side: int = 25) -> Problem:
    steps = np.subtract.outer(np.arange(side), np.arange(side))
    smoother = np.exp(-0.5 * (steps / 1.5) ** 2).astype(dtype)
    surface = rng.normal(size=(size.batch, side, side)).astype(dtype)
    outputs = [np.zeros_like(surface), np.zeros_like(surface), np.zeros((size.batch, 3), dtype)]
    madds = 2 * surface.size * side
    return Problem("surface_peak", [surface, smoother], outputs, surface.size, madds, scratch=1)


def clip_outliers(size: Size, rng, dtype) -> Problem:
    image = _image(size, rng, dtype) ** 3
    outputs = [np.zeros((size.batch, size.side, 2), dtype), np.zeros(size.batch, dtype)]
    outputs += [np.zeros(size.batch, dtype), np.zeros_like(image)]
    return Problem("clip_outliers", [image, 1.7], outputs, image.size, 3 * image.size, scratch=2)


def reduce_image(size: Size, rng, dtype, ratio: float = 1.25) -> Problem:
    image, coarse = _image(size, rng, dtype), -int(-size.side // ratio)
    shapes = (size.batch, coarse, size.side), (size.batch, coarse, coarse)
    outputs = [np.zeros(shape, dtype) for shape in shapes]
    return Problem("reduce_image", [image, ratio], outputs, image.size, 4 * image.size, scratch=1)


def mix_images(size: Size, rng, dtype, results: int = 8) -> Problem:
    images = _image(size, rng, dtype)
    weight = rng.normal(size=(results, size.batch)).astype(dtype)
    out = np.zeros((results, size.side, size.side), dtype)
    return Problem("mix_images", [images, weight], [out], images.size, results * images.size)


def correlate_templates(size: Size, rng, dtype) -> Problem:
    n, side, batch = TEMPLATE, size.side, size.batch
    image = rng.normal(size=(batch, side + n - 1, side + n - 1)).astype(dtype)
    steps = np.arange(n) - n // 2
    disc = (steps[:, None] ** 2 + steps**2) <= (n // 2) ** 2
    spans = np.array([(c.argmax(), n - c[::-1].argmax()) for c in disc.T], np.int32)
    basis, _ = np.linalg.qr((rng.normal(size=(n, n, 5)) * disc[..., None]).reshape(-1, 5))
    mix = rng.normal(size=(8, 5))
    mix /= np.linalg.norm(mix, axis=1, keepdims=True)
    inputs = [image, np.zeros(batch, dtype), basis.reshape(n, n, 5).astype(dtype), mix.astype(dtype), spans]
    outputs = [
        np.zeros((batch, side + n, side + n - 1), dtype),
        np.zeros(batch, dtype),
        np.zeros((batch, 6, side, side), dtype),
        np.zeros((batch, side, side), dtype),
        np.zeros((batch, side, side), np.int32),
    ]
    pixels = batch * side**2
    madds = pixels * (5 * int(disc.sum()) + 45)
    return Problem("correlate_templates", [*inputs, 0.0, 0.0], outputs, pixels, madds, scratch=3)


def local_maxima(size: Size, rng, dtype, most: int = 8) -> Problem:
    response = rng.uniform(-1, 1, (size.batch, size.side, size.side)).astype(dtype)
    angle = rng.integers(0, 8, response.shape).astype(np.int32)
    out = np.zeros((size.batch, size.side, most, 5), dtype)
    inputs = [response, angle, 0.3, 2.5, 3.125, 0.2]
    return Problem("local_maxima", inputs, [out], response.size, 8 * response.size)


def merge_maxima(size: Size, rng, dtype, keep: int = 48) -> Problem:
    count = 4 * size.side
    columns = [rng.uniform(-1, 1, (size.batch, count))]
    columns += list(rng.uniform(0, size.side, (2, size.batch, count)))
    columns += [rng.choice([4.0, 5.0, 6.1], (size.batch, count)), rng.uniform(0, 1.5, (size.batch, count))]
    maxima = np.stack(columns, axis=-1).astype(dtype)
    strength, index = np.zeros((size.batch, count), dtype), np.zeros((size.batch, count), np.int32)
    outputs = [strength, index, np.zeros((size.batch, keep, 5), dtype)]
    items = size.batch * count
    return Problem("merge_maxima", [maxima, 2.0, 0.3], outputs, items, 4 * items, "maximum", scratch=2)


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
    outputs = [np.zeros((size.batch, count, count), np.int32), np.zeros((size.batch, count, count, 3), dtype)]
    outputs += [np.zeros((size.batch, count, most, 4), dtype)]
    pairs = size.batch * count**2
    return Problem("match_corners", [peaks, tolerances], outputs, pairs, 20 * pairs, "pair", scratch=2)


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
    chunks = np.zeros((size.batch, -(-len(inputs[4]) // CHUNK), COLUMNS + 1), dtype)
    outputs = [chunks, np.zeros((size.batch, COLUMNS + 1), dtype)]
    madds = samples * (COLUMNS + 18)
    return Problem("sample_moments", inputs, outputs, samples, madds, "sample", scratch=1)


def sample_moments_adjoint(size: Size, rng, dtype) -> Problem:
    inputs = [*_moments(size, rng, dtype), rng.normal(size=(size.batch, COLUMNS + 1)).astype(dtype)]
    samples, out = size.batch * len(inputs[4]), np.zeros_like(inputs[0])
    madds = samples * (COLUMNS + 24)
    return Problem("sample_moments_adjoint", inputs, [out], samples, madds, "sample", passes=2)


def _terms(perspective: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Say what the parameters' derivatives are made of, for a table in the order of `align_poses`."""
    rows = [[(w, 1), (6 + w, 2)] for w in range(3)] + [[(6 + w, 1), (12 + w, 2)] for w in range(3)]
    if perspective:
        rows += [[(3 + k, 1), (9 + k, 2), (10 + k, 1), (16 + k, 2)] for k in range(2)]
    rows += [[(18, 3)], [(19, 3)]]
    padded = np.array([row + [(0, 0)] * (4 - len(row)) for row in rows], np.int32)
    return np.ascontiguousarray(padded[..., 0]), np.ascontiguousarray(padded[..., 1])


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
    terms, factors = _terms()
    settings = np.array([*[middle] * 4, 1e-3, 1e-3, 0.0])
    start = poses + np.array([0, 0, 0.3, 0, 0, -0.2, 0, 0, 0]) * poses[:, :1]
    inputs = [images, np.arange(size.batch), points, table, table.T @ table, terms, factors, settings]
    kinds = [dtype, np.int32, dtype, dtype, dtype, np.int32, np.int32, dtype]
    inputs = [array.astype(kind) for array, kind in zip(inputs, kinds, strict=True)]
    outputs = [start.astype(dtype), np.zeros((size.batch, 5), dtype)]
    samples = size.batch * len(points) * (iterations + 1)
    madds = samples * (COLUMNS + 18)
    return Problem("align_poses", [*inputs, iterations], outputs, samples, madds, "sample", inout=0)


def pose_normal_equations(size: Size, rng, dtype) -> Problem:
    table = rng.normal(size=(60, COLUMNS)).astype(dtype)
    moments = rng.normal(size=(size.batch, COLUMNS + 1)).astype(dtype)
    terms, factors = _terms(perspective=True)
    n = len(terms)
    outputs = [np.zeros(s, dtype) for s in ((size.batch, 2), (size.batch, n, n), (size.batch, n))]
    inputs = [moments, table.T @ table, terms, factors, 1e-3]
    madds = size.batch * (n * n * 16 + 4 * n)
    return Problem("pose_normal_equations", inputs, outputs, size.batch, madds, "pose")


def _rhs(size: Size, rng, dtype) -> tuple[list, list, int, float]:
    """Give inputs, outputs, samples and multiply-adds of the right-hand side of stage two."""
    per, modules = SAMPLES_A_MODULE, size.modules
    count = modules * per
    lattice = ((np.arange(count) + 0.5) / per).astype(dtype)
    profile, slope = rng.normal(size=(2, PROFILE_MODULES * per)).astype(dtype)
    gain = rng.normal(size=(size.batch, 2)).astype(dtype)
    inputs = [_image(size, rng, dtype), _poses(size, rng, dtype), lattice, lattice, profile, slope, gain, per]
    shapes = ((size.batch, count, count), (size.batch, 2, count, modules), (size.batch, modules, modules))
    samples = size.batch * count**2
    taps = PROFILE_MODULES * per
    madds = 18 * samples + 2 * taps * size.batch * (count * modules + modules**2)
    return inputs, [np.zeros(shape, dtype) for shape in shapes], samples, madds


def code_rhs(size: Size, rng, dtype) -> Problem:
    inputs, outputs, samples, madds = _rhs(size, rng, dtype)
    return Problem("code_rhs", inputs, outputs, samples, madds, "sample", scratch=2)


def code_normal_equations(size: Size, rng, dtype) -> Problem:
    inputs, (samples_out, rows, rhs), samples, madds = _rhs(size, rng, dtype)
    side = 2 * REACH + 1
    outputs = [samples_out, rows, np.zeros((size.batch, side, side), dtype), rhs]
    madds += size.batch * side**2 * 2 * PROFILE_MODULES * SAMPLES_A_MODULE
    return Problem("code_normal_equations", inputs, outputs, samples, madds, "sample", scratch=2)


def _system(size: Size, rng, dtype) -> tuple[list, np.ndarray]:
    """rhs, stencil, damping and free modules of a positive definite system, and where to start."""
    batch, modules, side = size.batch, size.modules, 2 * REACH + 1
    free = (rng.random((modules, modules)) < 0.7).astype(np.int32)
    taps = rng.normal(size=(batch, REACH + 1, REACH + 1))
    stencil = np.zeros((batch, side, side))
    for j, i in np.ndindex(REACH + 1, REACH + 1):
        part = taps[:, j, i, None, None] * taps[:, ::-1, ::-1]
        stencil[:, j : j + REACH + 1, i : i + REACH + 1] += part
    rhs, start = rng.normal(size=(2, batch, modules, modules)).astype(dtype)
    damping = np.full(batch, 5.0, dtype)
    return [rhs, stencil.astype(dtype), damping, free], start


def code_product(size: Size, rng, dtype) -> Problem:
    (_, *system), q = _system(size, rng, dtype)
    madds = q.size * (2 * REACH + 1) ** 2
    return Problem("code_product", [q, *system], [np.zeros_like(q)], q.size, madds, "module")


def pull_modules(size: Size, rng, dtype) -> Problem:
    (seen, _, damping, _), q = _system(size, rng, dtype)
    unclear = np.zeros(q.shape[:2], np.int32)
    return Problem(
        "pull_modules", [seen, q, damping, 4.0], [np.zeros_like(q), unclear], q.size, 2 * q.size, "module"
    )


def solve_code(size: Size, rng, dtype, iterations: int = 20) -> Problem:
    system, start = _system(size, rng, dtype)
    rows = np.zeros((size.batch, 4, size.modules), dtype)
    scratch = (*(np.zeros_like(start) for _ in range(4)), rows, rows)
    done = np.zeros(size.batch, np.int32)
    items = start.size * iterations
    madds = items * ((2 * REACH + 1) ** 2 + 5)
    return Problem(
        "solve_code",
        system,
        [start, scratch, done],
        items,
        madds,
        "module",
        options={"max_iterations": iterations, "tolerance": 0.0},
        inout=0,
    )


def solve_code_banded(size: Size, rng, dtype) -> Problem:
    system, start = _system(size, rng, dtype)
    width = REACH * (size.modules + 1)
    band = np.zeros((size.batch, size.modules**2, width + 1), dtype)
    share = float(np.square(system[3].mean()))  # fixed modules leave empty rows and columns
    madds = share * start.size * width**2 / 2
    return Problem(
        "solve_code_banded", system, [band, start], start.size, madds, "module", scratch=1, inout=1
    )


def _code(size: Size, rng, dtype, parameters: int) -> list:
    """Grid, map and outside: the code fills most of the image, turned."""
    scale = 1.2 * size.modules / size.side
    base = scale * np.array([0.96, 0.28, -0.2 * size.side, -0.28, 0.96, 0.1 * size.side])
    maps = base * (1 + rng.uniform(-0.02, 0.02, (size.batch, 6)))
    tilt = rng.uniform(-2e-4, 2e-4, (size.batch, parameters - 6))
    grid = rng.normal(size=(size.batch, size.modules, size.modules)).astype(dtype)
    return [grid, np.hstack([maps, tilt]).astype(dtype), rng.normal(size=size.batch).astype(dtype)]


def _render(size: Size, rng, dtype, parameters: int = 6, sigma: float = 0.0) -> Problem:
    inputs, image = [*_code(size, rng, dtype, parameters), sigma], np.zeros_like(_image(size, rng, dtype))
    madds = image.size * (4 + 2 * (parameters == 8) + (8 if sigma == 0 else 64))
    return Problem("render_code", inputs, [image], image.size, madds)


def render_code(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype)


def render_code_tilted(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype, parameters=8)


def render_code_smooth(size: Size, rng, dtype) -> Problem:
    return _render(size, rng, dtype, sigma=0.2)


def _render_adjoint(size: Size, rng, dtype, parameters: int = 6, sigma: float = 0.0) -> Problem:
    problem, adj = _render(size, rng, dtype, parameters, sigma), _image(size, rng, dtype)
    rows = np.zeros((size.batch, size.side, parameters), dtype)
    grid, to_grid = problem.inputs[:2]
    outputs = [rows, np.zeros_like(grid), np.zeros_like(to_grid)]
    madds = problem.madds + adj.size * (22 if sigma == 0 else 60)
    return Problem("render_code_adjoint", [*problem.inputs, adj], outputs, adj.size, madds, scratch=1)


def render_code_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype)


def render_code_tilted_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype, parameters=8)


def render_code_smooth_adjoint(size: Size, rng, dtype) -> Problem:
    return _render_adjoint(size, rng, dtype, sigma=0.2)


def brightness_residual(size: Size, rng, dtype) -> Problem:
    luminance, events = _image(size, rng, dtype), _image(size, rng, dtype)
    motion = rng.normal(size=(size.batch, 2)).astype(dtype)
    inputs, out = [luminance, events, motion], np.zeros_like(events)
    return Problem("brightness_residual", inputs, [out], out.size, 4 * out.size)


def brightness_residual_adjoint(size: Size, rng, dtype) -> Problem:
    luminance, adj = _image(size, rng, dtype), _image(size, rng, dtype)
    motion = rng.normal(size=(size.batch, 2)).astype(dtype)
    outputs = [np.zeros((size.batch, size.side, 2), dtype), np.zeros_like(adj), np.zeros_like(motion)]
    return Problem(
        "brightness_residual_adjoint", [luminance, motion, adj], outputs, adj.size, 8 * adj.size, scratch=1
    )


def _cost(size: Size, rng, dtype) -> list:
    """Give luminance, image of events, motion, and a mask that leaves some pixels out."""
    inputs = brightness_residual(size, rng, dtype).inputs
    return [*inputs, (rng.random(inputs[0].shape) < 0.7).astype(dtype)]


def brightness_cost(size: Size, rng, dtype) -> Problem:
    inputs = _cost(size, rng, dtype)
    outputs = [np.zeros((size.batch, size.side), dtype), np.zeros(size.batch, dtype)]
    pixels = inputs[0].size
    return Problem("brightness_cost", inputs, outputs, pixels, 6 * pixels, scratch=1)


def brightness_cost_adjoint(size: Size, rng, dtype) -> Problem:
    inputs = [*_cost(size, rng, dtype), rng.normal(size=size.batch).astype(dtype)]
    luminance, events, motion, *_ = inputs
    rows = np.zeros((size.batch, size.side, 2), dtype)
    outputs = [rows, np.zeros_like(luminance), np.zeros_like(events), np.zeros_like(motion)]
    pixels = luminance.size
    return Problem("brightness_cost_adjoint", inputs, outputs, pixels, 12 * pixels, scratch=1)


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
    results = [*splat_adjoint.outputs[1:], *render_adjoint.outputs[1:], residual_adjoint.outputs[2]]
    inputs = [*splat.inputs, *render.inputs, residual.inputs[2]]
    madds = sum(part.madds for part in parts)
    return Problem("cost", inputs, [*scratch, *results], splat.items, madds, "event", scratch=7, run=run_cost)


def run_cost(backend: KernelBackend, op: str, problem: Problem, inputs: list, outputs: list) -> None:
    """Launch the operations of the cost; its derivative with respect to a residual is the residual."""
    events, (grid, to_grid, outside, sigma), displacement = inputs[:8], inputs[8:12], inputs[12]
    image, luminance, residual, adj_luminance, chunks, map_rows, rows = outputs[:7]
    adj_weight, adj_motion, adj_grid, adj_map, adj_displacement = outputs[7:]
    backend.clear(image)
    backend.splat_events(*events, image, SPLAT)
    backend.render_code(grid, to_grid, outside, sigma, luminance)
    backend.brightness_residual(luminance, image, displacement, residual)
    backend.brightness_residual_adjoint(
        luminance, displacement, residual, rows, adj_luminance, adj_displacement
    )
    backend.splat_events_adjoint(*events, residual, chunks, adj_weight, adj_motion, SPLAT)
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
        sample_moments,
        sample_moments_adjoint,
        align_poses,
        pose_normal_equations,
        code_rhs,
        code_normal_equations,
        code_product,
        pull_modules,
        solve_code,
        solve_code_banded,
    )
}


def build(name: str, size: Size, dtype: str = "float32") -> Problem:
    """Make a problem; the same inputs every time."""
    return PROBLEMS[name](size, np.random.default_rng(0), np.dtype(dtype).type)
