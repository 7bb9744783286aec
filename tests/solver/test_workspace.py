"""Events on the device: shared by windows of one beginning, and by no others."""

import gc
import weakref

import numpy as np
import pytest

from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
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


def assert_there(slots, window):
    count = len(window)
    for there, column in ((slots.x, window.x), (slots.y, window.y), (slots.p, window.p)):
        np.testing.assert_array_equal(there[:count], column)
    np.testing.assert_array_equal(slots.t[:count], window.events.t - window.middle_us)


def test_windows_of_one_beginning_share_their_events(workspace, events):
    buffer = EventBuffer.of(events)
    long, short = buffer.window(500, 3500), buffer.window(500, 1500)
    slots = workspace.events(long)
    slots.x[0] = -7.0  # whoever loads again finds another value there
    assert workspace.events(short) is slots
    assert slots.x[0] == -7.0
    np.testing.assert_array_equal(slots.t[: len(short)], short.events.t - short.middle_us)
    assert_there(workspace.events(buffer.window(501, 1500)), buffer.window(501, 1500))
    assert_there(workspace.events(buffer.window(500, 3600)), buffer.window(500, 3600))


@pytest.mark.parametrize("chunk", [1, 7, 600, 2500])
def test_windows_share_their_events_across_chunks(chunk, workspace, events):
    buffer = EventBuffer(events.width, events.height)
    for k in range(0, COUNT, chunk):
        buffer.push(events.cut(k, k + chunk))
    buffer.close()
    slots = workspace.events(buffer.window(500, 3500))
    slots.x[0] = -7.0
    assert workspace.events(buffer.window(500, 1500)).x[0] == -7.0
    assert_there(workspace.events(buffer.window(501, 1500)), buffer.window(501, 1500))


def test_a_window_is_loaded_once(workspace, events):
    window = make_window(events, 0, 50)
    slots = workspace.events(window)
    slots.x[0] = -7.0
    assert workspace.events(window).x[0] == -7.0


@pytest.mark.parametrize("other", ["polarity", "every second", "filled again"])
def test_other_events_are_not_taken_for_the_same(other, workspace, events):
    """Windows made of arrays say nothing about what else lies in them."""
    workspace.events(make_window(events, 0, COUNT))
    e = events
    if other == "polarity":
        e = EventArray(e.t, e.x, e.y, -e.p, 100, 100)
    elif other == "every second":
        e = EventArray(e.t[::2], e.x[::2], e.y[::2], e.p[::2], 100, 100)
    else:
        e.x[:] = 7
    window = make_window(e, 0, COUNT)
    assert_there(workspace.events(window), window)


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


def test_what_works_on_buffers_of_a_step_goes_with_it(workspace):
    """No key knows an array by its address, so that none can be taken for another one's."""
    workspace.most_kept = 1
    step = workspace.once("first", lambda: Owner(workspace.backend))
    kept = weakref.ref(step.once("what", lambda: Owner(workspace.backend)))
    assert step.once("what", lambda: None) is kept()
    del step
    gc.collect()
    assert kept() is not None
    workspace.once("second", lambda: Owner(workspace.backend))
    gc.collect()
    assert kept() is None
