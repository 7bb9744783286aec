"""A call of every operation, small and crooked: odd sizes, several windows, one of them empty, events off it.

Overwritten outputs and scratch hold NaN, accumulated ones something else than zero.
"""

from dataclasses import dataclass, field

import numpy as np

from evqr_kernels import OPERATIONS, SplatConfig
from evqr_kernels.operation import Output, Scratch, Written, buffers_behind, checked_name

from .helpers import filled

B, Y, X = 3, 23, 31
WIDE, TALL = (7, 12), (13, 6)  # modules of codes: rows, columns
SPLAT = SplatConfig(epsilon_px=0.8)


@dataclass
class Call:
    op: str
    inputs: list
    outputs: list
    tail: tuple = ()
    options: dict = field(default_factory=dict)  # of the checked function alone

    @property
    def operation(self):
        return OPERATIONS[self.op]

    @property
    def scratch(self):
        """So many of the first outputs are scratch."""
        return len(self.operation.scratch)

    def run(self, runner):
        return runner(self.op, self.inputs, self.outputs, *self.tail)[self.scratch :]

    @property
    def checked(self):
        """Arguments of the checked function, by name."""
        arguments, count = self.operation.arguments, len(self.inputs)
        given = dict(
            zip(map(checked_name, arguments), [*self.inputs, *self.outputs, *self.tail], strict=True)
        )
        written = {checked_name(a) for a in arguments[count:] if isinstance(a, (Output, Scratch))}
        written -= {a.start for a in self.operation.outputs}
        return {name: value for name, value in given.items() if name not in written} | self.options


def call(op, inputs, *tail, start=None, **options):
    """A call whose outputs and scratch are those of the table.

    ``inputs`` are the first arguments, ``tail`` the last, ``start`` what is overwritten in place, ``options``
    sizes and settings of the checked function alone.
    """
    operation = OPERATIONS[op]
    tile = operation.variant("warp", "cpu").tile
    buffers = buffers_behind(operation, inputs, options, tile)
    return Call(op, inputs, [output(buffer, start) for buffer in buffers], tail, options)


def output(buffer, start):
    """What an output holds before: NaN or -1, something to add to, or where to start."""
    written = getattr(buffer.array, "written", None)
    if written is Written.IN_PLACE:
        return start
    if buffer.array.integer:
        return np.full(buffer.shape, -1, np.int32)
    return filled(buffer.shape, buffer.dtype, 0.5 if written is Written.ACCUMULATED else np.nan)


def events(rng, dtype, count=300, margin=6.0):
    """x, y, t, weight, window_ptr of events in and around the image; the middle window is empty."""
    x = rng.uniform(-margin, X + margin, count).astype(dtype)
    y = rng.uniform(-margin, Y + margin, count).astype(dtype)
    t = rng.uniform(-1e-3, 1e-3, count).astype(dtype)
    weight = rng.choice([-1.0, 1.0, 0.5], count).astype(dtype)
    third = count // 3
    return [x, y, t, weight, np.array([0, third, third, count], np.int32)]


def splat_inputs(rng, dtype, count=300):
    motion = rng.uniform(-3000, 3000, (B, 2)).astype(dtype)
    motion[2] = 0
    lag = rng.uniform(0, 3, (B, 2)).astype(dtype)
    frame = np.array([[0, 0, 1], [0, 0, 1], [-4.25, 1.5, 1.3]], dtype)
    return [*events(rng, dtype, count), motion, lag, frame]


def poses(rng, count, dtype):
    """Poses that look mostly, not wholly, into the image, with some perspective."""
    base = np.array([1.4, 0.3, 3.0, -0.2, 1.1, 2.0, 0.002, -0.003, 1.0])
    return (base + rng.uniform(-0.01, 0.01, (count, 9)) * np.abs(base)).astype(dtype)


def bin_events(rng, dtype):
    x, y, _, weight, window_ptr = events(rng, dtype)
    return call("bin_events", [x, y, weight, window_ptr, 2.0], shape=(Y // 2, X // 2))


def splat_events(rng, dtype, cfg=SPLAT):
    return call("splat_events", splat_inputs(rng, dtype), cfg, shape=(Y, X))


def splat_events_wide(rng, dtype):
    return splat_events(rng, dtype, SplatConfig(epsilon_px=1.5, radius_px=4.0))


def splat_events_adjoint(rng, dtype, cfg=SPLAT):
    inputs = [*splat_inputs(rng, dtype), rng.normal(size=(B, Y, X)).astype(dtype)]
    return call("splat_events_adjoint", inputs, cfg)


def splat_events_bilinear(rng, dtype):
    return splat_events(rng, dtype, SplatConfig(kind="bilinear"))


def splat_events_bilinear_adjoint(rng, dtype):
    return splat_events_adjoint(rng, dtype, SplatConfig(kind="bilinear"))


def affine_motion(rng, dtype):
    """Motions that turn, grow and shear by some pixels over the window, beside those of `splat_inputs`."""
    return rng.uniform(-100, 100, (B, 4)).astype(dtype)


def splat_events_affine(rng, dtype):
    made = splat_events(rng, dtype)
    made.inputs[5] = np.hstack([made.inputs[5], affine_motion(rng, dtype)])
    return made


def splat_events_affine_adjoint(rng, dtype):
    inputs = splat_events_adjoint(rng, dtype).inputs
    inputs[5] = np.hstack([inputs[5], affine_motion(rng, dtype)])
    return call("splat_events_adjoint", inputs, SPLAT)


def deposit_events(rng, dtype):
    *events, motion, _, frame = splat_inputs(rng, dtype)
    return call("deposit_events", [*events, motion, frame], shape=(Y, X))


def deposit_events_adjoint(rng, dtype):
    inputs = [*deposit_events(rng, dtype).inputs, rng.normal(size=(B, 2, Y, X)).astype(dtype)]
    return call("deposit_events_adjoint", inputs)


def packed_inputs(rng, count=300):
    """x, y, stamp, window_ptr, t_ref of events in and beside the image, of times beyond 2^30 us.

    The first and the last window share events, the middle one is empty.
    """
    x, y = (rng.integers(0, size + 9, count).astype(np.uint16) for size in (X, Y))
    time = (1 << 31) - 3000 + np.sort(rng.integers(0, 3000, count))
    stamp = (2 * time + rng.integers(0, 2, count)).astype(np.uint32)
    window_ptr = np.array([[0, 2 * count // 3], [count // 2, count // 2], [count // 3, count]], np.int32)
    return [x, y, stamp, window_ptr, np.array([1 << 30, 0, (1 << 31) - 1500], np.int32)]


def bin_packed_events(rng, dtype):
    *events, _ = packed_inputs(rng)
    made = call("bin_packed_events", [*events, 2.0], shape=(Y // 2, X // 2))
    made.outputs[0] = made.outputs[0].astype(dtype)  # no input is of floats
    return made


def deposit_packed_events(rng, dtype):
    *events, t_ref = packed_inputs(rng)
    motion = rng.uniform(-3e-3, 3e-3, (B, 2)).astype(dtype)
    motion[0] = 0  # of times too long for what moves
    frame = np.array([[0, 0, 1], [0, 0, 1], [-4.25, 1.5, 1.3]], dtype)
    extent = np.array([[Y, X], [5, 9], [Y - 6, X - 7]], np.int32)
    return call("deposit_packed_events", [*events, t_ref, motion, frame, extent], shape=(Y, X))


def voxel_grid(rng, dtype, planes=5):
    span = np.array([[-9e-4, 8e-4], [0, 1], [-1e-3, 1e-3]], dtype)
    return call("voxel_grid", [*events(rng, dtype), span], bins=planes, shape=(Y, X))


def voxel_grid_of_one_plane(rng, dtype):
    return voxel_grid(rng, dtype, 1)


def voxel_grid_adjoint(rng, dtype, planes=5):
    inputs = [*voxel_grid(rng, dtype).inputs, rng.normal(size=(B, planes, Y, X)).astype(dtype)]
    return call("voxel_grid_adjoint", inputs)


def voxel_grid_of_one_plane_adjoint(rng, dtype):
    return voxel_grid_adjoint(rng, dtype, 1)


def time_surface(rng, dtype):
    return call("time_surface", [*events(rng, dtype), 6e-4], shape=(Y, X))


def event_histogram(rng, dtype):
    x, y, _, weight, window_ptr = events(rng, dtype)
    return call("event_histogram", [x, y, weight, window_ptr], shape=(Y, X))


def lag_operator(rng, dtype):
    deposit = rng.normal(size=(B, 2, Y, X)).astype(dtype)
    angle = rng.uniform(0, 6, 3)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(dtype)
    lag = rng.uniform(0, 3, (3, 2)).astype(dtype)
    taps = rng.normal(size=(2, 5)).astype(dtype)
    extent = np.array([[Y, X], [Y - 4, X - 11], [Y, X - 1]], np.int32)
    inputs = [deposit, np.array([2, 0, 2], np.int32), direction, lag, taps, extent]
    return call("lag_operator", inputs)


def lag_operator_adjoint(rng, dtype):
    inputs = [*lag_operator(rng, dtype).inputs[1:], rng.normal(size=(3, Y, X)).astype(dtype)]
    return call("lag_operator_adjoint", inputs, deposits=B)


def motion_correlation(rng, dtype, radius=5, shape=(Y, X)):
    images = 2.0 * rng.normal(size=(B, 2, *shape)) * (rng.random((B, 2, *shape)) < 0.3)
    energies = (images**2).sum(axis=(1, 2, 3))
    quiet = np.where(np.arange(B)[:, None] == 1, energies[:, None] * [0.9, 1.1], 0.0)  # one of them
    return call("motion_correlation", [images.astype(dtype), quiet.astype(dtype), 2.0, radius])


def surface_peak(rng, dtype, size=11):
    surface = rng.normal(size=(B, size, size))
    return call("surface_peak", [surface.astype(dtype), 2.5])


def clip_outliers(rng, dtype):
    image = rng.normal(size=(B, Y, X)) ** 3 * (rng.random((B, Y, X)) < 0.5)
    image[1] = 0
    return call("clip_outliers", [image.astype(dtype), 1.7])


def reduce_image(rng, dtype):
    image = rng.normal(size=(B, Y, X)).astype(dtype)
    return call("reduce_image", [image, 1.25])


def mix_images(rng, dtype, width=X):
    images, weight = rng.normal(size=(2, 4, Y, width)), rng.normal(size=(3, 4))
    return call("mix_images", [images.astype(dtype), np.array([0, 1, 0], np.int32), weight.astype(dtype)])


def levels(height, width):
    """Rows of two levels, the second of seven rows, and what of them is each window's own."""
    rows = np.full((height, 2), -1, np.int32)
    first = height - 9
    rows[:first] = np.stack([np.zeros(first), np.arange(first)], axis=1)
    rows[-7:] = np.stack([np.ones(7), np.arange(7)], axis=1)
    extent = np.array([[[first, width], [7, max(0, width - 2)]], [[first, width], [0, 0]]], np.int32)
    return rows, np.concatenate([extent, [[[first - 2, width // 2], [5, width // 3]]]]).astype(np.int32)


def correlate_templates(rng, dtype, width=24, n=5):
    image = rng.normal(size=(B, Y + n - 1, width + n - 1)) * (rng.random((B, 1, width + n - 1)) < 0.8)
    image[1, :, : width // 2] = 0
    g = np.arange(n) - n // 2
    disc = (g[:, None] ** 2 + g**2) <= (n // 2) ** 2
    spans = np.array([(c.argmax(), n - c[::-1].argmax()) for c in disc.T], np.int32)
    basis, mix = np.empty((B, n, n, 5)), rng.normal(size=(B, 8, 5))
    for b in range(B):
        ortho, _ = np.linalg.qr((rng.normal(size=(n, n, 5)) * disc[..., None]).reshape(-1, 5))
        # what lies outside the disc does not count
        basis[b] = ortho.reshape(n, n, 5) + rng.normal(size=(n, n, 5)) * ~disc[..., None]
    mix /= np.linalg.norm(mix, axis=2, keepdims=True)
    busy, quiet = np.array([500.0, 300.0, 0.0], dtype), np.array([0.7, 0.9], dtype)
    inputs = [image.astype(dtype), busy, basis.astype(dtype), mix.astype(dtype), spans]
    made = call("correlate_templates", [*inputs, *levels(Y, width), quiet, 0.1, 0.2])
    made.outputs[-2][:] = 7.0  # what is left as it is beyond the extent
    return made


def local_maxima(rng, dtype, most=3):
    response = rng.uniform(-1, 1, (B, Y, X)).astype(dtype)
    response[0, 5:8, 5:8] = 0.99  # a plateau: all of it counts
    angle = rng.integers(0, 8, (B, Y, X)).astype(np.int32)
    sizes = np.array([[2.5, 3.125], [3.0, 4.0]], dtype)
    origin = rng.uniform(-9, 9, (B, 2)).astype(dtype)
    inputs = [response, angle, *levels(Y, X), sizes, origin, 0.3, 0.2]
    return call("local_maxima", inputs, most=most)


def line_runs(rng, dtype, lines=45):
    """An edge across each image, light, then dark, in noise; one direction is left out."""
    y, x = np.indices((Y, X))
    image = rng.normal(size=(B, Y, X))
    image[0] += 9.0 * np.exp(-(((x - 0.4 * y - 9.0) / 1.3) ** 2)) * (y > 5)
    image[1] -= 9.0 * np.exp(-(((y - 0.2 * x - 4.0) / 1.3) ** 2)) * (x < 20)
    angle = np.linspace(0.0, np.pi, 7)
    steep = np.abs(np.sin(angle)) > np.abs(np.cos(angle))
    slope = np.where(steep, np.cos(angle), np.sin(angle)) / np.where(steep, np.sin(angle), np.cos(angle))
    threshold = rng.uniform(2.0, 3.0, (B, 7))
    threshold[1, 3] = 0.0
    inputs = [image.astype(dtype), slope.astype(dtype), steep.astype(np.int32), threshold.astype(dtype), 3.0]
    return call("line_runs", inputs, lines=lines)


def merge_maxima(rng, dtype, count=60, keep=9):
    maxima = np.stack(
        [
            rng.uniform(-1, 1, (B, count)),
            rng.uniform(0, 60, (B, count)),
            rng.uniform(0, 60, (B, count)),
            rng.choice([4.0, 5.0, 6.1], (B, count)),
            rng.uniform(0, 1.5, (B, count)),
        ],
        axis=-1,
    )
    maxima[rng.random((B, count)) < 0.3] = 0
    maxima[1, 4:] = 0  # fewer than are kept
    return call("merge_maxima", [maxima.astype(dtype), 2.0, 0.3], most=keep)


def match_corners(rng, dtype, count=12, most=3):
    """Corners of a code, moved a little, among others; the last rows are empty."""
    turn = 0.4
    u, v = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    peaks = np.zeros((B, count, 5))
    for b in range(B):
        legs = 4.0 * (14 + 4 * b)
        corner = np.array([90.0, 80.0])
        places = [corner, corner + legs * u, corner + legs * v, corner + legs * (u + v)]
        places += list(rng.uniform(0, 200, (4, 2)))
        peaks[b, :8, 1:3] = np.array(places) + rng.normal(size=(8, 2))
    peaks[:, :8, 0] = rng.uniform(0.3, 1, (B, 8)) * np.where(np.arange(B) == 1, -1, 1)[:, None]
    peaks[:, :8, 3] = 4.0 * np.exp(rng.uniform(-0.05, 0.05, (B, 8)))
    peaks[:, :8, 4] = turn + rng.uniform(-0.05, 0.05, (B, 8))
    tolerances = np.array([0.2, 0.16, 0.24, np.log(14.0), np.log(170.0)])
    return call("match_corners", [peaks.astype(dtype), tolerances.astype(dtype)], most=most)


def moment_inputs(rng, dtype, samples=700, columns=5, count=4):
    image = rng.normal(size=(B, Y, X)).astype(dtype)
    points = rng.uniform(-3, 20, (samples, 2)).astype(dtype)
    table = rng.normal(size=(samples, columns)).astype(dtype)
    active = np.array([1, 0, 1, 1][:count], np.int32)
    return [image, np.array([2, 1, 0, 2][:count], np.int32), poses(rng, count, dtype), active, points, table]


def sample_moments(rng, dtype):
    inputs = moment_inputs(rng, dtype)
    inputs[3][:] = 1
    made = call("sample_moments", inputs)
    made.outputs[0] = filled((4, 3, 6), dtype)  # any number of chunks
    return made


def sample_moments_adjoint(rng, dtype):
    inputs = [*moment_inputs(rng, dtype), rng.normal(size=(4, 6)).astype(dtype)]
    return call("sample_moments_adjoint", inputs)


def score_poses(rng, dtype):
    """Models of both parts, of one alone, and of no points; poses that look past the image too."""
    image = rng.normal(size=(B, Y, X)).astype(dtype)
    model = np.hstack([rng.uniform(-3, 20, (90, 2)), rng.normal(size=(90, 2))]).astype(dtype)
    ptr = np.array([[0, 30, 60], [60, 60, 90], [5, 50, 50], [70, 70, 70]], np.int32)
    idx = np.array([0, 1, 2, 3, 0], np.int32)
    image_idx = np.array([2, 1, 0, 2, 1], np.int32)
    part = np.array([[0, Y, X], [3, Y - 5, X - 7], [0, 0, X], [2, Y - 2, X - 1], [1, 9, X]], np.int32)
    return call("score_poses", [image, image_idx, part, poses(rng, 5, dtype), idx, ptr, model, 1e-3])


def code_rhs(rng, dtype, shape=WIDE, samples=3, smaller=()):
    """Windows of a code that fills the arrays, and of others that do not: by so many rows and columns."""
    sides = np.maximum(1, np.subtract(shape, [(0, 0), *smaller])).astype(np.int32)
    across, down = (
        np.stack([(np.arange(size * samples) + 0.5) / samples - quiet for quiet in range(len(sides))])
        for size in shape[::-1]
    )
    profile, slope = rng.normal(size=(2, 5 * samples)).astype(dtype)
    image = rng.normal(size=(B, Y, X)).astype(dtype)
    gain = rng.normal(size=(B, 2)).astype(dtype)
    idx = np.arange(B, dtype=np.int32) % len(sides)
    lattices = idx, across.astype(dtype), down.astype(dtype), sides
    inputs = [image, poses(rng, B, dtype), *lattices, profile, slope, gain, samples]
    return call("code_rhs", inputs)


def code_rhs_of_several(rng, dtype):
    return code_rhs(rng, dtype, (13, 19), smaller=[(2, 4)])


def code_rhs_tall(rng, dtype):
    return code_rhs(rng, dtype, TALL)


def pose_normal_equations(rng, dtype, parameters=8, count=4, columns=20):
    table = rng.normal(size=(60, columns)).astype(dtype)
    moments = rng.normal(size=(count, columns + 1)).astype(dtype)
    terms = rng.integers(0, columns, (parameters + 2, 4)).astype(np.int32)
    factors = rng.integers(0, 4, (parameters + 2, 4)).astype(np.int32)
    return call("pose_normal_equations", [moments, table.T @ table, terms, factors, 1e-3])


def code_normal_equations(rng, dtype, shape=WIDE, reach=2):
    return call("code_normal_equations", code_rhs(rng, dtype, shape).inputs, reach=reach)


def code_normal_equations_tall(rng, dtype):
    return code_normal_equations(rng, dtype, TALL)


def code_product(rng, dtype, shape=WIDE):
    _, stencil, damping, free, start = system(rng, dtype, shape)
    return call("code_product", [start, stencil, damping, free])


def code_product_tall(rng, dtype):
    return code_product(rng, dtype, TALL)


def sum_equations(rng, dtype, shape=WIDE):
    """Windows of two codes: one without noise, one that agrees too little, one with little to see."""
    rhs, before = rng.normal(size=(2, B, *shape)).astype(dtype)
    gain, noise = rng.normal(size=(B, 2)), np.array([0.4, 0.0, 2.0])
    gain[1:] *= [[1e-5], [0.1]]
    products, stencils = rng.normal(size=(2, 3, 5, 5)).astype(dtype)
    idx, score = np.arange(B, dtype=np.int32) % 2 + 1, np.array([0.5, 0.8, 0.9], dtype)
    known = rng.normal(size=(3, *shape)).astype(dtype)
    sums = [rhs, gain.astype(dtype), noise.astype(dtype), products, before, np.abs(stencils)]
    return call("sum_equations", [*sums, score, dtype(0.8).repeat(B), idx, known, 0.3, 0.5, 2.0])


def sum_equations_tall(rng, dtype):
    return sum_equations(rng, dtype, TALL)


def pull_modules(rng, dtype, shape=WIDE):
    seen, q = rng.normal(size=(2, B, *shape)).astype(dtype)
    return call("pull_modules", [seen, q - dtype(1.0), np.linspace(0.1, 0.5, B).astype(dtype), 2.0])


def pull_modules_tall(rng, dtype):
    return pull_modules(rng, dtype, TALL)


def solve_code_banded(rng, dtype, shape=WIDE):
    *inputs, start = system(rng, dtype, shape)
    return call("solve_code_banded", inputs, start=start)


def solve_code_banded_tall(rng, dtype):
    return solve_code_banded(rng, dtype, TALL)


def system(rng, dtype, shape=WIDE):
    """Arguments of `solve_code`: positive definite, with free modules up to the border."""
    taps = rng.normal(size=(B, 3, 3))
    stencil = np.zeros((B, 5, 5))
    for b in range(B):
        for j, i in np.ndindex(3, 3):
            stencil[b, j : j + 3, i : i + 3] += taps[b, j, i] * taps[b, ::-1, ::-1]
    free = (rng.random(shape) < 0.7).astype(np.int32)
    rhs, start = rng.normal(size=(2, B, *shape))
    return [rhs.astype(dtype), stencil.astype(dtype), np.full(B, 0.3, dtype), free, start.astype(dtype)]


def systems(rng, dtype, shape=WIDE):
    """Arguments of `solve_code` for two codes: of the second not all rows and columns are free.

    The window in the middle, of the second code, is clear enough already where it has three rows.
    """
    rhs, stencil, damping, free, start = system(rng, dtype, shape)
    rows, columns = shape
    bounds = [[0, rows, 0, columns], [rows // 5, rows - rows // 4, columns // 6, columns - columns // 7]]
    idx, enough = np.array([0, 1, 1], np.int32), np.array([0, 3], np.int32)
    unclear = np.array([[1], [1], [4]], np.int32).repeat(rows, axis=1)
    about = [idx, np.stack([free, free[::-1]]), np.array(bounds, np.int32), unclear, enough]
    return [rhs, stencil, damping, *about, start]


def render_code(rng, dtype, parameters=6, sigma=0.0):
    grid = rng.normal(size=(B, 7, 6)).astype(dtype)
    inputs = [grid, maps(dtype, parameters), np.array([0.0, 1.0, -0.5], dtype), sigma]
    return call("render_code", inputs, shape=(Y, X))


def render_code_smooth(rng, dtype):
    return render_code(rng, dtype, sigma=0.23)


def render_code_tilted(rng, dtype):
    return render_code(rng, dtype, parameters=8)


def render_code_tilted_smooth(rng, dtype):
    return render_code(rng, dtype, parameters=8, sigma=0.23)


def maps(dtype, parameters=6):
    """Image to grid: one turned, one that shows all of the grid, and one close to singular.

    With 8 parameters the first is in front of a part of the image only.
    """
    rows = [
        [0.21, 0.09, -2.013, -0.08, 0.24, 0.507, -0.0431234, 0.0031567],
        [0.33, 0.0, -1.517, 0.0, 0.41, -1.019, 0.0112789, 0.0073141],
        [0.2, 0.1, 0.303, 0.4, 0.2, -3.017, 0.0021379, -0.0011757],
    ]
    return np.array(rows, dtype)[:, :parameters].copy()


def render_code_adjoint(rng, dtype, parameters=6, sigma=0.0):
    grid, to_grid, outside, _ = render_code(rng, dtype, parameters).inputs
    adj_image = rng.normal(size=(B, Y, X)).astype(dtype)
    return call("render_code_adjoint", [grid, to_grid, outside, sigma, adj_image])


def render_code_adjoint_tilted_smooth(rng, dtype):
    return render_code_adjoint(rng, dtype, parameters=8, sigma=0.23)


def brightness_residual(rng, dtype):
    luminance, events_image = rng.normal(size=(2, B, Y, X)).astype(dtype)
    motion = rng.normal(size=(B, 2)).astype(dtype)
    return call("brightness_residual", [luminance, events_image, motion])


def brightness_residual_adjoint(rng, dtype):
    luminance, _, motion = brightness_residual(rng, dtype).inputs
    return call("brightness_residual_adjoint", [luminance, motion, rng.normal(size=(B, Y, X)).astype(dtype)])


def brightness_cost(rng, dtype):
    """Some pixels do not count, others count for more or less than one."""
    inputs = brightness_residual(rng, dtype).inputs
    mask = rng.uniform(0, 2, (B, Y, X)) * (rng.random((B, Y, X)) < 0.6)
    return call("brightness_cost", [*inputs, mask.astype(dtype)])


def brightness_cost_adjoint(rng, dtype):
    inputs = [*brightness_cost(rng, dtype).inputs, rng.normal(size=B).astype(dtype)]
    return call("brightness_cost_adjoint", inputs)


CALLS = [
    bin_events,
    splat_events,
    splat_events_wide,
    splat_events_affine,
    splat_events_adjoint,
    splat_events_affine_adjoint,
    splat_events_bilinear,
    splat_events_bilinear_adjoint,
    deposit_events,
    deposit_events_adjoint,
    bin_packed_events,
    deposit_packed_events,
    voxel_grid,
    voxel_grid_of_one_plane,
    voxel_grid_adjoint,
    voxel_grid_of_one_plane_adjoint,
    time_surface,
    event_histogram,
    lag_operator,
    lag_operator_adjoint,
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
    score_poses,
    pose_normal_equations,
    code_rhs,
    code_rhs_tall,
    code_rhs_of_several,
    code_normal_equations,
    code_normal_equations_tall,
    code_product,
    code_product_tall,
    sum_equations,
    sum_equations_tall,
    pull_modules,
    pull_modules_tall,
    render_code,
    render_code_smooth,
    render_code_tilted,
    render_code_tilted_smooth,
    render_code_adjoint,
    render_code_adjoint_tilted_smooth,
    brightness_residual,
    brightness_residual_adjoint,
    brightness_cost,
    brightness_cost_adjoint,
]
"""All operations but those that update an input in place, which have files of their own."""
