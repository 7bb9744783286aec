"""The backend that counts: what computes on it must bring all that it needs there and back, as on a GPU."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import find, middle_us, motion_at, scene, windows_of_many_kinds

from evqr import ReadConfig, read_windows
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.packed import PackedEvents
from evqr.events.window import make_window
from evqr.fit.detection import NotFound
from evqr.solver import Solver
from evqr.symbology import Symbology
from evqr.workspace import Staging, Workspace
from evqr_kernels import register_backend, registry

sys.path.insert(0, str(Path(__file__).parents[2] / "perf"))

import counting

pytest.importorskip("warp")


@pytest.fixture
def counting_over_warp(monkeypatch):
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_loaded", dict(registry._loaded))
    register_backend("counting", "counting:load_over_warp")
    kinds = (Symbology.QR_CODE, Symbology.MICRO_QR_CODE)  # what the counts below are of
    return Solver(ReadConfig(symbologies=kinds), backend="counting")


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
    solver = Solver(counting_over_warp.config, backend="warp")
    solver.workspace.shared = False  # what a device is asked at once
    one, other = found_and_followed(counting_over_warp), found_and_followed(solver)
    for ours, theirs in zip(one[:2], other[:2], strict=True):
        np.testing.assert_array_equal(ours.pose, theirs.pose)
        assert ours.score == theirs.score
    np.testing.assert_array_equal(one[2].q, other[2].q)


def test_a_followed_window_is_recorded_sequences_alone(counting_over_warp):
    counts, _ = counting.counted(counting_over_warp, lambda: found_and_followed(counting_over_warp))
    assert counts.launches == 0 and counts.graphs > 0
    assert counts.recorded == sum(counts.kernels.values())
    assert counts.kernels["deposit_packed_events"] >= 2


def tracked(solver, batch, before):
    return solver.follow(batch, [before] * len(batch), [before.weighted] * len(batch))


@pytest.mark.parametrize("count", [1, 5])
def test_what_is_copied_does_not_grow_with_the_batch(count, counting_over_warp):
    """A batch that is followed and solved with earlier windows: once there, in one sequence, once back."""
    solver, made = counting_over_warp, scene(preset="fast")
    buffer, start = EventBuffer.of(made.events), middle_us(made) - 250
    window = buffer.window(start, start + 500)
    before = find(solver, window, motion_at(made.truth["truth"], window.middle_us))

    def run():
        later = buffer.window(start + 500, start + 1000)
        # events of their own, as of several cameras
        windows = [make_window(later.events, later.start_us, later.end_us) for _ in range(count)]
        return tracked(solver, EventBatch.of(windows), before)

    counts, followed = counting.counted(solver, run)
    assert all(each.score > 0.8 and each.fused for each in followed)
    assert (counts.uploads, counts.downloads) == (1, 1)
    assert counts.launches == 0 and counts.graphs == 1


def test_a_search_does_not_launch_more_for_more_windows(counting_over_warp):
    made = scene(preset="fast")
    buffer, start = EventBuffer.of(made.events), middle_us(made) - 250
    window = buffer.window(start, start + 500)
    motion = motion_at(made.truth["truth"], window.middle_us)
    counted = []
    for count in (1, 17):
        found = []

        def run(count=count, found=found):
            windows = [make_window(window.events, window.start_us, window.end_us) for _ in range(count)]
            found[:] = counting_over_warp.find(EventBatch.of(windows), [motion] * count)

        counts, _ = counting.counted(counting_over_warp, run)
        assert all(codes[0].score > 0.8 for codes in found)
        counted.append((counts.recorded, counts.launches, counts.uploads, counts.downloads))
    assert counted[0] == counted[1]
    recorded, launches, uploads, downloads = counted[0]
    assert recorded <= 46 and launches == 0 and uploads == downloads <= 7  # with lags


def test_nor_where_windows_differ_and_some_show_nothing(counting_over_warp):
    """Codes in several sizes on several sensors, noise, and no events at all: all of a search but lags."""
    windows, motions = windows_of_many_kinds()
    counted = []
    for times, thorough in ((1, False), (1, True), (3, True)):
        found = []

        def run(times=times, thorough=thorough, found=found):
            again = [make_window(w.events, w.start_us, w.end_us) for _ in range(times) for w in windows]
            found[:] = counting_over_warp.find(EventBatch.of(again), times * motions, thorough=thorough)

        counts, _ = counting.counted(counting_over_warp, run)
        assert [isinstance(each, NotFound) for each in found] == times * (5 * [False] + 4 * [True])
        counted.append((counts.recorded, counts.launches, counts.uploads, counts.downloads))
    assert counted[1] == counted[2]
    recorded, launches, uploads, downloads = counted[0]
    assert recorded <= 37 and launches == 0 and uploads == downloads <= 6
    recorded, launches, uploads, downloads = counted[1]  # with tilted codes, hidden patterns, small modules
    assert recorded <= 60 and launches == 0 and uploads == downloads <= 13


def test_a_sequence_has_one_copy_each_way():
    backend = counting.CountingBackend()
    workspace = Workspace(backend, "cpu")
    staging = Staging(workspace)
    weight = staging.input((1, 1))
    images = staging.both((1, 1, 4, 8), value=np.arange(8.0))
    first, mixed = staging.input((1,), np.int32), staging.output((1, 4, 8))
    run = staging.sequence(
        lambda: backend.mix_images(images.device, first.device, weight.device, mixed.device)
    )
    backend.counts = counting.Counts()
    weight.write(2.0)
    images.host[..., 0] = 5.0
    for times in (1, 2):
        run()
        assert backend.counts.uploads == times
        np.testing.assert_array_equal(mixed.read()[0], [[10, 2, 4, 6, 8, 10, 12, 14]] * 4)
        np.testing.assert_array_equal(images.read()[0, 0], [[5, 1, 2, 3, 4, 5, 6, 7]] * 4)
        assert backend.counts.downloads == times
    assert backend.counts.graphs == 2
    assert backend.counts.up_bytes == 2 * (64 + 64 + 128) and backend.counts.down_bytes == 2 * (128 + 128)


def test_events_are_copied_at_once_or_where_few_are_there_by_column():
    backend = counting.CountingBackend()
    workspace = Workspace(backend, "cpu")

    def copies(count):
        one = np.full(count, count % 60_000, np.uint16)
        events = PackedEvents(one, one + np.uint16(1), one.astype(np.uint32) + 2)
        batch = EventBatch((), (events,), np.zeros((0, 2), np.int32), np.zeros(0, np.int32))
        backend.counts = counting.Counts()
        room = workspace.events(batch)
        room.push(inputs)
        block, first = room.before(len(inputs))
        np.testing.assert_array_equal(workspace.get(block)[first : first + len(inputs)], inputs)
        for column, values in ((room.x, events.x), (room.y, events.y), (room.stamp, events.stamp)):
            np.testing.assert_array_equal(workspace.get(column)[:count], values)
        counts = backend.counts.uploads, backend.counts.up_bytes
        room.push(inputs)
        assert backend.counts.uploads == counts[0] + 1  # events are there
        return counts

    inputs = np.arange(1, 33, dtype=np.uint32)
    assert not workspace.shared
    assert copies(10_000) == (1, 128 + 4 * (1 << 14) + 40_000)
    assert copies(1_000_000)[0] == 2  # room is made, too
    assert copies(900_000) == (1, 128 + 4 * (1 << 20) + 3_600_000)
    assert copies(100_000) == (3, 128 + 800_000)


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


def test_windows_are_read_side_by_side_where_arrays_are_not_the_hosts(counting_over_warp):
    """And say what they say one by one."""
    events, config = scene(preset="fast", travel_px=30.0).events, ReadConfig(max_windows=6)

    def read():
        return list(read_windows(events, config=config, backend="counting"))

    at_once = read()
    counts, _ = counting.counted(counting_over_warp, read)
    one_by_one = list(read_windows(events, config=config, backend="warp"))
    assert [w.text for w in at_once] == [w.text for w in one_by_one] == ["EVQR-07"] * 6
    for ours, theirs in zip(at_once, one_by_one, strict=True):
        assert (ours.t_start_us, ours.t_end_us) == (theirs.t_start_us, theirs.t_end_us)
        np.testing.assert_allclose(ours.affine, theirs.affine, atol=1e-3)
    # one search of all, their hypotheses scored at once; motions coarsely and precisely
    assert counts.kernels["local_maxima"] == counts.kernels["score_poses"] == 1
    assert counts.kernels["surface_peak"] == 2
