"""The paper's own optimisation: first-order gradient descent on equation 1, on the solver's kernels.

    residual(x) = grad L(x) . m + g E(x),    cost = sum of residual^2 / (2 lambda),    L = f_W(q)

in two steps (section 3.5): first the motion m and the map W, with q fixed where the symbol's version fixes
it, then q.  E is the image of the events, transported by m and splatted as Gaussians (section 3.3), L is
bilinear (equation 5).  Rates and thresholds are those of section 4.2.  Where the paper leaves a choice open:

- *start*: principal components in space-time and 1:1:3:1:1 along rows or columns, as
  `evqr.paper.methods.start` reads the paper.  Where that finds no code, and the paper does not say what
  then, the start is the solver's:
  `estimate_motion`, and three finder patterns of its search, not refined, to the method's favour.
- *version*: told, as in the paper, whose r is given.
- *units*: m is the displacement over the window [px]; W maps image coordinates, centred on the code and
  divided by half its side, to modules.  The rates are stable only for a cost divided by its largest curvature
  in q, lambda, which is `CURVATURE` |m|^2 whatever the size of a module.
- *gain* g: the paper sets the threshold to 0.2, but the print's contrast is unknown as well, and only their
  ratio enters.  It is the least-squares one on the known modules, estimated anew in each iteration.
- *events while m changes*: they are splatted anew in each iteration, but held fixed in its derivative.  Their
  own derivative would make an iteration twice as expensive, and at a rate of 0.001 it moves nothing.
- *grad L*: central differences of the image: the exact slope of a bilinear image has no second derivative.
- *pixels* of the first step: those whose L, neighbours included, is made of known modules only.
- *outside*: the quiet zone is known too, and light: it anchors rows of modules along the motion.
- *unknown modules* start at 0, and known ones stay fixed in the second step.  From all light or all dark the
  steps are below the paper's threshold before any code reads.
- *iterations* to read are those of the second step; time to read is of both, and of the search.  They are
  fewer than the paper's.  From 0 the first iterate is along the derivative at 0, whatever the rate, and on
  good sensors its signs read at 30 and 45 degrees: our decoder uses all check codewords, and erasures.  The
  paper takes a code for readable with up to about five wrong codewords (section 4.1); the tables say how many
  iterations it takes until then, too, and on harder scenes, where they are about the paper's.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr.clock import StageClock
from evqr.events.batch import EventBatch
from evqr.events.window import Window
from evqr.fit.detection import NotFound
from evqr.fit.model import MOST_QUIET_MODULES as QUIET_MODULES
from evqr.fit.region import Region
from evqr.geometry import module_px, outline
from evqr.motion import Motion
from evqr.paper.methods.method import Outcome, Watch, unwatched
from evqr.paper.methods.start import find_pose, principal_motion
from evqr.search.finder import find_patterns
from evqr.search.score import score
from evqr.search.triples import codes_of_triples
from evqr.solver import Solver
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.workspace import Workspace
from evqr_kernels.config import SplatConfig

CURVATURE = 3.5
"""Largest curvature in q of half the squared residual, over |m|^2: measured 2.0 to 3.4 at all angles."""

BILINEAR = 0.0
"""Blur of a module's profile [modules]: none, equation 5."""

MARGIN_PX = 4.0
"""Image around the quiet zone [px]."""

Start = Literal["paper", "solver"]
"""Where a first motion and pose come from: `evqr.paper.methods.start`, or the solver's own search."""


@dataclass(frozen=True, kw_only=True)
class DescentConfig:
    """Settings of the descent; those of the paper's section 4.2 where it gives them.

    Attributes
    ----------
    epsilon_px : float [px]
        Standard deviation of an event's splat.
    pose_rate : float
        Update rate of m and W.
    code_rate : float
        Update rate of q.
    pose_tolerance : float
        Size of a step of W below which the first step has converged.
    code_tolerance : float
        Size of a step of q below which the second step has converged.
    max_iterations : int
        Of either step.
    shown_iterations : int
        Of the second step that a watch is shown at least, converged or not.
    starts : tuple of "paper" or "solver"
        Tried one after another until one finds a code.
    """

    epsilon_px: float = 0.8
    pose_rate: float = 0.001
    code_rate: float = 1.0
    pose_tolerance: float = 0.001
    code_tolerance: float = 5.0
    max_iterations: int = 300
    shown_iterations: int = 40
    starts: tuple[Start, ...] = ("paper", "solver")


@dataclass(frozen=True, eq=False)
class DescentReading:
    """What one window gave.

    Attributes
    ----------
    text : str, optional
        None when the modules do not decode.
    q : (r, r) float32
        Modules, < 0 dark, > 0 light.
    pose : (3, 3) float64
        Code coordinates to px.
    motion : Motion
        At the middle of the window.
    stage_one_iterations : int
        Of m and W.
    stage_two_iterations : int
        Of q.
    compute_ms : mapping of str to float [ms]
        By stage, and "total".
    """

    text: str | None
    q: NDArray[np.float32]
    pose: NDArray[np.float64]
    motion: Motion
    stage_one_iterations: int
    stage_two_iterations: int
    compute_ms: Mapping[str, float]


class Descent:
    """The paper's method (Nagata et al. 2020, section 3), from a window of events and the code's version."""

    takes: Literal["events"] = "events"
    windows = 1
    matched = False

    def __init__(self, version: int, cfg: DescentConfig | None = None) -> None:
        self.version = version
        self.cfg = cfg or DescentConfig()
        self._solver = Solver()

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Find the code, then take both steps; the second goes on while the watch wants to see more."""
        began = time.perf_counter()
        for name in self.cfg.starts:
            start = self.from_paper(seen) if name == "paper" else self.from_solver(seen)
            if start is not None:
                searched = time.perf_counter() - began
                return replace(self._descend(seen, *start, watch), start=name, search_seconds=searched)
        return Outcome(converged=False)

    def _descend(
        self,
        seen: Window,
        start: Motion,
        pose: NDArray[np.float64],
        watch: Watch,
    ) -> Outcome:
        cfg, workspace = self.cfg, self._solver.workspace
        problem = Problem(seen, start, pose, self.version, cfg.epsilon_px, workspace=workspace)
        motion, affine, pose_iterations = descend_pose(problem, cfg)
        q, iterations = descend_code(problem, motion, affine, cfg, watch)
        outcome = decode_grid(q, qr.space(self.version), effort="full")
        return Outcome(
            modules=q,
            pose=problem.pose_of(affine),
            text=outcome.text if isinstance(outcome, Decoded) else None,
            converged=iterations < cfg.max_iterations,
            pose_iterations=pose_iterations,
        )

    def from_paper(self, window: Window) -> tuple[Motion, NDArray[np.float64]] | None:
        """Give a first motion and pose (3, 3) as the paper does, None where it finds no code."""
        motion = principal_motion(window)
        if motion is None:
            return None
        pose = find_pose(
            window,
            motion,
            self.version,
            epsilon_px=self.cfg.epsilon_px,
            workspace=self._solver.workspace,
        )
        return None if pose is None else (Motion(motion / window.seconds, window.middle_us), pose)

    def from_solver(self, window: Window) -> tuple[Motion, NDArray[np.float64]] | None:
        """Give those that the solver's stage one starts from, None where three patterns are not found."""
        solver = self._solver
        moving = solver.motion_in(window)
        if isinstance(moving, NotFound):
            return None
        finder, workspace = solver.config.finder, solver.workspace
        (found,), pyramid = find_patterns(
            EventBatch.of([window]), [moving.motion], finder, workspace=workspace
        )
        made = codes_of_triples(found.peaks.table, found.triples, finder)
        made = made[np.array([made.space(k).version == self.version for k in range(len(made))], bool)]
        if not len(made):
            return None
        alone = np.zeros(len(made), np.intp)
        scores = score(pyramid, alone, made.size, made.pose, solver.config.align, workspace=workspace)
        pose = made.pose[int(scores.mean(axis=1).argmax())]
        return moving.motion, pose


def read_window(
    window: Window,
    start: Motion,
    pose: NDArray[np.float64],
    version: int,
    *,
    workspace: Workspace,
    cfg: DescentConfig | None = None,
) -> DescentReading:
    """Read a code from one window of events, from a first guess of its motion and pose.

    Parameters
    ----------
    window : Window
        Events of one window.
    start : Motion
        First guess of the motion.
    pose : (3, 3) float64
        Code coordinates to px at the middle of the window, affine.
    version : int
        Of the symbol.
    workspace : Workspace
        Whose buffers are used.
    cfg : DescentConfig, optional
        Settings.
    """
    cfg, clock = cfg or DescentConfig(), StageClock()
    with clock("stage_one"):
        problem = Problem(window, start, pose, version, cfg.epsilon_px, workspace=workspace)
        motion, affine, pose_iterations = descend_pose(problem, cfg)
    with clock("stage_two"):
        q, code_iterations = descend_code(problem, motion, affine, cfg)
    with clock("decode"):
        outcome = decode_grid(q, qr.space(version))
    return DescentReading(
        text=outcome.text if isinstance(outcome, Decoded) else None,
        q=q,
        pose=problem.pose_of(affine),
        motion=Motion(motion / window.seconds, window.middle_us),
        stage_one_iterations=pose_iterations,
        stage_two_iterations=code_iterations,
        compute_ms=clock.total(),
    )


def descend_pose(
    problem: Problem, cfg: DescentConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Take the first step: motion (2,) [px] and map (2, 3) from the known modules, and count iterations."""
    motion, affine, iterations = problem.motion, problem.affine, 0
    while iterations < cfg.max_iterations:
        iterations += 1
        problem.splat(motion)
        _, adj_motion, adj_affine = problem.pose_gradient(motion, affine)
        motion = motion - cfg.pose_rate * adj_motion
        affine = affine - cfg.pose_rate * adj_affine
        if cfg.pose_rate * np.linalg.norm(adj_affine) < cfg.pose_tolerance:
            break
    return motion, affine, iterations


def descend_code(
    problem: Problem,
    motion: NDArray[np.float64],
    affine: NDArray[np.float64],
    cfg: DescentConfig,
    watch: Watch = unwatched,
) -> tuple[NDArray[np.float32], int]:
    """Take the second step: modules (r, r) at convergence, and count iterations.

    Where the watch has not seen enough by then, it is shown up to ``cfg.shown_iterations`` of what would
    follow.
    """
    problem.splat(motion)
    problem.splat(motion, gain=problem.gain(motion, affine))
    grid, inner = problem.known_grid, slice(QUIET_MODULES, -QUIET_MODULES)
    final, iteration = None, 0
    while iteration < cfg.max_iterations:
        iteration += 1
        _, adj_grid = problem.code_gradient(grid, motion, affine)
        step = np.where(problem.free, cfg.code_rate * adj_grid, 0.0)
        grid = grid - step
        if final is None and np.linalg.norm(step) < cfg.code_tolerance:
            final = grid, iteration
        enough = watch(iteration, grid[inner, inner], final is not None)
        if final is not None and (enough or iteration >= cfg.shown_iterations):
            break
    grid, iterations = (grid, iteration) if final is None else final
    return grid[inner, inner].astype(np.float32), iterations


class Problem:
    """Equation 1 for one window: its events near a code, and the derivatives of the cost.

    Arrays that the kernels fill are made once and used in every iteration.

    Attributes
    ----------
    motion : (2,) float64 [px]
        First guess of m: displacement over the window.
    affine : (2, 3) float64
        First guess of W: (x, y, 1), centred on the code and divided by half its side, to modules from the
        code's centre.
    known_grid : (n, n)
        Modules with a quiet zone of `QUIET_MODULES` around them, 0 where unknown.
    free : (n, n) bool
        The unknown ones.
    """

    def __init__(
        self,
        window: Window,
        start: Motion,
        pose: NDArray[np.float64],
        version: int,
        epsilon_px: float,
        *,
        workspace: Workspace,
        dtype: DTypeLike = np.float32,
    ) -> None:
        self._workspace, self._dtype = workspace, np.dtype(dtype)
        self._splat_cfg = SplatConfig(epsilon_px=epsilon_px)
        size = qr.size_of(version)
        space = qr.space(version)
        self.known_grid = np.pad(space.values.astype(self._dtype), QUIET_MODULES, constant_values=1)
        self.free = np.pad(~space.known, QUIET_MODULES)

        corners = outline(pose, (size, size), QUIET_MODULES + 1.0)
        low, high = np.floor(corners.min(axis=0) - MARGIN_PX), np.ceil(corners.max(axis=0) + MARGIN_PX)
        width, height = (int(extent) + 1 for extent in high - low)
        region = Region(low[0] - 0.5, low[1] - 0.5, 1.0, height, width)
        self._low, self._shape = low, (1, height, width)
        half = size / 2.0
        self._unit = half * module_px(pose, (size, size))
        self._centre = (pose @ (half, half, 1.0))[:2] - low
        self._middle = half - 0.5 + QUIET_MODULES  # of the grid, integers at module centres

        self.motion: NDArray[np.float64] = start.displacement(1e6 * window.seconds)
        self.affine: NDArray[np.float64] = np.zeros((2, 3))
        self.affine[:, :2] = np.linalg.inv(pose)[:2, :2] * self._unit
        near = _events_near(window, start, region)
        put = self._put
        window_ptr = workspace.put(np.array([0, len(near)], np.int32))
        t = near.t / window.seconds
        self._events = (put(near.x - low[0]), put(near.y - low[1]), put(t), near.p, window_ptr)
        self._still, self._frame = put(np.zeros((1, 2))), put(np.array([[0.0, 0.0, 1.0]]))
        self._events_image = self._buffer("events")
        self._luminance, self._residual = self._buffer("luminance"), self._buffer("residual")
        self._nothing = self._buffer("nothing")
        workspace.get(self._nothing).fill(0.0)
        self._known_share = put(~self.free[None])
        self._known_luminance = put(self.known_grid[None])
        self._light, self._dark = put(np.ones(1)), put(np.zeros(1))

    def _put(self, array: NDArray[Any]) -> Any:
        return self._workspace.put(np.ascontiguousarray(array, self._dtype))

    def _buffer(self, name: str, shape: tuple[int, ...] | None = None) -> Any:
        return self._workspace.buffer(f"descent {name}", shape or self._shape, self._dtype)

    def _scratch(self, op: str, **sizes: int) -> list[Any]:
        sizes |= {"B": 1, "Y": self._shape[1]}
        key = ("descent", op, self._dtype, *sizes.items())
        workspace = self._workspace
        return workspace.once(key, lambda: workspace.scratch(op, self._dtype, **sizes))

    def pose_of(self, affine: NDArray[np.float64]) -> NDArray[np.float64]:
        """Code coordinates to px, (3, 3), of a map W."""
        from_px = np.eye(3)
        from_px[:2] = self._grid_from_image(affine).reshape(2, 3)
        from_px[:2, 2] += 0.5 - QUIET_MODULES - from_px[:2, :2] @ self._low
        return np.linalg.inv(from_px).astype(np.float64)

    def _grid_from_image(self, affine: NDArray[np.float64]) -> NDArray[np.float64]:
        """W as the kernels take it, (1, 6): image px to nodes of the grid."""
        linear = affine[:, :2] / self._unit
        shift = affine[:, 2] + self._middle - linear @ self._centre
        return np.column_stack([linear, shift]).reshape(1, 6)

    def splat(self, motion: NDArray[np.float64], *, gain: float = 1.0) -> None:
        """Make the events' image for a motion, which the methods below use."""
        x, y, t, p, window_ptr = self._events
        self._workspace.get(self._events_image).fill(0.0)
        self._workspace.backend.splat_events(
            x,
            y,
            t,
            self._put(gain * p),
            window_ptr,
            self._put(motion[None]),
            self._still,
            self._frame,
            self._events_image,
            self._splat_cfg,
        )

    def _render(self, grid: Any, affine: Any, outside: Any, image: Any) -> NDArray[Any]:
        self._workspace.backend.render_code(grid, affine, outside, BILINEAR, image)
        return self._workspace.get(image)[0]

    def known_pixels(self, affine: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Pixels (Y, X) whose luminance and its slope come from known modules and the quiet zone alone."""
        share = self._render(
            self._known_share, self._put(self._grid_from_image(affine)), self._dark, self._buffer("known")
        )
        known = share > 1.0 - 1e-3
        inner = known[1:-1, 1:-1]
        use = np.zeros_like(known)
        use[1:-1, 1:-1] = inner & known[:-2, 1:-1] & known[2:, 1:-1] & known[1:-1, :-2] & known[1:-1, 2:]
        return use

    def gain(self, motion: NDArray[np.float64], affine: NDArray[np.float64]) -> float:
        """Factor g of the events that makes them agree best with the known modules."""
        return self._gain(self._model(motion, affine), self.known_pixels(affine))

    def _model(self, motion: NDArray[np.float64], affine: NDArray[np.float64]) -> NDArray[Any]:
        """Grad L . m (Y, X) of the known modules; its luminance stays in its buffer."""
        self._render(
            self._known_luminance, self._put(self._grid_from_image(affine)), self._light, self._luminance
        )
        self._workspace.backend.brightness_residual(
            self._luminance, self._nothing, self._put(motion[None]), self._residual
        )
        return self._workspace.get(self._residual)[0]

    def _gain(self, model: NDArray[Any], use: NDArray[np.bool_]) -> float:
        events = self._workspace.get(self._events_image)[0]
        agreement = -float(model[use] @ events[use])
        energy = float(model[use] @ model[use])
        # at a pose that does not agree at all, any gain is wrong: one that keeps the two alike in size
        alike = np.sqrt(energy / max(float(events[use] @ events[use]), 1e-12))
        return float(min(energy / max(agreement, 1e-12), 2.0 * alike))

    def pose_gradient(
        self, motion: NDArray[np.float64], affine: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Cost on the known modules and its derivatives in m (2,) and W (2, 3), the events' image held."""
        use = self.known_pixels(affine)
        model = self._model(motion, affine)
        events = self._workspace.get(self._events_image)[0]
        residual = np.where(use, model + self._gain(model, use) * events, 0.0)
        adj_motion, adj_luminance = self._residual_adjoint(residual, motion)
        _, adj = self._render_adjoint(self._known_luminance, affine, adj_luminance)
        adj = adj.reshape(2, 3)
        adj_affine = np.column_stack([(adj[:, :2] - adj[:, 2:] * self._centre) / self._unit, adj[:, 2]])
        scale = 1.0 / (CURVATURE * float(motion @ motion))
        cost = 0.5 * scale * float(np.square(residual).sum())
        return cost, scale * adj_motion, scale * adj_affine

    def code_gradient(
        self, grid: NDArray[Any], motion: NDArray[np.float64], affine: NDArray[np.float64]
    ) -> tuple[float, NDArray[Any]]:
        """Cost over all pixels and its derivative in the grid (n, n), the events' image held."""
        modules, put, backend = self._put(grid[None]), self._put, self._workspace.backend
        self._render(modules, put(self._grid_from_image(affine)), self._light, self._luminance)
        backend.brightness_residual(self._luminance, self._events_image, put(motion[None]), self._residual)
        residual = self._workspace.get(self._residual)[0]
        _, adj_luminance = self._residual_adjoint(residual, motion)
        adj_grid, _ = self._render_adjoint(modules, affine, adj_luminance)
        scale = 1.0 / (CURVATURE * float(motion @ motion))
        return 0.5 * scale * float(np.square(residual).sum()), scale * adj_grid

    def _residual_adjoint(
        self, residual: NDArray[Any], motion: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Any]:
        adj_motion, adj_luminance = self._buffer("adj motion", (1, 2)), self._buffer("adj luminance")
        rows = self._scratch("brightness_residual_adjoint")
        self._workspace.backend.brightness_residual_adjoint(
            self._luminance,
            self._put(motion[None]),
            self._put(residual[None]),
            *rows,
            adj_luminance,
            adj_motion,
        )
        return self._workspace.get(adj_motion)[0].astype(np.float64), adj_luminance

    def _render_adjoint(
        self, grid: Any, affine: NDArray[np.float64], adj_luminance: Any
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        adj_grid = self._buffer("adj grid", (1, *self.free.shape))
        adj_affine = self._buffer("adj affine", (1, 6))
        rows = self._scratch("render_code_adjoint", P=6)
        self._workspace.backend.render_code_adjoint(
            grid,
            self._put(self._grid_from_image(affine)),
            self._light,
            BILINEAR,
            adj_luminance,
            *rows,
            adj_grid,
            adj_affine,
        )
        return self._workspace.get(adj_grid)[0], self._workspace.get(adj_affine)[0].astype(np.float64)


def _events_near(window: Window, motion: Motion, region: Region) -> Window:
    """Keep the events of a window that can reach a region: the others are dropped once for all."""
    reach = np.abs(motion.displacement(0.5e6 * window.seconds)) + 3.0 * region.cell
    return window.keep(
        (window.x > region.x - reach[0])
        & (window.x < region.x + region.width * region.cell + reach[0])
        & (window.y > region.y - reach[1])
        & (window.y < region.y + region.height * region.cell + reach[1])
    )
