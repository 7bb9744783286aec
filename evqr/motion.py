"""How things move in the image: the only place that knows.

A motion is a field of velocities that holds for a while: the same everywhere,

    v = m                          2 parameters: m_x, m_y
    v(p) = m + A (p - c)           6 parameters: m_x, m_y, A_xx, A_xy, A_yx, A_yy

in the order of `evqr_kernels.splat_events`, where c is the middle of the image.  What is seen at p, a time t
after the reference, was at ``p - t v(p)`` then: that is how events are transported, and poses are advanced by
its inverse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.geometry import compose, inverse
from evqr.values import Value, read_only

SHORTEST_WINDOW_US = 20.0
"""Windows are never shorter, however fast something moves: time stamps are microseconds [us]."""

SLOWEST_PX_PER_S = 1e-9
"""Speed that stands in for none where one divides by it [px/s]."""


@dataclass(frozen=True, eq=False)
class Motion(Value):
    """A motion in the image, and the time that it is of.

    Attributes
    ----------
    parameters : (2,) or (6,) float64 [px/s, 1/s]
        The velocity (m_x, m_y), the same everywhere; or m and A as in the formula above.
    time_us : float [us]
        Reference time.
    about : (float, float) [px]
        The point c at which the velocity is m; says nothing of a motion that is the same everywhere.

    Raises
    ------
    ValueError
        If there are neither 2 nor 6 parameters, or one is not finite.
    """

    parameters: NDArray[np.float64]
    time_us: float = 0.0
    about: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        parameters = read_only(self.parameters)
        if parameters.shape not in ((2,), (6,)):
            raise ValueError(f"parameters must have shape (2,) or (6,), got {parameters.shape}")
        if not all(map(math.isfinite, parameters.tolist())):
            raise ValueError(f"parameters must be finite, got {parameters.tolist()}")
        object.__setattr__(self, "parameters", parameters)
        # so that motions that are the same compare equal
        object.__setattr__(self, "time_us", float(self.time_us))
        if len(parameters) == 2 and self.about != (0.0, 0.0):
            object.__setattr__(self, "about", (0.0, 0.0))

    @property
    def uniform(self) -> bool:
        """Whether the velocity is the same everywhere."""
        return len(self.parameters) == 2

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity (2,), that at ``about`` where it is not the same everywhere [px/s]."""
        return self.parameters[:2]

    @cached_property
    def speed(self) -> float:
        """Length of the velocity [px/s]."""
        return math.hypot(*self.velocity.tolist())

    @cached_property
    def direction(self) -> NDArray[np.float64]:
        """The velocity (2,), divided by its length; 0 where nothing moves."""
        return self.velocity / max(self.speed, SLOWEST_PX_PER_S)

    def across_px(self, width: int, height: int) -> float:
        """Give how far it is across an image along the velocity.

        Parameters
        ----------
        width, height : int [px]
            Of the image.

        Returns
        -------
        way : float [px]
            From one border through the middle to the other.
        """
        along_x, along_y = np.abs(self.direction).tolist()
        return min(width / max(along_x, 1e-9), height / max(along_y, 1e-9))

    @property
    def slope(self) -> NDArray[np.float64]:
        """A (2, 2): how the velocity changes with the position [1/s]."""
        return np.zeros((2, 2)) if self.uniform else self.parameters[2:].reshape(2, 2)

    def velocity_at(self, point: ArrayLike) -> NDArray[np.float64]:
        """Give the velocity at a point, or at many.

        Parameters
        ----------
        point : (..., 2) array-like [px]
            Column and row.

        Returns
        -------
        velocity : (..., 2) float64 [px/s]
            There.
        """
        if self.uniform:
            shape = np.shape(point)
            return self.parameters if len(shape) == 1 else np.broadcast_to(self.parameters, shape)
        off = np.asarray(point) - self.about
        (a_xx, a_xy), (a_yx, a_yy) = self.slope.tolist()
        change = a_xx * off[..., 0] + a_xy * off[..., 1], a_yx * off[..., 0] + a_yy * off[..., 1]
        return self.velocity + np.stack(change, axis=-1)

    def transport(
        self, x: NDArray[Any], y: NDArray[Any], t: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Bring events to the reference time.

        Parameters
        ----------
        x, y : (E,) float [px]
            Where they are seen.
        t : (E,) float [s]
            When, after the reference time.

        Returns
        -------
        x, y : (E,) float [px]
            Where what caused them was at the reference time, in the dtype of the input.
        """
        m_x, m_y = (x.dtype.type(m) for m in self.velocity.tolist())
        if self.uniform:
            return x - t * m_x, y - t * m_y
        (a_xx, a_xy), (a_yx, a_yy) = self.slope.astype(x.dtype)
        c_x, c_y = (x.dtype.type(c) for c in self.about)
        dx, dy = x - c_x, y - c_y
        return x - t * (m_x + a_xx * dx + a_xy * dy), y - t * (m_y + a_yx * dx + a_yy * dy)

    def advance(self, pose: NDArray[np.float64], time_us: float) -> NDArray[np.float64]:
        """Give a pose of the reference time at another time.

        Parameters
        ----------
        pose : (3, 3) float64
            Code coordinates to px, at the reference time.
        time_us : float [us]
            The other time.

        Returns
        -------
        pose : (3, 3) float64
            Code coordinates to px, then.
        """
        seconds = (time_us - self.time_us) * 1e-6
        if self.uniform:  # in Python: once a followed window, and NumPy takes twice as long for so little
            x, y = self.parameters.tolist()
            x, y = x * seconds, y * seconds
            (a, b, p), (d, e, q), (g, h, r) = pose.tolist()
            moved = [a + x * g, b + x * h, p + x * r], [d + y * g, e + y * h, q + y * r], [g, h, r]
            return np.array(moved)
        # p = p0 + t (m + A (p - c)), solved for p
        behind = np.eye(3)
        behind[:2, :2] -= seconds * self.slope
        behind[:2, 2] = -seconds * self.velocity_at((0.0, 0.0))
        return compose(inverse(behind), pose)

    def at(self, time_us: float) -> Motion:
        """Give the same motion with another reference time: it is taken to hold until then.

        Parameters
        ----------
        time_us : float [us]
            The other time.

        Returns
        -------
        motion : Motion
            With the same parameters.
        """
        if time_us == self.time_us:
            return self
        return self.altered(time_us=float(time_us))  # speed and direction are of no time

    def turned(self, angle: float) -> Motion:
        """Give the motion with all velocities turned by an angle.

        Parameters
        ----------
        angle : float [rad]
            From x to y.

        Returns
        -------
        motion : Motion
            As fast, of the same time.
        """
        if angle == 0.0:
            return self
        cos, sin = math.cos(angle), math.sin(angle)
        m_x, m_y, *slope = self.parameters.tolist()
        turned = [cos * m_x - sin * m_y, sin * m_x + cos * m_y]
        if slope:
            a_xx, a_xy, a_yx, a_yy = slope
            turned += [cos * a_xx - sin * a_yx, cos * a_xy - sin * a_yy]
            turned += [sin * a_xx + cos * a_yx, sin * a_xy + cos * a_yy]
        return replace(self, parameters=np.array(turned))

    def lag_px(self, tau_us: tuple[float, float]) -> tuple[float, float]:
        """Give how far pixels lag along the motion.

        Parameters
        ----------
        tau_us : (float, float) [us]
            Their time constants for ON and OFF events.

        Returns
        -------
        lag_px : (float, float) [px]
            For ON and OFF events.
        """
        per_us = self.speed * 1e-6
        return tau_us[0] * per_us, tau_us[1] * per_us

    def tau_us(self, lag_px: tuple[float, float]) -> tuple[float, float]:
        """Give the time constants of pixels that lag so far along the motion.

        Parameters
        ----------
        lag_px : (float, float) [px]
            For ON and OFF events.

        Returns
        -------
        tau_us : (float, float) [us]
            For ON and OFF events.
        """
        per_us = max(self.speed, SLOWEST_PX_PER_S) * 1e-6
        return lag_px[0] / per_us, lag_px[1] / per_us

    def displacement(self, duration_us: float) -> NDArray[np.float64]:
        """Give the way that things go in a time.

        Parameters
        ----------
        duration_us : float [us]
            The time.

        Returns
        -------
        way : (2,) float64 [px]
            Column and row.
        """
        return self.velocity * (duration_us * 1e-6)

    def travel_px(self, duration_us: float) -> float:
        """Give how far things travel in a time.

        Parameters
        ----------
        duration_us : float [us]
            The time.

        Returns
        -------
        travel_px : float [px]
            Length of the way.
        """
        return self.speed * duration_us * 1e-6

    def travel_time_us(self, travel_px: float) -> float:
        """Give the time in which things travel so far.

        Parameters
        ----------
        travel_px : float [px]
            Length of the way.

        Returns
        -------
        time_us : float [us]
            Very long where nothing moves.
        """
        return travel_px / max(self.speed, SLOWEST_PX_PER_S) * 1e6

    def window_us(self, travel_px: float, *, longest_us: float) -> int:
        """Give the length of a window in which things travel so far.

        Parameters
        ----------
        travel_px : float [px]
            Length of the way.
        longest_us : float [us]
            The window is no longer than this, nor shorter than `SHORTEST_WINDOW_US`.

        Returns
        -------
        length_us : int [us]
            Whole microseconds.
        """
        return int(min(max(self.travel_time_us(travel_px), SHORTEST_WINDOW_US), longest_us))


class Motions(NamedTuple):
    """Motions side by side, each the same everywhere in its image.

    Attributes
    ----------
    velocity : (N, 2) float64 [px/s]
        Of each.
    speed : (N,) float64 [px/s]
        Their lengths.
    """

    velocity: NDArray[np.float64]
    speed: NDArray[np.float64]

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> Motions:
        """Put motions side by side.

        Parameters
        ----------
        motions : sequence of Motion
            At least one.

        Returns
        -------
        motions : Motions
            Of any times.

        Raises
        ------
        NotImplementedError
            If one is not the same everywhere.
        """
        parameters = [motion.parameters for motion in motions]
        if any(len(each) != 2 for each in parameters):
            raise NotImplementedError("events are deposited for motions of 2 parameters, got 6")
        velocity = np.concatenate(parameters).reshape(-1, 2)
        return cls(velocity, np.hypot(velocity[:, 0], velocity[:, 1]))

    @property
    def direction(self) -> NDArray[np.float64]:
        """The velocities (N, 2), divided by their lengths; 0 where nothing moves."""
        return self.velocity / np.maximum(self.speed, SLOWEST_PX_PER_S)[:, None]
