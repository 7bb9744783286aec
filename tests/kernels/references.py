"""Operations from their definitions, dense and slow.

The differentiable ones are for PyTorch and JAX alike: ``xp`` is `torch` or `jax.numpy`, ``erf`` its error
function; index arrays are NumPy's.  The problem of a code's modules is NumPy's alone.
"""

import math
from itertools import pairwise

import numpy as np


def hat(xp, s):
    return xp.clip(1 - xp.abs(s), 0, None)


def transported(xp, x, y, t, motion, shape, frame):
    """Where events are at the reference time, for 2 or 6 parameters, in pixels of the frame's image."""
    left, top, scale = frame
    vx, vy = motion[0], motion[1]
    if len(motion) == 6:
        dx, dy = x - left + 0.5 - scale * shape[1] / 2, y - top + 0.5 - scale * shape[0] / 2
        vx, vy = vx + motion[2] * dx + motion[3] * dy, vy + motion[4] * dx + motion[5] * dy
    return (x - t * vx - left + 0.5) / scale - 0.5, (y - t * vy - top + 0.5) / scale - 0.5


def splat_events(
    xp, x, y, t, weight, window_ptr, motion, lag=None, frame=None, *, shape, cfg, direction=None
):
    """With a lag, ``direction`` (B, 2) is that of the motions."""

    def profile(r):
        if cfg.kind == "bilinear":
            return hat(xp, r)
        q = xp.clip(1 - (r / cfg.radius_px) ** 2, 0, None)
        return cfg.norm * xp.exp(-0.5 * (r / cfg.epsilon_px) ** 2) * q * q

    def slope(r):
        if cfg.kind == "bilinear":
            return -xp.sign(r) * (xp.abs(r) < 1)
        q = xp.clip(1 - (r / cfg.radius_px) ** 2, 0, None)
        gauss = cfg.norm * xp.exp(-0.5 * (r / cfg.epsilon_px) ** 2)
        return -r * gauss * q * (q / cfg.epsilon_px**2 + 4 / cfg.radius_px**2)

    images = []
    frame = [(0.0, 0.0, 1.0)] * len(motion) if frame is None else frame
    rows, columns = (xp.arange(size, dtype=x.dtype)[None] for size in shape)
    for b, (begin, end) in enumerate(pairwise(window_ptr)):
        part = slice(int(begin), int(end))
        w = weight[part]
        cx, cy = transported(xp, x[part], y[part], t[part], motion[b], shape, frame[b])
        right, down = columns - cx[:, None], rows - cy[:, None]
        image = xp.einsum("e,ey,ex->yx", w, profile(down), profile(right))
        if lag is not None:
            lagging = w * xp.where(w < 0, lag[b, 1], lag[b, 0])
            along, across = direction[b, 0] * lagging, direction[b, 1] * lagging
            image = image - xp.einsum("e,ey,ex->yx", along, profile(down), slope(right))
            image = image - xp.einsum("e,ey,ex->yx", across, slope(down), profile(right))
        images.append(image)
    return xp.stack(images)


def deposit_events(xp, x, y, t, weight, window_ptr, motion, frame=None, *, shape):
    images = []
    frame = [(0.0, 0.0, 1.0)] * len(motion) if frame is None else frame
    rows, columns = (xp.arange(size, dtype=x.dtype)[None] for size in shape)
    for b, (begin, end) in enumerate(pairwise(window_ptr)):
        part = slice(int(begin), int(end))
        cx, cy = transported(xp, x[part], y[part], t[part], motion[b], shape, frame[b])
        along, across = hat(xp, columns - cx[:, None]), hat(xp, rows - cy[:, None])
        for signed in (weight[part] * (weight[part] > 0), weight[part] * (weight[part] < 0)):
            images.append(xp.einsum("e,ey,ex->yx", signed, across, along))
    return xp.stack(images).reshape(-1, 2, *shape)


def voxel_grid(xp, x, y, t, weight, window_ptr, span, *, bins, shape):
    def at(places, size):
        near = xp.floor(places + 0.5)[:, None] == xp.arange(size, dtype=x.dtype)[None]
        return xp.where(near, xp.ones_like(places)[:, None], xp.zeros_like(places)[:, None])

    grids = []
    for (begin, end), (first, last) in zip(pairwise(window_ptr), span, strict=True):
        part = slice(int(begin), int(end))
        inside = (t[part] >= first) & (t[part] <= last)
        place = (t[part] - first) / (last - first) * (bins - 1)
        shares = hat(xp, xp.arange(bins, dtype=x.dtype)[None] - place[:, None])
        pixels = at(y[part], shape[0]), at(x[part], shape[1])
        grids.append(xp.einsum("e,ek,ey,ex->kyx", weight[part] * inside, shares, *pixels))
    return xp.stack(grids)


def lag_operator(xp, deposit, deposit_idx, direction, lag, taps, extent=None):
    reach = taps.shape[1] // 2

    def filter_of(weights, size):
        shifts = xp.asarray(np.stack([np.eye(size, k=reach - k, dtype=dtype) for k in range(2 * reach + 1)]))
        return xp.einsum("k,kij->ij", weights, shifts)

    dtype = np.asarray(taps).dtype
    (down, down_slope), (right, right_slope) = (
        [filter_of(weights, size) for weights in taps] for size in deposit.shape[2:]
    )
    images = []
    for n, b in enumerate(deposit_idx):
        total = 0
        for p in range(2):
            image = deposit[int(b), p]
            slope_x, slope_y = down.T @ image @ right_slope, down_slope.T @ image @ right
            slope = direction[n, 0] * slope_x + direction[n, 1] * slope_y
            total = total + down.T @ image @ right - lag[n, p] * slope
        own = total.shape if extent is None else extent[n]
        cells = (xp.arange(size) for size in total.shape)
        inner = [(k >= reach) & (k < size - reach) for k, size in zip(cells, own, strict=True)]
        images.append(total * inner[0][:, None] * inner[1][None])
    return xp.stack(images)


def render_code(xp, grid, to_grid, outside, *, shape, sigma, erf):
    def profile(s):
        if sigma == 0:
            return hat(xp, s)
        scale = 0.5 / math.erf(6 * math.sqrt(0.5))

        def edge(z):
            return 0.5 + scale * erf(xp.clip(z, -6, 6) * math.sqrt(0.5))

        return edge((s + 0.5) / sigma) - edge((s - 0.5) / sigma)

    y, x = (xp.arange(size, dtype=grid.dtype) for size in shape)
    y, x = y[:, None], x[None]
    images = []
    for q, w, beyond in zip(grid, to_grid, outside, strict=True):
        depth = w[6] * x + w[7] * y + 1 if len(w) == 8 else 1 + 0 * x * y
        u, v = (w[0] * x + w[1] * y + w[2]) / depth, (w[3] * x + w[4] * y + w[5]) / depth
        nodes_v, nodes_u = (xp.arange(size, dtype=grid.dtype) for size in q.shape)
        shares = profile(v[..., None] - nodes_v), profile(u[..., None] - nodes_u)
        images.append(beyond + xp.einsum("ji,yxj,yxi->yx", q - beyond, *shares))
    return xp.stack(images)


def brightness_residual(xp, luminance, events_image, motion):
    def slope(image, axis):
        moved = xp.swapaxes(image, axis, 2)
        padded = xp.concatenate([moved[:, :, :1], moved, moved[:, :, -1:]], 2)
        return xp.swapaxes(0.5 * (padded[:, :, 2:] - padded[:, :, :-2]), axis, 2)

    m = motion[:, :, None, None]
    return m[:, 0] * slope(luminance, 2) + m[:, 1] * slope(luminance, 1) + events_image


def brightness_cost(xp, luminance, events_image, motion, mask):
    residual = brightness_residual(xp, luminance, events_image, motion)
    return 0.5 * (mask * residual * residual).sum((1, 2))


def sample_moments(xp, image, image_idx, pose, points, table, active=None):
    height, width = image.shape[1:]
    rows, columns = (xp.arange(size, dtype=image.dtype)[None] for size in (height, width))
    moments = []
    active = np.ones(len(pose)) if active is None else active
    for b, p, looks in zip(image_idx, pose, active, strict=True):
        u, v = points[:, 0], points[:, 1]
        depth = p[6] * u + p[7] * v + p[8]
        x, y = (p[0] * u + p[1] * v + p[2]) / depth, (p[3] * u + p[4] * v + p[5]) / depth
        inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
        shares = hat(xp, rows - y[:, None]), hat(xp, columns - x[:, None])
        e = inside * xp.einsum("yx,sy,sx->s", image[int(b)], *shares)
        moments.append(float(looks) * xp.concatenate([e @ table, (e @ e)[None]]))
    return xp.stack(moments)


def code_model(profile, slope, gain, shape, samples):
    """A of `code_rhs` for one window of V x U modules: (lattice points, modules), both row by row."""

    def along(values, modules):
        matrix = np.zeros((modules * samples, modules))
        for j in range(modules):
            for k, value in enumerate(values):
                if 0 <= (row := j * samples - (len(values) - samples) // 2 + k) < len(matrix):
                    matrix[row, j] = value
        return matrix

    (b_v, slope_v), (b_u, slope_u) = ([along(f, modules) for f in (profile, slope)] for modules in shape)
    return gain[0] * np.kron(b_v, slope_u) + gain[1] * np.kron(slope_v, b_u)


def code_matrix(stencil, damping, shape):
    """The system of `code_product` for one window with all V x U modules free."""
    reach = len(stencil) // 2
    matrix = np.zeros((*shape, *shape))
    for i, j in np.ndindex(*shape):
        for k, m in np.ndindex(*stencil.shape):
            row, column = i + k - reach, j + m - reach
            if 0 <= row < shape[0] and 0 <= column < shape[1]:
                matrix[i, j, row, column] = stencil[k, m]
    size = shape[0] * shape[1]
    return matrix.reshape(size, size) + damping * np.eye(size)


def code_solution(rhs, stencil, damping, free, start):
    """The modules of `solve_code` for one window."""
    matrix = code_matrix(stencil, damping, rhs.shape)
    is_free, q = free.ravel() != 0, start.ravel().astype(float)
    fixed = matrix[np.ix_(is_free, ~is_free)] @ q[~is_free]
    q[is_free] = np.linalg.solve(matrix[np.ix_(is_free, is_free)], -rhs.ravel()[is_free] - fixed)
    return q.reshape(rhs.shape)
