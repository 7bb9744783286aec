"""Lines in states that a page must show: empty, busy, failing."""

from __future__ import annotations

import random
import time

import numpy as np
import sample_results

from evqr.events.array import EventArray
from evqr.page.state import LineState
from evqr.sinks.outlet import OutletStatus

UP = OutletStatus(up=True, waiting=0, delivered=912, lost=0, refused=0, failures=0, error="")
DOWN = OutletStatus(
    up=False, waiting=312, delivered=600, lost=3, refused=0, failures=14, error="Connection refused"
)

HOSTILE = "<img src=x onerror=alert(1)>"
"""What a code may say as well as anything else."""


def events(count=5_000, width=320, height=240):
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, width, count), rng.integers(0, height, count)
    p = rng.choice(np.array([-1, 1], np.int8), count)
    return EventArray(np.arange(count), x.astype(np.uint16), y.astype(np.uint16), p, width, height)


def part(k, *texts, **more):
    return {"record": "part", "part": k, "trigger": k, "texts": list(texts), "matches": None, "reason": "",
            "reason_code": None, "t_utc": "2026-01-01T08:00:00.000Z", "latency_ms": 3.0, **more}  # fmt: skip


def line(kind, *, parts=200):
    """A line's state, an hour after it began."""
    now = [time.time() - 3600.0]
    state = LineState("" if kind == "empty" else "Packaging 3", clock=lambda: now[0])
    if kind != "empty":
        rng = random.Random(1)
        state.connected(
            "tcp://camera:9000", "the other side has ended the connection" if kind == "failing" else ""
        )
        sinks = [("database parts.db", UP), ("mqtt broker:1883", DOWN if kind == "failing" else UP)]
        state.watch_sinks(lambda: sinks)
        reading = sample_results.read_result().readings[0]
        read = {"record": "read", **reading.to_dict(), "text": HOSTILE}
        for k in range(parts):
            now[0] += 3600.0 / parts
            state.take(
                {**read, "compute_ms": {"total": rng.lognormvariate(1.0, 0.7)}}, modules=["101", "010", "110"]
            )
            if rng.random() < (0.3 if kind == "failing" else 0.05):
                why = {"reason": "code seen but not decoded: 61 % are clear", "reason_code": "not_decoded"}
                state.take(part(k, **why), file=f"part-{k}.h5")
            else:
                state.take(part(k, HOSTILE, latency_ms=rng.lognormvariate(1.5, 1.0)))
        state.saw(events(), behind_ms=1.2)
    now[0] = time.time()
    return state
