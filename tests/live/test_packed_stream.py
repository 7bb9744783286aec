"""The packed stream: what is written comes back, however it is cut, and other bytes are refused."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evqr.errors import RecordingError
from evqr.live.packed_stream import MAGIC, MOST_EVENTS, PackedDecoder, PackedWriter
from evqr.live.pieces import Events, Sensor, TimePasses, TriggerSeen

event = st.tuples(
    st.integers(-(1 << 40), 1 << 40), st.integers(0, 65535), st.integers(0, 65535), st.booleans()
)
entry = st.one_of(
    st.lists(event, max_size=5),
    st.builds(
        TriggerSeen, st.integers(-(1 << 62), 1 << 62), st.sampled_from(["pulse", "start", "end"]),
        st.none() | st.integers(0, 1 << 62), st.none() | st.floats(allow_nan=False),
    ),
    st.builds(TimePasses, st.integers(-(1 << 62), 1 << 62)),
)  # fmt: skip


def written(entries, sensor=(640, 480)):
    file = io.BytesIO()
    writer = PackedWriter(file, sensor)
    for each in entries:
        if isinstance(each, TriggerSeen):
            writer.trigger(each.t_us, each.kind, index=each.index, ticks=each.ticks)
        elif isinstance(each, TimePasses):
            writer.time(each.t_us)
        else:
            writer.events(
                *(np.array(column, np.int64) for column in zip(*each, strict=True)) if each else ([],) * 4
            )
    return file.getvalue()


def flat(pieces):
    """Events one by one, and all else as it is."""
    for piece in pieces:
        if isinstance(piece, Events):
            yield from zip(*(column.tolist() for column in piece.columns), strict=True)
        else:
            yield piece


@settings(deadline=None, max_examples=60)
@given(st.lists(entry, max_size=6), st.lists(st.integers(1, 40), max_size=30))
def test_what_is_written_comes_back_however_it_is_cut(entries, cuts):
    data = written(entries)
    decoder, got, at = PackedDecoder("here"), [], 0
    for length in [*cuts, len(data)]:
        got += decoder.feed(data[at : at + length])
        at += length
    expected = [Sensor(640, 480)]
    for each in entries:
        expected += [(t, x, y, int(p)) for t, x, y, p in each] if isinstance(each, list) else [each]
    assert list(flat(got)) == expected


def test_frames_are_not_longer_than_a_reader_takes():
    count = MOST_EVENTS + 10
    data = written([])
    file = io.BytesIO()
    PackedWriter(file, (640, 480)).events(np.arange(count), *np.zeros((3, count), np.int64))
    pieces = list(PackedDecoder("here").feed(file.getvalue()))
    assert [len(piece.columns.t) for piece in pieces[1:]] == [MOST_EVENTS, 10]
    assert pieces[-1].columns.t[-1] == count - 1 and file.getvalue()[: len(data)] == data


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=200), st.booleans(), st.integers(0, 250), st.integers(0, 255))
def test_any_bytes_are_pieces_or_an_error_of_one_line(tail, headed, at, value):
    data = bytearray(written([[(5, 1, 2, True)], TriggerSeen(7, "pulse")]) if headed else b"")
    if at < len(data):
        data[at] = value
    try:
        list(PackedDecoder("here").feed(bytes(data) + tail))
    except RecordingError as error:
        assert str(error).startswith("here: ") and "\n" not in str(error)


@pytest.mark.parametrize("frame", [(1, MOST_EVENTS + 1), (2, 2), (9, 1), (3, 0)])
def test_a_frame_that_makes_no_sense_is_refused_before_it_is_waited_for(frame):
    data = written([]) + struct.pack("<II", *frame)
    with pytest.raises(RecordingError, match=f"kind {frame[0]} with {frame[1]}"):
        list(PackedDecoder("here").feed(data))


def test_what_has_no_room_is_refused():
    writer = PackedWriter(io.BytesIO(), (640, 480))
    with pytest.raises(ValueError, match="x must be 0 to 65535, got 70000"):
        writer.events([0], [70000], [0], [1])
    assert MAGIC == b"EVQRPKT1"
