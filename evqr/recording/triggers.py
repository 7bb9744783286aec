"""Triggers that recordings and streams have beside their events: edges of a signal at the camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

TriggerKind = Literal["pulse", "start", "end"]
"""A part passes; its gate opens, as the signal rises; its gate closes, as it falls."""

AEDAT4_SOURCES: dict[int, TriggerKind] = {1: "start", 2: "end", 3: "pulse"}
"""Kinds by the number of AEDAT4's ``TriggerType``, of external signals; others are the camera's own."""

TIME_LOW, TIME_HIGH, TRIGGER = 0x6, 0x8, 0xA
PAYLOAD = 0xFFF
LOOP_US = 1 << 24
"""The times in words of EVT3 go round after so many microseconds."""


class Edge(NamedTuple):
    """A trigger.

    Attributes
    ----------
    t_us : int [us]
        By the clock of the events.
    kind : "pulse", "start" or "end"
        What it means.
    """

    t_us: int
    kind: TriggerKind


class Evt3Edges:
    """Finds the triggers among the words of EVT3, however they are cut.

    Words of type EXT_TRIGGER have the number of their line and its new level (openeb,
    ``evt3_event_types.h``). A line that rises opens a gate, and one that falls closes it.
    """

    def __init__(self) -> None:
        self._low = self._high = self._loops = 0

    def among(self, words: NDArray[np.uint16]) -> Iterator[Edge]:
        """Give the triggers among the next words, with the times of the words before them.

        Parameters
        ----------
        words : (W,) uint16
            Consecutive.

        Yields
        ------
        edge : Edge
            In order.
        """
        kind = words >> 12
        lows_at, highs_at, triggers_at = (np.flatnonzero(kind == of) for of in (TIME_LOW, TIME_HIGH, TRIGGER))
        low = np.concatenate([[self._low], words[lows_at] & PAYLOAD]).astype(np.int64)
        high = np.concatenate([[self._high], words[highs_at] & PAYLOAD]).astype(np.int64)
        loops = self._loops + np.concatenate([[0], np.cumsum(np.diff(high) < -(PAYLOAD >> 1))])
        for at in triggers_at.tolist():
            turn = np.searchsorted(highs_at, at)
            t_us = int(loops[turn] * LOOP_US + (high[turn] << 12) + low[np.searchsorted(lows_at, at)])
            yield Edge(t_us, "start" if words[at] & 1 else "end")
        self._low, self._high, self._loops = int(low[-1]), int(high[-1]), int(loops[-1])
