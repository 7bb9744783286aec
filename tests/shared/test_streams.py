"""Recordings of other simulators as streams: records do not depend on how events were cut into chunks.

Parts of them are read, in which a code travels a few pixels; ``--whole`` reads all of each, in minutes.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from stream_steps import cut_anywhere, cut_every, records_of

from evqr.recording import open_recording
from evqr.solver import Solver
from evqr.stream.records import CodeAgain, CodeRead

SHARED = Path(__file__).parents[3] / "shared"
RECORDINGS = [path for name in ("recordings", "streams") for path in sorted((SHARED / name).glob("*.h5"))]

TRAVEL_PX = 5.0
LONGEST_US = 10_000

pytestmark = pytest.mark.skipif(not RECORDINGS, reason="no folder ../shared beside the repository")


@pytest.fixture(scope="module")
def solver():
    return Solver()


def part_us(path):
    """A part of a recording in which its code is in view and travels so far; without one, the beginning."""
    with h5py.File(path) as file:
        if "truth" not in file or "in_view" not in file["truth"]:
            first = int(file["events/t"][0])
            return first, first + LONGEST_US // 4
        truth = file["truth"]
        inside = np.flatnonzero(truth["in_view"][:])
        middle = int(truth["t_us"][inside[len(inside) // 2]])
        speed = float(np.hypot(*truth["velocity"][inside[len(inside) // 2]]))
    return middle, middle + min(round(TRAVEL_PX / speed * 1e6), LONGEST_US)


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_chunks_of_any_size_give_the_same_records(path, solver, request):
    whole = request.config.getoption("--whole")
    start_us, end_us = (None, None) if whole else part_us(path)
    with open_recording(path, start_us=start_us, end_us=end_us) as recording:
        events = recording.read()
    at_once = records_of([events], solver)
    ways = {"1 us": cut_every(events, 1), "anywhere": cut_anywhere(events, 97, seed=7)}
    if whole:
        ways["1 ms"] = cut_every(events, 1_000)
    for name, chunks in ways.items():
        assert records_of(chunks, solver) == at_once, name
    read = [record.reading.text for record in at_once[0] if isinstance(record, CodeRead)]
    assert bool(read) == (path.stem != "no_code") or not whole


def test_parts_that_say_the_same_are_read_one_by_one(solver):
    """The second moves the other way, and is found where the first would be by then."""
    path = SHARED / "streams" / "stream_11_parts.h5"
    with h5py.File(path) as file:
        parts = file["parts"]
        start_us, end_us = int(parts["t_start_us"][8]), int(parts["t_end_us"][9])
        text = parts["payloads"][8].decode()
        assert parts["payloads"][9].decode() == text
    with open_recording(path, start_us=start_us, end_us=end_us) as recording:
        records, _ = records_of([recording.read()], solver)
    read = [record for record in records if isinstance(record, CodeRead)]
    assert [(record.code, record.reading.text) for record in read] == [(0, text), (1, text)]
    assert not any(isinstance(record, CodeAgain) for record in records)
