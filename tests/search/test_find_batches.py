"""Windows searched side by side: what is found in each does not depend on the others, to the bit."""

import functools

import numpy as np
import pytest
from scenes import motion_at, noise, scene, window_of

from evqr.config import ReadConfig
from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.window import Window, make_window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.search.busy import busy_region
from evqr.solver import Solver

SENSORS = (640, 480), (1280, 720), (320, 240)


def on_sensor(window: Window, sensor: tuple[int, int], corner: tuple[int, int], *, flip: bool) -> Window:
    """What a larger sensor sees, from some corner on; or with every event's polarity changed."""
    events, at = window.events, [np.uint16(each) for each in corner]
    signs = -events.p if flip else events.p
    moved = EventArray(events.t, events.x + at[0], events.y + at[1], signs, *sensor)
    return make_window(moved, window.start_us, window.end_us)


@functools.cache
def kinds() -> tuple[tuple[Window, ...], tuple[Motion, ...]]:
    """Windows whose busy regions differ in size, their motions: of codes in several sizes, and of none."""
    windows, motions = [], []
    for seed, version, module_px, side in ((0, 1, 8.0, 260), (1, 5, 4.0, 230)):
        made = scene(
            seed=seed, version=version, module_px=module_px, width=side + 40, height=side, travel_px=3.0,
            angle=20.0 + 25.0 * seed,
        )  # fmt: skip
        window = window_of(made)
        for k, sensor in enumerate(SENSORS):
            room = [least - size for least, size in zip(sensor, (window.width, window.height), strict=True)]
            if min(room) < 0:
                continue
            corner = room[0] // (k + 1), room[1] * k // 2
            windows.append(on_sensor(window, sensor, corner, flip=(seed + k) % 2 == 1))
            motions.append(motion_at(made.truth["truth"], window.middle_us))
    for count, (width, height) in (
        (9_000, SENSORS[1]),
        (4_000, SENSORS[0]),
        (3, SENSORS[0]),
        (0, SENSORS[1]),
    ):
        events = noise(count, 1_000, width=width, height=height)
        windows.append(make_window(events, 0, 1_000))
        motions.append(Motion([2000.0, 500.0], 500))
    return tuple(windows), tuple(motions)


@functools.cache
def alone(backend: str, which: int):
    """What is found in a window that is searched alone."""
    windows, motions = kinds()
    return Solver(backend=backend).find(EventBatch.of([windows[which]]), [motions[which]])[0]


def test_windows_are_of_many_sizes():
    sizes = {busy_region(window, ReadConfig().finder)[3:] for window in kinds()[0]}
    assert len(sizes) >= 5
    found = [alone("warp", k) for k in range(len(kinds()[0]))]
    assert sum(isinstance(each, NotFound) for each in found) == 4
    assert {each[0].space.version for each in found if not isinstance(each, NotFound)} == {1, 5}
    assert {bool(each[0].gain[0] > 0) for each in found if not isinstance(each, NotFound)} == {False, True}


@pytest.mark.parametrize(
    ("backend", "which"),
    [("warp", [4, 0]), ("warp", 16), ("warp", 128), ("numpy", [2, 3])],
    ids=["2", "16", "128", "2 on NumPy"],
)
def test_a_batch_finds_what_each_window_shows_alone(backend, which):
    windows, motions = kinds()
    if isinstance(which, int):
        which = (np.random.default_rng(which).permutation(which) % len(windows)).tolist()
    batch = EventBatch.of([windows[k] for k in which])
    together = Solver(backend=backend).find(batch, [motions[k] for k in which])
    for k, found in zip(which, together, strict=True):
        assert found == alone(backend, k)
