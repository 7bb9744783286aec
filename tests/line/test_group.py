"""Readers of many cameras: each gives what a reader of its own would, in processes and in one batch."""

import os
import signal
import time
from dataclasses import replace

import pytest
from scenes import joined, noise, scene

from evqr import Reader, ReaderGroup, TriggerConfig, UsageError
from evqr.errors import BackendError, RecordingError
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.ledger import Ledger
from evqr.line.records import GapRecord, PartRecord
from evqr.reason import Reason
from evqr.work import do

VIEW = {"width": 200, "height": 120, "direction": 0.0}
SIZE = VIEW["width"], VIEW["height"]
TRIGGERS = TriggerConfig(after_us=8_000)
FIRST_US, NEXT_US = 30_000, 100_000


@pytest.fixture(scope="module")
def streams():
    """Of two cameras, each with two parts, the second of which has no code; the pushes of each."""

    def passing(text):
        still = noise(1_500, FIRST_US, width=VIEW["width"], height=VIEW["height"])
        code = scene(text=text, version=1, module_px=4.0, travel_px=24.0, **VIEW).events
        events = joined(still, code, still)
        return [events.cut(0, 9_000), events.cut(9_000, 40_000), events.cut(40_000, len(events))]

    return {"left": passing("ONE"), "right": passing("TWO")}


def fed(reader, name, chunks, *camera):
    """Push a stream, each trigger before the events of its time."""
    reader.trigger(*camera, FIRST_US)
    records = []
    for chunk in chunks:
        records += reader.push(*camera, chunk)
    records += reader.interrupt(*camera, f"{name} was unplugged")
    reader.trigger(*camera, NEXT_US, ticks=3.0)
    return records + reader.advance(*camera, NEXT_US + 20_000)


@pytest.fixture(scope="module")
def alone(streams):
    """What each camera's own reader gives."""
    found = {}
    for name, chunks in streams.items():
        reader = Reader(SIZE, triggers=TRIGGERS, camera=name)
        found[name] = fed(reader, name, chunks) + reader.close()
    texts = [record.texts for record in found["left"] if isinstance(record, PartRecord)]
    assert texts == [("ONE",), ()]
    return found


def of(records, name):
    return [record for record in records if record.camera == name]


def until(condition):
    ends = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.01)


def test_all_in_one_process_are_what_each_is_alone(streams, alone, monkeypatch):
    most = []
    monkeypatch.setattr("evqr.work.do", lambda works, *rest: most.append(len(works)) or do(works, *rest))
    records = []
    with ReaderGroup(dict.fromkeys(streams, SIZE), triggers=TRIGGERS, mode="together") as group:
        for name in streams:
            group.trigger(name, FIRST_US)
        for chunks in zip(*streams.values(), strict=True):
            for name, chunk in zip(streams, chunks, strict=True):
                records += group.push(name, chunk)
        for name in streams:
            records += group.interrupt(name, f"{name} was unplugged")
            group.trigger(name, NEXT_US, ticks=3.0)
            records += group.advance(name, NEXT_US + 20_000)
        records += group.close()
        assert group.close() == []
    for name, chunks in streams.items():
        assert of(records, name) == alone[name]
        assert group.statistics[name].events == sum(map(len, chunks))
    assert max(most) >= 2  # what both asked for was done at once


def test_a_process_each_and_one_that_is_killed(streams, alone):
    """What the one is does not depend on the other, whose parts are all told."""
    with ReaderGroup(
        dict.fromkeys(streams, "200x120"), triggers=TRIGGERS, jobs={}, mode="processes"
    ) as group:
        records = fed(group, "left", streams["left"], "left")
        group.trigger("right", FIRST_US)
        group.trigger("right", FIRST_US + 1)
        until(lambda: len(group._ledgers["right"]._owed) == 2)
        doomed = group._lanes["right"].worker.process
        os.kill(doomed.pid, signal.SIGKILL)
        records += group.push("right", streams["right"][0])
        until(lambda: records.extend(group.poll(0.1)) or len(of(records, "right")) == 3)
        assert group._lanes["right"].worker.process is not doomed
        group.trigger("right", FIRST_US)
        for chunk in streams["right"][1:]:
            records += group.push("right", chunk)
        records += group.close()
    assert of(records, "left") == alone["left"]
    assert group.statistics["left"].windows == group.statistics["left"]["windows"] > 0
    assert group.statistics["right"].events == sum(map(len, streams["right"][1:]))  # the first was lost
    right = of(records, "right")
    assert [record.sequence for record in right] == list(range(len(right)))
    (gap,) = [record for record in right if isinstance(record, GapRecord)]
    assert gap.reason_code is Reason.WORKER_LOST and "exit status -9" in gap.reason
    parts = [record for record in right if isinstance(record, PartRecord)]
    assert [(part.part, part.trigger, part.texts) for part in parts] == [
        (0, 0, ()), (1, 1, ()), (2, 2, ("TWO",)),
    ]  # fmt: skip
    assert {part.reason_code for part in parts[:2]} == {Reason.WORKER_LOST}


def test_what_is_refused_is_raised_by_a_later_call_and_loses_nothing(streams):
    group = ReaderGroup(
        {"left": SIZE, "right": (64, 48)}, triggers=TRIGGERS, mode="together", backend="numpy"
    )
    group.push("left", noise(10, 100, width=64, height=48))
    with pytest.raises(RecordingError, match="events must be of a sensor 200x120, got 64x48"):
        group.poll(10.0)
    group.trigger("left", 5, index=8)
    (part,) = group.close()
    assert (part.camera, part.trigger, part.texts) == ("left", 8, ())
    with pytest.raises(ValueError, match="the group is closed"):
        group.advance("left", 3)


def test_misuse_is_refused():
    with pytest.raises(ValueError, match="cameras must name one at least"):
        ReaderGroup({})
    with pytest.raises(ValueError, match="mode must be 'auto', 'processes' or 'together', got 'threads'"):
        ReaderGroup({"a": SIZE}, mode="threads")  # pyright: ignore[reportArgumentType]
    with pytest.raises(UsageError, match="sensor"):
        ReaderGroup({"a": "wide"})
    with pytest.raises(BackendError, match="cuda:99"):
        ReaderGroup({"a": SIZE}, backend="numpy", device="cuda:99")
    with ReaderGroup({"a": SIZE, "b": SIZE}, mode="together", backend="numpy") as group:
        with pytest.raises(ValueError, match="camera must be one of a, b, got 'c'"):
            group.push("c", [])
        with pytest.raises(ValueError, match="triggers must be set where there are any"):
            group.trigger("a", 3)
        with pytest.raises(ValueError, match="job must be one of none, got 'x'"):
            group.use("a", "x")
        with pytest.raises(TypeError, match="whole number"):
            group.advance("a", 0.5)  # pyright: ignore[reportArgumentType]


def test_a_ledger_knows_what_is_owed():
    ledger = Ledger("L", "a", 7, {"job"})
    ledger.job = "job"
    first, second = (ledger.numbered(Trigger(t)) for t in (10, 20))
    assert (first.index, second.index) == (0, 1)
    end = ledger.numbered(Trigger(40, TriggerKind.END))
    for trigger in (first, second, end):
        ledger.owe(trigger)
    assert end.index is None and ledger.numbered(Trigger(50)).index == 2  # which waits in its queue
    (again,) = ledger.take([PartRecord(sequence=0, part=0, trigger=0, epoch=2)], 50)
    assert (again.sequence, again.epoch) == (7, 2)
    gap, part = ledger.lost("exit status 1")
    assert (gap.sequence, gap.t_from_us, gap.epoch, part.sequence) == (8, 50, 2, 9)
    assert (part.part, part.trigger, part.job, part.matches) == (1, 1, "job", False)
    assert ledger.lost("exit status 1") == []
    (again,) = ledger.take([replace(again, sequence=0, epoch=0)], 60)
    assert (again.sequence, again.part, again.epoch) == (10, 2, 2)
