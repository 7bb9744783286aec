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
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.config import AlignConfig
from evqr.fit.image import count_for
from evqr.fit.tables import Codes, Level, PoseTables
from evqr.geometry import compose
from evqr.symbol.space import CodeSpace
from evqr.workspace import Images, Staging, Step, Workspace


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
    iterations : (N,) int
        Gauss-Newton steps taken, over all levels.
    """

    pose: NDArray[np.float64]
    gain: NDArray[np.float64]
    score: NDArray[np.float64]
    noise: NDArray[np.float64]
    iterations: NDArray[np.int64]

    @property
    def best(self) -> int:
        """The hypothesis with the highest score."""
        scores = self.score.tolist()
        return scores.index(max(scores))

    def pick(self, which: ArrayLike) -> Alignment:
        """Give some hypotheses alone."""
        which = np.asarray(which)
        return Alignment(
            self.pose[which], self.gain[which], self.score[which], self.noise[which], self.iterations[which]
        )

    def putting(self, which: ArrayLike, others: Alignment) -> Alignment:
        """Give the same with some hypotheses replaced; their iterations add up."""
        which = np.asarray(which)
        made = Alignment(*(getattr(self, f.name).copy() for f in fields(Alignment)))
        for f in fields(Alignment):
            getattr(made, f.name)[which] = getattr(others, f.name)
        made.iterations[which] += self.iterations[which]
        return made


class Align(Step):
    """Refines the poses of N hypotheses, each of a code and on one of some images, over levels."""

    def __init__(
        self, images: Images, count: int, tables: Sequence[PoseTables], max_iterations: int,
        workspace: Workspace, staging: Staging | None = None,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        self._images, self._max_iterations, self.rows = images.device, max_iterations, count
        self._image_idx = self._staging.input((count,), np.int32)
        _, height, width = images.device.shape
        self._image_part = self._staging.input((count, 3), np.int32, value=(0, height, width))
        self._table_idx = self._staging.input((count,), np.int32)
        self._tables = [each.arguments for each in tables]
        self._results = [self._staging.output((count, 5)) for _ in tables]
        # rows without a hypothesis have a pose, too
        self._pose = self._staging.both((count, 9), value=np.eye(3).ravel())

    @property
    def image_part(self) -> Any:
        """Which part of its image each pose is relative to, on the device."""
        return self._image_part.device

    @property
    def image_idx(self) -> Any:
        """Images that they are on (N,) on the device."""
        return self._image_idx.device

    @property
    def pose(self) -> Any:
        """Poses (N, 9) on the device."""
        return self._pose.device

    @property
    def gain(self) -> Any:
        """Gains (N, 2) on the device."""
        return self._results[-1].device[:, :2]

    @property
    def score(self) -> Any:
        """Scores (N,) on the device, of all that is known."""
        return self._results[-1].device[:, 2]

    @property
    def noise(self) -> Any:
        """Variances (N,) of a sample on the device."""
        return self._results[-1].device[:, 3]

    @property
    def number(self) -> Any:
        """Numbers of their codes (N,) on the device."""
        return self._table_idx.device

    def write(
        self, pose: NDArray[np.float64], image_idx: NDArray[np.int32], numbers: Sequence[int],
        image_part: NDArray[np.int32] | None = None,
    ) -> None:  # fmt: skip
        """Say where to start (N, 3, 3), on which images or which parts of them, and for which codes."""
        self._count = len(numbers)
        self._pose.host[: self._count] = pose.reshape(-1, 9)
        self._image_idx.fill(image_idx)
        if image_part is not None:
            self._image_part.fill(image_part)
        self._table_idx.fill(numbers)

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for tables, result in zip(self._tables, self._results, strict=True):
            self._backend.align_poses(
                self._images, self._image_idx.device, self._image_part.device, self._table_idx.device,
                *tables, self._max_iterations, self._pose.device, result.device,
            )  # fmt: skip

    def read(self) -> Alignment:
        """Wait for the device and give what came out."""
        count = self._count
        results = [result.read()[:count] for result in self._results]
        last = results[-1].astype(np.float64)
        return Alignment(
            self._pose.read()[:count].astype(np.float64).reshape(-1, 3, 3),
            last[:, :2],
            last[:, 2],
            last[:, 3],
            functools.reduce(np.add, [result[:, 4].astype(np.int64) for result in results]),
        )


class Beyond(Step):
    """Scores poses of an alignment, as they are when it runs, by other tables.

    By what is known outside of finder patterns alone: see `judged`.
    """

    def __init__(
        self, images: Images, poses: Align, tables: PoseTables, workspace: Workspace, staging: Staging
    ) -> None:
        super().__init__(workspace, staging)
        self._images, self._poses, self._tables = images.device, poses, tables.arguments
        self._number = staging.input((poses.rows,), np.int32)
        self._result = staging.output((poses.rows, 5))

    def write(self, single: list[int], numbers: Sequence[int]) -> None:
        """Say which codes, and which of them are looked at: those with a single finder pattern."""
        self._single = single
        self._number.write(0)
        self._number.host[single] = [numbers[k] for k in single]

    def launch(self) -> None:
        """Launch the kernels one by one."""
        self._backend.align_poses(
            self._images, self._poses.image_idx, self._poses.image_part, self._number.device, *self._tables,
            0, self._poses.pose, self._result.device,
        )  # fmt: skip

    @property
    def score(self) -> NDArray[np.float64]:
        """Wait for the device and give the scores."""
        return self._result.read()[self._single, 2].astype(np.float64)

    def judged(self, found: Alignment) -> Alignment:
        """Wait for the device and give poses with both scores in one."""
        score, which = found.score.copy(), self._single
        score[which] = 0.5 * (score[which] + self.score)
        return replace(found, score=score)


class _ScoredAndRefined(Step):
    """Scores poses as they are, and refines them, at once: to ask one by one takes a device longer."""

    def __init__(
        self, images: Images, count: int, tables: PoseTables, beyond: PoseTables | None, most: int,
        workspace: Workspace,
    ) -> None:  # fmt: skip
        super().__init__(workspace)
        self._align = Align(images, count, [tables], most, workspace, self._staging)
        self._as_they_are, *self._beyond = (
            Beyond(images, self._align, each, workspace, self._staging)
            for each in (tables, beyond, beyond)
            if each is not None
        )

    def launch(self) -> None:
        """Launch the kernels one by one."""
        for step in (self._as_they_are, *self._beyond[:1], self._align, *self._beyond[1:]):
            step.launch()

    def __call__(
        self, pose: NDArray[np.float64], image_idx: NDArray[np.int32], numbers: list[int], single: list[int]
    ) -> tuple[NDArray[np.float64], Alignment]:
        """Give the scores of poses (N, 3, 3) as they are, and what they are refined to."""
        self._align.write(pose, image_idx, numbers)
        self._as_they_are.write(list(range(len(numbers))), numbers)
        for step in self._beyond:
            step.write(single, numbers)
        self.run()
        found = self._align.read()
        before = replace(found, score=self._as_they_are.score)
        if self._beyond:
            first, last = self._beyond
            return first.judged(before).score, last.judged(found)
        return before.score, found


def align(
    images: Images,
    pose: NDArray[np.float64],
    spaces: CodeSpace | Sequence[CodeSpace],
    levels: tuple[Level, ...],
    cfg: AlignConfig,
    *,
    workspace: Workspace,
    image_idx: NDArray[np.int32] | None = None,
    image_part: NDArray[np.int32] | None = None,
    max_iterations: int | None = None,
) -> Alignment:
    """Refine the poses of N hypotheses, all in one launch a level.

    Parameters
    ----------
    images : Images
        Of events, (B, Y, X).
    pose : (N, 3, 3) float64
        Code coordinates to cells, to start from.
    spaces : CodeSpace or sequence of CodeSpace
        Of all of them, or of each.
    levels : tuple of Level
        Coarse to fine.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.
    image_idx : (N,) int32
        Image of each hypothesis; default the first.
    image_part : (N, 3) int32
        First row, rows and columns of the part of it that its pose is in; default all of it.
    max_iterations : int
        At each level; default the configured; 0 scores the poses as they are.

    Returns
    -------
    alignment : Alignment
        Of all N.  What comes out of one does not depend on the others.
    """
    codes, most = Codes.of(workspace), cfg.max_iterations if max_iterations is None else max_iterations
    if isinstance(spaces, CodeSpace):
        spaces = [spaces] * len(pose)
    numbers = [codes.number(space) for space in spaces]
    tables = [codes.poses(level, cfg, numbers) for level in levels]
    count = count_for(len(pose))
    step = images.once(
        ("align", levels, count, most, image_part is None, tuple(each.version for each in tables)),
        lambda: Align(images, count, tables, most, workspace),
    )
    which = np.zeros(len(pose), np.int32) if image_idx is None else image_idx
    step.write(pose, which, numbers, image_part)
    step.run()
    found = step.read()
    if levels[-1].beyond_patterns:
        return found
    return judged(
        images, found, spaces, levels[-1], cfg, workspace=workspace, image_idx=which, image_part=image_part
    )


def judged(
    images: Images,
    found: Alignment,
    spaces: Sequence[CodeSpace],
    level: Level,
    cfg: AlignConfig,
    *,
    workspace: Workspace,
    image_idx: NDArray[np.int32],
    image_part: NDArray[np.int32] | None = None,
) -> Alignment:
    """Give poses with scores that tell kinds and sizes of symbols apart.

    A single finder pattern is most of what is known of a symbol: another size, or another kind that has such
    a pattern too, agrees with it nearly as well.  Half of the score then is the correlation with the rest,
    timing and quiet zone, alone.
    """
    single = [k for k, space in enumerate(spaces) if space.single_pattern]
    if not single:
        return found
    beyond = align(
        images, found.pose[single], [spaces[k] for k in single], (replace(level, beyond_patterns=True),), cfg,
        workspace=workspace, image_idx=image_idx[single],
        image_part=None if image_part is None else image_part[single], max_iterations=0,
    )  # fmt: skip
    score = found.score.copy()
    score[single] = 0.5 * (score[single] + beyond.score)
    return replace(found, score=score)


def shifted(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give poses (N, 3, 3) and their neighbours one module away, (N, 9, 3, 3); a pose itself is the fifth."""
    steps = np.tile(np.eye(3), (9, 1, 1))
    steps[:, 0, 2] = np.tile((-1.0, 0.0, 1.0), 3)
    steps[:, 1, 2] = np.repeat((-1.0, 0.0, 1.0), 3)
    return compose(pose[:, None], steps)


def escape_side_minimum(
    images: Images, found: Alignment, spaces: Sequence[CodeSpace], cfg: AlignConfig, *, workspace: Workspace
) -> tuple[Alignment, NDArray[np.bool_]]:
    """Look at the poses one module away from those that were refined from the search, one an image.

    The cost has a side minimum one module off, where finder patterns half agree.  Unless the score is better
    than that allows, the neighbours are looked at, not refined: from a side minimum the true pose is exactly
    one module away.

    Gives the poses, and which are others (N,): those that a neighbour is better than.
    """
    escaped = np.zeros(len(spaces), np.bool_)
    unsure = np.flatnonzero(found.score < cfg.good_score).astype(np.int32)
    if not len(unsure):
        return found, escaped
    levels = fine_levels(cfg)
    around = shifted(found.pose[unsure])
    around_each = [spaces[k] for k in unsure.tolist() for _ in range(9)]
    given = images, around.reshape(-1, 3, 3), around_each, unsure.repeat(9), cfg
    refined = None
    if workspace.shared:  # most are not looked at again
        scores = align(
            *given[:3], levels, cfg, workspace=workspace, image_idx=given[3], max_iterations=0
        ).score  # fmt: skip
    else:
        scores, refined = _scored_and_refined(*given, workspace=workspace)
    scores = scores.reshape(-1, 9)
    best = scores.argmax(axis=1)
    rows = np.arange(len(unsure))
    better = np.flatnonzero(scores[rows, best] > found.score[unsure] + cfg.shift_gain)
    if not len(better):
        return found, escaped
    which = unsure[better]
    if refined is not None:
        again = refined.pick(9 * better + best[better])
    else:
        again = align(
            images, around[better, best[better]], [spaces[k] for k in which.tolist()], levels, cfg,
            workspace=workspace, image_idx=which,
        )  # fmt: skip
    escaped[which] = True
    return found.putting(which, again), escaped


def _scored_and_refined(
    images: Images,
    pose: NDArray[np.float64],
    spaces: Sequence[CodeSpace],
    image_idx: NDArray[np.int32],
    cfg: AlignConfig,
    *,
    workspace: Workspace,
) -> tuple[NDArray[np.float64], Alignment]:
    """Give the scores of poses as they are, and what they are refined to at the finest level."""
    codes, (level,) = Codes.of(workspace), fine_levels(cfg)
    numbers, count = codes.numbers(spaces), count_for(len(pose))
    single = [k for k, space in enumerate(spaces) if space.single_pattern]
    tables, beyond = codes.poses(level, cfg, numbers), None
    if single:
        beyond = codes.poses(replace(level, beyond_patterns=True), cfg, [numbers[k] for k in single])
    step = images.once(
        ("scored and refined", count, cfg, tables.version, beyond and beyond.version),
        lambda: _ScoredAndRefined(images, count, tables, beyond, cfg.max_iterations, workspace),
    )
    return step(pose, image_idx, numbers, single)
