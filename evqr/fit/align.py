"""Stage one: pose and gain from the known modules, by inverse-compositional Gauss-Newton.

The residual of a sample at code coordinates (u, v) is ``e + a_u L_u + a_v L_v``: e the event image seen
through the pose, L the model (`evqr.fit.model`), and the gain a = (a_u, a_v) the motion in modules times
contrast over threshold, so that neither contrast nor threshold need be known.  A small affine motion of the
model changes it by ``G_u (1, u', v'), G_v (1, u', v')`` with ``G_u = a_u L_uu + a_v L_uv`` and
``G_v = a_u L_uv + a_v L_vv``; perspective adds ``(G_u w_u + G_v w_v) (u', v')``.  Coordinates are those from
the centre of the code, over half its size along each axis, or for w over half the longer side.  All of these
are linear in a with columns that are known beforehand, so the Gauss-Newton matrix comes from a table
(`PoseTable.gram`) and the image enters by its moments with that table alone (`evqr_kernels`, align_poses).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.config import AlignConfig
from evqr.fit.model import MOMENTS, pose_table
from evqr.geometry import compose
from evqr.symbol.space import CodeSpace
from evqr.workspace import Images, Step, Workspace


@dataclass(frozen=True, kw_only=True)
class Level:
    """One step from coarse to fine.

    Attributes
    ----------
    sigma : float [modules]
        Blur of the model.
    samples : int
        Samples a module.
    tilt : bool
        Whether perspective is free where there is more than one finder pattern to hold it.
    tolerance : float [modules]
        Step at which it has converged.
    beyond_patterns : bool
        Whether only what is known outside of finder patterns counts.
    """

    sigma: float
    samples: int
    tilt: bool
    tolerance: float
    beyond_patterns: bool = False


def coarse_levels(cfg: AlignConfig) -> tuple[Level, ...]:
    """Give the levels that a pose from the search goes through before the last."""
    return tuple(
        Level(sigma=sigma, samples=samples, tilt=False, tolerance=cfg.coarse_tolerance)
        for sigma, samples in cfg.coarse_levels
    )


def fine_levels(cfg: AlignConfig) -> tuple[Level, ...]:
    """Give the levels for a pose that is known to a fraction of a module."""
    return (Level(sigma=cfg.sigma, samples=cfg.samples, tilt=True, tolerance=cfg.tolerance),)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses of N hypotheses after stage one.

    Attributes
    ----------
    pose : (N, 3, 3) float64
        Code coordinates to cells of the image.
    gain : (N, 2) float64
        a_u, a_v.
    score : (N,) float64
        Normalised correlation of the model with the image on the known modules, -1 to 1; see `judged`.
    noise : (N,) float64
        Variance of what the model leaves unexplained, a sample.
    iterations : int
        Gauss-Newton steps taken, over all levels.
    """

    pose: NDArray[np.float64]
    gain: NDArray[np.float64]
    score: NDArray[np.float64]
    noise: NDArray[np.float64]
    iterations: int

    @property
    def best(self) -> int:
        """The hypothesis with the highest score."""
        scores = self.score.tolist()
        return scores.index(max(scores))

    def only(self, which: int) -> Alignment:
        """Give one hypothesis alone."""
        pick = slice(which, which + 1)
        return Alignment(
            self.pose[pick], self.gain[pick], self.score[pick], self.noise[pick], self.iterations
        )


@functools.cache
def _terms(tilt: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Give the table's columns that make up each of the Jacobian's, and their factors, (P + 2, 4) each.

    Factors: 0 nothing, 1 a_u, 2 a_v, 3 one.
    """
    uu, uv, vv = 0, 5, 12  # where L_uu, L_uv, L_vv start in the table
    rows: list[tuple[tuple[int, int], ...]] = [((uu + w, 1), (uv + w, 2)) for w in range(3)]
    rows += [((uv + w, 1), (vv + w, 2)) for w in range(3)]
    if tilt:
        for w in (3, 4):  # w_u u', w_u v' with L_uu and L_uv; w_v u', w_v v' with L_uv and L_vv
            rows.append(((uu + w, 1), (uv + w, 2), (uv + w + 2, 1), (vv + w, 2)))
    rows += [((MOMENTS - 2, 3),), ((MOMENTS - 1, 3),)]
    padded = np.array([[*row, *[(0, 0)] * (4 - len(row))] for row in rows], np.int32)
    return np.ascontiguousarray(padded[..., 0]), np.ascontiguousarray(padded[..., 1])


class Align(Step):
    """Refines the poses of N hypotheses of one code space, each on one of some images, over levels."""

    def __init__(
        self, images: Images, count: int, space: CodeSpace, levels: tuple[Level, ...], max_iterations: int,
        cfg: AlignConfig, workspace: Workspace,
    ) -> None:  # fmt: skip
        super().__init__(workspace.backend)
        self._images, self._max_iterations = images.device, max_iterations
        self._image_idx = workspace.mirror((count,), np.int32)
        self._tables = [_tables(space, level, cfg, workspace) for level in levels]
        self._results = [workspace.mirror((count, 5)) for _ in levels]
        self._pose = workspace.mirror((count, 9))

    @property
    def pose(self) -> Any:
        """Poses (N, 9) on the device."""
        return self._pose.device

    @property
    def gain(self) -> Any:
        """Gains (N, 2) on the device."""
        return self._results[-1].device[:, :2]

    def write(self, pose: NDArray[np.float64], image_idx: ArrayLike) -> None:
        """Say where to start (N, 3, 3) and on which images."""
        self._pose.write(pose.reshape(-1, 9))
        self._image_idx.write(image_idx)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for tables, result in zip(self._tables, self._results, strict=True):
            self._backend.align_poses(
                self._images, self._image_idx.device, *tables, self._max_iterations, self._pose.device,
                result.device,
            )  # fmt: skip

    def read(self) -> Alignment:
        """Wait for the device and give what came out."""
        last = self._results[-1].read().astype(np.float64)
        return Alignment(
            self._pose.read().astype(np.float64).reshape(-1, 3, 3),
            last[:, :2],
            last[:, 2],
            last[:, 3],
            sum(int(max(result.read()[:, 4].tolist())) for result in self._results),
        )


def align(
    images: Images,
    pose: NDArray[np.float64],
    space: CodeSpace,
    levels: tuple[Level, ...],
    cfg: AlignConfig,
    *,
    workspace: Workspace,
    image_idx: NDArray[np.int32] | None = None,
    max_iterations: int | None = None,
) -> Alignment:
    """Refine the poses of N hypotheses of one code space.

    Parameters
    ----------
    images : Images
        Of events, (B, Y, X).
    pose : (N, 3, 3) float64
        Code coordinates to cells, to start from.
    space : CodeSpace
        Of all of them.
    levels : tuple of Level
        Coarse to fine.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.
    image_idx : (N,) int32
        Image of each hypothesis; default the first.
    max_iterations : int
        At each level; default the configured; 0 scores the poses as they are.

    Returns
    -------
    alignment : Alignment
        Of all N.
    """
    most = cfg.max_iterations if max_iterations is None else max_iterations
    step = images.once(
        ("align", space, levels, len(pose), most, cfg),
        lambda: Align(images, len(pose), space, levels, most, cfg, workspace),
    )
    step.write(pose, 0 if image_idx is None else image_idx)
    step.run()
    found = step.read()
    if levels[-1].beyond_patterns:
        return found
    return judged(images, found, space, levels[-1], cfg, workspace=workspace, image_idx=image_idx)


def judged(
    images: Images,
    found: Alignment,
    space: CodeSpace,
    level: Level,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
    image_idx: NDArray[np.int32] | None = None,
) -> Alignment:
    """Give poses with scores that tell kinds and sizes of symbols apart.

    A single finder pattern is most of what is known of a symbol: another size, or another kind that has such
    a pattern too, agrees with it nearly as well.  Half of the score then is the correlation with the rest,
    timing and quiet zone, alone.
    """
    if not space.single_pattern:
        return found
    beyond = align(
        images, found.pose, space, (replace(level, beyond_patterns=True),), cfg, workspace=workspace,
        image_idx=image_idx, max_iterations=0,
    )  # fmt: skip
    return replace(found, score=0.5 * (found.score + beyond.score))


_Tables = tuple[Any, Any, Any, Any, Any, Any]


def _tables(space: CodeSpace, level: Level, cfg: AlignConfig, workspace: Workspace) -> _Tables:
    """Give what `align_poses` takes of a level: points, table, gram, terms, factors, settings."""
    table = pose_table(space, level.sigma, level.samples, level.beyond_patterns)
    tilt = level.tilt and not space.single_pattern
    terms, factors = _terms(tilt)
    settings = (*table.centre, *table.scale, cfg.ridge, cfg.damping, level.tolerance)
    return (
        workspace.table(("points", space, level), table.points),
        workspace.table(("table", space, level), table.table),
        workspace.table(("gram", space, level), table.gram.astype(np.float32)),
        workspace.table(("terms", tilt), terms),
        workspace.table(("factors", tilt), factors),
        workspace.put(np.array(settings, np.float32)),
    )


def shifted(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give a pose (3, 3) and its neighbours one module away, (9, 3, 3); the pose itself is the fifth."""
    steps = np.tile(np.eye(3), (9, 1, 1))
    steps[:, 0, 2] = np.tile((-1.0, 0.0, 1.0), 3)
    steps[:, 1, 2] = np.repeat((-1.0, 0.0, 1.0), 3)
    return compose(pose, steps)


def escape_side_minimum(
    images: Images, found: Alignment, space: CodeSpace, cfg: AlignConfig, *, workspace: Workspace
) -> Alignment | None:
    """Look at the poses one module away from one that was refined from the search.

    The cost has a side minimum one module off, where finder patterns half agree.  Unless the score is better
    than that allows, the neighbours are looked at, not refined: from a side minimum the true pose is exactly
    one module away.  None where no neighbour is better.
    """
    if found.score[0] >= cfg.good_score:
        return None
    levels = fine_levels(cfg)
    around = shifted(found.pose[0])
    scored = align(images, around, space, levels[-1:], cfg, workspace=workspace, max_iterations=0)
    best = scored.best
    if scored.score[best] <= found.score[0] + cfg.shift_gain:
        return None
    again = align(images, around[best : best + 1], space, levels, cfg, workspace=workspace)
    return replace(again, iterations=found.iterations + again.iterations)
