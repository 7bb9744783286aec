"""Deposits of batches: windows of any streams, sensors, motions and regions, each as alone."""

import numpy as np
import pytest
from scenes import noise
from steps import deposited

from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.window import make_window
from evqr.fit.image import cells_for
from evqr.fit.region import Region, regions_of
from evqr.motion import Motion, Motions
from evqr.workspace import Workspace
from evqr_kernels import get_backend

REGIONS = [Region(10.0, 20.0, 2.5, 48, 64), Region(-7.5, 60.0, 1.7, 64, 32), Region(100.0, 3.0, 3.1, 16, 80)]
MOTIONS = [Motion(np.array(v)) for v in ((4000.0, -900.0), (0.0, 0.0), (-250.0, 7000.0), (31.0, -1200.0))]


def since(events, start_us):
    return EventArray(events.t + start_us, events.x, events.y, events.p, events.width, events.height)


def windows():
    """Two that share events, some of others' sensors and clocks, one empty, one of a few events."""
    streams = [
        since(noise(9000, 6000, seed=1), (1 << 31) - 3000),
        since(noise(20_000, 5000, seed=2, width=640, height=480), (1 << 32) - 2000),
        since(noise(40, 3000, seed=3), -1500),
    ]
    (a, b, c) = (EventBuffer.of(stream) for stream in streams)
    first, second, third = ((stream.t[0] // 1000) * 1000 for stream in streams)
    return [
        a.window(first, first + 3500),
        a.window(first + 2000, first + 6000),
        b.window(second + 10, second + 4100),
        make_window(streams[0], first + 7000, first + 9000),
        c.window(third, third + 2000),
    ]


def cells_of(batch, motions, regions, workspace):
    return workspace.get(deposited(batch, motions, regions, workspace=workspace).device).copy()


@pytest.fixture(scope="module", params=["numpy", "warp"])
def fresh(request):
    return Workspace(get_backend(request.param), "cpu")


@pytest.mark.parametrize("count", [1, 5, 16, 128])
def test_a_window_has_in_any_batch_what_it_has_alone(count, fresh):
    """To the bit; what lies beyond its region, and beyond the windows, is zero."""
    made = windows()
    taken = [made[k % len(made)] for k in range(count)]
    motions = [MOTIONS[k % len(MOTIONS)] for k in range(count)]
    regions = [REGIONS[k % len(REGIONS)] for k in range(count)]
    together = cells_of(EventBatch.of(taken), motions, regions, fresh)
    for k in range(min(count, 60)):  # after which all repeats
        region = regions[k]
        alone = cells_of(EventBatch.of([taken[k]]), [motions[k]], [region], fresh)[0]
        own = together[k, :, : region.height, : region.width]
        np.testing.assert_array_equal(own, alone)
        assert alone.any() or len(taken[k]) < 100
        own[:] = 0
        assert not together[k].any()
    assert not together[count:].any()


def test_windows_that_are_picked_again_and_again(fresh):
    """Several places of one window, in one deposit: its events are there once."""
    batch = EventBatch.of(windows())
    picked = batch.pick([2, 2, 0])
    together = cells_of(picked, MOTIONS[:3], REGIONS, fresh)
    for k in range(3):
        alone = cells_of(EventBatch.of([picked.windows[k]]), [MOTIONS[k]], [REGIONS[k]], fresh)[0]
        np.testing.assert_array_equal(together[k, :, : REGIONS[k].height, : REGIONS[k].width], alone)


def test_fewer_windows_than_the_time_before(fresh):
    """What the rows behind held is gone."""
    batch = EventBatch.of(windows())
    cells_of(batch.pick([0, 1, 2, 4]), MOTIONS[:4], [REGIONS[0]] * 4, fresh)
    together = cells_of(batch.pick([0, 1, 2]), MOTIONS[:3], [REGIONS[0]] * 3, fresh)
    assert together[2].any() and not together[3].any()


@pytest.mark.parametrize("start_us", [(1 << 31) - 1700, (1 << 32) - 1700, -1700, 10**15])
def test_what_the_clock_shows_does_not_matter(start_us, fresh):
    events = noise(3000, 4000, seed=4)
    one, other = (make_window(since(events, t), t + 500, t + 3500) for t in (0, start_us))
    cells = [cells_of(EventBatch.of([w]), MOTIONS[:1], REGIONS[:1], fresh) for w in (one, other)]
    np.testing.assert_array_equal(*cells)
    assert cells[0].any()


def test_a_deposit_that_is_there_is_not_made_again(fresh):
    batch = EventBatch.of(windows()[:2])
    motions, regions = Motions.of(MOTIONS[:2]), regions_of([REGIONS[0]] * 2)
    cells = cells_for(regions, workspace=fresh)
    assert cells.take(batch, motions, regions)
    assert cells_for(regions.copy(), workspace=fresh) is cells
    assert not cells.take(batch.pick([0, 1]), Motions.of(MOTIONS[:2]), regions.copy())
    for changed in (
        (batch.pick([1, 0]), motions, regions),
        (batch, Motions.of(MOTIONS[1::-1]), regions),
        (batch, motions, regions + 1e-9),
    ):
        assert cells.take(*changed)


def test_motions_that_turn_are_refused(fresh):
    turning = Motion(np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0]))
    with pytest.raises(NotImplementedError, match="2 parameters, got 6"):
        deposited(EventBatch.of(windows()[:1]), [turning], REGIONS[:1], workspace=fresh)
