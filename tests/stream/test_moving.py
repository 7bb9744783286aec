"""What moves in a stream: not what several parts look like that pass one behind the other."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import joined, noise, scene

from evqr.events.buffer import EventBuffer
from evqr.fit.detection import NotFound
from evqr.motion import Motion
from evqr.search.motion_estimate import MotionEstimate
from evqr.solver import Solver
from evqr.stream.moving import Moving
from evqr.stream.records import CodeAgain, CodeRead
from evqr.stream.scheduler import StreamScheduler
from evqr.work import answer, with_windows

VIEW = {"width": 200, "height": 120}
MS = 1_000


@pytest.fixture(scope="module")
def solver():
    return Solver()


@pytest.fixture(scope="module")
def parts():
    made = {"module_px": 4.0, "version": 1, "travel_px": 24.0, "speed_px_ms": 4.0, "direction": 0.0}
    return [scene(f"LOT-{k}", seed=k, **made, **VIEW).events for k in range(2)]


def moving_in(events, solver):
    buffer = EventBuffer.of(events)
    return Moving(buffer, events.width, events.height, solver, lambda: None), buffer


@pytest.mark.parametrize("gap_us", [8 * MS, 14 * MS])
def test_parts_that_come_closer_than_the_longest_window_are_all_read(gap_us, parts, solver):
    count, stream, t_us, read = 8, StreamScheduler([solver], **VIEW), 0, set()
    for k in range(count):
        quiet, part = noise(gap_us // 30, gap_us, seed=k, **VIEW), parts[k % 2]
        period_us = gap_us + 6 * MS
        stream.push(replace(quiet, t=quiet.t + t_us))
        stream.push(replace(part, t=part.t + t_us + gap_us))
        t_us += period_us
        for record in [*stream.step(), *(stream.close() if k == count - 1 else [])]:
            if isinstance(record, CodeRead):
                read.add(record.reading.t_first_us // period_us)
            elif isinstance(record, CodeAgain):
                read.add(record.t_first_us // period_us)
    assert read == set(range(count))


def test_a_part_at_the_same_place_again_is_nothing_that_is_slow(parts, solver):
    once = parts[0]
    twice = joined(once, once, gap_us=14 * MS)
    moving, buffer = moving_in(twice, solver)
    at_us = 13 * MS  # between them; both are in a window that begins with the first
    assert buffer.first_from(at_us) > at_us + MS
    moving.patient = True
    found, _, _ = answer(with_windows(moving.at(5 * MS + 500, None), buffer), solver)
    assert isinstance(found, NotFound) or found.motion.speed > 2_000.0


def test_what_is_faster_is_told_from_what_was_seen(parts, solver):
    still = noise(3_000, 20 * MS, **VIEW)
    stream = joined(still, parts[0], gap_us=0)
    moving, buffer = moving_in(stream, solver)

    def next_us(speed):
        seen = Motion(np.array([speed, 0.0]))
        return answer(with_windows(moving.faster(seen, 10 * MS, 25 * MS, 2 * MS), buffer), solver)

    assert 20 * MS - MS <= next_us(200.0) <= 23 * MS
    assert next_us(3_000.0) == 25 * MS


def test_a_young_stream_is_not_waited_for(parts, solver):
    """What is fast comes within milliseconds; what is slow when there have been enough events."""
    asked = []
    moving, buffer = moving_in(noise(6_000, 60 * MS, **VIEW), solver)
    for at_us in (0, 20 * MS):
        asking, given = moving.at(at_us, None), None
        with pytest.raises(StopIteration) as end:
            while True:
                bounds = asking.send(given)
                if isinstance(bounds, list):
                    given = answer(iter_of(bounds), solver)
                else:
                    asked.append(bounds)
                    given = buffer.window(*bounds)
        assert isinstance(end.value.value[0], NotFound)
    assert max(end_us for _, end_us in asked) == 21 * MS
    assert {end - start for start, end in asked} == {MS, 4 * MS, 16 * MS}


def iter_of(works):
    return (yield works)


def test_the_window_that_told_is_told(parts, solver):
    moving, buffer = moving_in(parts[0], solver)
    found, start_us, end_us = answer(with_windows(moving.at(2 * MS, None), buffer), solver)
    assert isinstance(found, MotionEstimate)
    assert start_us <= found.motion.time_us <= end_us
