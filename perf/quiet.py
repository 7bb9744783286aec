#!/usr/bin/env python3
"""Print what a stream of noise costs, and a search in it: nothing is there to be read.

usage: quiet.py [--rates 0.25 1 2] [--ms 200] [--rounds 3]

A row a rate: processor time an event of a stream that brings so many million events a second, at any time and
place of 640x480 px, and of one search from cold; the best of the rounds, after one that is not counted.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from line_streams import HEIGHT, WIDTH, noise

from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import NotFound
from evqr.solver import Solver
from evqr.stream.scheduler import StreamScheduler

SEARCHES = 20


def time_stream(events: EventArray, solver: Solver) -> float:
    """Give the processor time of a stream [s]."""
    begin = time.process_time()
    scheduler = StreamScheduler([solver], WIDTH, HEIGHT)
    for k in range(0, len(events), 10_000):
        scheduler.push(events.cut(k, min(k + 10_000, len(events))))
        scheduler.step()
    scheduler.close()
    return time.process_time() - begin


def time_search(events: EventArray, solver: Solver) -> float:
    """Give the processor time of a search from cold [s]."""
    buffer = EventBuffer.of(events)
    starts_us = np.linspace(0, int(events.t[-1]) - solver.config.motion.longest_us, SEARCHES).astype(int)
    begin = time.process_time()
    for start_us in starts_us.tolist():
        assert isinstance(buffer.answer(solver.motion_at(start_us)), NotFound)
    return (time.process_time() - begin) / SEARCHES


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rates", type=float, nargs="+", default=[0.25, 1.0, 2.0], metavar="MEV_S")
    parser.add_argument("--ms", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    solver = Solver()
    print(f"{'Mev/s':>6} {'ns an event':>12} {'ms a search':>12} {'share of a core':>16}")
    for rate in arguments.rates:
        events = noise(rate, 1000 * arguments.ms)
        time_stream(events, solver)
        stream = min(time_stream(events, solver) for _ in range(arguments.rounds))
        search = min(time_search(events, solver) for _ in range(arguments.rounds))
        share = 1e3 * stream / arguments.ms
        print(f"{rate:6} {1e9 * stream / len(events):12.0f} {1e3 * search:12.2f} {share:16.0%}", flush=True)


if __name__ == "__main__":
    main()
