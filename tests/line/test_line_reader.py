"""A reader of a line: the same codes as `read_codes` gives, however the stream is cut; one part a trigger."""

import asyncio
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import joined, noise, scene

from evqr import AsyncReader, JobConfig, LineConfig, ReadConfig, Reader, TriggerConfig, UsageError, read_codes
from evqr.errors import RecordingError
from evqr.events.packed import PackedEvents, write_stamps
from evqr.line.pace import Clocks, Pace
from evqr.line.records import ClockRecord, GapRecord, OverloadRecord, PartRecord, ReadRecord
from evqr.reason import Reason

VIEW = {"width": 200, "height": 120, "direction": 0.0}
LATER_US = 3_000_000_000
"""Streams are put so late that their stamps need more than 31 bits."""


@pytest.fixture(scope="module")
def stream():
    """A code, noise, a decoy, noise, a code of another text: where each passes, and the events."""
    still = noise(2_000, 30_000, width=VIEW["width"], height=VIEW["height"])
    parts = (
        scene(text="ONE", version=1, module_px=4.0, travel_px=24.0, **VIEW).events,
        scene(code=False, travel_px=24.0, **VIEW).events,
        scene(text="TWO", version=1, module_px=4.0, travel_px=24.0, **VIEW).events,
    )
    events = joined(parts[0], still, parts[1], still, parts[2], still, gap_us=500)
    ends = np.flatnonzero(np.diff(events.t) >= 500).tolist()
    firsts = [int(events.t[0]), *(int(events.t[at + 1]) for at in ends[1::2])]
    gates = [(t + LATER_US, t + LATER_US + 7_000) for t in firsts[:3]]
    return replace(events, t=events.t + LATER_US), gates


@pytest.fixture(scope="module")
def make(stream):
    """Readers; what they compile is kept."""
    size = stream[0].width, stream[0].height

    def reader(config=None, **given):
        return Reader(size, config, **given)

    return reader


def triggered(reader, gates, events, cuts=()):
    """Push events cut at some places, each trigger before the events of its time."""
    triggers = [
        (t, kind, k) for k, gate in enumerate(gates) for t, kind in zip(gate, ("start", "end"), strict=True)
    ]
    records = []
    bounds = [0, *sorted(cuts), len(events)]
    for first, last in itertools.pairwise(bounds):
        chunk = events.cut(first, last)
        while triggers and len(chunk) and triggers[0][0] <= int(chunk.t[-1]):
            reader.trigger(*triggers.pop(0))
        records += reader.push(chunk)
    for trigger in triggers:
        reader.trigger(*trigger)
    return records + reader.close()


@pytest.fixture(scope="module")
def whole(stream, make):
    events, gates = stream
    return triggered(make(triggers=TriggerConfig()), gates, events)


def of_kind(records, kind):
    return [record for record in records if isinstance(record, kind)]


def test_one_part_a_trigger(whole):
    parts = of_kind(whole, PartRecord)
    assert [(part.trigger, part.texts) for part in parts] == [(0, ("ONE",)), (1, ()), (2, ("TWO",))]
    assert parts[1].reason_code in (Reason.NOTHING_LIKE_A_CODE, Reason.NOTHING_MOVES)
    assert [record.reading.text for record in of_kind(whole, ReadRecord)] == ["ONE", "TWO"]
    assert [record.sequence for record in whole] == list(range(len(whole)))
    assert parts[0].t_start_us >= LATER_US and parts[0].t_read_us > LATER_US


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_how_the_stream_is_cut_does_not_matter(data, stream, make, whole):
    events, gates = stream
    cuts = data.draw(st.lists(st.integers(0, len(events)), min_size=1, max_size=60))
    assert triggered(make(triggers=TriggerConfig()), gates, events, cuts) == whole


def test_without_triggers_it_reads_what_read_codes_reads(stream, make):
    events, _ = stream
    reader = make()
    records = [
        record
        for start in range(0, len(events), 20_000)
        for record in reader.push(events.cut(start, min(start + 20_000, len(events))))
    ]
    records += reader.close()
    result = read_codes(events)
    assert (
        result.readings
        and tuple(part.readings[0] for part in of_kind(records, PartRecord)) == result.readings
    )
    assert reader.statistics == result.seen
    assert reader.close() == []


@pytest.mark.parametrize("kind", ["EventArray", "tuple", "dict", "structured", "packed", "nanoseconds"])
def test_events_of_any_kind(kind, stream, make):
    events = stream[0].cut(0, 60_000)
    columns = {"t": events.t, "x": events.x, "y": events.y, "p": events.p}
    reader = make(time_unit="ns") if kind == "nanoseconds" else make()
    if kind == "tuple":
        given_ = tuple(columns.values())
    elif kind == "dict":
        given_ = columns
    elif kind == "structured":
        given_ = np.rec.fromarrays(list(columns.values()), names="t,x,y,p")
    elif kind == "nanoseconds":
        given_ = {**columns, "t": 1_000 * events.t}
    else:
        given_ = events
    if kind == "packed":
        stamps = np.empty(len(events), np.uint32)
        write_stamps(events, stamps)
        reader.advance(LATER_US)  # which of the times that a stamp may mean is told by the time that it is
        given_ = PackedEvents(events.x, events.y, stamps)
    records = reader.push(given_) + reader.close()
    (part,) = of_kind(records, PartRecord)
    assert part.texts == ("ONE",) and part.t_first_us >= LATER_US
    assert reader.statistics.events == len(events)


def test_time_that_passes_tells_what_a_stopped_belt_would_hold_back(stream, make):
    events, gates = stream
    reader = make(triggers=TriggerConfig(longest_us=20_000))
    reader.trigger(gates[0][0], "start")
    records = reader.push(events.cut(0, int(np.searchsorted(events.t, gates[0][1]))))
    assert not of_kind(records, PartRecord)
    records = reader.advance(gates[0][0] + 200_000)
    (part,) = of_kind(records, PartRecord)
    assert part.texts == ("ONE",) and part.t_end_us == gates[0][0] + 20_000
    reader.trigger(gates[0][0] + 300_000, index=5)
    (part,) = reader.advance(gates[0][0] + 600_000)
    assert (part.trigger, part.reason_code) == (5, Reason.NOTHING_MOVES)


def test_jobs_say_whether_parts_match(stream, make):
    events, gates = stream
    jobs = {"one": JobConfig(text="ONE", codes=1), "words": JobConfig(pattern=r"[A-Z]+", symbology="QRCode")}
    reader = make(triggers=TriggerConfig(), jobs=jobs)
    reader.use("one")
    for gate in gates:
        for t, kind in zip(gate, ("start", "end"), strict=True):
            reader.trigger(t, kind)
        reader.use("words" if gate is gates[1] else "one")
    parts = of_kind(reader.push(events) + reader.close(), PartRecord)
    assert [(part.job, part.matches) for part in parts] == [("one", True), ("one", False), ("words", True)]
    assert parts[1].reason_code is not Reason.NO_MATCH  # why it is not read says more
    with pytest.raises(ValueError, match="job must be one of one, words, got 'two'"):
        reader.use("two")


@pytest.mark.parametrize(
    ("job", "mismatch"),
    [
        (JobConfig(text="TWO"), "'ONE', where 'TWO' is expected"),
        (JobConfig(pattern=r"\d+"), "'ONE' does not match"),
        (JobConfig(symbology="MicroQRCode"), "QRCode, where MicroQRCode is expected"),
        (JobConfig(codes=2), "1 of 2 codes were read"),
    ],
)
def test_what_does_not_match_says_why(job, mismatch, stream, make):
    reader = make(jobs={"": job})
    parts = of_kind(reader.push(stream[0].cut(0, 60_000)) + reader.close(), PartRecord)
    assert [(part.texts, part.matches, part.reason_code) for part in parts] == [
        (("ONE",), False, Reason.NO_MATCH)
    ]
    assert mismatch in parts[0].reason


def test_a_clock_that_is_reset_begins_a_new_epoch(stream, make):
    events, gates = stream
    end = int(np.searchsorted(events.t, gates[1][0] - 500))
    first, second = events.cut(0, end), replace(events, t=events.t - gates[0][0])
    reader = make(triggers=TriggerConfig())
    reader.trigger(*gates[0][:1], "start", 0)
    records = reader.push(first)
    reader.trigger(gates[2][0] - gates[0][0], "start", 2)
    reader.trigger(gates[2][1] - gates[0][0], "end", 2)
    records += reader.push(second) + reader.close()
    (clock,) = of_kind(records, ClockRecord)
    assert (clock.t_before_us, clock.t_after_us, clock.epoch) == (int(first.t[-1]), int(second.t[0]), 1)
    told = [(part.epoch, part.trigger, part.texts) for part in of_kind(records, PartRecord)]
    assert told == [(0, 0, ("ONE",)), (1, 2, ("TWO",))]
    assert [record.code for record in of_kind(records, ReadRecord)] == [0, 1, 2]
    assert reader.statistics.events == len(first) + len(second)


def test_a_silence_and_garbage_are_told_as_gaps(make):
    cut = noise(3_000, 20_000, width=VIEW["width"], height=VIEW["height"])
    cut = replace(cut, t=cut.t + LATER_US)
    reader = make(ReadConfig(line=LineConfig(silence_us=200_000)))
    records = reader.push(cut)
    records += reader.push(replace(cut, t=cut.t + 400_000))
    (gap,) = records
    assert (gap.t_from_us, gap.t_to_us) == (int(cut.t[-1]), int(cut.t[0]) + 400_000)
    assert (gap.reason_code, gap.dropped) == (Reason.SILENCE, 0)
    columns = {"t": cut.t + 500_000, "x": cut.x, "y": cut.y + np.uint16(500), "p": cut.p}
    (gap,) = reader.push(columns)
    assert isinstance(gap, GapRecord) and (gap.reason_code, gap.dropped) == (Reason.EVENTS_DROPPED, 3_000)
    reader.advance(LATER_US + 900_000)
    assert not reader.push(replace(cut, t=cut.t + 1_000_000))  # no silence: the source said that time passes


def test_when_there_is_too_much_to_do_searches_are_skipped_and_no_parts(stream, make):
    """By a clock that goes on twice as fast as the events come between the first two gates."""
    events, gates = stream
    wall = [0.0]
    reader = make(ReadConfig(line=LineConfig(behind_us=20_000)), triggers=TriggerConfig())
    reader._line._pace = Pace(Clocks(lambda: wall[0], lambda: wall[0]))
    triggers = [(t, kind) for gate in gates for t, kind in zip(gate, ("start", "end"), strict=True)]
    records, end = [], int(events.t[-1])
    for start in range(LATER_US, end, 1_000):
        wall[0] += 2e-3 if gates[0][1] < start < gates[1][0] else 1e-3 if start < gates[1][1] else 0.0
        while triggers and triggers[0][0] < start + 1_000:
            reader.trigger(*triggers.pop(0))
        records += reader.push(events.between(start, start + 1_000))
    records += reader.close()
    (overload,) = of_kind(records, OverloadRecord)
    assert gates[0][1] < overload.t_from_us < overload.t_to_us <= end
    assert overload.windows > 5 and overload.behind_ms > 20.0
    parts = of_kind(records, PartRecord)
    assert [(part.trigger, part.texts) for part in parts] == [(0, ("ONE",)), (1, ()), (2, ("TWO",))]
    assert parts[1].reason_code is Reason.OVERLOAD


def test_records_are_json_and_say_who_and_when(stream, make):
    reader = make(line="line 4", camera="left", sequence=100)
    records = reader.push(stream[0].cut(0, 60_000)) + reader.close()
    rows = [json.loads(record.to_json()) for record in records]
    assert [(row["record"], row["sequence"]) for row in rows] == [("read", 100), ("part", 101)]
    for row in rows:
        assert (row["line"], row["camera"], row["epoch"]) == ("line 4", "left", 0)
        assert row["t_utc"].endswith("Z") and row["latency_ms"] >= 0.0
    assert rows[0]["text"] == "ONE" and rows[1]["texts"] == ["ONE"]
    assert rows[1]["codes"][0]["corners_px"] == rows[0]["corners_px"]


def test_memory_does_not_grow_with_the_stream(make):
    """Ten seconds of noise: what is kept is of the longest window."""
    still = noise(200, 100_000, width=VIEW["width"], height=VIEW["height"])
    reader, sizes = make(triggers=TriggerConfig(after_us=5_000)), []
    for k in range(60):
        reader.trigger(100_000 * k, index=k)
        reader.push(replace(still, t=still.t + 100_000 * k))
        held = reader._line._stream._events._held
        history = reader._line._parts.history
        sizes.append((held.last - held.first, len(history.searches), len(reader._line._pace._arrivals)))
    assert max(sizes[30:])[0] <= max(sizes[:30])[0]
    assert max(row[1] for row in sizes[30:]) <= max(row[1] for row in sizes[:30])


def test_misuse_is_refused(make, stream):
    reader = make(triggers=TriggerConfig())
    with pytest.raises(TypeError, match="t_us must be a whole number of microseconds, got 1"):
        reader.trigger(1.5)
    with pytest.raises(ValueError, match="pluse"):
        reader.trigger(1, "pluse")
    with pytest.raises(UsageError, match="must have ticks"):
        reader.trigger(1, "ticks")
    with pytest.raises(TypeError, match="source must be"):
        reader.push(5)
    with pytest.raises(RecordingError, match="events must be of a sensor 200x120, got 320x240"):
        reader.push(noise(5, 5))
    with pytest.raises(UsageError, match="sensor 'big' is no size"):
        Reader("big")
    reader.close()
    for call in (lambda: reader.push(stream[0]), lambda: reader.advance(5), lambda: reader.trigger(5)):
        with pytest.raises(ValueError, match="the reader is closed"):
            call()


def test_the_same_to_be_awaited(stream, whole):
    events, gates = stream

    async def read():
        records = []
        async with AsyncReader((events.width, events.height), triggers=TriggerConfig()) as reader:
            for k, gate in enumerate(gates):
                for t, kind in zip(gate, ("start", "end"), strict=True):
                    await reader.trigger(t, kind, k)
            half = len(events) // 2
            for each in await asyncio.gather(
                reader.push(events.cut(0, half)), reader.push(events.cut(half, len(events)))
            ):
                records += each
            assert (await reader.statistics()).events == len(events)
            records += await reader.close()
            assert await reader.close() == []
            with pytest.raises(ValueError, match="the reader is closed"):
                await reader.push(events)
        return records

    assert asyncio.run(read()) == whole
