#!/usr/bin/env python3
"""Give what a line takes from outside damaged bytes, for long: it is taken, or refused in one line.

usage: fuzz.py [--minutes 15] [--first 0] [--only evt3 packed reader triggers settings]

A case is a number: it says which good input is damaged, and how.  Targets, by turns: streams of EVT3 and of
packed events, cut anywhere; those of packed events read by a line's reader, with their triggers; files of
triggers; files of a service's settings.  An exception that is no `EvqrError` of one line ends it, with the
number of the case, and so does a reader that has not exactly one part a trigger, or a hole in its numbers.
"""

from __future__ import annotations

import argparse
import functools
import io
import itertools
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evqr import EvqrError, PartRecord, Reader, TriggerConfig
from evqr.line.trigger_file import read_triggers
from evqr.live.evt3_stream import Evt3Decoder
from evqr.live.packed_stream import PackedDecoder, PackedWriter
from evqr.live.pieces import Events, Piece, Sensor, TimePasses, TriggerSeen
from evqr.recording import save_recording
from evqr.service.settings import parse_settings

MOST_PX = 1280
"""Readers are made for sensors up to this: a header may claim 65535 by 65535."""

WORDS = (
    b"\0",
    b"\xff" * 8,
    b"\x80",
    b"-1",
    b"nan",
    b"1e999",
    b'"',
    b"[",
    b"]",
    b"=",
    b"\n",
    b",",
    b"\xef\xbb\xbf",
)
"""What is put in, beside random bytes: what parsers trip over."""


class Target(NamedTuple):
    """What takes input.

    Attributes
    ----------
    good : callable
        Gives inputs that it takes.
    take : callable
        Takes an input, and may raise an `EvqrError`.
    every : int
        Of so many cases one is tried: those that take long are rarer.
    """

    good: Callable[[], list[bytes]]
    take: Callable[[bytes, np.random.Generator], None]
    every: int = 1


def damaged(data: bytes, others: list[bytes], rng: np.random.Generator) -> bytes:
    """Damage bytes in up to eight places: altered, cut out, doubled, put in, or of another input."""
    for _ in range(rng.integers(0, 9)):
        first, last = np.sort(rng.integers(0, len(data) + 1, 2)).tolist()
        last = min(last, first + int(rng.integers(1, 40)))
        how = rng.integers(6)
        if how == 0:
            data = data[:first] + rng.bytes(last - first) + data[last:]
        elif how == 1:
            data = data[:first] + data[last:]
        elif how == 2:
            data = data[:last] + data[first:]
        elif how == 3:
            data = data[:first] + WORDS[rng.integers(len(WORDS))] + data[first:]
        elif how == 4:
            other = others[rng.integers(len(others))]
            data = data[:first] + other[rng.integers(len(other) + 1) :]
        elif first < len(data):
            data = data[:first] + bytes([data[first] ^ 1 << int(rng.integers(8))]) + data[first + 1 :]
    return data


def cut(data: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    bounds = [0, *np.sort(rng.integers(0, len(data) + 1, rng.integers(0, 6))).tolist(), len(data)]
    return (data[first:last] for first, last in itertools.pairwise(bounds))


def noise(seed: int, count: int = 150) -> np.ndarray:
    """Give columns of events of 64 x 48 px."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 30_000, count))
    return np.stack([t, rng.integers(0, 64, count), rng.integers(0, 48, count), rng.integers(0, 2, count)])


@functools.cache
def good_packed() -> list[bytes]:
    made = []
    for seed in range(4):
        file = io.BytesIO()
        writer = PackedWriter(file, (64, 48))
        for k, part in enumerate(np.array_split(noise(seed), 4, axis=1)):
            writer.trigger(int(part[0, 0]), ("start", "end", "pulse", "pulse")[k], index=k, ticks=float(k))
            writer.events(*part)
        writer.time(90_000)
        made.append(file.getvalue())
    return made


@functools.cache
def good_evt3() -> list[bytes]:
    from evqr import EventArray

    made = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(4):
            t, x, y, p = noise(seed)
            path = Path(folder) / f"{seed}.raw"
            save_recording(path, EventArray(t, x, y, 2 * p - 1, 64, 48))
            made.append(path.read_bytes() + b"\x01\xa0\x05\x60\x00\xa0")  # and edges of a trigger
    return made


def good_triggers() -> list[bytes]:
    return [b"t_us,kind,index,ticks\n0,start,4\n9000,end,4\n20000,pulse,,3.5\n", b"7,pulse\n5,ticks,,1e3\n"]


def good_settings() -> list[bytes]:
    return [(files("evqr") / "data" / "watch.toml").read_bytes()]


def take_packed(data: bytes, rng: np.random.Generator) -> None:
    decoder = PackedDecoder("here")
    for part in cut(data, rng):
        list(decoder.feed(part))


def take_evt3(data: bytes, rng: np.random.Generator) -> None:
    decoder = Evt3Decoder("here")
    for part in cut(data, rng):
        list(decoder.feed(part))


def take_triggers(data: bytes, rng: np.random.Generator) -> None:
    with tempfile.NamedTemporaryFile(suffix=".csv") as file:
        file.write(data)
        file.flush()
        read_triggers(file.name)


def take_settings(data: bytes, rng: np.random.Generator) -> None:
    settings, _ = parse_settings(data.decode("utf-8", "replace"), "here")
    json.dumps(settings.to_dict())


def pieces_of(data: bytes, rng: np.random.Generator) -> Iterator[Piece]:
    """Give what is before the damage that the decoder refuses."""
    decoder = PackedDecoder("here")
    try:
        for part in cut(data, rng):
            yield from decoder.feed(part)
    except EvqrError:
        return


def take_reader(data: bytes, rng: np.random.Generator) -> None:
    reader: Reader | None = None
    asked, records = 0, []
    for piece in pieces_of(data, rng):
        if isinstance(piece, Sensor):
            if max(piece.width, piece.height) > MOST_PX:
                return
            reader = Reader((piece.width, piece.height), triggers=TriggerConfig(after_us=5_000))
        assert reader is not None
        if isinstance(piece, Events):
            records += reader.push(piece.columns)
        elif isinstance(piece, TimePasses):
            records += reader.advance(piece.t_us)
        elif isinstance(piece, TriggerSeen):
            reader.trigger(piece.t_us, piece.kind, piece.index, piece.ticks)
            asked += piece.kind in ("pulse", "start")
    if reader is not None:
        records += reader.close()
        assert [record.sequence for record in records] == list(range(len(records))), "a hole in the numbers"
        assert sum(isinstance(record, PartRecord) for record in records) == asked, "not one part a trigger"


TARGETS = {
    "evt3": Target(good_evt3, take_evt3),
    "packed": Target(good_packed, take_packed),
    "reader": Target(good_packed, take_reader, every=16),
    "triggers": Target(good_triggers, take_triggers),
    "settings": Target(good_settings, take_settings, every=2),
}


def try_case(name: str, number: int) -> str:
    """Try a case.

    Returns
    -------
    outcome : {"taken", "refused"}
        Anything else is an exception.
    """
    target, rng = TARGETS[name], np.random.default_rng([number, len(name)])
    good = target.good()
    data = damaged(good[rng.integers(len(good))], good, rng)
    try:
        target.take(data, rng)
    except EvqrError as error:
        assert str(error) and len(str(error).splitlines()) == 1, f"not one line: {error}"
        return "refused"
    return "taken"


def main() -> int:
    parser = argparse.ArgumentParser(description="Give what a line takes damaged bytes, for long.")
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", nargs="+", choices=TARGETS, default=list(TARGETS))
    given = parser.parse_args()
    outcomes, ends = Counter(), time.monotonic() + 60.0 * given.minutes
    last = given.first
    for number in itertools.count(given.first):
        if time.monotonic() >= ends:
            break
        last = number
        for name in given.only:
            if number % TARGETS[name].every:
                continue
            try:
                outcomes[name, try_case(name, number)] += 1
            except Exception:
                print(
                    f"{name}, case {number}: --only {name} --first {number} --minutes 0.01", file=sys.stderr
                )
                raise
    print(f"{'target':>10}{'cases':>10}{'taken':>10}{'refused':>10}")
    for name in given.only:
        taken, refused = outcomes[name, "taken"], outcomes[name, "refused"]
        print(f"{name:>10}{taken + refused:>10}{taken:>10}{refused:>10}")
    print(f"cases {given.first} to {last}: nothing else")
    return 0


if __name__ == "__main__":
    sys.exit(main())
