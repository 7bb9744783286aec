"""EVT3 as it comes: the same events as of the file, triggers with their times, wherever it is cut."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("evt3", reason="extra 'formats' is not installed")

from evqr.errors import RecordingError
from evqr.events.array import EventArray
from evqr.live.evt3_stream import Evt3Decoder
from evqr.live.pieces import Events, Sensor, TriggerSeen
from evqr.recording import open_recording, save_recording

HEADER = b"% format EVT3;height=480;width=640\n% geometry 640x480\n% end\n"


def word(kind, payload):
    return np.array(kind << 12 | payload, "<u2").tobytes()


def time_words(t_us):
    return word(0x8, t_us >> 12 & 0xFFF) + word(0x6, t_us & 0xFFF)


def event_words(x, y, on):
    return word(0x0, y) + word(0x2, on << 11 | x)


def decoded(data, lengths):
    decoder, got, at = Evt3Decoder("camera"), [], 0
    for length in [*lengths, len(data)]:
        got += decoder.feed(data[at : at + length])
        at += length
    return got


@pytest.mark.parametrize("seed", range(3))
def test_events_are_those_of_the_file(tmp_path, seed):
    rng = np.random.default_rng(seed)
    count = 2000
    t = np.sort(rng.integers(0, 60_000_000, count))  # the times in words go round three times
    events = EventArray(
        t, rng.integers(0, 640, count), rng.integers(0, 480, count), rng.integers(0, 2, count), 640, 480
    )
    path = tmp_path / "events.raw"
    save_recording(path, events)
    with open_recording(path) as recording:
        expected = np.concatenate([[chunk.t, chunk.x, chunk.y] for chunk in recording.chunks()], axis=1)
    got = decoded(path.read_bytes(), rng.integers(1, 700, 60))
    assert got[0] == Sensor(640, 480)
    columns = [piece.columns for piece in got if isinstance(piece, Events)]
    assert np.array_equal(np.concatenate([[c.t, c.x, c.y] for c in columns], axis=1), expected)


@pytest.mark.parametrize("lengths", [[], [1] * 200, [60, 3, 5, 7, 9]])
def test_triggers_have_the_times_of_the_words_before_them(lengths):
    data, expected = HEADER, []
    for t_us, level in [
        (5_000, 1),
        (9_000, 0),
        (16_777_215, 1),
        (16_777_216 + 40, 0),
        (2 * 16_777_216 - 5, 0),
        (2 * 16_777_216 + 4096, 1),
    ]:
        data += time_words(t_us) + event_words(3, 4, 1) + word(0xA, level) + event_words(5, 6, 0)
        expected.append(TriggerSeen(t_us, "start" if level else "end"))
    got = decoded(data, lengths)
    assert [piece for piece in got if isinstance(piece, TriggerSeen)] == expected
    t = np.concatenate([piece.columns.t for piece in got if isinstance(piece, Events)])
    assert t.tolist() == [each.t_us for each in expected for _ in range(2)]


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"% format EVT2\n% geometry 640x480\n% end\n", "sends EVT2"),
        (b"% format EVT3\n% end\n", "no size of the sensor"),
        (b"% format EVT3\n" + b"% x y\n" * 20_000, "no end of the header"),
    ],
)
def test_headers_that_do_not_do(header, message):
    with pytest.raises(RecordingError, match=message) as refused:
        decoded(header + event_words(1, 1, 1), [])
    assert "\n" not in str(refused.value)
