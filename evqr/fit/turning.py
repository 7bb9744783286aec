"""Codes that turn: a motion of 6 parameters, with the gain that it makes.

The usual model takes the motion in a window to be the same everywhere.  Where a code turns about a point near
by, speed and direction differ from one of its corners to the other, and so does the gain of its samples: in
code coordinates it is ``a(u, v) = s J^-1 v(p)``, J the slope of the pose and v the velocity, so that a motion
that is affine in the image is a gain that is affine in the code.  Its 6 numbers are found with the pose
(`evqr.fit.affine_gain`).  They say how the velocity changes over the code, but not how large it is, for the
contrast is not known; that is said by how far the halves of the window are apart once events were
transported.  With the motion events are transported again, and lags undone along the velocity that each place
has.

This is asked for where the usual model does not decode, which is rare, so it is done on the host.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig, ReadConfig
from evqr.events.window import Window
from evqr.fit.affine_gain import Fit, Samples, align_affine, places, samples_of, seen_through, times
from evqr.fit.align import coarse_levels, fine_levels
from evqr.fit.detection import Detection, Target
from evqr.fit.image import blur_taps
from evqr.fit.model import lattices
from evqr.fit.modules import NormalEquations, profile_products
from evqr.fit.region import Region, region_around
from evqr.fit.tables import Level
from evqr.fit.varying import right_hand_side, stencils
from evqr.geometry import compose, module_px
from evqr.motion import Motion
from evqr.symbol.space import closed

ROUNDS, ROUNDS_AGAIN = 3, 2
"""How often events are transported, each with the motion that the one before found; or where one is known."""

MARGIN_PX = 6.0
"""How far the pose of what was found may be off, for the size of the region around it [px]."""

FEWEST = 50
"""Events of half a window below which it says nothing of the speed."""

HALVES_STEPS = 3
"""Steps of Gauss-Newton in which the halves of a window are brought together."""

FIRST_LAG = 0.2, 0.5
"""Lags of ON and OFF events that are tried where none were found without turning [modules]."""

TAU_FACTORS = (1.0, 1.0), (0.6, 0.6), (1.6, 1.6), (1.6, 1.0), (1.0, 1.6)
"""Time constants of ON and OFF events that are tried, over those found without turning."""

TAU_STEPS = 2
"""Steps of Gauss-Newton that settle which of them is best."""

HOPELESS = 0.4
"""Correlation after a round below which there is no such code."""


def fit_turning(window: Window, target: Target, cfg: ReadConfig, *, lags: bool = True) -> Detection | None:
    """Fit a code that may turn to a window.

    Parameters
    ----------
    window : Window
        Of which it is to be found at the middle.
    target : Target
        Where it is about, to a module; a motion that is the same everywhere may be far off.
    cfg : ReadConfig
        Settings.
    lags : bool
        Whether the time constants of the pixels are to be found, too, around those of the target.

    Returns
    -------
    detection : Detection or None
        With a motion of 6 parameters, and equations whose stencils vary; None where there is no such code.
    """
    one, target = cfg.align, target.at(window.middle_us)
    space, motion, tau_us = target.space, target.motion, target.tau_us
    region = region_around(target.pose, space, one, margin_px=MARGIN_PX)
    levels = *coarse_levels(one), *fine_levels(one)
    samples = samples_of(space, levels[-1])
    seen = _Seen(window, motion, region, one)
    fit = _through(seen.image(tau_us), compose(region.from_px, target.pose), target, levels, one)
    steps = fit.steps
    for turn in range(1, ROUNDS if motion.uniform else ROUNDS_AGAIN):
        known = fit.score >= HOPELESS and _motion(window, motion, region, fit, tau_us, samples, one)
        if not known:
            return None
        motion = known
        seen = _Seen(window, motion, region, one)
        fit = _through(seen.image(tau_us), fit.pose, target, levels[-1:], one)
        if turn == 1 and lags:
            fit, tau_us = _with_lags(seen, fit, samples, levels[-1], _around(tau_us, motion, target), one)
        steps += fit.steps
    image = seen.image(tau_us)
    each, sigma = cfg.modules.samples, one.sigma
    across, down = lattices(space, each)
    lattice = seen_through(fit.pose, image, np.stack(np.meshgrid(across, down), axis=-1))
    equations = NormalEquations(
        space, stencils(fit.gain, profile_products(sigma, each), space),
        right_hand_side(lattice, fit.gain, space, sigma, each),
    )  # fmt: skip
    pose = compose(region.to_px, fit.pose)
    return Detection(
        target=target.altered(pose=closed(pose / pose[2, 2]), motion=motion, tau_us=tau_us),
        gain=closed(fit.gain[:, 0].copy()),
        score=fit.score,
        noise=fit.noise,
        equations=equations,
        iterations=steps,
    )


def _through(
    image: NDArray[np.float64],
    pose: NDArray[np.float64],
    target: Target,
    levels: Sequence[Level],
    cfg: AlignConfig,
) -> Fit:
    """Refine a pose through levels."""
    fit, steps = Fit(pose, np.zeros((2, 3)), 0.0, 0.0, 0), 0
    for level in levels:
        fit = align_affine(image, fit.pose, samples_of(target.space, level), level, cfg)
        steps += fit.steps
    return fit._replace(steps=steps)


class _Seen:
    """Events of a window on the cells of a region, brought to its middle by a motion of 6 parameters."""

    def __init__(
        self, window: Window, motion: Motion, region: Region, cfg: AlignConfig, part: slice = slice(None)
    ) -> None:
        x, y, t = (column[part].astype(np.float64) for column in (window.x, window.y, window.t))
        x, y = motion.transport(x, y, t)
        x, y = ((at + 0.5 - corner) / region.cell - 0.5 for at, corner in ((x, region.x), (y, region.y)))
        height, width = region.height, region.width
        inside = (x >= 0.0) & (y >= 0.0) & (x < width - 1) & (y < height - 1)
        x, y, sign = x[inside], y[inside], window.events.p[part][inside]
        column, row = x.astype(np.intp), y.astype(np.intp)
        fx, fy = x - column, y - row
        # cells of ON events, then those of OFF events
        at = row * width + column + np.where(sign > 0, 0, height * width)
        total = np.zeros(2 * height * width)
        for step, share in (
            (0, (1.0 - fx) * (1.0 - fy)), (1, fx * (1.0 - fy)), (width, (1.0 - fx) * fy), (width + 1, fx * fy)
        ):  # fmt: skip
            total += np.bincount(at + step, sign * share, len(total))

        columns = region.x + (np.arange(width) + 0.5) * region.cell - 0.5
        rows = region.y + (np.arange(height) + 0.5) * region.cell - 0.5
        # in cells a microsecond
        velocity = motion.velocity_at(np.stack(np.meshgrid(columns, rows), axis=-1)) * (1e-6 / region.cell)
        blur, slope = blur_taps(cfg.blur_cells).astype(np.float64)
        self._sharp, self._lags = np.zeros((height, width)), []
        for cells in total.reshape(2, height, width):
            across = _filtered(cells, blur, axis=1)
            self._sharp += _filtered(across, blur, axis=0)
            along = _filtered(_filtered(cells, slope, axis=1), blur, axis=0), _filtered(across, slope, axis=0)
            self._lags.append(velocity[..., 0] * along[0] + velocity[..., 1] * along[1])

    def image(self, tau_us: tuple[float, float]) -> NDArray[np.float64]:
        """Give the image with the lags undone, of ON and OFF events."""
        return self._sharp - tau_us[0] * self._lags[0] - tau_us[1] * self._lags[1]


def _filtered(image: NDArray[np.float64], taps: NDArray[np.float64], *, axis: int) -> NDArray[np.float64]:
    """Correlate with taps along one axis; beyond the image everything is 0."""
    reach, length = len(taps) // 2, image.shape[axis]
    around = np.pad(image, [(reach, reach) if a == axis else (0, 0) for a in range(2)])
    total = np.zeros_like(image)
    for k, tap in enumerate(taps.tolist()):
        total += tap * (around[k : k + length] if axis == 0 else around[:, k : k + length])
    return total


def _around(tau_us: tuple[float, float], motion: Motion, target: Target) -> list[tuple[float, float]]:
    """Give the time constants that are tried."""
    on, off = tau_us
    if on == 0.0 and off == 0.0:
        a_module = module_px(target.pose, target.space.shape)
        on, off = motion.tau_us((FIRST_LAG[0] * a_module, FIRST_LAG[1] * a_module))
    return [(f * on, g * off) for f, g in TAU_FACTORS]


def _with_lags(
    seen: _Seen,
    fit: Fit,
    samples: Samples,
    level: Level,
    tried: Sequence[tuple[float, float]],
    cfg: AlignConfig,
) -> tuple[Fit, tuple[float, float]]:
    """Give the time constants with which an image agrees best, and the fit with these."""
    best = [
        (align_affine(seen.image(tau_us), fit.pose, samples, level, cfg, TAU_STEPS), tau_us)
        for tau_us in tried
    ]
    return max(best, key=lambda one: one[0].score)


def _motion(
    window: Window,
    motion: Motion,
    region: Region,
    fit: Fit,
    tau_us: tuple[float, float],
    samples: Samples,
    cfg: AlignConfig,
) -> Motion | None:
    """Give the motion that a gain says, as large as the halves of the window say; None where they do not."""
    pose = compose(region.to_px, fit.pose)
    x, y = places(pose, samples.points)
    (cu, cv), step = samples.scale, 1e-3
    centre, right, below = places(pose, np.array([[cu, cv], [cu + step, cv], [cu, cv + step]])).T
    slope = np.stack([right - centre, below - centre], axis=1) / step
    (a, b), (c, d) = slope.tolist()
    # u' and v' of px
    back = np.array([[d / cu, -b / cu], [-c / cv, a / cv]]) / (a * d - b * c)
    velocity = times(slope, fit.gain)
    shape = Motion(
        np.concatenate([velocity[:, 0], times(velocity[:, 1:], back).ravel()]), window.middle_us,
        (float(centre[0]), float(centre[1])),
    )  # fmt: skip
    faster = _faster(window, motion, region, fit, tau_us, samples, cfg)
    if faster is None:
        return None
    at = np.stack([x, y], axis=-1)
    own, before = shape.velocity_at(at), motion.velocity_at(at)
    size = float((own * before).sum()) / max(float((own * own).sum()), 1e-20) + faster
    return Motion(size * shape.parameters, window.middle_us, shape.about) if size > 0.0 else None


def _faster(
    window: Window,
    motion: Motion,
    region: Region,
    fit: Fit,
    tau_us: tuple[float, float],
    samples: Samples,
    cfg: AlignConfig,
) -> float | None:
    """Give how much faster a code is than the motion that its events were transported with [gain/s].

    So much the second half of the window is ahead of the first, along the gain, which is along the velocity.
    """
    middle = window.events.first_at(window.middle_us)
    halves = slice(0, middle), slice(middle, len(window))
    if min(middle, len(window) - middle) < FEWEST:
        return None
    field, (g_u, g_v), model = times(fit.gain, samples.along), samples.bent(fit.gain), samples.model(fit.gain)
    steeper = -(g_u * field[0] + g_v * field[1])
    energy, ahead = max(float((model * model).sum()), 1e-20), []
    for part in halves:
        image, moved = _Seen(window, motion, region, cfg, part).image(tau_us), 0.0
        for _ in range(HALVES_STEPS):
            e = seen_through(fit.pose, image, samples.points + moved * field.T)
            share = float((e * model).sum()) / energy
            change = share * steeper
            moved -= float(((e - share * model) * change).sum()) / max(float((change * change).sum()), 1e-20)
        ahead.append(moved)
    first, second = (float(window.t[part].mean()) for part in halves)
    return (ahead[1] - ahead[0]) / max(second - first, 1e-6)
