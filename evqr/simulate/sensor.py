"""Light on the sensor to events: the pixels, their noise, and the readout."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.device import kernels_failing, kernels_on
from evqr.events.array import EventArray
from evqr.simulate.config import SceneConfig, SensorConfig
from evqr.simulate.geometry import Motion
from evqr.simulate.texture import Texture

#: Travel before the recording starts, in which the pixels forget their initial state [px].
RUN_IN_PX = 10.0
#: Rows that one launch works on.
BAND_ROWS = 60
#: Room for the events of a band; only what is used takes memory, and a band with more events runs again.
EVENTS_PER_PIXEL = 40
#: No pixel has a threshold below this [log units].
LEAST_THRESHOLD = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class RawEvents:
    """Events in any order.

    Attributes
    ----------
    t : (E,) float64 [us]
        0 at the start of the recording; negative in the run-in.
    address : (E,) int64
        2 (y width + x) + (1 if brighter).
    """

    t: NDArray[np.float64]
    address: NDArray[np.int64]


def draw_pixels(scene: SceneConfig, sensor: SensorConfig, rng: np.random.Generator) -> NDArray[np.float32]:
    """(height, width, 3) thresholds ON and OFF of each pixel, and its level at the start [log units]."""
    shape = (scene.height, scene.width)
    mean = np.array([sensor.threshold, sensor.threshold * sensor.off_to_on], np.float32)
    spread = np.float32(sensor.threshold_spread) * rng.standard_normal((*shape, 2), np.float32)
    thresholds = np.maximum(mean + spread, np.float32(LEAST_THRESHOLD))
    # A pixel that has been still lies anywhere between its thresholds, short of both.
    level = thresholds.sum(axis=-1) * (0.005 + 0.99 * rng.random(shape, np.float32)) - thresholds[..., 1]
    return np.concatenate([thresholds, level[..., None]], axis=-1).astype(np.float32)


def needs_compile() -> bool:
    """Whether `run_pixels` has to compile its kernel first, which takes seconds."""
    kernels_on("warp", "cpu")
    import warp as wp

    from evqr.simulate import pixel_kernel
    from evqr_kernels.warp_backend.cache import is_compiled

    return not is_compiled(wp.get_module(pixel_kernel.__name__), "cpu")


def run_pixels(
    scene: SceneConfig,
    sensor: SensorConfig,
    motion: Motion,
    texture: Texture,
    background: NDArray[np.float32],
    pixel: NDArray[np.float32],
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RawEvents:
    """Events of the pixels of `draw_pixels`, without noise, from the run-in to the end."""
    kernels_on("warp", "cpu")  # it starts Warp, in silence
    import warp as wp

    from evqr.simulate import pixel_kernel
    from evqr_kernels.warp_backend.cache import load_module

    with kernels_failing():
        load_module(wp.get_module(pixel_kernel.__name__), "cpu")
    start_us = -RUN_IN_PX / motion.speed
    begin = texture.seen_by(motion, start_us, (scene.height, scene.width))
    bandwidth = 1.0 / sensor.tau_us if sensor.tau_us > 0.0 else 0.0
    response = (0.0, bandwidth) if sensor.tau_follows_light else (bandwidth, 0.0)
    still = [
        wp.array(texture.light, dtype=wp.float32, device="cpu", copy=False),
        wp.array(texture.cover_along, dtype=wp.float32, device="cpu", copy=False),
        wp.array(texture.cover_across, dtype=wp.float32, device="cpu", copy=False),
        wp.array(background, dtype=wp.float32, device="cpu", copy=False),
        wp.array(pixel, dtype=wp.vec3f, device="cpu", copy=False),
        wp.array(begin, dtype=wp.vec2d, device="cpu", copy=False),
        wp.vec3d(start_us, float(motion.duration_us), 1.0 / texture.columns_a_us(motion)),
        wp.vec4f(*response, sensor.refractory_us, sensor.leak_hz * 1e-6),
    ]

    def run_band(first_row: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        rows = min(BAND_ROWS, scene.height - first_row)
        capacity = EVENTS_PER_PIXEL * rows * scene.width
        while True:
            count = np.zeros(1, np.int32)
            t = np.empty(capacity, np.float64)
            address = np.empty(capacity, np.int32)
            outputs = [wp.array(a, device="cpu", copy=False) for a in (count, t, address)]
            wp.launch(
                pixel_kernel.walk_pixels,
                dim=(rows, scene.width),
                inputs=[*still, first_row, *outputs],
                device="cpu",
            )
            if count[0] <= capacity:
                return t[: count[0]], address[: count[0]]
            capacity = int(count[0])

    with ThreadPoolExecutor(threads or min(os.cpu_count() or 1, 8)) as pool:
        first_rows = range(0, scene.height, BAND_ROWS)
        bands = []
        for band in pool.map(run_band, first_rows):
            bands.append(band)
            if progress is not None:
                progress(len(bands), len(first_rows))
    return RawEvents(
        t=np.concatenate([t for t, _ in bands]),
        address=np.concatenate([a for _, a in bands]).astype(np.int64),
    )


def add_noise(
    events: RawEvents, scene: SceneConfig, sensor: SensorConfig, motion: Motion, rng: np.random.Generator
) -> RawEvents:
    """Add background activity and hot pixels, lose some events, and shake the time stamps."""
    start_us = -RUN_IN_PX / motion.speed
    length_us = motion.duration_us - start_us
    pixels = scene.width * scene.height

    n_background = rng.poisson(sensor.background_hz * 1e-6 * length_us * pixels)
    hot_pixel = rng.choice(pixels, round(sensor.hot_fraction * pixels), replace=False)
    hot_address = 2 * hot_pixel + rng.integers(0, 2, len(hot_pixel))
    n_hot = rng.poisson(sensor.hot_hz * 1e-6 * length_us, len(hot_pixel))
    address = np.concatenate(
        [events.address, rng.integers(0, 2 * pixels, n_background), np.repeat(hot_address, n_hot)]
    )
    t = np.concatenate([events.t, rng.uniform(start_us, motion.duration_us, n_background + n_hot.sum())])

    if sensor.drop_rate > 0.0:
        kept = rng.random(len(t), np.float32) >= sensor.drop_rate
        t, address = t[kept], address[kept]
    if sensor.jitter_us > 0.0:
        t = t + sensor.jitter_us * rng.standard_normal(len(t), np.float32)
    return RawEvents(t=t, address=address)


def read_out(
    events: RawEvents, scene: SceneConfig, sensor: SensorConfig, motion: Motion, rng: np.random.Generator
) -> EventArray:
    """Sort the events, send them through the readout, and stamp whole microseconds."""
    t, address = events.t, events.address
    if sensor.row_scan_us > 0.0:
        turn = (address // (2 * scene.width)) * (sensor.row_scan_us / scene.height)
        t = np.ceil((t - turn) / sensor.row_scan_us) * sensor.row_scan_us + turn

    # One integer an event, time before address: a plain sort of these is fast, and leaves no order to chance.
    bits = (2 * scene.width * scene.height - 1).bit_length()
    before = int(np.ceil(-t.min(initial=0.0))) + 1
    key = np.sort(((np.rint(t).astype(np.int64) + before) << bits) | address)
    stamp, address = (key >> bits) - before, key & ((1 << bits) - 1)

    if sensor.readout_meps > 0.0:
        stamp, address = _queue(stamp, address, sensor, rng)
    first, last = np.searchsorted(stamp, [0, motion.duration_us])
    stamp, address = stamp[first:last], address[first:last]
    where = address >> 1
    return EventArray(
        t=stamp,
        x=(where % scene.width).astype(np.uint16),
        y=(where // scene.width).astype(np.uint16),
        p=(2 * (address & 1) - 1).astype(np.int8),
        width=scene.width,
        height=scene.height,
    )


def _queue(
    stamp: NDArray[np.int64], address: NDArray[np.int64], sensor: SensorConfig, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Let events leave one by one at the readout's rate; those that would wait too long are lost."""
    # In each stretch of the queue's length the readout carries so many events; which of the others are lost
    # is random, for a pixel that waits misses its own next event, wherever it lies.
    stretch = np.floor_divide(stamp, sensor.readout_queue_us).astype(np.int64)
    _, first, count = np.unique(stretch, return_index=True, return_counts=True)
    capacity = max(1, int(sensor.readout_meps * sensor.readout_queue_us))
    kept = np.ones(len(stamp), bool)
    for begin, events in zip(first[count > capacity], count[count > capacity], strict=True):
        kept[begin + rng.choice(events, events - capacity, replace=False)] = False
    stamp, address = stamp[kept], address[kept]
    # departure_i = max(stamp_i, departure_{i-1} + 1 / rate), unrolled into a running maximum.
    sent = np.arange(len(stamp)) / sensor.readout_meps
    leaves = np.maximum.accumulate(stamp - sent) + sent
    return np.ceil(leaves - 1e-6).astype(np.int64), address
