"""Events on the device: shared by windows of one beginning, and by no others."""

import gc
import weakref

import numpy as np
import pytest

from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.packed import PackedEvents
from evqr.events.window import make_window
from evqr.workspace import Step, Workspace
from evqr_kernels import get_backend

COUNT = 4000


@pytest.fixture
def workspace():
    return Workspace(get_backend("numpy"), "cpu")


@pytest.fixture
def events(rng):
    x, y = rng.integers(0, 100, (2, COUNT)).astype(np.uint16)
    p = rng.choice([-1, 1], COUNT).astype(np.int8)
    return EventArray(np.arange(COUNT, dtype=np.int64), x, y, p, 100, 100)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def assert_there(room, batch):
    for there, column in (
        (room.x, batch.events.x),
        (room.y, batch.events.y),
        (room.stamp, batch.events.stamp),
    ):
        np.testing.assert_array_equal(there[: len(batch.events)], column)


def of(*windows):
    return EventBatch.of(windows)


def spoil(room):
    """Whoever loads again finds another value there."""
    room.x[0] = 777


def test_windows_of_one_beginning_share_their_events(workspace, events):
    buffer = EventBuffer.of(events)
    long, short = buffer.window(500, 3500), buffer.window(500, 1500)
    room = workspace.events(of(long))
    spoil(room)
    assert workspace.events(of(short)) is workspace.events(of(short, long)) is room
    assert room.x[0] == 777
    assert_there(workspace.events(of(buffer.window(501, 1500))), of(buffer.window(501, 1500)))
    assert_there(workspace.events(of(long)), of(long))


def test_of_a_longer_window_only_the_rest_is_written(workspace, events):
    buffer = EventBuffer.of(events)
    room = workspace.events(of(buffer.window(500, 1500)))
    before = int(room.x[0])
    spoil(room)
    assert workspace.events(of(buffer.window(500, 3500))).x[0] == 777
    room.x[0] = before
    assert_there(room, of(buffer.window(500, 3500)))


@pytest.mark.parametrize("chunk", [1, 7, 600, 2500])
def test_windows_share_their_events_across_chunks(chunk, workspace, events):
    buffer = EventBuffer(events.width, events.height)
    for k in range(0, COUNT, chunk):
        buffer.push(events.cut(k, k + chunk))
    buffer.close()
    spoil(workspace.events(of(buffer.window(500, 3500))))
    assert workspace.events(of(buffer.window(500, 1500))).x[0] == 777
    assert_there(workspace.events(of(buffer.window(501, 1500))), of(buffer.window(501, 1500)))


def test_a_batch_is_loaded_once_for_all_that_is_picked_of_it(workspace, events):
    batch = of(make_window(events, 0, 50), make_window(events, 20, 90))
    room = workspace.events(batch)
    spoil(room)
    for picked in (batch.pick([1]), batch.pick([0, 0, 1]), batch.pick([])):
        assert workspace.events(picked).x[0] == 777
    assert workspace.events(of(*batch.windows)).x[0] == 777  # the same windows, in a batch made anew
    assert_there(workspace.events(of(batch.windows[0])), of(batch.windows[0]))
    assert_there(workspace.events(batch), batch)


def test_a_window_is_loaded_once(workspace, events):
    window = make_window(events, 0, 50)
    spoil(workspace.events(of(window)))
    assert workspace.events(of(window)).x[0] == 777


def test_room_grows_in_powers_of_two_and_is_kept(workspace, rng):
    def window(count):
        t, x = np.arange(count, dtype=np.int64), np.ones(count, np.uint16)
        return make_window(EventArray(t, x, x, x.astype(np.int8), 100, 100), 0, count)

    small = workspace.events(of(window(10)))
    large = workspace.events(of(window(20_000)))
    assert small.capacity < large.capacity == 1 << 15
    assert workspace.events(of(window(10))) is workspace.events(of(window(1 << 15))) is large


def test_large_room_grows_in_smaller_steps(workspace, monkeypatch):
    monkeypatch.setattr("evqr.workspace.MANY_EVENTS", 1 << 15)
    for count, capacity in ((20_000, 1 << 15), (33_000, 9 << 12), (65_000, 1 << 16), (65_537, 9 << 13)):
        workspace = Workspace(workspace.backend, "cpu")
        one = np.ones(count, np.uint16)
        packed = PackedEvents(one, one, one.astype(np.uint32))
        batch = EventBatch((), (packed,), np.zeros((0, 2), np.int32), np.zeros(0, np.int32))
        assert workspace.events(batch).capacity == capacity


@pytest.mark.parametrize("other", ["polarity", "every second", "filled again"])
def test_other_events_are_not_taken_for_the_same(other, workspace, events):
    """Windows made of arrays say nothing about what else lies in them."""
    workspace.events(of(make_window(events, 0, COUNT)))
    e = events
    if other == "polarity":
        e = EventArray(e.t, e.x, e.y, -e.p, 100, 100)
    elif other == "every second":
        e = EventArray(e.t[::2], e.x[::2], e.y[::2], e.p[::2], 100, 100)
    else:
        e.x[:] = 7
    batch = of(make_window(e, 0, COUNT))
    assert_there(workspace.events(batch), batch)


def test_windows_are_worked_on_at_once_as_long_as_they_fit(workspace, monkeypatch):
    monkeypatch.setattr("evqr.workspace.MOST_BYTES", {"host": 1000, "device": 10**6})
    assert [workspace.windows_at_once(each) for each in (1, 100, 125, 501, 2000)] == [512, 8, 8, 1, 1]
    monkeypatch.setattr(workspace, "shared", False)
    assert workspace.windows_at_once(100) == 8192


# ---- what is kept


class Owner(Step):
    """Keeps what works on its buffers."""


def test_what_was_not_used_for_longest_goes_first(workspace):
    workspace.most_kept = 3
    made = []
    for key in "abcad":
        workspace.once(key, lambda key=key: made.append(key))
    assert made == ["a", "b", "c", "d"]
    for key in "acd":
        workspace.once(key, lambda key=key: made.append(key))
    assert made == ["a", "b", "c", "d"]  # b went
    workspace.once("b", lambda: made.append("b"))
    assert made[-1] == "b"


def test_what_takes_too_much_in_all_goes(workspace, monkeypatch):
    """What was not used for longest first, until half of it is left; a few things stay whatever they take."""
    monkeypatch.setattr("evqr.workspace.MOST_KEPT_BYTES", {"host": 8000})
    monkeypatch.setattr("evqr.workspace.FEWEST_KEPT", 2)
    made = []

    def ask(name, count=500):
        workspace.once(name, lambda: (made.append(name), workspace.empty(count))[1])

    for name in "abcd":
        ask(name)  # 2000 bytes each
    ask("a")
    assert made == [*"abcd"]
    ask("e")  # 10,000 of 8000 in all: b, c and d go
    for name in "aedcb":
        ask(name)
    assert made == [*"abcde", *"dcb"]
    ask("large", 5000)
    ask("large", 5000)
    ask("larger", 5000)
    ask("large", 5000)
    assert made[-2:] == ["large", "larger"]


def test_a_workspace_goes_with_what_it_made():
    workspace = Workspace(get_backend("numpy"), "cpu")
    array, kept = workspace.empty(5), weakref.ref(workspace)
    del workspace
    gc.collect()
    assert kept() is None and array.size == 5


def test_what_works_on_buffers_of_a_step_goes_with_it(workspace):
    """No key knows an array by its address, so that none can be taken for another one's."""
    workspace.most_kept = 1
    step = workspace.once("first", lambda: Owner(workspace))
    kept = weakref.ref(step.once("what", lambda: Owner(workspace)))
    assert step.once("what", lambda: None) is kept()
    del step
    gc.collect()
    assert kept() is not None
    workspace.once("second", lambda: Owner(workspace))
    gc.collect()
    assert kept() is None
