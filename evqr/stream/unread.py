"""How many codes of a stream were followed and never read: codes, not guesses at one."""

from __future__ import annotations

import math
from collections import deque

from evqr.config import ReadConfig
from evqr.fit.detection import Target
from evqr.stream.records import CodeUnread


class UnreadCodes:
    """Codes that were followed in vain, each once.

    A guess is none: what hardly agrees with a code, and what is where a code was read, before or after.

    Parameters
    ----------
    cfg : ReadConfig
        ``align.good_score`` says what agrees well, ``scheduler.remembered_codes`` how many codes are kept in
        mind.
    """

    def __init__(self, cfg: ReadConfig) -> None:
        self._least = cfg.align.good_score
        self._read: deque[Target] = deque(maxlen=cfg.scheduler.remembered_codes)
        self._unread: deque[Target] = deque()
        self._most = cfg.scheduler.remembered_codes
        self._settled = 0

    def __len__(self) -> int:
        return self._settled + len(self._unread)

    def read(self, target: Target) -> None:
        """Take note of where a code was read: what was followed there before is that code."""
        self._read.append(target)
        self._unread = deque(one for one in self._unread if not at_one_place(one, target))

    def add(self, unread: CodeUnread) -> None:
        """Take what was followed in vain."""
        target = unread.target
        if not unread.agrees(self._least) or any(
            at_one_place(one, target) for one in (*self._read, *self._unread)
        ):
            return
        self._unread.append(target)
        if len(self._unread) > self._most:
            self._unread.popleft()
            self._settled += 1


def at_one_place(one: Target, other: Target) -> bool:
    """Whether two things were at one place, their motions held: codes cannot overlap."""
    early, late = sorted((one, other), key=lambda target: target.time_us)
    early = early.at(late.time_us)
    corners = late.outline()
    reach = math.hypot(*(corners[2] - corners[0]).tolist()) / 2.0
    return math.hypot(*(early.centre - late.centre).tolist()) < reach
