"""Records of a stream, made by hand, for tests of what a line makes of them."""

import numpy as np
from sample_results import reading

from evqr.config import ReadConfig, TriggerConfig
from evqr.fit.detection import NotFound, Target
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.parts import FreeRunning, Triggered
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.stream.records import CodeAgain, CodeLeft, CodeRead, CodeUnread, Searched
from evqr.symbol import qr
from evqr.symbol.decoded import DecodeFailure

SIZE = (640, 480)
CFG = ReadConfig()
GOOD = CFG.align.good_score


def read(code, text, first_us, *, read_us=None, x=100.0, speed=2000.0):
    """A code of 84 px that goes right from x [px] at a speed [px/s]."""
    corners = np.array([[x, 100.0], [x + 84.0, 100.0], [x + 84.0, 184.0], [x, 184.0]])
    read_us = first_us + 500 if read_us is None else read_us
    return CodeRead(
        code,
        reading(
            text=text,
            data=text.encode(),
            t_first_us=first_us,
            t_last_us=read_us,
            t_read_us=read_us,
            corners_px=corners,
            motion_px_per_s=np.array([speed, 0.0]),
        ),
    )


def left(code, last_us):
    return CodeLeft(code, last_us)


def again(code, first_us):
    return CodeAgain(code, first_us)


def unread(first_us, last_us, *, score=0.9, x=100.0, speed=2000.0, windows=5, tau_us=(0.0, 0.0)):
    """Something as large, which is at x in its middle, and does not decode."""
    pose = np.array([[4.0, 0.0, x], [0.0, 4.0, 100.0], [0.0, 0.0, 1.0]])
    motion = Motion(np.array([speed, 0.0]), (first_us + last_us) / 2.0)
    space = qr.space(1)
    failure = DecodeFailure(reason=Reason.TOO_MANY_ERRORS, detail="", space=space)
    return CodeUnread(
        first_us, last_us, windows, score, failure, Target(space, pose, motion, tau_us),
        mean_score=score, clear_modules=0.62, events_an_edge=3.1,
    )  # fmt: skip


def searched(start_us, *, codes=0, reason=Reason.NOTHING_MOVES, closest=-1.0, speed=None, length_us=500):
    motion = None if speed is None else Motion(np.array([speed, 0.0]), start_us)
    end_us = start_us if speed is None else start_us + length_us
    return Searched(start_us, end_us, codes, None if codes else NotFound(reason, closest=closest), motion)


class Line:
    """Parts, and the times that they are decided at, as a reader runs them."""

    def __init__(self, triggers=None, cfg=CFG, **settings):
        if triggers is None and settings:
            triggers = TriggerConfig(**settings)
        self.parts = FreeRunning(cfg, SIZE) if triggers is None else Triggered(triggers, cfg, SIZE)
        self.told = []

    def trigger(self, t_us, kind="pulse", index=None, ticks=None, job=""):
        trigger = Trigger(t_us, TriggerKind(kind), index, ticks)
        self.parts.check(trigger)
        self.parts.trigger(trigger, job)

    def take(self, *records, job=""):
        for record in records:
            self.told += self.parts.take(record, job)

    def until(self, time_us, settled_us=None, following=()):
        """All is read that can be up to a time; the search is as far, or as far as is said."""
        while (check_us := self.parts.check_us) <= time_us:
            settled = check_us if settled_us is None else settled_us
            self.told += self.parts.decide(check_us, settled, following)

    def end(self, time_us, goes_on=False):
        self.told += self.parts.finish(time_us, goes_on=goes_on)

    @property
    def rows(self):
        """Trigger, texts, and the reason, of each part."""
        return [
            (
                None if part.gate is None else part.gate.index,
                [each.text for each in part.readings],
                part.verdict.reason if part.verdict else None,
            )
            for part in self.told
        ]
