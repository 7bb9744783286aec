"""`read_many`: order, errors that stop nothing, and every kind of executor."""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
import sample_results
from scenes import noise, scene

from evqr.config import ReadConfig
from evqr.demo import demo_recording
from evqr.errors import RecordingError
from evqr.many import read_many
from evqr.offline import read_codes
from evqr.results import ReadResult, ReadStatus
from evqr.solver import Solver
from evqr.solvers import solvers_for


@pytest.fixture
def fake_reader(monkeypatch):
    """A reader that says the name of its source, fails for "bad", and notes its options."""
    calls = []

    def read_codes(source, **options):
        calls.append((source, options))
        if source == "bad":
            raise RecordingError("bad: the file is empty; record it again")
        if source == "bug":
            raise ZeroDivisionError("division\nby zero")
        return ReadResult(ReadStatus.NO_READ, f"read {source}", source=source)

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    return calls


def outcomes(results):
    return [(result.source, result.status, result.reason) for result in results]


EXPECTED = [
    ("a", ReadStatus.NO_READ, "read a"),
    ("bad", ReadStatus.ERROR, "bad: the file is empty; record it again"),
    ("b", ReadStatus.NO_READ, "read b"),
    ("bug", ReadStatus.ERROR, "ZeroDivisionError: division by zero"),
    ("c", ReadStatus.NO_READ, "read c"),
]


def test_serial_keeps_the_order_and_goes_on_after_errors(fake_reader):
    assert outcomes(read_many(["a", "bad", "b", "bug", "c"])) == EXPECTED


def test_serial_reads_only_what_is_asked_for(fake_reader):
    results = read_many(iter(["a", "b", "c"]))
    assert next(results).source == "a"
    assert [source for source, _ in fake_reader] == ["a"]


def test_options_reach_the_reader(fake_reader):
    options = {
        "config": object(),
        "sensor": (64, 48),
        "time_unit": "ms",
        "backend": "numpy",
        "device": "cpu",
        "threads": 3,
    }
    list(read_many(["a"], **options))
    assert fake_reader == [("a", options)]


def test_threads(fake_reader):
    with ThreadPoolExecutor(3) as executor:
        assert outcomes(read_many(["a", "bad", "b", "bug", "c"], executor=executor)) == EXPECTED


def test_results_come_in_order_of_sources_not_of_completion(monkeypatch):
    second_is_done = threading.Event()

    def read_codes(source, **options):
        if source == "first":
            assert second_is_done.wait(20)
        else:
            second_is_done.set()
        return sample_results.no_read_result()

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    with ThreadPoolExecutor(2) as executor:
        assert len(list(read_many(["first", "second"], executor=executor))) == 2


def test_leaving_early_cancels_what_has_not_begun(monkeypatch):
    begun, release = [], threading.Event()

    def read_codes(source, **options):
        begun.append(source)
        if source != "first":
            assert release.wait(20)
        return sample_results.no_read_result()

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    with ThreadPoolExecutor(1) as executor:
        results = read_many(["first", *map(str, range(20))], executor=executor)
        next(results)
        results.close()
        release.set()
    assert len(begun) <= 2  # the one that was asked for, and perhaps the next


class EndsItsWorker:
    """A source that takes its worker down on arrival."""

    def __reduce__(self):
        return os._exit, (3,)


def test_a_lost_worker_is_an_error_of_the_source(tmp_path):
    """Real processes: errors travel back, and a worker that dies raises nothing here."""
    missing = [str(tmp_path / "one.h5"), str(tmp_path / "two.h5")]
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as executor:
        first, second = read_many(missing, executor=executor)
        assert (first.source, second.source) == (missing[0], missing[1])
        assert first.status is second.status is ReadStatus.ERROR
        assert missing[0] in first.reason and "Traceback" not in first.reason
        (lost,) = read_many([EndsItsWorker()], executor=executor)
    assert lost.status is ReadStatus.ERROR
    assert "BrokenProcessPool" in lost.reason


def test_dask(fake_reader):
    distributed = pytest.importorskip("distributed", reason="extra 'distributed' is not installed")
    local = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        executor = client.get_executor()
        assert outcomes(read_many(["a", "bad", "b", "bug", "c"], executor=executor)) == EXPECTED


@pytest.fixture
def solvers_taken(monkeypatch):
    """A reader that only takes a solver; returns those that it had, in order."""
    taken = []

    def read_codes(source, *, config=None, backend="numpy", device="cpu", threads=None):
        with solvers_for(1, config, backend="numpy", device=device) as (solver,):
            taken.append(solver)
            if source == "bad":
                raise RecordingError("bad: cut short; copy it again")
        return ReadResult(ReadStatus.NO_READ, f"read {source}", source=source)

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    return taken


def test_a_solver_is_kept_for_the_next_recording_but_not_where_one_failed(solvers_taken):
    list(read_many(["a", "b", "bad", "c", "d"]))
    first, second, third, fourth, fifth = solvers_taken
    assert first is second is third
    assert fourth is fifth and fourth is not third

    list(read_many(["a"]))
    assert solvers_taken[-1] is not fifth, "kept beyond the call"


def test_a_thread_keeps_its_solver_for_as_long_as_it_is_configured_alike(solvers_taken):
    with ThreadPoolExecutor(1) as pool:
        for config in (ReadConfig(), ReadConfig(), ReadConfig(max_windows=3)):
            list(read_many(["a"], executor=pool, config=config))
    first, second, third = solvers_taken
    assert first is second and third is not second


def test_a_kept_solver_reads_to_the_bit_what_a_new_one_reads():
    with demo_recording() as path:
        (alone,) = read_many([path], config=ReadConfig(max_windows=2))
        one, other = read_many([path, path], config=ReadConfig(max_windows=2))
    assert alone.readings and alone.readings == one.readings == other.readings


@pytest.fixture
def three_at_once(monkeypatch):
    monkeypatch.setattr("evqr.many._at_once", lambda device, threads: 3)


def test_recordings_side_by_side_are_what_each_is_alone(three_at_once, monkeypatch, tmp_path):
    """As on a device; one cannot be opened, one has no code, and one waits until there is room."""
    searched, find = [], Solver.find

    def counting(self, batch, motions, **more):
        searched.append(len(batch))
        return find(self, batch, motions, **more)

    sources = [
        scene().events,
        str(tmp_path / "missing.h5"),
        noise(20_000, 5_000),
        scene(version=1, module_px=4.0, direction=30.0).events,
    ]
    one_by_one = [read_codes(sources[k]) for k in (0, 2, 3)]
    monkeypatch.setattr(Solver, "find", counting)
    first, missing, second, third = read_many(iter(sources))
    assert searched and missing.status is ReadStatus.ERROR and "missing.h5" in missing.reason
    for ours, alone in zip((first, second, third), one_by_one, strict=True):
        assert (ours.status, ours.reason_code) == (alone.status, alone.reason_code)
        assert ours.seen == alone.seen
        for one, other in zip(ours.readings, alone.readings, strict=True):
            assert (one.text, one.t_read_us, one.t_last_us) == (other.text, other.t_read_us, other.t_last_us)
    assert [first.status, second.status, third.status] == [
        ReadStatus.READ,
        ReadStatus.NO_READ,
        ReadStatus.READ,
    ]


def test_recordings_side_by_side_share_their_batches(three_at_once, monkeypatch):
    followed, follow = [], Solver.follow

    def counting(self, batch, detections, before=()):
        followed.append(len(batch))
        return follow(self, batch, detections, before)

    monkeypatch.setattr(Solver, "follow", counting)
    events = scene().events
    results = list(read_many([events] * 3))
    assert [result.readings[0].text for result in results] == ["EVQR-07"] * 3
    assert set(followed) == {3}


def test_what_fails_for_all_at_once_is_an_error_of_each(three_at_once, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(Solver, "find", broken)
    events = scene().events
    assert (
        outcomes(read_many([events, events])) == [("", ReadStatus.ERROR, "RuntimeError: out of memory")] * 2
    )
    no_backend = list(read_many([events, events], backend="no such"))
    assert [(r.status, "no such" in r.reason) for r in no_backend] == [(ReadStatus.ERROR, True)] * 2
