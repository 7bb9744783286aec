"""Whether two sightings are of one code, on simulated motions: neither one counted twice, nor two as one."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evqr.config import SchedulerConfig
from evqr.fit.detection import Target
from evqr.motion import Motion
from evqr.stream.identity import distance_as_one
from evqr.stream.known import KnownCodes
from evqr.symbol import qr
from evqr.symbol.payload import Payload

VERSION, MODULE_PX = 1, 4.0
SPACE = qr.space(VERSION)
SIDE = SPACE.size * MODULE_PX
WIDTH, HEIGHT = 640, 480
TEXT = Payload(text="the same", data=b"the same")


class Body:
    """A code that moves: its place [px] and angle [rad] as functions of time [s]."""

    def __init__(self, place, angle=lambda t: 0.0, module_px=lambda t: MODULE_PX):
        self.place, self.angle, self.module_px = place, angle, module_px

    def seen(self, t, rng=None, space=SPACE):
        """A sighting at a time, as wrong as poses and motions of single windows are."""
        x, y = self.place(t)
        angle, module_px = self.angle(t), self.module_px(t)
        velocity = (np.array(self.place(t + 1e-4)) - self.place(t - 1e-4)) / 2e-4
        if rng is not None:
            x, y = rng.normal((x, y), 0.2 * module_px)
            angle += rng.normal(0.0, math.radians(0.3))
            velocity = velocity * rng.normal(1.0, 0.05) + rng.normal(0.0, 0.02, 2) * np.hypot(*velocity)
        turn = module_px * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        pose = np.eye(3)
        pose[:2, :2] = turn
        pose[:2, 2] = (x, y) - turn @ np.full(2, space.size / 2.0)
        return Target(space, pose, Motion(velocity, 1e6 * t))


def straight(start, velocity, from_s=0.0):
    return lambda t: (start[0] + velocity[0] * (t - from_s), start[1] + velocity[1] * (t - from_s))


def along(way):
    """A body on a line, from its way along x [px]."""
    return Body(lambda t: (100.0 + way(t), 240.0))


def stopping(speed, braking_s, rest_s):
    """The way of a body that brakes evenly, rests and sets off again."""

    def way(t):
        if t < 0.0:
            return speed * t
        if t < braking_s:
            return speed * (t - 0.5 * t * t / braking_s)
        t -= braking_s + rest_s
        done = 0.5 * speed * braking_s
        if t < 0.0:
            return done
        if t < braking_s:
            return done + 0.5 * speed * t * t / braking_s
        return done + speed * (t - 0.5 * braking_s)

    return way


ONE = {
    "on a belt": (along(lambda t: 2_000.0 * t), 0.0, (0.005, 0.05, 0.15)),
    "fast": (along(lambda t: 8_000.0 * t), 0.0, (0.002, 0.02, 0.05)),
    "slow": (along(lambda t: 300.0 * t), 0.0, (0.03, 0.3, 1.0)),
    "speeding up": (along(lambda t: 1_000.0 * t + 0.5 * 4_000.0 * t * t), 0.0, (0.02, 0.1, 0.2)),
    "braking": (along(lambda t: 2_000.0 * t - 0.5 * 4_000.0 * t * t), 0.0, (0.02, 0.1, 0.25)),
    "in a hand": (along(lambda t: 60.0 * math.sin(5.0 * t)), 0.1, (0.02, 0.1, 0.2)),
    "turning back": (along(lambda t: 500.0 * t - 0.5 * 3_000.0 * t * t), 0.1, (0.03, 0.1, 0.15)),
    "turning": (
        Body(lambda t: (320 + 80 * math.cos(44 * t), 240 + 80 * math.sin(44 * t)), lambda t: 44 * t), 0.01,
        (0.003, 0.006),
    ),
    "turned in place": (Body(straight((200, 200), (300, 0)), lambda t: 3.0 * t), 0.0, (0.05, 0.2)),
    "coming near": (
        Body(straight((100, 200), (900, 0)), module_px=lambda t: 4.0 + 6.0 * t), 0.0, (0.05, 0.3),
    ),
    # lost while it brakes, found while it sets off
    "stopped": (along(stopping(300.0, 0.2, 1.0)), 0.1, (1.2,)),
    "stopped for long": (along(stopping(200.0, 0.1, 60.0)), 0.06, (60.1,)),
}  # fmt: skip


@pytest.mark.parametrize("name", ONE)
def test_one_code_is_not_counted_twice(name):
    body, lost_s, times = ONE[name]
    for lost_for_s in times:
        for seed in range(8):
            rng = np.random.default_rng(seed)
            known = KnownCodes(SchedulerConfig(), WIDTH, HEIGHT)
            for t in np.linspace(lost_s - 0.02, lost_s, 9):
                known.forget(1e6 * t)
                if t == lost_s - 0.02:
                    code, _ = known.merge_with_earlier(TEXT, body.seen(t, rng))
                else:
                    known.moved(code, body.seen(t, rng))
            known.forget(1e6 * (lost_s + lost_for_s))
            found = body.seen(lost_s + lost_for_s, rng)
            assert known.merge_with_earlier(TEXT, found) == (0, True), (lost_for_s, seed)


def belt(speed, spacing, start=100.0):
    """Two codes one behind the other on a belt, and when the second is where the first was lost."""
    first = Body(straight((start, 240.0), (speed, 0.0)))
    second = Body(straight((start - spacing, 240.0), (speed, 0.0)))
    return first, second


BACK = Body(straight((100.0, 240.0), (-5_500.0, 0.0)))

TWO = {
    # the second is found at any time that the first may be remembered
    "behind": (*belt(2_000.0, 1.3 * SIDE), np.arange(0.0, 0.3, 0.01)),
    "behind and slow": (*belt(250.0, 1.2 * SIDE), np.arange(0.0, 2.0, 0.05)),
    "beside": (
        Body(straight((100, 100), (2_000, 0))),
        Body(straight((100, 100 + 1.05 * SIDE), (2_000, 0))),
        np.arange(0, 0.3, 0.01),
    ),
    "across": (Body(straight((0, 240), (2_000, 0))), Body(straight((320, -80), (0, 2_000))), [0.16]),
    "back where the first would be": (
        Body(straight((100, 240), (2_200, 0))),
        Body(straight((100 + 2_200 * 0.057, 240), (-5_500, 0), from_s=0.057)),
        [0.057],
    ),
    "faster, where the first would be": (
        Body(straight((100, 240), (1_000, 0))),
        Body(straight((150, 240), (4_000, 0), from_s=0.05)),
        [0.05],
    ),
    "the same motion again": (
        Body(straight((319, 240), (310, 0))),
        Body(straight((309, 240), (310, 0), from_s=0.044)),
        [0.044, 0.06, 0.08],
    ),
    "turned": (
        Body(straight((100, 240), (1_000, 0))), Body(straight((100, 240), (1_000, 0)), lambda t: 0.7), [0.05]
    ),
    "of another size": (
        Body(straight((100, 240), (1_000, 0))),
        Body(straight((100, 240), (1_000, 0)), module_px=lambda t: 5.5), [0.05],
    ),
    "where one stopped, the other way": (
        along(stopping(300.0, 0.1, 1e3)), Body(straight((160, 240), (300, 0), from_s=0.5)), [0.5]
    ),
}  # fmt: skip


def test_one_code_that_turns_is_not_counted_twice_though_its_motion_is_taken_for_that_of_its_ground():
    """From cold the motion is that of most of what is seen: of a larger thing that turns with the code."""
    body, known = ONE["turning"][0], KnownCodes(SchedulerConfig(), WIDTH, HEIGHT)
    known.merge_with_earlier(TEXT, body.seen(0.0))
    known.moved(0, body.seen(0.001))
    found = body.seen(0.005)
    faster = replace(found, motion=Motion(1.4 * found.motion.velocity, found.time_us))
    assert known.merge_with_earlier(TEXT, faster) == (0, True)


@pytest.mark.parametrize("name", TWO)
def test_two_codes_are_not_counted_as_one(name):
    first, second, times = TWO[name]
    for t in times:
        for seed in range(8):
            rng = np.random.default_rng(seed)
            known = KnownCodes(SchedulerConfig(), WIDTH, HEIGHT)
            known.merge_with_earlier(TEXT, first.seen(-0.02, rng))
            known.moved(0, first.seen(0.0, rng))
            assert known.merge_with_earlier(TEXT, second.seen(t, rng)) == (1, False), (t, seed)


def test_of_several_it_is_the_nearest():
    known = KnownCodes(SchedulerConfig(), WIDTH, HEIGHT)
    first, second = belt(100.0, 1.05 * SIDE, start=300.0)
    assert known.merge_with_earlier(TEXT, second.seen(0.0)) == (0, False)
    assert known.merge_with_earlier(TEXT, first.seen(0.0)) == (1, False)
    assert known.merge_with_earlier(TEXT, first.seen(0.1)) == (1, True)
    assert known.merge_with_earlier(TEXT, second.seen(0.1)) == (0, True)


def test_the_order_of_two_sightings_does_not_matter():
    body, cfg = along(lambda t: 1_000.0 * t + 0.5 * 4_000.0 * t * t), SchedulerConfig()
    early, late = body.seen(0.0), body.seen(0.1)
    assert distance_as_one(early, late, 0.0, cfg) == distance_as_one(late, early, 0.0, cfg) < 1.0


def test_kinds_of_symbols_are_different_codes():
    body, cfg = along(lambda t: 1_000.0 * t), SchedulerConfig()
    now = body.seen(0.0)
    assert distance_as_one(now, replace(now, motion=now.motion), 0.0, cfg) == 0.0
    assert distance_as_one(now, body.seen(0.0, space=qr.space(2)), 0.0, cfg) == math.inf
