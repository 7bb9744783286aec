"""Stage one: pose and gain from the known modules, by inverse-compositional Gauss-Newton.

The residual of a sample at code coordinates (u, v) is ``e + a_u L_u + a_v L_v``: e the event image seen through the pose, L the
model (`evqr.model`), and the gain a = (a_u, a_v) the motion in modules times contrast over threshold, so that neither contrast nor
threshold need be known.  A small affine motion of the model changes it by ``G_u (1, u, v), G_v (1, u, v)`` with
``G_u = a_u L_uu + a_v L_uv`` and ``G_v = a_u L_uv + a_v L_vv``; perspective adds ``G_u uu + G_v uv, G_u uv + G_v vv``.  All of these
are linear in a with columns that are known beforehand, so the Gauss-Newton matrix comes from a table (`PoseTable.gram`) and the
image enters by its moments with that table alone (`evqr_kernels`, sample_moments).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import StageOneConfig
from evqr.model import MOMENTS, PoseTable, pose_table
from evqr.workspace import Workspace

CHUNK = 512
"""Samples that one thread of the kernel adds up."""

RIDGE = 1e-3
"""Regularises the gain where the known modules leave a direction open, relative to the trace."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One step from coarse to fine: blur of the model [modules], samples a module, and whether perspective is free."""

    sigma: float
    samples: int
    tilt: bool


def coarse_levels(cfg: StageOneConfig) -> tuple[Level, ...]:
    """The levels that a pose from the search goes through before the last."""
    return tuple(Level(sigma=s, samples=cfg.coarse_samples, tilt=False) for s in cfg.coarse_sigmas)


def fine_levels(cfg: StageOneConfig) -> tuple[Level, ...]:
    """The levels for a pose that is known to a fraction of a module."""
    return (Level(sigma=cfg.sigma, samples=cfg.samples, tilt=True),)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses of N hypotheses after stage one.

    Attributes
    ----------
    pose : (N, 3, 3)    code coordinates to cells of the image
    gain : (N, 2)       a_u, a_v
    score : (N,)        normalised correlation of the model with the image on the known modules, -1 to 1
    noise : (N,)        variance of what the model leaves unexplained, a sample
    iterations          Gauss-Newton steps taken, over all levels
    """

    pose: NDArray[np.float64]
    gain: NDArray[np.float64]
    score: NDArray[np.float64]
    noise: NDArray[np.float64]
    iterations: int


@functools.cache
def _columns(tilt: bool) -> NDArray[np.float64]:
    """(2, P + 2, MOMENTS): the Jacobian's columns in terms of the table's, one matrix a component of the gain.

    The last two columns, the gain's own, do not depend on the gain: `align` sets them.
    """
    parameters = 8 if tilt else 6
    columns = np.zeros((2, parameters + 2, MOMENTS))
    uu, uv, vv = 0, 6, 12  # where L_uu, L_uv, L_vv start in the table; behind each: 1, u, v, uu, uv, vv
    for w in range(3):
        columns[0, w, uu + w] = columns[1, w, uv + w] = 1.0
        columns[0, 3 + w, uv + w] = columns[1, 3 + w, vv + w] = 1.0
    if tilt:
        for k, (first, second) in enumerate(((3, 4), (4, 5))):
            columns[0, 6 + k, uu + first] = columns[1, 6 + k, uv + first] = 1.0
            columns[0, 6 + k, uv + second] = columns[1, 6 + k, vv + second] = 1.0
    return columns


def _moments(
    image: Any, image_idx: NDArray[np.int32], pose: NDArray[np.float64], active: NDArray[np.bool_],
    table_key: tuple[int, Level], table: PoseTable, workspace: Workspace,
) -> NDArray[np.float64]:  # fmt: skip
    n, chunks = len(pose), -(-len(table.points) // CHUNK)
    out = workspace.buffer("moments", (n, MOMENTS + 1))
    workspace.backend.sample_moments(
        image,
        workspace.put(image_idx),
        workspace.put(pose.reshape(n, 9).astype(np.float32)),
        workspace.put(active.astype(np.int32)),
        workspace.table((*table_key, "points"), table.points),
        workspace.table((*table_key, "table"), table.table),
        workspace.buffer("moment chunks", (n, chunks, MOMENTS + 1)),
        out,
    )
    workspace.backend.synchronize(workspace.device)
    return workspace.get(out).astype(np.float64)


def _gain(
    moments: NDArray[np.float64], table: PoseTable
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares gain, its score and the residual variance."""
    gram = table.gram[18:, 18:]
    gain = -np.linalg.solve(gram + RIDGE * np.trace(gram) * np.eye(2), moments[:, 18:20].T).T
    model = np.einsum("ni,ij,nj->n", gain, gram, gain)
    cross = -(gain * moments[:, 18:20]).sum(axis=1)
    energy = moments[:, 20]
    score = cross / np.sqrt(np.maximum(model * energy, 1e-20))
    return gain, score, np.maximum(energy - 2.0 * cross + model, 0.0) / len(table.points)


def _compose(
    pose: NDArray[np.float64], step: NDArray[np.float64], table: PoseTable
) -> NDArray[np.float64]:
    """Undo a small motion of the model: pose o D^-1, with D from parameters in centred, scaled coordinates."""
    n, c, s = len(pose), table.centre, table.scale
    warp = np.zeros((n, 3, 3))
    warp[:, 0, 0] = 1.0 + step[:, 1] / s
    warp[:, 0, 1] = step[:, 2] / s
    warp[:, 0, 2] = step[:, 0]
    warp[:, 1, 0] = step[:, 4] / s
    warp[:, 1, 1] = 1.0 + step[:, 5] / s
    warp[:, 1, 2] = step[:, 3]
    warp[:, 2, 0] = -step[:, 6] / s**2
    warp[:, 2, 1] = -step[:, 7] / s**2
    warp[:, 2, 2] = 1.0
    to_centre = np.array([[1.0, 0.0, -c], [0.0, 1.0, -c], [0.0, 0.0, 1.0]])
    back = np.array([[1.0, 0.0, c], [0.0, 1.0, c], [0.0, 0.0, 1.0]])
    moved = pose @ (back @ np.linalg.inv(warp) @ to_centre)
    return moved / moved[:, 2:, 2:]


def align(
    image: Any,
    pose: NDArray[np.float64],
    version: int,
    levels: tuple[Level, ...],
    cfg: StageOneConfig,
    *,
    workspace: Workspace,
    image_idx: NDArray[np.int32] | None = None,
) -> Alignment:
    """Refine the poses of N hypotheses of one version.

    Parameters
    ----------
    image : (B, Y, X) float32     event images on the device
    pose : (N, 3, 3)              code coordinates to cells
    levels                        coarse to fine
    image_idx : (N,) int32        image of each hypothesis; default the first
    """
    pose, n = pose.copy(), len(pose)
    idx = np.zeros(n, np.int32) if image_idx is None else image_idx
    everyone = np.ones(n, bool)
    iterations = 0
    for level in levels:
        key, table = (version, level), pose_table(version, level.sigma, level.samples)
        columns = _columns(level.tilt)
        parameters = columns.shape[1] - 2
        active = everyone.copy()
        for _ in range(cfg.max_iterations):
            moments = _moments(image, idx, pose, active, key, table, workspace)[active]
            gain, _, _ = _gain(moments, table)
            jacobian = np.einsum("nk,kpm->npm", gain, columns)
            jacobian[:, parameters, 18] = jacobian[:, parameters + 1, 19] = 1.0
            matrix = jacobian @ table.gram @ jacobian.transpose(0, 2, 1)
            rhs = jacobian @ (moments[:, :MOMENTS] + gain @ table.gram[18:])[:, :, None]
            diagonal = np.einsum("npp->np", matrix)
            diagonal += cfg.damping * diagonal + 1e-9 * diagonal.sum(axis=1, keepdims=True) + 1e-12
            step = np.zeros((len(moments), 8))
            step[:, :parameters] = -np.linalg.solve(matrix, rhs)[:, :parameters, 0]
            size = np.abs(step).sum(axis=1, keepdims=True)
            step /= np.maximum(size, 1.0)
            pose[active] = _compose(pose[active], step, table)
            iterations += 1
            active[active] = size[:, 0] >= cfg.tolerance
            if not active.any():
                break
    gain, score, noise = _gain(_moments(image, idx, pose, everyone, key, table, workspace), table)
    return Alignment(pose, gain, score, noise, iterations)


def shifted(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pose (3, 3) and its eight neighbours one module away, (9, 3, 3); the pose itself is the fifth."""
    steps = np.tile(np.eye(3), (9, 1, 1))
    steps[:, 0, 2] = np.tile((-1.0, 0.0, 1.0), 3)
    steps[:, 1, 2] = np.repeat((-1.0, 0.0, 1.0), 3)
    return pose @ steps


def refine_from_cold(
    image: Any, pose: NDArray[np.float64], version: int, cfg: StageOneConfig, *, workspace: Workspace
) -> Alignment:
    """Refine one pose (3, 3) from the coarse look: the last levels, then the neighbours one module away.

    The cost has a side minimum one module off, where finder patterns half agree.  Its neighbours are looked at, not refined: from
    a side minimum the true pose is exactly one module away.
    """
    levels = (*coarse_levels(cfg)[-1:], *fine_levels(cfg))
    found = align(image, pose[None], version, levels, cfg, workspace=workspace)
    around = shifted(found.pose[0])
    score = score_poses(image, around, version, levels[-1], workspace=workspace)
    best = int(score.argmax())
    if score[best] <= found.score[0] + cfg.shift_gain:
        return found
    again = align(image, around[best : best + 1], version, fine_levels(cfg), cfg, workspace=workspace)
    return replace(again, iterations=found.iterations + again.iterations)


def score_poses(
    image: Any, pose: NDArray[np.float64], version: int, level: Level, *, workspace: Workspace
) -> NDArray[np.float64]:
    """Score (N,) of poses (N, 3, 3) as they are."""
    n, table = len(pose), pose_table(version, level.sigma, level.samples)
    moments = _moments(
        image, np.zeros(n, np.int32), pose, np.ones(n, bool), (version, level), table, workspace
    )
    return _gain(moments, table)[1]
