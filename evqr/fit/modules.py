"""Stage two: the modules q, as a damped linear least-squares problem.

For a fixed pose and gain the paper's cost is quadratic in q: ``|e + A q|^2``.  Its normal matrix is a
stencil (a module meets only its neighbours, and all alike), so a window is summed up by (2 REACH + 1)^2
numbers and one right-hand side, both of which add over windows: many windows of one code cost one solve.

Damping is what is known of a module before: it is dark or light, so about 1 away from grey, against the noise
of the events.  A pull to grey alone is a bias, though: where a code moves along its rows only the ends of a
dark run cause events, and its inside is pulled back half of the way.  So the modules are solved for again,
each pulled to the dark or light that it leant to before, or less where that was little, until nearly all are
clear.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evqr.config import ModulesConfig
from evqr.fit.align import Align
from evqr.fit.image import count_for
from evqr.fit.model import profiles, quiet_modules
from evqr.fit.tables import REACH, Codes, ModuleTables
from evqr.fit.varying import solve_varying
from evqr.symbol.space import CodeSpace, closed
from evqr.values import Value
from evqr.workspace import Images, Staging, Step, Workspace

SUPPORT = 5
"""Modules that a module's blurred profile is sampled over."""


def weight_of(noise: float) -> float:
    """Give the weight of what was seen with a noise of that variance a sample."""
    return 1.0 / max(noise, 1e-12)


@dataclass(frozen=True, eq=False)
class NormalEquations(Value):
    """What a window, or a sum of windows, knows of q - 1, the modules' distance from light.

    In units of one window's events, or of their noise once they are `weighted`.

    Attributes
    ----------
    space : CodeSpace
        Whose modules they are.
    stencil : (2 REACH + 1, 2 REACH + 1) float
        A^T A, alike for all modules; or (2 REACH + 1, 2 REACH + 1, V + 2 quiet, U + 2 quiet), that of each
        module of a code that turns (`evqr.fit.varying`).
    rhs : (V + 2 quiet, U + 2 quiet) float
        A^T e; ``quiet`` are the modules of quiet zone on each side, `evqr.fit.model.quiet_modules`.
    """

    space: CodeSpace
    stencil: NDArray[np.floating]
    rhs: NDArray[np.floating]

    @classmethod
    def nothing(cls, space: CodeSpace) -> NormalEquations:
        """Give what no window knows.

        Parameters
        ----------
        space : CodeSpace
            Of the code.

        Returns
        -------
        equations : NormalEquations
            All of them 0.
        """
        return _nothing(space)

    @property
    def is_nothing(self) -> bool:
        """Whether nothing was seen: A^T A, and with it A^T e, is 0."""
        return self.stencil.item(self.stencil.size // 2) == 0.0

    @property
    def varies(self) -> bool:
        """Whether each module has a stencil of its own."""
        return self.stencil.ndim > 2

    @property
    def information(self) -> float:
        """What is known of a module whose neighbours are known: one over the variance of its estimate."""
        own = self.stencil[REACH, REACH]
        return float(own.mean()) if self.varies else float(own)

    def __post_init__(self) -> None:
        # not copied: they are nobody else's
        self.stencil.setflags(write=False)
        self.rhs.setflags(write=False)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        mine, others = self.stencil, other.stencil
        if self.varies != other.varies:
            mine, others = (each if each.ndim > 2 else each[..., None, None] for each in (mine, others))
        return NormalEquations(self.space, mine + others, self.rhs + other.rhs)

    def weighted(self, noise: float) -> NormalEquations:
        """Give the same equations with the weight that they deserve.

        Parameters
        ----------
        noise : float
            Variance of a sample; the weight is one over it.

        Returns
        -------
        equations : NormalEquations
            In units of their noise.
        """
        return self.scaled(weight_of(noise))

    def scaled(self, weight: float) -> NormalEquations:
        """Give the same equations with a weight.

        Parameters
        ----------
        weight : float
            Of all of them.

        Returns
        -------
        equations : NormalEquations
            As if there were so many alike.
        """
        return NormalEquations(self.space, weight * self.stencil, weight * self.rhs)


@functools.cache
def _nothing(space: CodeSpace) -> NormalEquations:
    around = 2 * quiet_modules(space)
    rhs = np.zeros((space.rows + around, space.columns + around), np.float32)
    return NormalEquations(space, np.zeros((2 * REACH + 1, 2 * REACH + 1), np.float32), rhs)


@dataclass(frozen=True, eq=False)
class CodeEstimate(Value):
    """Modules of one solve.

    Attributes
    ----------
    q : (V, U) float32
        < 0 dark, > 0 light; the known modules have their known value.
    iterations : int
        Of conjugate gradients, of all passes.
    equations : NormalEquations
        What they solve, in units of its noise.
    """

    q: NDArray[np.float32]
    iterations: int
    equations: NormalEquations = field(repr=False)

    @property
    def information(self) -> float:
        """What is known of a module whose neighbours are known: one over the variance of its estimate."""
        return self.equations.information


@dataclass(frozen=True, eq=False)
class Fused(Value):
    """What windows of a code say together.

    Attributes
    ----------
    equations : NormalEquations
        Their sum, in units of their noise.
    estimate : CodeEstimate
        The modules that solve it.
    """

    equations: NormalEquations = field(repr=False)
    estimate: CodeEstimate


@functools.lru_cache(maxsize=32)
def _profile_tables(sigma: float, samples: int) -> tuple[NDArray[np.float64], ...]:
    """Sample profile and slope, and give their correlations at whole-module offsets: b b, b' b', b b'."""
    offsets = (np.arange(SUPPORT * samples) + 0.5) / samples - SUPPORT // 2
    b, slope, _ = profiles(offsets, sigma)

    def correlate(f: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
        padded = np.pad(f, REACH * samples)
        starts = range(0, len(padded) - len(g) + 1, samples)
        return np.array([(padded[start : start + len(g)] * g).sum() for start in starts])

    return b, slope, correlate(b, b), correlate(slope, slope), correlate(b, slope)


def profile_products(sigma: float, samples: int) -> tuple[NDArray[np.float64], ...]:
    """Give what a normal matrix is made of, each (2 REACH + 1, 2 REACH + 1): of a_u^2, a_v^2 and a_u a_v."""
    *_, bb, ss, bs = _profile_tables(sigma, samples)
    mixed = np.outer(bs, bs[::-1])
    return np.outer(bb, ss), np.outer(ss, bb), mixed + mixed.T


class Equations(Step):
    """Right-hand sides of windows' normal equations, for the poses and gains that an alignment ends with."""

    def __init__(
        self, images: Images, poses: Align, tables: ModuleTables, room: tuple[int, int], sigma: float,
        cfg: ModulesConfig, workspace: Workspace, staging: Staging | None = None,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        count = images.device.shape[0]
        rows, columns = room
        self._image, self._poses, self._tables = images.device, poses, tables
        b, slope, *_ = _profile_tables(sigma, cfg.samples)
        self._products = profile_products(sigma, cfg.samples)
        self._products_there = workspace.put(np.array(self._products, np.float32))
        self._profile, self._slope = (workspace.put(f.astype(np.float32)) for f in (b, slope))
        self._samples = cfg.samples
        self._scratch = workspace.scratch(
            "code_rhs", B=count, S=columns * cfg.samples, T=rows * cfg.samples, P=len(b),
            samples_a_module=cfg.samples,
        )  # fmt: skip
        self._rhs = self._staging.output((count, rows, columns))

    def launch(self) -> None:
        """Launch the kernels one by one."""
        tables, poses = self._tables, self._poses
        self._backend.code_rhs(
            self._image, poses.pose, poses.number, tables["lattice_u"], tables["lattice_v"], tables["sides"],
            self._profile, self._slope, poses.gain, self._samples, *self._scratch, self._rhs.device,
        )  # fmt: skip

    def read(self, gain: NDArray[np.float64], spaces: Sequence[CodeSpace]) -> list[NormalEquations]:
        """Wait for the device and give the equations, whose matrices depend on the gains (N, 2) alone."""
        across, down, mixed = self._products
        a_u, a_v = gain[:, 0, None, None], gain[:, 1, None, None]
        stencil = a_u * a_u * across + a_v * a_v * down + a_u * a_v * mixed
        return _equations(spaces, closed(stencil), closed(_needed(self._rhs.read(), spaces).copy()))

    def windows(self) -> Windows:
        """Give what the windows say, on the device."""
        poses = self._poses
        return Windows(
            self._rhs.device, poses.gain, poses.noise, poses.score, poses.number, self._products_there
        )


def _equations(
    spaces: Sequence[CodeSpace], stencil: NDArray[Any], rhs: NDArray[Any]
) -> list[NormalEquations]:
    """Give each code's, from arrays in which there is room for any of them."""
    return [
        NormalEquations.trusted(space=space, stencil=own, rhs=seen)
        for space, own, seen in zip(spaces, stencil, _parts(rhs, spaces, around=True), strict=True)
    ]


def _needed(room: NDArray[Any], spaces: Sequence[CodeSpace]) -> NDArray[Any]:
    """Give what codes lie in of arrays in which there is room for more, and for larger ones."""
    rows, columns = map(max, zip(*map(_around, set(spaces)), strict=True))
    return room[: len(spaces), :rows, :columns]


@functools.cache
def _around(space: CodeSpace) -> tuple[int, int]:
    """Rows and columns of a code with its quiet zone."""
    return space.rows + 2 * quiet_modules(space), space.columns + 2 * quiet_modules(space)


def _parts(room: NDArray[Any], spaces: Sequence[CodeSpace], *, around: bool) -> list[NDArray[Any]]:
    """Give each code's part of arrays (N, V, U) in which any of them lies, with the quiet zone or without."""
    first = spaces[0]
    if all(space is first for space in spaces):  # most often, and then one slice does
        return [*room[(slice(None), *_part(first, around))]]
    return [room[(k, *_part(space, around))] for k, space in enumerate(spaces)]


def _part(space: CodeSpace, around: bool) -> tuple[slice, slice]:
    quiet = quiet_modules(space)
    begin, end = (0, 2 * quiet) if around else (quiet, quiet)
    return slice(begin, space.rows + end), slice(begin, space.columns + end)


class Windows(NamedTuple):
    """What windows of codes say, on the device.

    Attributes
    ----------
    rhs : (N, V, U) float32
        Right-hand sides of their equations.
    gain : (N, 2) float32
        On which their matrices depend.
    noise, score : (N,) float32
        Variance of a sample, and how well they agree.
    number : (N,) int32
        Numbers of their codes.
    products : (3, 2 REACH + 1, 2 REACH + 1) float32
        What their matrices are made of, as `sum_equations` takes it.
    """

    rhs: Any
    gain: Any
    noise: Any
    score: Any
    number: Any
    products: Any


class Solution(Step):
    """Modules of N codes from what earlier windows say of them, and what new ones add to that.

    Equations are summed, and solved in passes, of which each pulls modules to what the one before says.  A
    code of which nearly all modules are clear is left as it is by the passes that are left.
    """

    def __init__(
        self, count: int, tables: ModuleTables, room: tuple[int, int], cfg: ModulesConfig,
        workspace: Workspace, added: Equations | None = None, staging: Staging | None = None,
    ) -> None:  # fmt: skip
        super().__init__(workspace, staging)
        reach, staging = 2 * REACH + 1, self._staging
        self._cfg, self._tables = cfg, tables
        self._number = None if added else staging.input((count,), np.int32)
        self._windows = added.windows if added else _no_windows(count, room, workspace)
        self._least = staging.input((count,))
        self._before = staging.input((count, *room)), staging.input((count, reach, reach))
        self._filled: list[tuple[int, ...]] = [(0, 0)] * count  # rows and columns that were written
        self._scratch = workspace.scratch("solve_code", B=count, V=room[0], U=room[1], K=reach)
        self._sum = staging.output((count, *room)), staging.output((count, reach, reach))
        self._peak = staging.output((count,))
        self._pulled, self._damping = workspace.empty(count, *room), workspace.empty(count)
        self._solved = workspace.empty(count, dtype=np.int32)
        self._unclear = workspace.empty(count, room[0], dtype=np.int32)
        self._q = staging.output((count, *room))
        self._iterations = [staging.output((count,), np.int32) for _ in range(cfg.passes)]

    def write(
        self,
        before: Sequence[NormalEquations | None],
        numbers: Sequence[int],
        weights: Sequence[float] | None = None,
        least: Sequence[float] | None = None,
    ) -> None:
        """Say what was seen of which codes; how much that counts, and from which score on they are solved.

        Those of which nothing is said, not even that nothing was seen, are not solved for.
        """
        if self._number is not None:
            self._number.fill(numbers)
        rhs, stencil = (mirror.host for mirror in self._before)
        scores = [np.inf] * len(self._filled)
        seen: dict[tuple[int, ...], list[int]] = {}
        for k, each in enumerate(before):
            if each is not None:
                scores[k] = least[k] if least else 0.0
            size = (0, 0) if each is None or each.is_nothing else each.rhs.shape
            if size != self._filled[k]:
                rhs[k] = stencil[k] = 0.0
                self._filled[k] = size
            if each is not None and size[0]:
                seen.setdefault(size, []).append(k)
        for (rows, columns), places in seen.items():
            them = [each for each in map(before.__getitem__, places) if each is not None]
            which: Any = places
            if places[-1] - places[0] + 1 == len(places):  # most often: then nothing is looked up by index
                which = slice(places[0], places[-1] + 1)
            seen_rhs = np.concatenate([each.rhs for each in them]).reshape(-1, rows, columns)
            seen_stencil = np.concatenate([each.stencil for each in them]).reshape(-1, *stencil.shape[1:])
            if weights:
                weight = np.array([weights[k] for k in places])[:, None, None]
                seen_rhs, seen_stencil = weight * seen_rhs, weight * seen_stencil
            rhs[which, :rows, :columns], stencil[which] = seen_rhs, seen_stencil
        self._least.write(scores)

    def launch(self) -> None:
        """Launch the kernels one by one: modules are pulled to what they start from, free ones to grey."""
        cfg, tables, seen = self._cfg, self._tables, self._windows()
        number = seen.number if self._number is None else self._number.device
        rhs, stencil = (mirror.device for mirror in self._sum)
        self._backend.sum_equations(
            seen.rhs, seen.gain, seen.noise, seen.products, *(mirror.device for mirror in self._before),
            seen.score, self._least.device, number, tables["start"], cfg.damping, *cfg.damping_range, rhs,
            stencil, self._peak.device, self._damping, self._q.device, self._solved,
        )  # fmt: skip
        for iterations in self._iterations:
            self._backend.pull_modules(
                rhs, self._q.device, self._damping, cfg.certainty, self._pulled, self._unclear
            )
            self._backend.solve_code(
                self._pulled, stencil, self._damping, self._solved, tables["free"], tables["bounds"],
                self._unclear, tables["enough"], cfg.max_iterations, cfg.tolerance, *self._scratch,
                self._q.device, iterations.device,
            )  # fmt: skip

    def read(self, spaces: Sequence[CodeSpace]) -> list[CodeEstimate]:
        """Wait for the device and give the modules of each code."""
        q = closed(_needed(self._q.read(), spaces) + np.float32(1.0))
        iterations = functools.reduce(np.add, [mirror.read() for mirror in self._iterations]).tolist()
        count = len(spaces)
        peak = self._peak.read()[:count, None, None]
        sums, matrices = (mirror.read()[:count] for mirror in self._sum)
        rhs, stencil = closed(peak * _needed(sums, spaces)), closed(peak * matrices)
        return [
            CodeEstimate.trusted(q=inner, iterations=taken, equations=equations)
            for inner, taken, equations in zip(
                _parts(q, spaces, around=False), iterations, _equations(spaces, stencil, rhs), strict=False
            )
        ]

    def fused(self, spaces: Sequence[CodeSpace]) -> list[Fused]:
        """Wait for the device and give the sums, too."""
        return [Fused.trusted(equations=each.equations, estimate=each) for each in self.read(spaces)]


def _no_windows(count: int, room: tuple[int, int], workspace: Workspace) -> Callable[[], Windows]:
    """Make what adds nothing to sums, and agrees with anything."""
    nothing, one = np.zeros((count, *room), np.float32), np.ones(count, np.float32)
    products = np.zeros((3, 2 * REACH + 1, 2 * REACH + 1), np.float32)
    arrays = nothing, np.zeros((count, 2), np.float32), one, one, np.zeros(count, np.int32), products
    windows = Windows(*map(workspace.put, arrays))
    return lambda: windows


def solve_modules(
    equations: Sequence[NormalEquations],
    cfg: ModulesConfig,
    *,
    workspace: Workspace,
    weights: Sequence[float] | None = None,
) -> list[CodeEstimate]:
    """Solve for the unknown modules of codes, with function patterns and quiet zone fixed.

    Parameters
    ----------
    equations : sequence of NormalEquations
        Of any codes.
    cfg : ModulesConfig
        Settings.
    workspace : Workspace
        Buffers.
    weights : sequence of float
        Of each, one over the variance of its noise; default 1, as of equations that are weighted already.

    Returns
    -------
    estimates : list of CodeEstimate
        Of all modules of each.  None depends on the others.
    """
    weights = weights or [1.0] * len(equations)
    alike = [k for k, each in enumerate(equations) if not each.varies]
    on_device = iter(
        _solved_alike([equations[k] for k in alike], cfg, [weights[k] for k in alike], workspace)
    )
    return [
        _solved_varying(each.scaled(weight), cfg) if each.varies else next(on_device)
        for each, weight in zip(equations, weights, strict=True)
    ]


def _solved_varying(equations: NormalEquations, cfg: ModulesConfig) -> CodeEstimate:
    """Solve for the modules of a code that turns."""
    q, iterations = solve_varying(equations.rhs, equations.stencil, equations.space, cfg)
    return CodeEstimate(q, iterations, equations)


def _solved_alike(
    equations: Sequence[NormalEquations], cfg: ModulesConfig, weights: Sequence[float], workspace: Workspace
) -> list[CodeEstimate]:
    """Solve for the modules of codes that are alike all over, on the device."""
    if not equations:
        return []
    codes, spaces = Codes.of(workspace), [each.space for each in equations]
    numbers = codes.numbers(spaces)
    tables, room, count = codes.modules(cfg, numbers), codes.room(numbers), count_for(len(spaces))
    step = workspace.once(
        ("solution", cfg, count, room, tables.version),
        lambda: Solution(count, tables, room, cfg, workspace),
    )
    step.write(equations, numbers, weights)
    step.run()
    return step.read(spaces)
