"""Whether two sightings are of one code: what a thing may have done in the time between them.

A thing that was at c0 with velocity v0, and is at c1 with velocity v1 a time T later, has either moved on or
stood still for a while.  If it moved on, its velocity changed by no more than it can, and it went about

    c1 - c0 = T (v0 + v1) / 2,

which is exact where the velocity changes evenly.  Both velocities count: by that of the earlier sighting
alone, a thing that comes back the other way may well be where the first would be by now.  If it stood still,
it came to rest soon after c0 and set off shortly before c1.  Either way it has the size that it had, and has
turned no more than it was turning.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evqr.config import SchedulerConfig
from evqr.fit.detection import Target
from evqr.geometry import at_centre

LEAST_MODULES = 1.5
"""How far off a code may be, however short the time: poses of single windows differ by so much [modules]."""

LEAST_TURN = math.radians(20.0)
"""How much it may have turned, however short the time [rad]."""

LEAST_GROWTH = 0.1
"""Natural logarithm of how much it may have grown or shrunk, however short the time."""

GENTLY = 4.0
"""How much farther than it must something may go that comes to rest, or sets off."""

SLOWEST = 1e-9
"""Stands in for none where one divides by it."""


def similarity_of(target: Target) -> tuple[float, float]:
    """Give the angle of a code in the image, and the natural logarithm of its module [px].

    Parameters
    ----------
    target : Target
        Of the code.

    Returns
    -------
    angle, log_module : float [rad], float
        At its centre.
    """
    _, (x_u, x_v, y_u, y_v) = at_centre(target.pose, target.space.shape)
    return math.atan2(y_u, x_u), 0.5 * math.log(abs(x_u * y_v - x_v * y_u))


def turn_between(earlier: Target, later: Target) -> float:
    """Give by how much a code has turned [rad].

    Parameters
    ----------
    earlier, later : Target
        Of the code.

    Returns
    -------
    turn : float [rad]
        From -pi to pi.
    """
    return math.remainder(similarity_of(later)[0] - similarity_of(earlier)[0], math.tau)


def may_stop(target: Target, cfg: SchedulerConfig) -> bool:
    """Tell whether a code is slow enough to come to rest where it is.

    Parameters
    ----------
    target : Target
        Of the code.
    cfg : SchedulerConfig
        What is possible.

    Returns
    -------
    may_stop : bool
        Whether it is.
    """
    module_px = math.exp(similarity_of(target)[1])
    speed = abs(_vector(target.motion.velocity_at(target.centre)))
    acceleration = cfg.acceleration * target.space.size * module_px
    return _braking_px(speed, acceleration) <= LEAST_MODULES * module_px


def distance_as_one(earlier: Target, later: Target, turning: float, cfg: SchedulerConfig) -> float:
    """Give how far two sightings are from being of one code that did nothing unusual.

    Parameters
    ----------
    earlier, later : Target
        Of codes that say the same.
    turning : float [rad/s]
        How fast the earlier one was seen to turn.
    cfg : SchedulerConfig
        What is possible.

    Returns
    -------
    distance : float
        Share of the place that may be off, 0 to 1; infinite where they cannot be one.
    """
    if later.time_us < earlier.time_us:  # a search looks at an older window than a code was followed to
        earlier, later = later, earlier
    seconds = (later.time_us - earlier.time_us) * 1e-6
    (angle, log_module), (later_angle, later_log_module) = similarity_of(earlier), similarity_of(later)
    turned = math.remainder(later_angle - angle - 0.5 * turning * seconds, math.tau)
    if (
        (earlier.space.symbology, earlier.space.version) != (later.space.symbology, later.space.version)
        or abs(turned) > LEAST_TURN + seconds * (math.radians(cfg.turn_rate) + abs(turning))
        or abs(later_log_module - log_module) > LEAST_GROWTH + seconds * cfg.growth_rate
    ):
        return math.inf
    module_px = math.exp(0.5 * (log_module + later_log_module))
    size_px = earlier.space.size * module_px
    way = _vector(later.centre) - _vector(earlier.centre)
    before, after = (_vector(one.motion.velocity_at(one.centre)) for one in (earlier, later))
    least_px, most_px = LEAST_MODULES * module_px, cfg.same_place * size_px
    acceleration = cfg.acceleration * size_px
    return min(
        _moved_on(way, before, after, seconds, acceleration, least_px, most_px, cfg),
        _stood_still(way, before, after, seconds, acceleration, least_px, most_px),
    )


def _vector(pair: NDArray[np.float64]) -> complex:
    """Give (x, y) as a complex number, so that a vector is one value in Python."""
    return complex(*pair.tolist())


def _moved_on(
    way: complex, before: complex, after: complex, seconds: float, acceleration: float, least_px: float,
    most_px: float, cfg: SchedulerConfig,
) -> float:  # fmt: skip
    """Give how far off a code is that moved all the time."""
    speed, later_speed = abs(before), abs(after)
    if abs(after - before) > cfg.same_velocity * max(speed, later_speed) + acceleration * seconds:
        return math.inf
    unsure = 0.5 * cfg.same_velocity * 0.5 * seconds * (speed + later_speed)
    return _share(abs(way - 0.5 * seconds * (before + after)), min(least_px + unsure, most_px))


def _stood_still(
    way: complex, before: complex, after: complex, seconds: float, acceleration: float, least_px: float,
    most_px: float,
) -> float:  # fmt: skip
    """Give how far off a code is that came to rest, and set off again."""
    speed, later_speed = abs(before), abs(after)
    braking_px, starting_px = _braking_px(speed, acceleration), _braking_px(later_speed, acceleration)
    if max(braking_px, starting_px) > least_px or speed + later_speed > acceleration * seconds:
        return math.inf
    farthest = GENTLY * (
        braking_px * before / max(speed, SLOWEST) + starting_px * after / max(later_speed, SLOWEST)
    )
    ahead = farthest / max(abs(farthest), SLOWEST)
    went = min(max((way * ahead.conjugate()).real, 0.0), abs(farthest), most_px)
    return _share(abs(way - went * ahead), least_px)


def _braking_px(speed: float, acceleration: float) -> float:
    """Give how far something goes that brakes, or sets off."""
    return speed * speed / (2.0 * acceleration)


def _share(off: float, most: float) -> float:
    return off / most if off <= most else math.inf
