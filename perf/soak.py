#!/usr/bin/env python3
"""Let parts pass a line for long, and see that each is accounted for and nothing grows.

usage: soak.py [--parts 1000] [--marks 20] [--plot soak.png]

Parts pass one after another, with noise between them, each with a gate: of forty, 32 have a code, and
eight are NO READs: twice print that looks like one, half a code, and noise alone.  Passes are simulated once
and replayed at later times; the reader's own path is whole.  Stamps begin shortly before 2^31 us, and jump to
shortly before 2^32 us in the middle; some gates lose their ends, some triggers come late, events come in
packets of any size.  Twelve times, by turns, nothing comes for two seconds, the source is lost, a packet is
garbage, a packet comes twice, the clock is reset.

A row a mark: parts, NO READs, gaps, resets, event time, resident memory, file descriptors, threads.  Exit 0
when there was exactly one part a trigger, all texts are right, all that went wrong was told, record numbers
have no hole, descriptors and threads are as many as at first, and memory rose by less than 1 MB: the least of
the last quarter of the marks beside that of the second, as blocks of events come and go.  What the solver
makes once takes a few hundred parts.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import sys
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evqr import ClockRecord, EventArray, GapRecord, LineRecord, PartRecord, Reader, TriggerConfig
from evqr.simulate import SensorConfig, simulate

WIDTH, HEIGHT = 160, 112
QUIET_US, PASS_US = 60_000, 1_500
EACH_US = QUIET_US + PASS_US
NOISE_US = 8_000
"""Of the quiet time, just before a part: searching noise is what takes long."""

MOST_MB = 1.0
TROUBLES = ("silence", "lost", "garbage", "twice", "reset") * 2 + ("silence", "lost")
SENSOR = SensorConfig(threshold=0.9)
"""Of low sensitivity: two events an edge, so that a part is cheap."""


def noise(count: int, duration_us: int, rng: np.random.Generator) -> EventArray:
    return EventArray(
        np.sort(rng.integers(0, duration_us, count)),
        rng.integers(0, WIDTH, count).astype(np.uint16),
        rng.integers(0, HEIGHT, count).astype(np.uint16),
        rng.choice(np.array([-1, 1], np.int8), count),
        WIDTH,
        HEIGHT,
    )


def only(events: EventArray, those: np.ndarray) -> EventArray:
    t, x, y, p = (column[those] for column in (events.t, events.x, events.y, events.p))
    return EventArray(t, x, y, p, events.width, events.height)


def one_pass(text: str, seed: int) -> EventArray:
    """Give the events of a code that passes, or of print that looks like one."""
    return simulate(
        text or "NONE", code=bool(text), version=1, module_px=4.0, angle=20.0, direction=0.0,
        speed_px_ms=4.0, width=WIDTH, height=HEIGHT, duration_us=PASS_US, seed=seed, preset=SENSOR,
    ).events  # fmt: skip


def parts_of(rng: np.random.Generator) -> list[tuple[str, EventArray, list[int]]]:
    """Give what passes, in turn: texts, events with the noise before them, and where these are cut.

    Each time that all have passed, blocks of events are as they were: memory can be compared.
    """
    texts = [f"LOT-{k:02d}" for k in range(4)]
    codes = [(text, one_pass(text, k)) for k, text in enumerate(texts)]
    half = only(codes[0][1], codes[0][1].x < WIDTH // 2)
    decoy, still = one_pass("", 4), noise(60, PASS_US, rng)
    unread = [("", seen) for seen in (decoy, half, still, still, decoy, still, still, still)]
    made = []
    for k, (text, seen) in enumerate([*codes * 4, *unread[:4], *codes * 4, *unread[4:]]):
        before = noise(30, NOISE_US, rng)
        quiet_us = QUIET_US - NOISE_US
        x, y, p = (np.concatenate([getattr(before, name), getattr(seen, name)]) for name in ("x", "y", "p"))
        t = np.concatenate([before.t + quiet_us, seen.t + QUIET_US])
        cuts = [0, *np.sort(rng.integers(0, len(t), k % 4)).tolist(), len(t)]
        made.append((text, EventArray(t, x, y, p, WIDTH, HEIGHT), cuts))
    return made


def state() -> dict[str, float]:
    gc.collect()
    with open("/proc/self/statm", encoding="ascii") as file:
        pages = int(file.read().split()[1])
    return {
        "resident_mb": pages * os.sysconf("SC_PAGESIZE") / 1e6,
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


class Line:
    """A line, and what is to come of it.

    Attributes
    ----------
    t_us : int [us]
        When the next part comes.
    given, wrong : Counter
        Parts, NO READs, gaps and resets of the clock so far; and what is not as it is to be.
    """

    def __init__(self, count: int) -> None:
        self.made = parts_of(np.random.default_rng(0))
        self.reader = Reader((WIDTH, HEIGHT), triggers=TriggerConfig(longest_us=PASS_US + 2_000))
        self.ahead_us = EACH_US * min(count // 40, 100) - QUIET_US // 2
        self.t_us = (1 << 31) - self.ahead_us
        self.given = Counter(parts=0, no_reads=0, gaps=0, resets=0)
        self.wrong = Counter(twice=0, text=0, never=0, hole=0, untold=0)
        self._expected: dict[int, tuple[str, ...]] = {}
        self._troubles: Counter[str] = Counter()
        self._number = 0

    def take(self, records: list[LineRecord]) -> None:
        for record in records:
            self.wrong["hole"] += record.sequence != self._number
            self._number += 1
            self.given["gaps"] += isinstance(record, GapRecord)
            self.given["resets"] += isinstance(record, ClockRecord)
            if isinstance(record, PartRecord):
                assert record.trigger is not None
                texts = self._expected.pop(record.trigger, None)
                self.wrong["twice"] += texts is None
                self.wrong["text"] += texts is not None and texts != record.texts
                self.given["parts"] += 1
                self.given["no_reads"] += not record.texts

    def pass_by(self, part: int, trouble: str = "") -> None:
        """Let a part pass, and something go wrong with the source before it."""
        if trouble:
            getattr(self, f"_{trouble}")()
            self._troubles["resets" if trouble == "reset" else "gaps"] += 1
        reader, (text, events, cuts) = self.reader, self.made[part % len(self.made)]
        events = replace(events, t=events.t + self.t_us)
        start_us, end_us = self.t_us + QUIET_US, self.t_us + EACH_US
        self._expected[part] = (text,) if text else ()
        late = part % 7 == 3
        if not late:
            reader.trigger(start_us, "start", part)
        for first, last in itertools.pairwise(cuts):
            self.take(reader.push(events.cut(first, last)))
        if late:
            reader.trigger(start_us, "start", part)
        if part % 11 != 5:  # else its end is lost
            reader.trigger(end_us, "end", part)
        self.t_us = end_us

    def close(self) -> None:
        self.take(self.reader.close())
        self.wrong["never"] = len(self._expected)
        self.wrong["untold"] = sum(
            abs(self.given[kind] - self._troubles[kind]) for kind in ("gaps", "resets")
        )

    # ---- what goes wrong

    def _jump(self) -> None:
        self.t_us = max(self.t_us, (1 << 32) - self.ahead_us)

    def _silence(self) -> None:
        self.t_us += 2_000_000

    def _lost(self) -> None:
        self.take(self.reader.interrupt("the cable was pulled"))

    def _garbage(self) -> None:
        t_us = np.full(2, self.t_us)
        self.take(self.reader.push((t_us, np.array([WIDTH, 3]), np.array([5, HEIGHT]), np.array([1, 1]))))

    def _twice(self) -> None:
        still = replace(self.made[0][1].cut(0, 30), t=self.made[0][1].t[:30] + self.t_us)
        for _ in range(2):
            self.take(self.reader.push(still))
        self.t_us += QUIET_US

    def _reset(self) -> None:
        self.t_us -= 500_000_000


def soak(
    count: int, marks: int, say: Callable[[dict[str, float]], None] = lambda row: None
) -> tuple[list[dict[str, float]], dict[str, int]]:
    """Give a row a mark, which is said at once, and what went wrong, counted."""
    line = Line(count)
    troubles = {(k + 1) * count // (len(TROUBLES) + 1): name for k, name in enumerate(TROUBLES)}
    troubles[count // 2] = "jump"
    every = max(1, count // marks)
    every -= every % len(line.made) if every > len(line.made) else 0
    rows: list[dict[str, float]] = []

    def mark() -> None:
        rows.append({**line.given, "event_time_us": line.t_us, **state()})
        say(rows[-1])

    for part in range(count):
        line.pass_by(part, troubles.get(part, ""))
        if part % every == 0:
            mark()
    line.close()
    mark()
    return rows, dict(line.wrong)


def risen_mb(rows: list[dict[str, float]]) -> float:
    """Give the least of the last quarter of the marks beside that of the second [MB]."""
    resident_mb = [row["resident_mb"] for row in rows[:-1]]  # all but when it is closed
    quarter = max(1, len(resident_mb) // 4)
    return min(resident_mb[-quarter:]) - min(resident_mb[quarter : 2 * quarter])


def plot(rows: list[dict[str, float]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = ("resident_mb", "descriptors", "threads")
    figure, axes = pyplot.subplots(len(names), sharex=True, figsize=(7, 5), layout="constrained")
    for name, each in zip(names, axes, strict=True):
        each.plot([row["parts"] for row in rows], [row[name] for row in rows])
        each.set_ylabel({"resident_mb": "resident MB"}.get(name, name))
        each.set_ylim(bottom=0)
    axes[-1].set_xlabel("parts")
    figure.savefig(path, dpi=120)


COLUMNS = ("parts", "no_reads", "gaps", "resets", "event_time_us", "resident_mb", "descriptors", "threads")


def say(row: dict[str, float]) -> None:
    print("".join(f"{row[name]:>14.{2 if name == 'resident_mb' else 0}f}" for name in COLUMNS), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description="Let parts pass a line for long.")
    parser.add_argument("--parts", type=int, default=1000)
    parser.add_argument("--marks", type=int, default=20)
    parser.add_argument("--plot")
    given = parser.parse_args()
    print("".join(f"{name:>14}" for name in COLUMNS), flush=True)
    rows, wrong = soak(given.parts, given.marks, say)
    rise_mb = risen_mb(rows)
    if given.plot:
        plot(rows, given.plot)
    print(", ".join(f"{name} {count}" for name, count in wrong.items()), f"memory rose by {rise_mb:.2f} MB")
    flat = len({(row["descriptors"], row["threads"]) for row in rows}) == 1
    return 0 if flat and not any(wrong.values()) and rise_mb < MOST_MB else 1


if __name__ == "__main__":
    sys.exit(main())
