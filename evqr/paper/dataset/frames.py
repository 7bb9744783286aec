"""What a frame camera sees of a simulated scene: light added up over the exposure, noise, 8 bits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evqr.paper.dataset.scenes import CameraConfig
from evqr.simulate.config import SceneConfig
from evqr.simulate.geometry import Motion, plan_motion
from evqr.simulate.printed import make_symbol
from evqr.simulate.texture import TEXELS, Texture, draw_background, draw_object

STEP_PX = 1.0
"""Travel between two of the instants that an exposure is the mean of [px]."""


def render_frames(scene: SceneConfig, camera: CameraConfig) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Take the frames of a scene.

    Returns
    -------
    t_us : (N,) int64 [us]
        Middles of the exposures, of the frames that end before the scene does.
    frames : (N, Y, X) uint8
        Grey levels.
    """
    symbols = [make_symbol(placement) for placement in scene.codes]
    motion = plan_motion(scene, symbols)
    # the streams of evqr.simulate: the same texture and background, and noise apart from the events'
    scene_rng, _, camera_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(scene.seed).spawn(3))
    texture = draw_object(scene, symbols, scene_rng)
    background = draw_background(scene, scene_rng)
    period = 1e6 / camera.fps
    count = int((motion.duration_us - camera.exposure_us) // period) + 1
    middles = np.rint(np.arange(count) * period + 0.5 * camera.exposure_us).astype(np.int64)
    steps = max(1, math.ceil(camera.exposure_us * motion.speed / STEP_PX))
    offsets = ((np.arange(steps) + 0.5) / steps - 0.5) * camera.exposure_us
    frames = np.empty((count, scene.height, scene.width), np.uint8)
    for frame, middle in zip(frames, middles, strict=True):
        light = np.mean([_light(texture, background, motion, middle + d) for d in offsets], axis=0)
        noisy = camera.white * light + camera.read_noise * camera_rng.standard_normal(light.shape)
        frame[:] = np.clip(np.rint(noisy), 0, 255)
    return middles, frames


def _light(
    texture: Texture, background: NDArray[np.float32], motion: Motion, t_us: float
) -> NDArray[np.float32]:
    """Light (height, width) on the sensor at one instant."""
    to_texture = np.diag([*TEXELS, 1.0])
    to_texture[:2, 2] = texture.origin
    x_of, y_of, z_of = to_texture @ np.linalg.inv(motion.object_to_image(t_us))
    y, x = np.ogrid[: background.shape[0], : background.shape[1]]
    depth = z_of[0] * x + z_of[1] * y + z_of[2]
    along = (x_of[0] * x + x_of[1] * y + x_of[2]) / depth
    across = (y_of[0] * x + y_of[1] * y + y_of[2]) / depth
    height, width = texture.light.shape
    inside = (along >= 0) & (along < width - 1) & (across >= 0) & (across < height - 1)
    column, row = along[inside].astype(np.int32), across[inside].astype(np.int32)
    du, dv = along[inside] - column, across[inside] - row
    light = background.copy()
    flat, at = texture.light.ravel(), row * width + column
    upper = flat[at] + du * (flat[at + 1] - flat[at])
    lower = flat[at + width] + du * (flat[at + width + 1] - flat[at + width])
    cover = texture.cover_along[column] * texture.cover_across[row]
    light[inside] = upper + dv * (lower - upper) + (1.0 - cover) * background[inside]
    return light
