"""Events in order of time out of events nearly in order of time, streaming.

Recordings are often disordered locally: readout rows, packets of several threads, simulated frames.  Every
chunk is held back until no later event may precede it any more, so the memory is what the sensor fires within
`MAX_DISORDER_US`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from evqr.events.array import EventArray

from ..errors import RecordingError

MAX_DISORDER_US = 50_000
"""How far the clock may jump back; a recording that jumps further is refused."""


@dataclass
class Disorder:
    """How much sorting was needed so far."""

    late_events: int = 0
    worst_us: int = 0


def in_order(
    chunks: Iterable[EventArray], chunk_events: int, disorder: Disorder, name: str
) -> Iterator[EventArray]:
    """Yield the same events, ascending in time within and across chunks; equal times keep their order.

    Parameters
    ----------
    chunks        nearly sorted events, not empty
    chunk_events  sorted stretches are cut to this length again
    disorder      counts are added to it on the way
    name          the recording, for the message

    Raises
    ------
    RecordingError   when the clock jumps back by more than `MAX_DISORDER_US`
    """
    held: deque[EventArray] = deque()
    newest = np.iinfo(np.int64).min
    seen = 0
    for chunk in chunks:
        if chunk.t[0] >= newest and np.all(chunk.t[1:] >= chunk.t[:-1]):
            held.append(chunk)
        else:
            latest = np.maximum(np.maximum.accumulate(chunk.t), newest)
            back = latest - chunk.t
            worst = int(back.max())
            if worst > MAX_DISORDER_US:
                at = int(np.argmax(back > MAX_DISORDER_US))
                raise RecordingError(
                    f"{name}: times jump back by {int(back[at]):,} us to {chunk.t[at]} us at event"
                    f" {seen + at:,}; up to {MAX_DISORDER_US:,} us are sorted, more is refused:"
                    " cut the recording there"
                )
            disorder.late_events += int(np.count_nonzero(back))
            disorder.worst_us = max(disorder.worst_us, worst)
            held.extend(_merged(held, chunk, chunk_events))
        seen += len(chunk)
        newest = held[-1].t[-1]
        while held and held[0].t[-1] <= newest - MAX_DISORDER_US:
            yield held.popleft()
    yield from held


def _merged(held: deque[EventArray], chunk: EventArray, chunk_events: int) -> list[EventArray]:
    """Take from ``held`` what overlaps ``chunk`` in time; return both sorted, cut to ``chunk_events``."""
    earliest = chunk.t.min()
    parts = [chunk]
    while held and held[-1].t[-1] > earliest:
        parts.insert(0, held.pop())
    t = np.concatenate([part.t for part in parts])
    order = np.argsort(t, kind="stable")
    merged = EventArray(
        t[order],
        np.concatenate([part.x for part in parts])[order],
        np.concatenate([part.y for part in parts])[order],
        np.concatenate([part.p for part in parts])[order],
        chunk.width,
        chunk.height,
    )
    return [merged.cut(i, i + chunk_events) for i in range(0, len(merged), chunk_events)]
