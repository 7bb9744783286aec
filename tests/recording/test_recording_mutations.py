"""Damaged files give the right events, others that pass all checks, or a `RecordingError`; nothing else."""

import time
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_files import HEIGHT, WIDTH, WRITERS, assert_same_events, make_events
from vendor_files import FORMATS, write

from evqr.errors import RecordingError
from evqr.recording import open_recording

EVENTS = make_events(120)
KINDS = [*WRITERS, *(FORMATS if find_spec("eventcv") else ())]

position = st.floats(0, 1, exclude_max=True)
mutation = st.one_of(
    st.tuples(st.just("cut"), position, st.integers(1, 40)),
    st.tuples(st.just("flip"), position, st.integers(0, 7)),
    st.tuples(st.just("insert"), position, st.binary(min_size=1, max_size=12)),
    st.tuples(st.just("end"), position, st.none()),
)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Bytes of a good file of every format."""
    folder = tmp_path_factory.mktemp("good")
    for kind in KINDS:
        if kind in WRITERS:
            WRITERS[kind](folder / kind, EVENTS)
        else:
            write(kind, folder / kind, EVENTS)
    return {kind: (folder / kind).read_bytes() for kind in KINDS}


def mutated(data: bytes, mutations) -> bytes:
    for what, where, how in mutations:
        at = int(where * len(data))
        if what == "cut":
            data = data[:at] + data[at + how :]
        elif what == "flip" and data:
            data = data[:at] + bytes([data[at] ^ 1 << how]) + data[at + 1 :]
        elif what == "insert":
            data = data[:at] + how + data[at:]
        elif what == "end":
            data = data[:at]
    return data


def read_or_explain(path):
    """Read events, or return None after an error in the one allowed form."""
    started = time.monotonic()
    try:
        with open_recording(path, sensor=(WIDTH, HEIGHT)) as recording:
            events = recording.read()
    except RecordingError as error:
        assert str(error).startswith(str(path))
        assert "\n" not in str(error)
        events = None
    assert time.monotonic() - started < 5
    return events


@pytest.mark.parametrize("kind", KINDS)
@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)
@given(mutations=st.lists(mutation, max_size=4))
def test_mutated_files(tmp_path, good, kind, mutations):
    data = mutated(good[kind], mutations)
    path = tmp_path / "a"
    path.write_bytes(data)
    events = read_or_explain(path)
    if data == good[kind]:
        assert events is not None
        assert_same_events(events, EVENTS)
    elif events is not None:
        assert len(events) > 0
        assert np.all(np.diff(events.t) >= 0)
        assert events.t[0] >= 0
        assert events.x.max() < WIDTH
        assert events.y.max() < HEIGHT
        assert set(np.unique(events.p)) <= {-1, 1}


@pytest.mark.parametrize("kind", KINDS)
def test_every_prefix(tmp_path, good, kind):
    """Whatever a broken copy leaves of a file."""
    data, path = good[kind], tmp_path / "a"
    for length in range(0, len(data), max(1, len(data) // 100)):
        path.write_bytes(data[:length])
        events = read_or_explain(path)
        # What is stored event by event or in packets is read as far as it goes; nothing else may pass for
        # whole.
        by_event = ("h5", "bag", "text", "npy", "evt2", "evt3", "dat", "aedat4")
        assert events is None or (kind in by_event and len(events) <= len(EVENTS))
