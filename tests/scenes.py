"""Simulated scenes for the tests of solver and reader, each made once a session, and what is true of them."""

import functools
from dataclasses import replace

import numpy as np

from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.window import Window, make_window
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.simulate import CodePlacement, Simulation, simulate
from evqr.simulate.geometry import transform

SMALL = {"width": 320, "height": 240, "threads": 1}

SPEED_PX_MS = 4.0


@functools.cache
def scene(
    text: str = "EVQR-07",
    *,
    travel_px: float = 12.0,
    speed_px_ms: float = SPEED_PX_MS,
    codes: tuple[CodePlacement, ...] | None = None,
    **options,
) -> Simulation:
    """A code (or none: ``code=False``) that crosses the middle of a small view."""
    duration_us = round(1000.0 * travel_px / speed_px_ms)
    given = {"version": 2, "module_px": 5.0, "angle": 20.0, "direction": 35.0, **SMALL, **options}
    return simulate(text, speed_px_ms=speed_px_ms, duration_us=duration_us, codes=codes, **given)


def at(truth, field: str, time_us: float) -> np.ndarray:
    """Pose "H" (3, 3) or "velocity" (2,) at a time: nearly linear between those that truth gives."""
    t, values = truth["t_us"], truth[field]
    k = int(np.clip(np.searchsorted(t, time_us) - 1, 0, len(t) - 2))
    share = (time_us - t[k]) / (t[k + 1] - t[k])
    return (1.0 - share) * values[k] + share * values[k + 1]


def motion_at(truth, time_us: float) -> Motion:
    """True motion at a time."""
    return Motion(at(truth, "velocity", time_us), time_us)


def corners(pose: np.ndarray, size: int) -> np.ndarray:
    """Corners (4, 2) of a code of ``size`` modules [px]."""
    return transform(pose, np.array([[0.0, 0.0], [size, 0.0], [size, size], [0.0, size]]))


def true_corners(truth, time_us: float) -> np.ndarray:
    """Corners (4, 2) of a truth's code at a time [px]."""
    return corners(at(truth, "H", time_us), len(truth["modules"]))


def middle_us(simulation: Simulation) -> int:
    """The middle of a recording [us]."""
    return int(simulation.truth["truth"]["t_us"][-1]) // 2


def window_of(simulation: Simulation, travel_px: float = 2.0, *, middle: int | None = None) -> Window:
    """A window as long as so much travel takes, around a time [us]; default the middle of the recording."""
    middle = middle_us(simulation) if middle is None else middle
    half = round(500.0 * travel_px / simulation.scene.speed_px_ms)
    return make_window(simulation.events, middle - half, middle + half)


def find_all(solver, window, motion, tau_us=None):
    """All codes of a window, best first, or why there is none."""
    (found,) = solver.find(EventBatch.of([window]), [motion], tau_us=[tau_us])
    return found


def find(solver, window, motion, tau_us=None):
    """The best code of a window, or why there is none."""
    found = find_all(solver, window, motion, tau_us)
    return found if isinstance(found, NotFound) else found[0]


def moved(
    pose: np.ndarray, size: int, *, shift=(0.0, 0.0), turn_deg: float = 0.0, scale: float = 1.0
) -> np.ndarray:
    """A pose, wrong by a shift [modules], a turn and a scale about the code's centre."""
    c, s = scale * np.cos(np.deg2rad(turn_deg)), scale * np.sin(np.deg2rad(turn_deg))
    half = size / 2.0
    about = np.array(
        [
            [c, -s, half - c * half + s * half + shift[0]],
            [s, c, half - s * half - c * half + shift[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    return pose @ about


def joined(*parts: EventArray, gap_us: int = 0) -> EventArray:
    """Recordings one after another, each in the time after the one before."""
    moved_on, start = [], 0
    for part in parts:
        moved_on.append(replace(part, t=part.t + start))
        start = int(moved_on[-1].t[-1]) + 1 + gap_us
    columns = (np.concatenate([getattr(part, name) for part in moved_on]) for name in ("t", "x", "y", "p"))
    return EventArray(*columns, parts[0].width, parts[0].height)


def keep(events: EventArray, mask: np.ndarray) -> EventArray:
    """Only the events where ``mask``."""
    return EventArray(
        events.t[mask], events.x[mask], events.y[mask], events.p[mask], events.width, events.height
    )


def noise(count: int, duration_us: int, *, seed: int = 0, width: int = 320, height: int = 240) -> EventArray:
    """Events at any time and place."""
    rng = np.random.default_rng(seed)
    return EventArray(
        np.sort(rng.integers(0, duration_us, count)),
        rng.integers(0, width, count).astype(np.uint16),
        rng.integers(0, height, count).astype(np.uint16),
        rng.choice(np.array([-1, 1], np.int8), count),
        width,
        height,
    )


def events_at(times):
    """Events at given times, all different in x, y and p."""
    t = np.array(times, np.int64)
    k = np.arange(len(t))
    return EventArray(
        t,
        (k % 64).astype(np.uint16),
        (k // 64 % 48).astype(np.uint16),
        (2 * (k % 2) - 1).astype(np.int8),
        64,
        48,
    )


SENSORS = (640, 480), (1280, 720), (320, 240)


def _on_sensor(window: Window, sensor: tuple[int, int], corner: tuple[int, int], *, flip: bool) -> Window:
    """What a larger sensor sees, from some corner on; or with every event's polarity changed."""
    events, at = window.events, [np.uint16(each) for each in corner]
    signs = -events.p if flip else events.p
    moved = EventArray(events.t, events.x + at[0], events.y + at[1], signs, *sensor)
    return make_window(moved, window.start_us, window.end_us)


@functools.cache
def windows_of_many_kinds() -> tuple[tuple[Window, ...], tuple[Motion, ...]]:
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
            windows.append(_on_sensor(window, sensor, corner, flip=(seed + k) % 2 == 1))
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
