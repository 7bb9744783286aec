"""Pose and a gain that is affine in the code, by Gauss-Newton on one image: stage one where a code turns.

As `evqr.fit.align`, but the gain has 6 numbers, ``a(u, v) = g_0 + g_1 u' + g_2 v'`` with (u', v') of
`PoseTable`, and is found together with the pose.  It is asked for rarely, so this is done on the host.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.fit.model import pose_table
from evqr.fit.tables import Level
from evqr.geometry import compose, inverse
from evqr.symbol.space import CodeSpace, closed

SLOPE_RIDGE = 3e-3
"""Regularises how the gain varies, relative to the mean of the diagonal; a tenth of that its mean."""

GAIN_DAMPING = 10.0
"""How much more a step of the gain is damped than one of the pose."""

L_U, L_V, L_UU, L_UV, L_VV = 18, 19, 0, 5, 12
"""Columns of `PoseTable` with the model's derivatives."""


@dataclass(frozen=True, eq=False)
class Samples:
    """The known samples of a code at one level, and what the model says there.

    Attributes
    ----------
    points : (S, 2) float64 [modules]
        Where.
    along : (3, S) float64
        1, u' and v'.
    design : (6, S) float64
        Derivatives of the residual by the gain: L_u and L_v times ``along``.
    curves : (3, S) float64
        L_uu, L_uv and L_vv.
    scale : (float, float) [modules]
        Half the size of the code, along u and v.
    """

    points: NDArray[np.float64]
    along: NDArray[np.float64]
    design: NDArray[np.float64]
    curves: NDArray[np.float64]
    scale: tuple[float, float]

    def bent(self, gain: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Give G_u and G_v (S,): how the residual changes where the model is moved along u and v."""
        a_u, a_v = times(gain, self.along)
        l_uu, l_uv, l_vv = self.curves
        return a_u * l_uu + a_v * l_uv, a_u * l_uv + a_v * l_vv

    def model(self, gain: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give what an image should show at the samples (S,)."""
        return -times(gain.reshape(1, 6), self.design)[0]


@functools.lru_cache(maxsize=32)
def samples_of(space: CodeSpace, level: Level) -> Samples:
    """Give the known samples of a code at a level."""
    made = pose_table(space, level.sigma, level.samples)
    points, table = made.points.astype(np.float64), made.table.T.astype(np.float64)
    along = np.stack([np.ones(len(points)), *((points - made.centre) / made.scale).T])
    return Samples(
        points=closed(points),
        along=closed(along),
        design=closed((table[[L_U, L_V]][:, None] * along).reshape(6, -1)),
        curves=closed(table[[L_UU, L_UV, L_VV]]),
        scale=made.scale,
    )


class Fit(NamedTuple):
    """A pose on an image, and the gain there.

    Attributes
    ----------
    pose : (3, 3) float64
        Code coordinates to cells.
    gain : (2, 3) float64
        a_u and a_v: of 1, u' and v'.
    score : float
        Correlation of model and image on what is known, -1 to 1.
    noise : float
        Variance of a sample.
    steps : int
        Of Gauss-Newton.
    """

    pose: NDArray[np.float64]
    gain: NDArray[np.float64]
    score: float
    noise: float
    steps: int


def fit_gain(image: NDArray[np.float64], pose: NDArray[np.float64], samples: Samples) -> Fit:
    """Give the gain that explains an image best through a pose."""
    e = seen_through(pose, image, samples.points)
    gram = times(samples.design, samples.design.T)
    ridge = np.full(6, SLOPE_RIDGE * float(np.trace(gram)) / 6.0)
    ridge[::3] *= 0.1
    gain = -solved(gram + np.diag(ridge), times(samples.design, e)).reshape(2, 3)
    model = samples.model(gain)
    energy, own, cross = (float((a * b).sum()) for a, b in ((e, e), (model, model), (e, model)))
    score = cross / math.sqrt(max(energy * own, 1e-20))
    return Fit(pose, gain, score, max(energy - 2.0 * cross + own, 0.0) / max(len(e), 1), 0)


def align_affine(
    image: NDArray[np.float64],
    pose: NDArray[np.float64],
    samples: Samples,
    level: Level,
    cfg: AlignConfig,
    most_steps: int | None = None,
) -> Fit:
    """Refine a pose, and find the gain, on an image.

    Parameters
    ----------
    image : (Y, X) float64
        Events on cells, blurred, their lags undone.
    pose : (3, 3) float64
        Code coordinates to cells, to start from.
    samples : Samples
        Of the code.
    level : Level
        Theirs.
    cfg : AlignConfig
        Settings.
    most_steps : int, optional
        Default: ``cfg.max_iterations``.

    Returns
    -------
    fit : Fit
        What came out.
    """
    most, steps, last = cfg.max_iterations if most_steps is None else most_steps, 0, False
    (scale_u, scale_v), longer = samples.scale, max(samples.scale)
    to_centre = np.array([[1.0, 0.0, -scale_u], [0.0, 1.0, -scale_v], [0.0, 0.0, 1.0]])
    _, u, v = samples.along
    while True:
        fit = fit_gain(image, pose, samples)
        if last or steps >= most:
            return fit._replace(steps=steps)
        g_u, g_v = samples.bent(fit.gain)
        columns = [g_u, g_u * u, g_u * v, g_v, g_v * u, g_v * v]
        if level.tilt:
            tilted = (g_u * u * scale_u + g_v * v * scale_v) / longer
            columns += [tilted * u, tilted * v]
        jacobian = np.stack([*columns, *samples.design])
        left = seen_through(pose, image, samples.points) - samples.model(fit.gain)
        matrix = times(jacobian, jacobian.T)
        diagonal = np.diag(matrix).copy()
        damping = cfg.damping * diagonal + 1e-7 * diagonal.sum() + 1e-12
        damping[-6:] *= GAIN_DAMPING
        step = np.zeros(8)
        step[: len(columns)] = -solved(matrix + np.diag(damping), times(jacobian, left))[: len(columns)]
        size = float(np.abs(step).sum())
        step /= max(size, 1.0)
        warp = np.array(
            [
                [1.0 + step[1] / scale_u, step[2] / scale_v, step[0]],
                [step[4] / scale_u, 1.0 + step[5] / scale_v, step[3]],
                [-step[6] / (longer * scale_u), -step[7] / (longer * scale_v), 1.0],
            ]
        )
        moved = compose(pose, compose(inverse(to_centre), compose(inverse(warp), to_centre)))
        pose = moved / moved[2, 2]
        steps += 1
        last = size < level.tolerance


def times(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the product of a matrix with another one, or with a vector; without BLAS."""
    return np.einsum("ij,j...->i...", a, b)


def solved(matrix: NDArray[np.float64], rhs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve a small positive definite system, by elimination."""
    a, x = matrix.copy(), rhs.copy()
    n = len(x)
    for k in range(n):
        factor = a[k + 1 :, k] / a[k, k]
        a[k + 1 :, k:] -= factor[:, None] * a[k, k:]
        x[k + 1 :] -= factor * x[k]
    for k in reversed(range(n)):
        x[k] = (x[k] - float((a[k, k + 1 :] * x[k + 1 :]).sum())) / a[k, k]
    return x


def seen_through(
    pose: NDArray[np.float64], image: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate an image (Y, X) at places (..., 2) [modules] of a code; outside of it is 0."""
    (x, y), (height, width) = places(pose, points), image.shape
    inside = (x >= 0.0) & (y >= 0.0) & (x < width - 1) & (y < height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    column, row = x.astype(np.intp), y.astype(np.intp)
    fx, fy = x - column, y - row
    flat, at = image.ravel(), row * width + column
    top = flat[at] * (1.0 - fx) + flat[at + 1] * fx
    low = flat[at + width] * (1.0 - fx) + flat[at + width + 1] * fx
    return np.where(inside, top + fy * (low - top), 0.0)


def places(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give where places (..., 2) [modules] of a code are through its pose, (2, ...)."""
    u, v = points[..., 0], points[..., 1]
    x, y, w = (row[0] * u + row[1] * v + row[2] for row in pose.tolist())
    return np.stack([x / w, y / w])
