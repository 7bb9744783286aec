"""Times by stage, and work that is done once as a stage of its own."""

import threading
import time

import pytest

import evqr
from evqr.clock import ONE_TIME, StageClock, one_time, utc_text


@pytest.fixture
def ticking(monkeypatch):
    """A clock that only goes on when it is told to: gives the function that does so [ms]."""
    now = [0.0]

    def wait(ms):
        now[0] += ms * 1e-3

    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return wait


def test_what_is_done_once_is_no_part_of_the_stage_in_which_it_is_done_first(ticking):
    clock = StageClock()
    with clock("finder"):
        ticking(1)
        with one_time():
            ticking(10)
            with one_time():  # as a step that is made of other steps
                ticking(100)
        ticking(2)
    with clock("finder"):
        ticking(4)
    assert clock.ms == pytest.approx({"finder": 7.0, ONE_TIME: 110.0})
    assert clock.total()["total"] == pytest.approx(117.0)


def test_it_is_counted_once_however_stages_lie_in_each_other(ticking):
    inner, outer = StageClock(), StageClock()
    with outer("pose"):
        with inner("lag"), one_time():
            ticking(10)
        with one_time():
            ticking(5)
    assert inner.ms == pytest.approx({"lag": 0.0, ONE_TIME: 10.0})
    assert outer.ms[ONE_TIME] == pytest.approx(5.0)


def test_what_fails_is_counted_too(ticking):
    clock = StageClock()
    with pytest.raises(ZeroDivisionError), clock("decode"), one_time():
        ticking(3)
        raise ZeroDivisionError
    assert clock.ms == pytest.approx({"decode": 0.0, ONE_TIME: 3.0})


def test_threads_do_not_count_each_others(ticking):
    clock = StageClock()

    def other():
        with one_time():
            ticking(10)

    with clock("motion"):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        ticking(1)
    assert clock.ms == pytest.approx({"motion": 11.0})


def test_a_reading_tells_of_it_within_its_total():
    from evqr.demo import demo_recording

    with demo_recording() as path:
        result = evqr.read_codes(path, config=evqr.ReadConfig(max_windows=3))
    stages = {name: ms for name, ms in result.compute_ms.items() if name != "total"}
    assert 0.0 < stages[ONE_TIME] < result.compute_ms["total"]
    assert sum(stages.values()) <= result.compute_ms["total"]


def test_times_in_utc_are_written_in_one_way():
    assert utc_text(0.0) == "1970-01-01T00:00:00.000Z"
    assert utc_text(1_790_000_000.1256) == "2026-09-21T14:13:20.125Z"
    assert utc_text()[:4] >= "2026" and utc_text().endswith("Z")
