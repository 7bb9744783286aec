#!/usr/bin/env python3
"""What a production line asks of one core: to keep up, to be in time, and to cost little while nothing moves.

usage: line.py [--quick] [--rates 2 10 30] [--parts 6] [--rounds 7] [--minutes 7] [--skip NAME ...] [--json F]

Streams are simulated once and kept in a folder for temporary files: 640x480, parts at 5 px/ms, in view half
of the time, a third of them without a code; and noise alone.  The process is confined to one core.  Before
and after each round a bare timer thread sleeps 1 ms again and again on that core: rounds in which its 99th
percentile came 2 ms late or later are not counted, and how many were is printed (where none was, all are
counted, and the line says so).

keeps up    processor time over the time of the events, fed as fast as can be; shares of parts that are right
in time     from the chunk (1 ms) with the last event needed to the record, fed as the events were fired: by
            the wall, and above by the processor's time alone, as if nothing else ran; share of records out
            before the code had begun to leave the view
idle        ns an event of noise, beside dv-processing's accumulator and `bin_packed_events`
baseline    frames of 2 px of travel, each read by zxing-cpp, of the same stream
two         two cameras on two cores over two processes that share nothing: gain of each over one alone
goals       what is asked for, what was measured, and whether that is enough

A row takes its share of the minutes, and one round at least.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import line_streams
import numpy as np
import zxingcpp
from line_streams import HEIGHT, PASS_US, WIDTH, Pass
from processes import counting

from evqr import EventArray, Reader, ReadRecord
from evqr.events.window import Window
from evqr_kernels import ops

CHUNK_US = 1_000
LATE_S, CONTROL_S = 2e-3, 0.2
IDLE_EVENTS = 1_000_000
FRAME_US, FRAME_EVERY_US = 400, 2_000
HERE = Path(__file__).parent


class Wall:
    """Time as it passes: chunks are waited for."""

    def begin(self) -> None:
        self._start_s = time.perf_counter()

    def wait(self, time_us: float) -> None:
        left_s = 1e-6 * time_us - (time.perf_counter() - self._start_s)
        if left_s > 0.0:
            time.sleep(left_s)

    def now_us(self) -> float:
        return 1e6 * (time.perf_counter() - self._start_s)


class Processor:
    """Time as it would pass if nothing else ran: what the processor takes, and no waiting."""

    def begin(self) -> None:
        self._skipped_s = -time.process_time()

    def wait(self, time_us: float) -> None:
        self._skipped_s += max(0.0, 1e-6 * (time_us - self.now_us()))

    def now_us(self) -> float:
        return 1e6 * (time.process_time() + self._skipped_s)


@dataclass
class Fed:
    """What came of feeding a stream once."""

    event_s: float = 0.0
    processor_s: float = 0.0
    latency_ms: list[float] = field(default_factory=list)
    in_time: list[bool] = field(default_factory=list)
    right: int = 0
    wrong: int = 0
    coded: int = 0

    @property
    def ratio(self) -> float:
        return self.processor_s / self.event_s


def feed(passes: list[Pass], clock: Wall | Processor) -> Fed:
    """Push a stream chunk by chunk, each when its time has come by a clock."""
    fed = Fed()
    with Reader((WIDTH, HEIGHT)) as reader:
        begin_us = warm(reader, passes)
        start_us = begin_us
        clock.begin()
        begin_s = time.process_time()
        for one in passes:
            found: list[tuple[ReadRecord, float]] = []
            for end_us, events in line_streams.chunks(one.events, CHUNK_US, start_us):
                clock.wait(end_us - begin_us)
                records = [*reader.push(events), *reader.advance(end_us)]
                now_us = clock.now_us() + begin_us
                found += [(each, now_us) for each in records if isinstance(each, ReadRecord)]
            _score(fed, one, found, start_us)
            start_us += 2 * PASS_US
        fed.processor_s = time.process_time() - begin_s
        fed.event_s = 1e-6 * (start_us - begin_us)
    return fed


def warm(reader: Reader, passes: list[Pass]) -> int:
    """Let all parts pass, for which the reader makes what it makes once; say when that ends [us]."""
    end_us = 0
    for one in passes:
        for _, events in line_streams.chunks(one.events, CHUNK_US, end_us):
            reader.push(events)
        end_us += 2 * PASS_US
    return end_us


def _score(fed: Fed, one: Pass, found: list[tuple[ReadRecord, float]], start_us: int) -> None:
    texts = [record.reading.text for record, _ in found]
    fed.coded += bool(one.text)
    fed.right += bool(one.text) and texts == [one.text]
    fed.wrong += sum(text != one.text for text in texts)
    for record, now_us in found:
        needed_us = -(-record.reading.t_read_us // CHUNK_US) * CHUNK_US
        fed.latency_ms.append(1e-3 * (now_us - needed_us))
    if one.text:
        fed.in_time.append(any(now_us <= start_us + one.leaves_us for _, now_us in found))


def timer_p99_s() -> float:
    """Sleep a millisecond again and again on a thread of its own: how late it woke, 99 times of 100 [s]."""
    late: list[float] = []

    def sleep() -> None:
        end_s = time.perf_counter() + CONTROL_S
        while (begin_s := time.perf_counter()) < end_s:
            time.sleep(1e-3)
            late.append(time.perf_counter() - begin_s - 1e-3)

    thread = threading.Thread(target=sleep)
    thread.start()
    thread.join()
    return float(np.quantile(late, 0.99))


class Rounds:
    """Rounds of a measurement, and which of them nothing else disturbed."""

    def __init__(self, count: int, seconds: float) -> None:
        self._most, self._seconds = count, seconds
        self._count = self.quiet = 0

    def of(self, run: Callable[[], Any]) -> list[Any]:
        """Run so many times; give what undisturbed runs gave, or all where none was."""
        kept, every = [], []
        ends_s = time.perf_counter() + self._seconds
        while len(every) < self._most and (not every or time.perf_counter() < ends_s):
            before = timer_p99_s()
            every.append(run())
            if max(before, timer_p99_s()) < LATE_S:
                kept.append(every[-1])
        self._count, self.quiet = len(every), len(kept)
        return kept or every

    def __str__(self) -> str:
        return f"{self.quiet} of {self._count}" if self.quiet else f"0 of {self._count}: all counted"


def quantile(values: list[float], share: float) -> float:
    return float(np.quantile(values, share)) if values else float("nan")


# ---- what is measured


def keeps_up(rates: list[float], parts: int, rounds: Rounds) -> Iterator[dict[str, Any]]:
    for rate in rates:
        passes = line_streams.passes(rate, parts)
        runs = rounds.of(lambda passes=passes: feed(passes, Processor()))
        latency = [ms for run in runs for ms in run.latency_ms]
        yield {
            "stream": f"parts, {rate:g} Mev/s",
            "processor / event time": statistics.median(run.ratio for run in runs),
            "read": sum(run.right for run in runs) / sum(run.coded for run in runs),
            "false": sum(run.wrong for run in runs),
            "ms p50": quantile(latency, 0.5),
            "ms p99": quantile(latency, 0.99),
            "before it left": float(np.mean([early for run in runs for early in run.in_time])),
            "quiet rounds": str(rounds),
        }
        if rate <= 10.0:
            events = line_streams.noise(rate, 2 * PASS_US)
            quiet = [Pass("", events, 0)]
            runs = rounds.of(lambda quiet=quiet: feed(quiet, Processor()))
            yield {
                "stream": f"noise, {rate:g} Mev/s",
                "processor / event time": statistics.median(run.ratio for run in runs),
                "false": sum(run.wrong for run in runs),
                "quiet rounds": str(rounds),
            }


def in_time(rates: list[float], parts: int, rounds: Rounds) -> Iterator[dict[str, Any]]:
    for rate in rates:
        passes = line_streams.passes(rate, parts)
        runs = rounds.of(lambda passes=passes: feed(passes, Wall()))
        latency = [ms for run in runs for ms in run.latency_ms]
        yield {
            "stream": f"parts, {rate:g} Mev/s",
            "read": sum(run.right for run in runs) / sum(run.coded for run in runs),
            "records": len(latency),
            "ms p50": quantile(latency, 0.5),
            "ms p99": quantile(latency, 0.99),
            "before it left": float(np.mean([early for run in runs for early in run.in_time])),
            "quiet rounds": str(rounds),
        }


def idle(rates: list[float], rounds: Rounds) -> Iterator[dict[str, Any]]:
    for rate in rates:
        events = line_streams.noise(rate, round(IDLE_EVENTS / rate))
        stores = dv_stores([part for _, part in line_streams.chunks(events, CHUNK_US)])
        cut = [part for _, part in line_streams.chunks(events, CHUNK_US)]
        contestants = {
            "Reader": lambda cut=cut: idle_reader(cut),
            "bin_packed_events": lambda cut=cut: idle_bin(cut),
            "dv-processing": lambda stores=stores: idle_dv(stores),
        }
        count = len(events)
        runs = rounds.of(lambda now=contestants: {name: run() for name, run in now.items()})
        for name in contestants:
            ns = [1e9 * run[name] / count for run in runs]
            yield {
                "noise": f"{rate:g} Mev/s",
                "who": name,
                "ns an event": statistics.median(ns),
                "quiet rounds": str(rounds),
            }


def idle_reader(cut: list[EventArray]) -> float:
    with Reader((WIDTH, HEIGHT)) as reader:
        later_us = warm(reader, [Pass("", line_streams.noise(1.0, 2 * PASS_US), 0)])
        later = [
            EventArray(each.t + later_us, each.x, each.y, each.p, each.width, each.height) for each in cut
        ]
        begin = time.process_time()
        for each in later:
            reader.push(each)
        return time.process_time() - begin


def idle_bin(cut: list[EventArray]) -> float:
    """Count packed events on an image, a chunk after the other."""
    packed = [Window(each, int(each.t[0]), int(each.t[-1]) + 1).packed for each in cut]
    image = np.zeros((1, HEIGHT, WIDTH), np.float32)
    bounds = [np.array([[0, len(each)]], np.int32) for each in packed]
    ops.bin_packed_events(packed[0].x, packed[0].y, packed[0].stamp, bounds[0], out=image)
    begin = time.process_time()
    for each, ptr in zip(packed, bounds, strict=True):
        ops.bin_packed_events(each.x, each.y, each.stamp, ptr, out=image)
    return time.process_time() - begin


def dv_stores(cut: list[EventArray]) -> list[Any]:
    """Give chunks as dv-processing takes them, which takes long; none where it is not installed."""
    try:
        import dv_processing as dv
    except ImportError:
        return []
    stores = []
    for each in cut:
        store = dv.EventStore()
        for event in zip(
            *(getattr(each, name).tolist() for name in "txy"), (each.p > 0).tolist(), strict=True
        ):
            store.push_back(*event)
        stores.append(store)
    return stores


def idle_dv(stores: list[Any]) -> float:
    """Give events to an accumulator as it is by default, and take a frame a chunk."""
    if not stores:
        return float("nan")
    import dv_processing as dv

    accumulator = dv.Accumulator((WIDTH, HEIGHT))
    begin = time.process_time()
    for store in stores:
        accumulator.accept(store)
        accumulator.generateFrame()
    return time.process_time() - begin


def baseline(rates: list[float], parts: int, rounds: Rounds) -> Iterator[dict[str, Any]]:
    for rate in rates:
        passes = line_streams.passes(rate, parts)
        runs = rounds.of(lambda passes=passes: integrate(passes))
        yield {
            "stream": f"parts, {rate:g} Mev/s",
            "who": "integrate, zxing-cpp",
            "processor / event time": statistics.median(run.ratio for run in runs),
            "read": sum(run.right for run in runs) / sum(run.coded for run in runs),
            "quiet rounds": str(rounds),
        }


def integrate(passes: list[Pass]) -> Fed:
    """Read frames of counts, each of as many events as blur it by 2 px at the parts' speed."""
    fed = Fed()
    begin = time.process_time()
    for one in passes:
        texts = set()
        events = one.events
        for start_us in range(0, 2 * PASS_US, FRAME_EVERY_US):
            some = events.between(start_us, start_us + FRAME_US)
            places = some.y.astype(np.int64) * WIDTH + some.x
            counts = np.bincount(places, weights=some.p, minlength=WIDTH * HEIGHT)
            frame = np.clip(128 + 40 * counts, 0, 255).astype(np.uint8).reshape(HEIGHT, WIDTH)
            texts |= {each.text for each in zxingcpp.read_barcodes(frame) if each.text}
        fed.coded += bool(one.text)
        fed.right += bool(one.text) and one.text in texts
        fed.event_s += 2e-6 * PASS_US
    fed.processor_s = time.process_time() - begin
    return fed


def camera(rate: float, parts: int, core: int) -> None:
    """Feed a stream on a core, once the other process is ready, too."""
    os.sched_setaffinity(0, {core})
    passes = line_streams.passes(rate, parts)
    feed(passes[:1], Processor())
    print("ready", flush=True)
    sys.stdin.readline()
    begin = time.perf_counter()
    feed(passes, Processor())
    print(time.perf_counter() - begin, flush=True)


def two(rates: list[float], parts: int, rounds: Rounds, cores: list[int]) -> Iterator[dict[str, Any]]:
    if len(cores) < 2:
        return
    for rate in rates[:1]:
        runs = rounds.of(lambda rate=rate: (_gain_of_cameras(rate, parts, cores), _gain_of_counting(cores)))
        yield {
            "stream": f"parts, {rate:g} Mev/s",
            "two cameras": statistics.median(cameras for cameras, _ in runs),
            "two that share nothing": statistics.median(control for _, control in runs),
            "ratio": statistics.median(cameras / control for cameras, control in runs),
            "quiet rounds": str(rounds),
        }


def _gain_of_cameras(rate: float, parts: int, cores: list[int]) -> float:
    def seconds(on: list[int]) -> float:
        command = [sys.executable, str(HERE / "line.py"), "--camera", str(rate), "--parts", str(parts)]
        started = [
            subprocess.Popen(
                [*command, "--core", str(core)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            for core in on
        ]
        pipes = [(each.stdin, each.stdout) for each in started]
        for _, said in pipes:
            assert said is not None and said.readline() == "ready\n"
        for go, _ in pipes:
            assert go is not None
            go.write("\n")
            go.flush()
        taken = [float(said.readline()) for _, said in pipes if said is not None]
        for each in started:
            each.communicate()
        return max(taken)

    return 2.0 * seconds(cores[:1]) / seconds(cores[:2])


def _gain_of_counting(cores: list[int]) -> float:
    def seconds(processes: int) -> float:
        begin = time.perf_counter()
        subprocess.run(
            counting(processes), check=True, preexec_fn=lambda: os.sched_setaffinity(0, set(cores[:2]))
        )
        return time.perf_counter() - begin

    return 2.0 * seconds(1) / seconds(2)


# ---- printed


def goals(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Give what is asked for beside what was measured; nothing where it was not."""

    def found(part: str, name: str, **where: str) -> list[float]:
        return [
            row[name]
            for row in rows
            if row["part"] == part
            and name in row
            and all(row.get(key) == each for key, each in where.items())
        ]

    by_wall, ten, two = "in time, by the wall", "parts, 10 Mev/s", "parts, 2 Mev/s"
    idle_ns = {
        who: found("idle", "ns an event", noise="10 Mev/s", who=who) for who in ("Reader", "dv-processing")
    }
    ratios = [dv / reader for reader, dv in zip(*idle_ns.values(), strict=False)]
    for what, values, least, most in (
        ("10 Mev/s: processor / event", found("keeps up", "processor / event time", stream=ten), None, 1.0),
        ("before it left, processor", found("keeps up", "before it left", stream=ten), 0.99, None),
        ("before it left, wall", found(by_wall, "before it left", stream=two), 0.99, None),
        ("2 Mev/s: ms p50", found(by_wall, "ms p50", stream=two), None, 5.0),
        ("2 Mev/s: ms p99", found(by_wall, "ms p99", stream=two), None, 20.0),
        ("idle 10 Mev/s: ns an event", idle_ns["Reader"], None, 20.0),
        ("idle: dv-processing / Reader", ratios, 2.0, None),
        ("two cameras: ratio", found("two cameras", "ratio"), 0.9, None),
    ):
        for value in values:
            enough = (least is None or value >= least) and (most is None or value <= most)
            goal = f"at least {least:g}" if most is None else f"at most {most:g}"
            yield {"what": what, "measured": value, "goal": goal, "met": "yes" if enough else "NO"}


def show(title: str, rows: Iterator[dict[str, Any]]) -> list[dict[str, Any]]:
    shown = []
    for row in rows:
        if not shown:
            print(f"\n{title}\n" + "  ".join(f"{name:>22}" for name in row), flush=True)
        cells = (f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values())
        print("  ".join(f"{cell:>22}" for cell in cells), flush=True)
        shown.append({"part": title, **row})
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="2 and 10 Mev/s, 3 parts, 3 rounds")
    parser.add_argument("--rates", type=float, nargs="+", choices=list(line_streams.SENSORS), metavar="MEV_S")
    parser.add_argument("--parts", type=int)
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--minutes", type=float, default=7.0)
    parser.add_argument("--skip", nargs="+", default=[], choices=["keeps", "time", "idle", "baseline", "two"])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--camera", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--core", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    rates = given.rates or ([2.0, 10.0] if given.quick else list(line_streams.SENSORS))
    parts = given.parts or (3 if given.quick else 6)
    if given.camera is not None:
        camera(given.camera, parts, given.core)
        return
    for rate in rates:
        line_streams.passes(rate, parts)
    share_s = 60.0 * given.minutes / (len(rates) * 4 + 4)
    rounds = Rounds(given.rounds or (3 if given.quick else 7), share_s)
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, set(cores[:1]))
    slow = [rate for rate in rates if rate <= 10.0]
    tables: dict[str, tuple[str, Callable[[], Iterator[dict[str, Any]]]]] = {
        "keeps": ("keeps up", lambda: keeps_up(rates, parts, rounds)),
        "time": ("in time, by the wall", lambda: in_time(slow, parts, rounds)),
        "idle": ("idle", lambda: idle([1.0, 10.0], rounds)),
        "baseline": ("baseline", lambda: baseline(rates, parts, rounds)),
        "two": ("two cameras", lambda: two(rates, parts, rounds, cores)),
    }
    rows = [
        row for name, (title, make) in tables.items() if name not in given.skip for row in show(title, make())
    ]
    show("goals", goals(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
