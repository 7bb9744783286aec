"""Where things are: codes on the object, the object in its plane, the plane in the image.

Three frames, all in px except the first:

    code    (u, v) modules from the outer corner of the top-left module
    object  (along, across) the direction of travel, from the object's centre
    plane   (X, Y) parallel to the image's axes where there is no tilt, from the centre of the view

The object moves in its plane on a straight line or on a circle, and turns with it as what lies on a turntable
does, so that each pixel's path over it is a straight line or a circle too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.errors import UsageError
from evqr.simulate.config import CodePlacement, SceneConfig
from evqr.simulate.printed import PrintedSymbol, make_symbol

#: Travel of a recording whose duration is left open [px].
DEFAULT_TRAVEL_PX = 40.0

Matrix = NDArray[np.float64]


def similarity(angle_deg: float, scale: float, shift: NDArray[np.float64]) -> Matrix:
    """(3, 3) rotation by an angle [deg] from +x to +y, scaled, then shifted."""
    c, s = scale * np.cos(np.deg2rad(angle_deg)), scale * np.sin(np.deg2rad(angle_deg))
    return np.array([[c, -s, shift[0]], [s, c, shift[1]], [0.0, 0.0, 1.0]])


def transform(homography: NDArray[np.floating[Any]], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map points (..., 2) by homographies (..., 3, 3), broadcast against each other."""
    homogeneous = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    mapped = (homography @ homogeneous[..., None])[..., 0]
    return mapped[..., :2] / mapped[..., 2:]


def plane_to_image(scene: SceneConfig) -> Matrix:
    """Homography of a pinhole camera that looks at a plane tilted about an axis through the view's centre."""
    axis = np.deg2rad(scene.tilt_axis)
    tilt = np.deg2rad(scene.tilt)
    k = np.array([np.cos(axis), np.sin(axis), 0.0])
    cross = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    rotation = np.eye(3) + np.sin(tilt) * cross + (1.0 - np.cos(tilt)) * cross @ cross
    view = np.column_stack([rotation[:, 0], rotation[:, 1], [0.0, 0.0, scene.focal_px]])
    f, cx, cy = scene.focal_px, (scene.width - 1) / 2, (scene.height - 1) / 2
    return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]]) @ view / f


def code_corners(symbol: PrintedSymbol, margin: float = 0.0) -> NDArray[np.float64]:
    """(4, 2) outer corners of a code in its own frame, ``margin`` modules outside of it [modules]."""
    low, right, bottom = -margin, symbol.space.columns + margin, symbol.space.rows + margin
    return np.array([[low, low], [right, low], [right, bottom], [low, bottom]])


def code_to_object(symbol: PrintedSymbol, direction: float) -> Matrix:
    """Homography from modules to the frame of an object that travels in ``direction`` [deg]."""
    p = symbol.placement
    turned = similarity(p.angle - direction, p.module_px, np.zeros(2))
    centre = np.array([symbol.space.columns, symbol.space.rows]) / 2
    turned[:2, 2] = np.asarray(p.offset_px) - turned[:2, :2] @ centre
    return turned


def in_a_row(placements: Sequence[CodePlacement], direction: float) -> list[CodePlacement]:
    """Put codes one behind the other along a travel in ``direction`` [deg], each with its quiet zone.

    The first is the first to pass; one alone is in the object's centre.
    """
    lengths = []
    for placement in placements:
        symbol = make_symbol(replace(placement, offset_px=(0.0, 0.0)))
        corners = transform(
            code_to_object(symbol, direction), code_corners(symbol, symbol.space.quiet_zone + 1)
        )
        lengths.append(float(np.ptp(corners[:, 0])))
    ends = sum(lengths) / 2 - np.cumsum([0.0, *lengths])
    middles = (ends[:-1] + ends[1:]) / 2
    return [
        replace(placement, offset_px=(float(along), 0.0))
        for placement, along in zip(placements, middles, strict=True)
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The object's path.

    Attributes
    ----------
    plane_to_image : (3, 3) float64
        Map of the object's plane to the image, both in px.
    direction : float [deg]
        Of travel in the plane, at t = 0.
    start : (2,) float64 [px]
        The object's centre at t = 0, in the plane.
    speed : float [px/us]
        Of travel in the plane.
    duration_us : int [us]
        Length of the recording.
    radius : float [px]
        Of the circle on which the object's centre travels, clockwise in the image; infinite: a straight line.
    """

    plane_to_image: Matrix
    direction: float
    start: NDArray[np.float64]
    speed: float
    duration_us: int
    radius: float = math.inf

    @property
    def turns(self) -> bool:
        """Whether the path is a circle."""
        return math.isfinite(self.radius)

    def object_to_image(self, t_us: ArrayLike) -> Matrix:
        """Homographies (..., 3, 3) from the object's frame to the image at times (...) [us]."""
        heading = np.deg2rad(self.direction)
        t = np.asarray(t_us, np.float64)
        pose = np.broadcast_to(similarity(self.direction, 1.0, self.start), (*t.shape, 3, 3)).copy()
        if self.turns:
            turned = heading + t * self.speed / self.radius
            cos, sin = np.cos(turned), np.sin(turned)
            pose[..., :2, :2] = np.stack([cos, -sin, sin, cos], axis=-1).reshape(*t.shape, 2, 2)
            pose[..., 0, 2] += self.radius * (sin - np.sin(heading))
            pose[..., 1, 2] -= self.radius * (cos - np.cos(heading))
            return self.plane_to_image @ pose
        pose[..., 0, 2] += t * self.speed * np.cos(heading)
        pose[..., 1, 2] += t * self.speed * np.sin(heading)
        return self.plane_to_image @ pose


def plan_motion(scene: SceneConfig, symbols: list[PrintedSymbol]) -> Motion:
    """Fill in the start and duration left open; raise UsageError for a code larger than the view."""
    view = plane_to_image(scene)
    image_to_plane = np.linalg.inv(view)
    edges = np.array([[x, y, 1.0] for x in (0, scene.width - 1) for y in (0, scene.height - 1)])
    # Proportional to the inverse of the depth at which a pixel's ray meets the plane.
    if (edges @ image_to_plane[2]).min() <= 0.05:
        raise UsageError(f"simulate: a tilt of {scene.tilt:g} degrees shows the horizon; take a smaller tilt")
    object_to_plane = similarity(scene.direction, 1.0, np.zeros(2))
    corners = [
        transform(object_to_plane @ code_to_object(s, scene.direction), code_corners(s)) for s in symbols
    ]
    sensor = np.array([scene.width, scene.height])
    for symbol, own in zip(symbols, corners, strict=True):
        extent = np.ptp(transform(view, own - own.mean(axis=0)), axis=0)
        if (extent > sensor).any():
            most = symbol.placement.module_px * (sensor / extent).min()
            raise UsageError(
                f"simulate: {symbol.space} at {symbol.placement.module_px:g} px a module takes "
                f"{extent[0]:.0f}x{extent[1]:.0f} px at this angle, more than the sensor's "
                f"{scene.width}x{scene.height}; take module_px below {most:.1f} or a lower version"
            )

    travel = DEFAULT_TRAVEL_PX
    heading = object_to_plane[:2, 0]
    if corners and scene.start is None and scene.duration_us is None:
        group = np.concatenate(corners)
        if (np.ptp(transform(view, group), axis=0) > sensor).any():
            travel = float(sensor @ np.abs(heading) + 2 * np.abs(group @ heading).max())
    speed = scene.speed_px_ms / 1000.0
    duration = scene.duration_us or max(1, round(travel / speed))
    radius, direction = scene.turn_radius_px or math.inf, scene.direction
    half_turn = 0.5 * speed * duration / radius
    if half_turn > math.pi:
        longest = int(2.0 * math.pi * radius / speed)
        raise UsageError(
            f"simulate: in {duration} us the object turns more than once; take a duration_us of at most "
            f"{longest}"
        )
    if scene.start is None and scene.turn_radius_px:
        # half of the turn puts it at the centre of the view, its travel and its codes as they were asked for
        direction -= math.degrees(half_turn)
        ahead = math.sin(half_turn) * heading
        aside = (1.0 - math.cos(half_turn)) * np.array([-heading[1], heading[0]])
        start = radius * (aside - ahead)
    elif scene.start is None:
        start = -0.5 * speed * duration * heading
    else:
        start = transform(image_to_plane, np.asarray(scene.start, np.float64))
    return Motion(
        plane_to_image=view,
        direction=direction,
        start=start,
        speed=speed,
        duration_us=duration,
        radius=radius,
    )
