"""An outlet delivers every record at least once, in order, or counts it; no sink holds up a line for long."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.errors import UsageError
from evqr.sinks.outlet import Outlet, WhenFull
from evqr.sinks.waiting import InMemory, Spool

QUICK = (0.001, 0.01)


class Collects:
    """A sink that fails as it is told to, before or after it has taken the records."""

    name = "collects"

    def __init__(self, plan=()):
        self.got, self.plan, self.opened = [], list(plan), 0
        self.hold = threading.Event()
        self.hold.set()

    def open(self):
        self.opened += 1
        if self.plan and self.plan[0] == "closed":
            self.plan.pop(0)
            raise OSError("nobody there")

    def write(self, records):
        assert self.hold.wait(20)
        what = self.plan.pop(0) if self.plan else "fine"
        if what in ("fine", "late"):
            self.got += [record["sequence"] if "sequence" in record else record for record in records]
        if what not in ("fine", "refused"):
            raise ConnectionError("away")
        return "no" if what == "refused" else ""

    def close(self):
        pass


def record(k):
    return {"record": "part", "sequence": k, "text": "é" * (k % 3)}


def test_a_sink_that_listens_is_opened_before_there_is_a_record():
    for failed in (0, 1):
        sink = Collects(["closed"] * failed)
        with Outlet(sink, retry_s=QUICK, at_once=True) as outlet:
            ends = time.monotonic() + 20.0
            while not sink.opened:
                assert time.monotonic() < ends
                time.sleep(0.001)
            outlet.put(record(0))
        assert sink.got == [0] and sink.opened == 1 + failed and not sink.plan


def in_order_and_whole(got, count):
    """Each arrives, first arrivals in order."""
    return list(dict.fromkeys(got)) == list(range(count))


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.sampled_from(["fine", "late", "down", "closed"]), max_size=8),
    st.integers(0, 30),
    st.booleans(),
)
def test_every_record_arrives_whatever_fails(tmp_path_factory, plan, count, on_disk):
    sink = Collects(plan)
    spool = tmp_path_factory.mktemp("spool") / "spool.db" if on_disk else None
    with Outlet(sink, spool=spool, retry_s=QUICK) as outlet:
        for k in range(count):
            outlet.put(record(k))
    status = outlet.close()
    assert in_order_and_whole(sink.got, count)
    assert (status.waiting, status.delivered, status.lost) == (0, count, 0)


def test_what_has_no_room_is_counted_and_told():
    sink = Collects()
    sink.hold.clear()
    outlet = Outlet(sink, room=3)
    for k in range(10):
        outlet.put(record(k))
    assert outlet.status.lost == 7
    sink.hold.set()
    status = outlet.close()
    assert sink.got == [0, 1, 2, {"record": "lost", "records": 7, "first": 3, "last": 9}] or (
        sink.got == [0, 1, 2] and status.lost == 7  # there was no room for that record either
    )


def test_records_lost_in_between_are_told_where_they_are_missing():
    sink = Collects()
    sink.hold.clear()
    outlet = Outlet(sink, room=2)
    for k in range(5):
        outlet.put(record(k))
    sink.hold.set()
    while outlet.status.waiting:
        time.sleep(0.001)
    outlet.put(record(5))
    outlet.close()
    assert sink.got == [0, 1, {"record": "lost", "records": 3, "first": 2, "last": 4}, 5]


def test_a_line_may_wait_instead():
    sink = Collects()
    sink.hold.clear()
    outlet = Outlet(sink, room=2, when_full=WhenFull.BLOCK)
    outlet.put(record(0))
    outlet.put(record(1))
    late = threading.Thread(target=outlet.put, args=(record(2),))
    late.start()
    late.join(0.05)
    assert late.is_alive()
    sink.hold.set()
    late.join(10)
    assert outlet.close().delivered == 3 and sink.got == [0, 1, 2]


def test_what_is_refused_is_not_sent_again():
    sink = Collects(["refused"])
    with Outlet(sink, retry_s=QUICK) as outlet:
        outlet.put(record(0))
        while not outlet.status.refused:
            time.sleep(0.001)
        outlet.put(record(1))
    assert sink.got == [1] and outlet.status.refused == 1


def test_a_sink_that_stays_away_does_not_keep_the_program(tmp_path):
    sink = Collects(["closed"] * 100_000)
    outlet = Outlet(sink, spool=tmp_path / "spool.db", retry_s=QUICK)
    outlet.put(record(0))
    began = time.monotonic()
    status = outlet.close(timeout_s=0.1)
    assert time.monotonic() - began < 5
    assert (status.waiting, status.up, status.error) == (1, False, "nobody there")
    again = Collects()
    Outlet(again, spool=tmp_path / "spool.db").close()
    assert again.got == [0]
    with pytest.raises(ValueError, match="collects is closed"):
        outlet.put(record(1))


KILLED = """
import os, sys
from evqr.sinks.waiting import Spool
spool = Spool(sys.argv[1], 1 << 20)
for k in range(50):
    assert spool.put({"record": "part", "sequence": k})
    print(k, flush=True)
    if k == 30:
        os.kill(os.getpid(), 9)
"""


def test_a_spool_outlives_a_kill(tmp_path):
    path = tmp_path / "spool.db"
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True)
    assert killed.returncode == -9 and killed.stdout.split()[-1] == "30"
    spool = Spool(path, 1 << 20)
    assert [each["sequence"] for each in spool.first(100)] == list(range(31))
    spool.close()


@settings(max_examples=20, deadline=None)
@given(st.lists(st.one_of(st.just("put"), st.integers(0, 4)), max_size=25))
def test_a_spool_is_a_queue(tmp_path_factory, steps):
    """The same as in memory, across being closed and opened; its bytes are counted right."""
    path = tmp_path_factory.mktemp("spool") / "spool.db"
    spool, model, added = Spool(path, 400), InMemory(10_000), 0
    for step in steps:
        if step == "put":
            if spool.put(record(added)):
                model.put(record(added))
            added += 1
        else:
            count = min(step, len(model))
            if count:
                spool.done(count)
                model.done(count)
        assert spool.first(100) == model.first(100) and len(spool) == len(model)
    spool.close()
    again = Spool(path, 400)
    assert again.first(100) == model.first(100) and len(again) == len(model)
    if model.first(100):
        again.done(len(model))
    assert again.put({"record": "part", "text": "x" * 300}) and not again.put(
        {"record": "x", "text": "x" * 300}
    )
    again.close()


def test_a_spool_that_is_something_else(tmp_path):
    path = tmp_path / "spool.db"
    path.write_bytes(b"this is no database, whatever its name says")
    with pytest.raises(UsageError, match=r"spool\.db: cannot be used"):
        Outlet(Collects(), spool=path)


def test_a_disk_that_is_full_while_it_runs_stops_nothing_and_is_told(tmp_path):
    """What found no room is counted, and told once there is some; what was taken arrives."""
    sink = Collects()
    sink.hold.clear()
    with Outlet(sink, spool=tmp_path / "spool", retry_s=QUICK) as outlet:
        spool = outlet._waiting
        assert isinstance(spool, Spool)
        disk = spool._file.db
        (pages,) = disk.execute("PRAGMA page_count").fetchone()
        disk.execute(f"PRAGMA max_page_count = {pages + 3}")
        for k in range(40):
            outlet.put({**record(k), "text": "x" * 2_000})
        full = outlet.status
        disk.execute("PRAGMA max_page_count = 100000")
        outlet.put(record(40))
        sink.hold.set()
    assert 0 < full.lost < 40 and "full" in full.error
    lost = [each for each in sink.got if isinstance(each, dict)]
    missing = [k for each in lost for k in range(each["first"], each["last"] + 1)]
    assert sum(each["records"] for each in lost) == len(missing) == full.lost
    arrived = [each for each in sink.got if not isinstance(each, dict)]
    assert sorted({*arrived, *missing}) == list(range(41)) and 40 in arrived
