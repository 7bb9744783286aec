#!/usr/bin/env python3
"""Let parts pass a line for long, and see that each is accounted for and nothing grows.

usage: soak.py [--parts 1000] [--marks 20] [--plot soak.png] [--json]

Parts pass one after another, with noise between them, each with a gate: of five, four have a code and one has
print that looks like one.  Stamps begin shortly before 2^31 us, and jump to shortly before 2^32 us in the
middle; some gates lose their ends, some triggers come late, events come in packets of any size.  A row a
mark: parts, event time, resident memory, file descriptors, threads.  Exit 0 when there was exactly one part a
trigger, all texts are right, record numbers have no hole, and memory rose by less than 1 MB: the least of the
last third of the marks beside that of the third before it, since blocks of events come and go.  What the
solver makes once takes a few hundred parts.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import os
import sys
import threading
from dataclasses import replace

import numpy as np

from evqr import EventArray, PartRecord, Reader, TriggerConfig
from evqr.simulate import simulate

WIDTH, HEIGHT = 200, 120
QUIET_US, PASS_US = 60_000, 6_000
MOST_MB = 1.0


def noise(count: int, duration_us: int, rng: np.random.Generator) -> EventArray:
    return EventArray(
        np.sort(rng.integers(0, duration_us, count)),
        rng.integers(0, WIDTH, count).astype(np.uint16),
        rng.integers(0, HEIGHT, count).astype(np.uint16),
        rng.choice(np.array([-1, 1], np.int8), count),
        WIDTH,
        HEIGHT,
    )


def parts_of(rng: np.random.Generator) -> list[tuple[str, EventArray, list[int]]]:
    """Give what passes, in turn: texts, events with the noise before them, and where these are cut.

    Each time that all have passed, blocks of events are as they were: memory can be compared.
    """
    made = []
    for k in range(5):
        text = f"LOT-{k:02d}" if k < 4 else ""
        seen = simulate(
            text or "NONE", code=bool(text), version=1, module_px=4.0, angle=20.0, direction=0.0,
            speed_px_ms=4.0, width=WIDTH, height=HEIGHT, duration_us=PASS_US, seed=k,
        ).events  # fmt: skip
        still = noise(2_000, QUIET_US, rng)
        x, y, p = (np.concatenate([getattr(still, name), getattr(seen, name)]) for name in ("x", "y", "p"))
        t = np.concatenate([still.t, seen.t + QUIET_US])
        cuts = [0, *np.sort(rng.integers(0, len(t), 3 * k)).tolist(), len(t)]
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


def soak(count: int, marks: int) -> tuple[list[dict[str, float]], dict[str, int]]:
    """Give a row a mark, and what went wrong, counted."""
    rng = np.random.default_rng(0)
    made = parts_of(rng)
    reader = Reader((WIDTH, HEIGHT), triggers=TriggerConfig(longest_us=PASS_US + 4_000))
    expected: dict[int, tuple[str, ...]] = {}
    wrong = {"twice": 0, "text": 0, "never": 0, "hole": 0}
    rows, number, t_us = [], 0, (1 << 31) - 66_000 * min(count // 4, 100)

    def take(records: list) -> None:
        nonlocal number
        for record in records:
            wrong["hole"] += record.sequence != number
            number += 1
            if isinstance(record, PartRecord):
                assert record.trigger is not None
                texts = expected.pop(record.trigger, None)
                wrong["twice"] += texts is None
                wrong["text"] += texts is not None and texts != record.texts

    for part in range(count):
        if part == count // 2:
            t_us = max(t_us, (1 << 32) - 66_000 * min(count // 4, 100))
        text, events, cuts = made[part % len(made)]
        events = replace(events, t=events.t + t_us)
        start_us, end_us = t_us + QUIET_US, int(events.t[-1]) + 1
        expected[part] = (text,) if text else ()
        late = part % 7 == 3
        if not late:
            reader.trigger(start_us, "start", part)
        for first, last in itertools.pairwise(cuts):
            take(reader.push(events.cut(first, last)))
        if late:
            reader.trigger(start_us, "start", part)
        if part % 11 != 5:  # else its end is lost
            reader.trigger(end_us, "end", part)
        t_us = end_us
        if part % (len(made) * max(1, count // marks // len(made))) == 0:
            rows.append({"parts": part, "event_time_us": t_us, **state()})
    take(reader.close())
    rows.append({"parts": count, "event_time_us": t_us, **state()})
    wrong["never"] = len(expected)
    return rows, wrong


def plot(rows: list[dict[str, float]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = ("resident_mb", "descriptors", "threads")
    figure, axes = pyplot.subplots(len(names), sharex=True, figsize=(7, 6), layout="constrained")
    for name, each in zip(names, axes, strict=True):
        each.plot([row["parts"] for row in rows], [row[name] for row in rows])
        each.set_ylabel(name.replace("_", " "))
        each.set_ylim(bottom=0)
    axes[-1].set_xlabel("parts")
    figure.savefig(path)


def main() -> int:
    parser = argparse.ArgumentParser(description="Let parts pass a line for long.")
    parser.add_argument("--parts", type=int, default=1000)
    parser.add_argument("--marks", type=int, default=20)
    parser.add_argument("--plot")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows, wrong = soak(given.parts, given.marks)
    resident_mb, third = (
        [row["resident_mb"] for row in rows[:-1]],
        len(rows) // 3,
    )  # all but when it is closed
    rise = min(resident_mb[-third:]) - min(resident_mb[-2 * third : -third])
    if given.plot:
        plot(rows, given.plot)
    if given.json:
        print(json.dumps({"rows": rows, "wrong": wrong, "rise_mb": rise}))
    else:
        print(f"{'parts':>8} {'event time us':>14} {'resident MB':>12} {'descriptors':>12} {'threads':>8}")
        for row in rows:
            print(
                f"{row['parts']:8.0f} {row['event_time_us']:14.0f} {row['resident_mb']:12.2f}"
                f" {row['descriptors']:12.0f} {row['threads']:8.0f}"
            )
        print(
            ", ".join(f"{name} {count}" for name, count in wrong.items()),
            f"memory rose by {rise:.2f} MB",
        )
    return 0 if not any(wrong.values()) and rise < MOST_MB else 1


if __name__ == "__main__":
    sys.exit(main())
