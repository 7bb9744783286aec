"""Triggers in recordings: given beside their events, and by a line that plays the recording."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from evqr.errors import RecordingError
from evqr.live.pieces import Events, TriggerSeen
from evqr.live.playing import Playing
from evqr.main import run
from evqr.recording import open_recording, save_recording
from evqr.recording.triggers import Edge
from evqr.simulate import simulate

EDGES = [Edge(16_777_215, "start"), Edge(16_777_300, "end"), Edge(33_554_400, "start")]
"""On both sides of where the times in words of EVT3 go round."""


def word(kind, payload):
    return np.array(kind << 12 | payload, "<u2").tobytes()


def evt3_with_triggers(path):
    pytest.importorskip("evt3", reason="extra 'formats' is not installed")
    data = b"% format EVT3\n% geometry 64x48\n% end\n"
    for t_us in [0, 16_777_000, *(edge.t_us for edge in EDGES), 33_554_500]:
        data += (
            word(0x8, t_us >> 12 & 0xFFF) + word(0x6, t_us & 0xFFF) + word(0x0, 4) + word(0x2, 1 << 11 | 3)
        )
        data += b"".join(word(0xA, edge.kind == "start") for edge in EDGES if edge.t_us == t_us)
    path.write_bytes(data)


def aedat4_with_triggers(path):
    pytest.importorskip("aedat", reason="extra 'formats' is not installed")
    dv = pytest.importorskip("dv_processing", reason="extra 'live' is not installed")
    cfg = dv.io.MonoCameraWriter.Config("camera")
    cfg.addEventStream((64, 48))
    cfg.addTriggerStream()
    writer = dv.io.MonoCameraWriter(str(path), cfg)
    events = dv.EventStore()
    for t_us in (0, 16_777_000, 33_554_500):
        events.push_back(t_us, 3, 4, True)
    writer.writeEvents(events)
    kinds = {"start": "EXTERNAL_SIGNAL_RISING_EDGE", "end": "EXTERNAL_SIGNAL_FALLING_EDGE"}
    writer.writeTrigger(dv.Trigger(5, dv.TriggerType.APS_FRAME_START))
    for t_us, kind in EDGES:
        writer.writeTrigger(dv.Trigger(t_us, getattr(dv.TriggerType, kinds[kind])))
    del writer


@pytest.mark.parametrize(("write", "suffix"), [(evt3_with_triggers, "raw"), (aedat4_with_triggers, "aedat4")])
def test_triggers_of_a_file(tmp_path, write, suffix):
    path = tmp_path / f"line.{suffix}"
    write(path)
    with open_recording(path) as recording:
        assert recording.triggers() == EDGES
        pieces = list(Playing(recording, "line", triggers=True).pieces())
        plain = list(Playing(recording, "line").pieces())
    with open_recording(path, start_us=16_777_216, end_us=33_554_399) as recording:
        assert recording.triggers() == EDGES[1:2]
    assert [TriggerSeen(*edge) for edge in EDGES] == [
        each for each in pieces if isinstance(each, TriggerSeen)
    ]
    assert not any(isinstance(each, TriggerSeen) for each in plain)
    for number, piece in enumerate(pieces):  # each before the events of its time
        if isinstance(piece, TriggerSeen):
            before = [each.columns.t.max() for each in pieces[:number] if isinstance(each, Events)]
            assert max(before) < piece.t_us


class Decoder:
    """The package aedat, with a file of one camera in its memory."""

    def __init__(self, path):
        self._path = path

    def id_to_stream(self):
        return {0: {"type": "events", "width": 64, "height": 48}, 1: {"type": "triggers"}}

    def __iter__(self):
        events = np.array([(1, 2, 3, True)], [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
        triggers = np.array([(7, 3), (5, 6), (6, 1)], [("t", "<u8"), ("source", "u1")])
        yield from ({"stream_id": 1, "triggers": triggers}, {"stream_id": 0, "events": events})


def test_triggers_of_aedat4_by_their_numbers(monkeypatch):
    aedat4 = pytest.importorskip("evqr.recording.aedat4")
    source = aedat4.Aedat4Source.__new__(aedat4.Aedat4Source)
    source._aedat, source.name = sys.modules[__name__], "line.aedat4"
    assert list(source.edges()) == [Edge(7, "pulse"), Edge(6, "start")]


def test_a_line_by_the_triggers_of_its_recording(tmp_path, capsys):
    pytest.importorskip("evt3", reason="extra 'formats' is not installed")
    events = simulate(
        "ONE", preset="fast", module_px=4.0, width=320, height=240, duration_us=1500, seed=2
    ).events
    path = tmp_path / "line.raw"
    save_recording(path, events)
    data = path.read_bytes()
    at = data.index(b"% end\n") + 6
    rises = word(0x8, 0) + word(0x6, 0) + word(0xA, 1)
    path.write_bytes(data[:at] + rises + data[at:] + word(0xA, 0))
    assert run(["watch", str(path), "--json", "--trigger", "stream"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(row["texts"], row["trigger"]) for row in rows if row["record"] == "part"] == [(["ONE"], 0)]


def test_files_without_triggers_say_so(tmp_path):
    path = tmp_path / "line.npz"
    save_recording(
        path, simulate(code=False, preset="fast", width=64, height=48, duration_us=300, seed=2).events
    )
    with open_recording(path) as recording, pytest.raises(RecordingError, match="no triggers are read from"):
        recording.triggers()
