"""The backend that counts: what computes on it must bring all that it needs there and back, as on a GPU."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import find, middle_us, motion_at, scene

from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.solver import Solver
from evqr_kernels import register_backend, registry

sys.path.insert(0, str(Path(__file__).parents[2] / "perf"))

import counting

pytest.importorskip("warp")


@pytest.fixture
def counting_over_warp(monkeypatch):
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_loaded", dict(registry._loaded))
    register_backend("counting", "counting:load_over_warp")
    return Solver(backend="counting")


def found_and_followed(solver):
    made = scene(preset="fast")
    buffer, start = EventBuffer.of(made.events), middle_us(made) - 250
    window = buffer.window(start, start + 500)
    detection = find(solver, window, motion_at(made.truth["truth"], window.middle_us))
    (followed,) = solver.follow(EventBatch.of([buffer.window(start + 500, start + 1000)]), [detection])
    (estimate,) = solver.solve([followed])
    return detection, followed, estimate


def test_nothing_lives_on_memory_that_the_host_shares(counting_over_warp):
    """A window from cold and one that is followed: the same as where arrays are the host's."""
    one, other = found_and_followed(counting_over_warp), found_and_followed(Solver(backend="warp"))
    for ours, theirs in zip(one[:2], other[:2], strict=True):
        np.testing.assert_array_equal(ours.pose, theirs.pose)
        assert ours.score == theirs.score
    np.testing.assert_array_equal(one[2].q, other[2].q)


def test_a_followed_window_is_recorded_sequences_alone(counting_over_warp):
    counts, _ = counting.counted(counting_over_warp, lambda: found_and_followed(counting_over_warp))
    assert counts.launches == 0 and counts.graphs > 0
    assert counts.recorded == sum(counts.kernels.values())
    assert counts.kernels["deposit_packed_events"] >= 2
    assert counts.uploads > 6 and counts.downloads > 1  # three columns of two windows, among them


def test_kernels_are_those_of_a_gpu_and_copies_are_copies():
    backend = counting.CountingBackend()
    ones = np.ones((2, 3, 40, 40), np.float32)
    there = backend.from_host(ones, "cpu")
    ones[:] = 7.0
    back = backend.to_host(there)
    back[:] = 5.0
    np.testing.assert_array_equal(backend.to_host(there), 1.0)
    assert (backend.counts.uploads, backend.counts.downloads) == (1, 2)
    assert (backend.counts.up_bytes, backend.counts.down_bytes) == (ones.nbytes, 2 * ones.nbytes)

    deposit, rows = there[:1, :2], backend.empty((1, 2, 40, 40), np.float32, "cpu")
    image, first = backend.empty((1, 40, 40), np.float32, "cpu"), np.zeros(1, np.int32)
    direction, taps = np.array([[1, 0]], np.float32), np.ones((2, 5), np.float32)
    extent = np.array([[40, 40]], np.int32)
    given = [backend.from_host(a, "cpu") for a in (first, direction, 0 * direction, taps, extent)]

    def launch():
        backend.clear(image)
        backend.lag_operator(deposit, *given, rows, image)

    replay = backend.record(launch)
    assert backend.counts.recorded == backend.counts.launches == 0
    replay()
    replay()
    assert (backend.counts.graphs, backend.counts.recorded) == (2, 6)
    launch()
    assert backend.counts.launches == 3
    assert backend.counts.kernels == {"clear": 3, "lag_operator": 6}
    assert backend.to_host(image)[0, 20, 20] == 50.0
