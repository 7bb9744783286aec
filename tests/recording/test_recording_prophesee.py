"""Prophesee's encodings: where the data begin, what the words mean, what the header tells."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prophesee_files import HEADER, dat, raw, words_of
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events

from evqr.errors import RecordingError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr.recording.faults import Faults
from evqr.recording.prophesee import parse_header
from evqr.recording.prophesee_words import EVT2, EVT4, EVT21, EVT21_LEGACY, WordDecoder

ENCODINGS = ["2.0", "2.1", "4.0"]
WORDS = {"2.0": EVT2, "2.1": EVT21, "4.0": EVT4}


def read(path, **options):
    with open_recording(path, **options) as recording:
        return recording.read(), recording


def at(t, x, y, p) -> EventArray:
    """Events at chosen places."""
    columns = (np.atleast_1d(v) for v in np.broadcast_arrays(t, x, y, p))
    t, x, y, p = columns
    return EventArray(
        t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.int8), WIDTH, HEIGHT
    )


line = st.binary(max_size=30).filter(lambda b: b"\n" not in b)
key = st.sampled_from([b"date", b"evt", b"geometry", b"serial_number", b"Firma", b"\xd0\x9a", b"%"])
body = st.binary(max_size=80)
versions = st.sampled_from(ENCODINGS)


@settings(max_examples=200, deadline=None)
@given(lines=st.lists(st.tuples(key, line), max_size=6), data=body)
def test_a_header_ends_at_its_end(lines, data):
    """Whatever the comments hold, and whatever the data begin with."""
    header = b"".join(b"% " + name + b" " + value + b"\n" for name, value in lines)
    assert parse_header(header + b"% end\n" + data)[1] == len(header) + len(b"% end\n")
    if not data.startswith(b"% "):
        assert parse_header(header + data)[1] == len(header)


@pytest.mark.parametrize("end", [b"% end\n", b""])
@pytest.mark.parametrize("first", [0x25, 0x0A25, 0x2525, 0x0D0A25])
def test_data_that_begin_with_a_percent_sign(tmp_path, events, first, end):
    t = events.t + (first << 6) - events.t[0] + (first << 6) % 64
    events = EventArray(t - t[0] + (first << 6), events.x, events.y, events.p, WIDTH, HEIGHT)
    header = HEADER.replace(b"% end\n", end)
    (tmp_path / "a").write_bytes(raw(events, "2.0", header=header))
    assert (tmp_path / "a").read_bytes()[len(header) - 4 :].startswith(b"%")
    assert_same_events(read(tmp_path / "a")[0], events)


def test_letters_of_all_languages_in_a_header(tmp_path, events):
    for text in ("Kraków", "北京", "Zürich"):
        for encoding in ("utf-8", "utf-16-le", "latin-1"):
            note = text.encode(encoding, "replace").replace(b"\n", b"")
            (tmp_path / "a").write_bytes(raw(events, "2.0", header=b"% place " + note + b"\n" + HEADER))
            assert_same_events(read(tmp_path / "a")[0], events)


def test_a_long_header(tmp_path, events):
    (tmp_path / "a").write_bytes(raw(events, "2.0", header=b"% note " + b"x" * 9000 + b"\n" + HEADER))
    with pytest.raises(
        RecordingError
    ):  # its key is not among the first bytes, by which formats are told apart
        read(tmp_path / "a")
    header = HEADER.replace(b"% end", b"% note " + b"x" * 9000 + b"\n% end")
    (tmp_path / "a").write_bytes(raw(events, "2.0", header=header))
    assert_same_events(read(tmp_path / "a")[0], events)


@pytest.mark.parametrize("vectors", [False, True])
@pytest.mark.parametrize("version", ENCODINGS)
def test_words_made_by_hand(tmp_path, version, vectors):
    rng = np.random.default_rng(1)
    events = make_events(300, span_us=40_000)
    # rows of events of one time, so that there are vectors
    t = np.repeat(events.t[::10], 10)[: len(events)]
    order = np.lexsort((events.x, events.p, events.y // 16, t))
    y = np.repeat(rng.integers(0, HEIGHT, 30), 10).astype(np.uint16)
    events = EventArray(t, events.x[order], y, np.repeat(events.p[::10], 10), WIDTH, HEIGHT)
    (tmp_path / "a").write_bytes(raw(events, version, vectors=vectors))
    for chunk_events in (7, 1 << 20):
        got, recording = read(tmp_path / "a", chunk_events=chunk_events)
        assert_same_events(got, events)
        assert recording.format == f"Prophesee EVT{version.removesuffix('.0')}"
        assert recording.notes == ()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 1000), cuts=st.lists(st.integers(0, 400), max_size=6), version=versions)
def test_a_decoder_takes_words_in_any_pieces(seed, cuts, version):
    rng = np.random.default_rng(seed)
    count = 60
    events = at(
        np.sort(rng.integers(0, 3000, count)) // 40 * 40,
        np.sort(rng.integers(0, WIDTH, count)),
        rng.integers(0, 2, count),
        rng.choice([-1, 1], count),
    )
    words = WORDS[version]
    data = np.array(words_of(events, version, vectors=True), "<u4").tobytes()
    edges = sorted({0, len(data), *(min(c * words.bytes, len(data)) for c in cuts)})
    decoder = WordDecoder(words, Faults("name"))
    parts = [decoder.feed(data[a:b]) for a, b in pairwise(edges)]
    for column, expected in (("t", events.t), ("x", events.x), ("y", events.y), ("p", events.p > 0)):
        np.testing.assert_array_equal(np.concatenate([getattr(part, column) for part in parts]), expected)


def test_vectors_that_look_like_words_of_any_kind():
    """A vector of EVT4 may have the bits of any other word."""
    decoder = WordDecoder(EVT4, Faults("name"))
    masks = [0xC0000001, 0xD0000003, 0xE0000007, 0xFFFFFFFF, 0xC0000001, 0x00000001]
    words = [0xE0000000, *(w for mask in masks for w in (0xD0000000 | 3 << 11 | 5, mask)), 0xB0000000]
    events = decoder.feed(np.array(words, "<u4").tobytes())
    assert len(events.t) == sum(mask.bit_count() for mask in masks) + 1
    assert set(events.y[:-1]) == {5}


@pytest.mark.parametrize("endianness", ["legacy", "little"])
def test_halves_of_words_may_be_exchanged(tmp_path, events, endianness):
    words = np.array(words_of(events, "2.1"), "<u4").reshape(-1, 2)
    data = words if endianness == "little" else words[:, ::-1]
    for header in (
        f"% evt 2.1\n% endianness {endianness}\n% geometry 64x48\n% end\n",
        f"% format EVT21;endianness={endianness};height=48;width=64\n% end\n",
    ):
        (tmp_path / "a").write_bytes(header.encode() + data.tobytes())
        assert_same_events(read(tmp_path / "a")[0], events)
    old = EVT21_LEGACY if endianness == "legacy" else EVT21
    assert old.key == (0 if endianness == "legacy" else 1)


@pytest.mark.parametrize("version", ENCODINGS)
def test_the_clock_goes_round_after_hours(tmp_path, version):
    loop = 1 << 34
    t = loop - 40_000 + np.arange(0, 80_000, 20)
    events = at(t, np.arange(4000) % WIDTH, np.arange(4000) % HEIGHT, 1)
    (tmp_path / "a").write_bytes(raw(events, version))
    for chunk_events in (100, 1 << 20):
        assert_same_events(read(tmp_path / "a", chunk_events=chunk_events)[0], events)


def test_other_words_are_no_events(tmp_path, events):
    triggers = [0x80000000, 0xA0000001, 0xE0000000, 0xF0000000]
    data = np.array(triggers + words_of(events, "2.0") + triggers[1:], "<u4").tobytes()
    (tmp_path / "a").write_bytes(HEADER.replace(b"VERSION", b"2.0") + data)
    assert_same_events(read(tmp_path / "a")[0], events)


def test_words_that_the_encoding_does_not_have_are_counted(tmp_path, events):
    words = words_of(events, "2.0")
    words[10] = 0x30000000
    (tmp_path / "a").write_bytes(HEADER.replace(b"VERSION", b"2.0") + np.array(words, "<u4").tobytes())
    got, recording = read(tmp_path / "a")
    assert recording.counts.left_out == 1
    assert len(got) == len(events) - (words_of(events, "2.0")[10] >> 28 < 2)
    assert "word 10 is of type 0x3, which EVT2 does not have" in recording.notes[-1]
    with pytest.raises(RecordingError, match="word 10 is of type 0x3"):
        read(tmp_path / "a", strict=True)
    shifted = (tmp_path / "a").read_bytes().replace(b"% end\n", b"% end\n\0")
    (tmp_path / "a").write_bytes(shifted)  # every word is wrong
    with pytest.raises(RecordingError):
        read(tmp_path / "a")


@pytest.mark.parametrize(
    ("header", "sensor", "encoding"),
    [
        (b"% evt 2.0\n% system_ID 28\n% end\n", (640, 480), "EVT2"),
        (b"% system_ID 28\n", (640, 480), "EVT2"),
        (b"% system_id 39\n% end\n", (1280, 720), "EVT2"),
        (b"% geometry 64 x 48\n% evt 2.0\n% end\n", (64, 48), "EVT2"),
        (b"% format EVT2;height=48;width=64\n% end\n", (64, 48), "EVT2"),
        (b"% system_ID 49\n% format EVT2;height=48;width=64\n% end\n", (64, 48), "EVT2"),
    ],
)
def test_the_sensor_by_header_or_system(tmp_path, events, header, sensor, encoding):
    (tmp_path / "a").write_bytes(raw(events, "2.0", header=header))
    got, recording = read(tmp_path / "a")
    assert (recording.width, recording.height, recording.format) == (*sensor, f"Prophesee {encoding}")
    assert len(got) == len(events)
    known = b"geometry" in header or b"format" in header
    assert recording.notes == () if known else "that of system" in recording.notes[0]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", [0x00, 0x0C])
def test_dat(tmp_path, events, version, kind):
    (tmp_path / "a").write_bytes(dat(events, version=version, kind=kind))
    for chunk_events in (64, 1 << 20):
        got, recording = read(tmp_path / "a", chunk_events=chunk_events)
        assert_same_events(got, events)
        assert recording.n_events == len(events)


def test_dat_over_hours(tmp_path):
    t = np.arange(0, 3 << 32, 1 << 27) + 5
    events = at(t, np.arange(len(t)) % WIDTH, 3, 1)
    (tmp_path / "a").write_bytes(dat(events))
    for chunk_events in (7, 1 << 20):
        assert_same_events(read(tmp_path / "a", chunk_events=chunk_events)[0], events)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": 0x0E}, r"no event stream in this file: DAT event type 14 \(external triggers\) of 8 bytes"),
        ({"kind": 0x28, "length": 16}, r"event type 40 \(events of an unknown type\) of 16 bytes"),
        ({"version": 3}, r"DAT version 3 is not known \(1 and 2 are\)"),
    ],
)
def test_dat_of_something_else(tmp_path, events, options, message):
    (tmp_path / "a").write_bytes(dat(events, **options))
    with pytest.raises(RecordingError, match=message):
        read(tmp_path / "a")


def test_encodings_that_are_not_read_name_a_way_that_exists(tmp_path):
    (tmp_path / "a").write_bytes(b"% format HISTO3D;height=48;width=64\n% end\n" + bytes(64))
    with pytest.raises(RecordingError, match=r"HISTO3D is not supported .*metavision_file_to_hdf5"):
        read(tmp_path / "a")


def test_a_peer_reads_the_same_from_evt2(tmp_path, events):
    eventcv = pytest.importorskip("eventcv")
    (tmp_path / "a.raw").write_bytes(raw(events, "2.0"))
    theirs = eventcv.load(str(tmp_path / "a.raw"), time_unit="us").numpy()
    np.testing.assert_array_equal(np.stack([events.x, events.y, events.t, events.p > 0], axis=1), theirs)
