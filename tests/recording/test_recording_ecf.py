"""Prophesee's compression of HDF5 gives back what was compressed, in each of its forms."""

import numpy as np
import pytest
from ecf_files import MODES, encode, write_ecf
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_files import assert_same_events, make_events

from evqr.errors import RecordingError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr.recording.ecf import decode


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1000),
    count=st.integers(1, 300),
    mode=st.sampled_from(sorted(MODES.values())),
    spread=st.sampled_from([1, 5, 100, 10**7]),
    longest=st.sampled_from([1, 3, 40, 200]),
)
def test_all_forms(seed, count, mode, spread, longest):
    """Steps and runs of all lengths."""
    rng = np.random.default_rng(seed)

    def runs(high):
        values, lengths = rng.integers(0, high, count), rng.integers(1, longest + 1, count)
        return np.repeat(values, lengths)[:count]

    t = np.cumsum(rng.integers(0, spread, count) * (rng.random(count) < 1 / longest)) + seed
    events = EventArray(t, np.sort(runs(2048)), runs(2048), runs(2) * 2 - 1, 2048, 2048)
    got = decode(encode(events, mode))
    for column, expected in (("t", t), ("x", events.x), ("y", events.y), ("p", events.p > 0)):
        np.testing.assert_array_equal(got[column], expected)
    whole = encode(events, mode)
    for end in range(0, len(whole), max(1, len(whole) // 7)):
        with pytest.raises(ValueError):
            decode(whole[:end])


@pytest.mark.parametrize("mode", MODES)
def test_files(tmp_path, mode):
    events = make_events(1000)
    write_ecf(tmp_path / "a", events, MODES[mode], 300)
    for chunk_events in (70, 300, 1 << 20):
        with open_recording(tmp_path / "a", chunk_events=chunk_events) as recording:
            assert_same_events(recording.read(), events)
            assert recording.t_last_us == events.t[-1]
            assert recording.notes == ()


def test_a_damaged_chunk(tmp_path):
    events = make_events(500)
    write_ecf(tmp_path / "a", events, 2, 500)
    data = (tmp_path / "a").read_bytes()
    chunk = encode(events, 2)
    at = data.index(chunk)
    (tmp_path / "a").write_bytes(data[:at] + b"\xff" * 40 + data[at + 40 :])
    with pytest.raises(RecordingError, match=r"HDF5 file is damaged or truncated \(a chunk of"):
        open_recording(tmp_path / "a")
