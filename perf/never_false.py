#!/usr/bin/env python3
"""Read windows that show no readable code, of many kinds; exit 1 when any gives a text.

usage: never_false.py [--windows 1000000] [--log FILE] [--recordings DIR] [--symbologies all] [--seed 0]

Scenes are made on the fly, each from the seed, its kind and its number alone; each is read window by window,
from cold, by all that a reader tries.  With --log each scene is a line of JSON, and a run goes on from where
the last one ended; a run in parts needs no other care.  The table says how far the windows of a kind got:
something moved in them, something was taken for a code and its grid decoded, a text came out.  A text that is
printed in the scene is no false one, where two codes lie over each other, or one is torn in two: it is
counted apart.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported: the processes share the cores

import argparse
import itertools
import json
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm
from without_code import label, printed

import evqr
from evqr.config import ReadConfig
from evqr.events.array import EventArray
from evqr.simulate import simulate
from evqr.simulate.config import PRESETS, CodePlacement
from evqr.simulate.printed import PrintedSymbol, make_symbol
from evqr.simulate.shuffle import shuffled
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology

WIDTH, HEIGHT = 320, 240
WINDOWS = 10
"""A scene, at most."""

FOREIGN = ("PDF417", "MaxiCode", "Code128", "EAN13", "ITF", "DataBar", "Code39")
"""Symbols that evqr does not read, by zxing-cpp's names; numbers all of them can say are printed."""

MOTIONLESS = frozenset({"nothing_moves", "too_few_events", "no_events"})
Made = tuple[EventArray, set[str]]


def text_of(rng: np.random.Generator, length: int) -> str:
    """Draw digits, which every symbol can say."""
    return "".join(rng.choice(list("0123456789"), length))


def draw_symbol(rng: np.random.Generator) -> PrintedSymbol:
    """Draw a symbol that evqr reads, small enough for the view."""
    symbology = list(SYMBOLS)[rng.integers(len(SYMBOLS))]
    sizes = [version for version, shape in SYMBOLS[symbology].sizes.items() if max(shape) <= 45]
    version = sizes[rng.integers(len(sizes))]
    levels = [["L"]] if symbology is Symbology.MICRO_QR_CODE else [["M", "H"]]
    return make_symbol(
        CodePlacement(
            text=text_of(rng, int(rng.integers(2, 5))),
            symbology=symbology,
            version=version,
            ec=str(rng.choice(levels[0])),  # pyright: ignore[reportArgumentType]
        )
    )


def draw_scene(rng: np.random.Generator, shape: tuple[int, int], quiet: int) -> dict:
    """Draw where and how something of a shape passes."""
    largest = min(9.0, 0.9 * HEIGHT / (np.hypot(*shape) + 2 * quiet))
    return {
        "preset": str(rng.choice(sorted(PRESETS))),
        "angle": float(rng.uniform(0.0, 360.0)),
        "direction": float(rng.uniform(0.0, 360.0)),
        "speed_px_ms": float(rng.uniform(1.0, 10.0)),
        "module_px": max(1.2, float(rng.uniform(0.6, 1.0) * largest)),
        "quiet": quiet,
        "width": WIDTH,
        "height": HEIGHT,
        "seed": int(rng.integers(2**31)),
    }


def passing(rng: np.random.Generator, squares: NDArray, quiet: int) -> EventArray:
    """Simulate squares that pass, 20 px of travel."""
    scene = draw_scene(rng, squares.shape, quiet)
    return label(squares, duration_us=round(20.0 / scene["speed_px_ms"] * 1000.0), **scene)


def code_passing(rng: np.random.Generator) -> Made:
    """Simulate a code that passes, and say its text."""
    symbol = draw_symbol(rng)
    return passing(rng, symbol.modules, symbol.space.quiet_zone), {symbol.placement.text}


# ---- kinds


def noise(rng: np.random.Generator, _: object) -> Made:
    """Draw events at random, with pixels that fire more than others; now and then two rates in turn."""
    count, span = int(rng.uniform(2e3, 2e5)), 20_000
    t = rng.uniform(0, span, count)
    if rng.random() < 0.5:
        t = np.where(rng.random(count) < 0.5, t, t % 1000 + 1000 * rng.integers(0, 20, count))
    x, y = rng.integers(0, WIDTH, count), rng.integers(0, HEIGHT, count)
    hot = rng.random(count) < rng.uniform(0.0, 0.3)
    x, y = np.where(hot, x // 16 * 16, x), np.where(hot, y // 16 * 16, y)
    p = rng.integers(0, 2, count)
    return events_of(np.sort(t).astype(np.int64), x, y, p), set()


def texture(rng: np.random.Generator, _: object) -> Made:
    """Print random squares, stripes, checks, lattices, blots."""
    rows, columns = (int(n) for n in rng.integers(12, 45, 2))
    v, u = np.indices((rows, columns))
    period, way = int(rng.integers(2, 9)), int(rng.integers(5))
    if way == 0:
        dark = rng.random((rows, columns)) < rng.uniform(0.2, 0.8)
    elif way == 1:
        dark = (u + int(rng.integers(0, 3)) * v) % period < period / 2
    elif way == 2:
        dark = (u // period + v // period) % 2 == 0
    elif way == 3:
        dark = (u % period == 0) | (v % period == 0)
    else:
        dark = np.kron(rng.random((rows // 3 + 1, columns // 3 + 1)) < 0.5, np.ones((3, 3)))[:rows, :columns]
    dark = np.asarray(dark, bool) ^ (rng.random((rows, columns)) < rng.choice([0.0, 0.02, 0.1]))
    return passing(rng, dark.astype(np.uint8), int(rng.integers(1, 5))), set()


def foreign(rng: np.random.Generator, config: ReadConfig) -> Made:
    """Print a symbol of a kind that is not searched for."""
    others = [symbology for symbology in SYMBOLS if symbology not in config.symbologies]
    which = int(rng.integers(len(FOREIGN) + len(others)))
    if which < len(FOREIGN):
        kind = FOREIGN[which]
        squares = printed(kind, text_of(rng, {"EAN13": 12, "ITF": 14, "DataBar": 13}.get(kind, 8)), 0)
        if len(squares) > 90 or squares.shape[1] > 130:
            squares = squares[:90, :130]
        return passing(rng, squares, 2), set()
    symbology = others[which - len(FOREIGN)]
    symbol = draw_symbol(rng)
    while symbol.space.symbology is not symbology:
        symbol = draw_symbol(rng)
    return passing(rng, symbol.modules, symbol.space.quiet_zone), set()


def decoy(rng: np.random.Generator, _: object) -> Made:
    """Simulate what there is in place of a code: bars, text, checks, boxes, finder patterns round coins."""
    scene = draw_scene(rng, (1, 1), 0)
    del scene["angle"], scene["module_px"], scene["quiet"]
    duration = round(20.0 / scene["speed_px_ms"] * 1000.0)
    return simulate("-", code=False, duration_us=duration, **scene).events, set()


def blocks(rng: np.random.Generator, _: object) -> Made:
    """Print a code whose modules are in another order: its blocks shuffled, all fixed patterns in place."""
    symbol = draw_symbol(rng)
    squares, free = symbol.modules.copy(), ~symbol.space.known
    bits, size = squares[free], int(rng.integers(2, 17))
    whole = len(bits) // size * size
    bits[:whole] = rng.permutation(bits[:whole].reshape(-1, size)).ravel()
    squares[free] = bits
    return passing(rng, squares, symbol.space.quiet_zone), {symbol.placement.text}


def coins(rng: np.random.Generator, _: object) -> Made:
    """Print a code's fixed patterns, all other modules coins."""
    symbol = draw_symbol(rng)
    squares, free = symbol.modules.copy(), ~symbol.space.known
    squares[free] = rng.integers(0, 2, int(free.sum()))
    return passing(rng, squares, symbol.space.quiet_zone), set()


def pixels(rng: np.random.Generator, _: object) -> Made:
    """Move a code's events, every pixel's to another pixel."""
    events, _ = code_passing(rng)
    return shuffled(events, int(rng.integers(2**31))), set()


def tiles(rng: np.random.Generator, _: object) -> Made:
    """Cut the image of a code's events into tiles, and put them together in another order."""
    events, texts = code_passing(rng)
    side = int(rng.choice([8, 10, 16, 20, 40]))
    across = WIDTH // side
    order = rng.permutation(across * (HEIGHT // side))
    where = order[events.y // side * across + events.x // side]
    x, y = where % across * side + events.x % side, where // across * side + events.y % side
    return events_of(events.t, x, y, events.p), texts


def polarities(rng: np.random.Generator, _: object) -> Made:
    """Draw the polarities of a code's events anew: for each event, or for each pixel."""
    events, texts = code_passing(rng)
    if rng.random() < 0.5:
        p = rng.integers(0, 2, len(events))
    else:
        p = rng.integers(0, 2, (HEIGHT, WIDTH))[events.y, events.x]
    return events_of(events.t, events.x, events.y, p), texts


def over(rng: np.random.Generator, _: object) -> Made:
    """Lay two codes over each other, each with its own motion."""
    (one, texts), (two, others) = code_passing(rng), code_passing(rng)
    span = min(int(one.t[-1]), int(two.t[-1]))
    parts = [each.between(0, span) for each in (one, two)]
    t = np.concatenate([part.t for part in parts])
    order = np.argsort(t, kind="stable")
    x, y, p = (np.concatenate([getattr(part, name) for part in parts])[order] for name in "xyp")
    return events_of(t[order], x, y, p), texts | others


def halves(rng: np.random.Generator, _: object) -> Made:
    """Shift the halves of a code's image against each other."""
    events, texts = code_passing(rng)
    along, shift = int(rng.integers(2)), int(rng.choice([-1, 1]) * rng.uniform(6, 60))
    x, y = events.x.astype(np.int64), events.y.astype(np.int64)
    if along:
        x = np.where(y < HEIGHT // 2, (x + shift) % WIDTH, x)
    else:
        y = np.where(x < WIDTH // 2, (y + shift) % HEIGHT, y)
    return events_of(events.t, x, y, events.p), texts


_MADE = (noise, texture, foreign, decoy, blocks, coins, pixels, tiles, polarities, over, halves)
KINDS = {make.__name__: make for make in _MADE}


def events_of(t: NDArray, x: NDArray, y: NDArray, p: NDArray) -> EventArray:
    """Put columns together."""
    return EventArray(
        t=t, x=x.astype(np.uint16), y=y.astype(np.uint16), p=np.where(p > 0, 1, -1).astype(np.int8),
        width=WIDTH, height=HEIGHT,
    )  # fmt: skip


# ---- recordings


@cache
def recorded(path: str) -> EventArray:
    """Read a recording of a sensor, all of it."""
    with evqr.open_recording(path) as recording:
        chunks = list(recording.chunks())
        t, x, y, p = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txyp")
        return EventArray(t=t, x=x, y=y, p=p, width=recording.width, height=recording.height)


def cut(rng: np.random.Generator, path: str) -> EventArray:
    """Cut a recording anywhere, as it is or as its mirror image, turned about, its polarities swapped."""
    events = recorded(path)
    span = int(events.t[-1] - events.t[0]) + 1
    length = int(min(span, rng.choice([5_000, 20_000, 100_000])))
    start = int(events.t[0]) + int(rng.integers(0, max(span - length, 1)))
    part = events.between(start, start + length)
    x, y, p = part.x.astype(np.int64), part.y.astype(np.int64), part.p
    if rng.random() < 0.5:
        x = part.width - 1 - x
    if rng.random() < 0.5:
        y = part.height - 1 - y
    if rng.random() < 0.5:
        p = -p
    return EventArray(
        t=part.t, x=x.astype(np.uint16), y=y.astype(np.uint16), p=p.astype(np.int8), width=part.width,
        height=part.height,
    )  # fmt: skip


# ---- reading


def run_scene(
    kind: str, number: int, *, seed: int, symbologies: tuple[Symbology, ...] | None, recordings: list[str]
) -> dict:
    """Make a scene, read its windows, and say how far they got."""
    names = [*KINDS, "recording"]
    rng = np.random.default_rng([seed, names.index(kind), number])
    config = ReadConfig(max_windows=WINDOWS, travel_px=float(rng.choice([1.0, 2.0, 2.0, 4.0])))
    if symbologies is not None:
        config = replace(config, symbologies=symbologies)
    if kind == "recording":
        events, printed_texts = cut(rng, recordings[number % len(recordings)]), set()
    else:
        events, printed_texts = KINDS[kind](rng, config)
    got, texts, true = Counter(), [], 0
    for window in evqr.read_windows(events, config=config, threads=1) if len(events) else ():
        got["windows"] += 1
        got["moving"] += window.reason_code is None or window.reason_code.value not in MOTIONLESS
        got["decoded"] += bool(window.codes)
        said = {code.text for code in window.codes if code.text is not None}
        texts += sorted(said - printed_texts)
        true += bool(said & printed_texts)
    return {"kind": kind, "number": number, "seed": seed, **got, "true": true, "false": texts}


def scenes(kinds: list[str], done: set[tuple[str, int]]) -> Iterator[tuple[str, int]]:
    """Give kinds in turn, and numbers that were not run yet."""
    for number in itertools.count():
        for kind in kinds:
            if (kind, number) not in done:
                yield kind, number


def table(outcomes: list[dict], kinds: list[str]) -> str:
    """Put what came out into a table in Markdown."""
    keys = ("windows", "moving", "decoded", "true", "false")
    total: dict[str, Counter] = {kind: Counter() for kind in [*kinds, "all"]}
    for outcome in outcomes:
        counts = {**{key: outcome.get(key, 0) for key in keys[:4]}, "false": len(outcome["false"])}
        for row in (outcome["kind"], "all"):
            total[row].update(counts)
    lines = [
        "| kind | windows | something moves | decoding tried | text that is printed | false text |",
        "|---|---|---|---|---|---|",
    ]
    lines += [f"| {kind} | {' | '.join(f'{total[kind][key]:,}' for key in keys)} |" for kind in total]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--windows", type=int, default=1_000_000, help="stop after so many, with those in --log"
    )
    parser.add_argument("--log", type=Path, help="JSON lines to append to, and to go on from")
    parser.add_argument("--recordings", type=Path, help="a folder of recordings that show no code")
    parser.add_argument("--symbologies", help="such as qr,datamatrix, or all; default as evqr has it")
    parser.add_argument("--kinds", help=f"some of {', '.join(KINDS)}, recording")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()

    found = sorted(map(str, arguments.recordings.rglob("*"))) if arguments.recordings else []
    recordings = [path for path in found if Path(path).is_file() and readable(path)]
    kinds = (
        arguments.kinds.split(",") if arguments.kinds else [*KINDS, *(["recording"] if recordings else [])]
    )
    symbologies = None
    if arguments.symbologies:
        named = arguments.symbologies
        symbologies = tuple(SYMBOLS) if named == "all" else tuple(map(Symbology.parse, named.split(",")))
    outcomes = []
    if arguments.log is not None and arguments.log.exists():
        lines = arguments.log.read_text().splitlines()
        outcomes = [each for each in map(json.loads, lines) if each["seed"] == arguments.seed]
    run = partial(run_scene, seed=arguments.seed, symbologies=symbologies, recordings=recordings)
    ahead = scenes(kinds, {(each["kind"], each["number"]) for each in outcomes})
    seen = sum(each.get("windows", 0) for each in outcomes)
    bar = tqdm(total=arguments.windows, initial=seen, unit="window", smoothing=0.05, disable=None)
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(run, *next(ahead)) for _ in range(2 * arguments.jobs)}
        while seen < arguments.windows:
            job = next(as_completed(jobs))
            jobs.remove(job)
            outcome = job.result()
            jobs.add(pool.submit(run, *next(ahead)))
            outcomes.append(outcome)
            seen += outcome.get("windows", 0)
            bar.update(outcome.get("windows", 0))
            if outcome["false"]:
                tqdm.write(f"FALSE {outcome}", file=sys.stdout)
            if arguments.log is not None:
                with open(arguments.log, "a", encoding="utf-8") as log:
                    log.write(json.dumps(outcome) + "\n")
        pool.shutdown(cancel_futures=True)
    bar.close()
    print(table(outcomes, kinds))
    return 1 if any(each["false"] for each in outcomes) else 0


def readable(path: str) -> bool:
    """Whether a file is a recording that this installation opens."""
    try:
        evqr.open_recording(path).close()
    except evqr.EvqrError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
