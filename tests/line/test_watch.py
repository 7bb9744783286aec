"""The command `evqr watch`: one record a part on standard output, and how it ends."""

import json
import os
import signal
import socket
import threading
import time

import pytest
from scenes import joined, noise, scene
from test_cli import READING_KEYS

from evqr import main as cli
from evqr.live.packed_stream import PackedWriter
from evqr.live.pieces import Events, TimePasses
from evqr.live.playing import Playing
from evqr.recording import open_recording, save_recording

VIEW = {"width": 200, "height": 120, "direction": 0.0}
HEAD = ["record", "recording", "sequence", "line", "camera", "epoch", "t_utc", "latency_ms", "code"]


@pytest.fixture(scope="module")
def events():
    code = scene(text="ONE", version=1, module_px=4.0, travel_px=24.0, **VIEW).events
    still = noise(2_000, 20_000, width=VIEW["width"], height=VIEW["height"])
    return joined(still, code, still)


@pytest.fixture(scope="module")
def recording(events, tmp_path_factory):
    path = tmp_path_factory.mktemp("watch") / "line3.h5"
    save_recording(path, events)
    return str(path)


def run(capsys, *arguments):
    """Exit status, lines on stdout, lines on stderr."""
    status = cli.run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out.splitlines(), captured.err.splitlines()


def test_one_part_a_trigger(capsys, recording, tmp_path):
    gates = tmp_path / "gates.csv"
    gates.write_text("t_us,kind,index\n0,start,4\n9000,end,4\n20000,start,5\n27000,end,5\n90000,pulse,6\n")
    status, out, err = run(capsys, "watch", recording, "--json", "--trigger", gates)
    rows = [json.loads(line) for line in out]
    assert (status, err) == (0, [])
    parts = [(row["trigger"], row["texts"], row["reason_code"]) for row in rows if row["record"] == "part"]
    assert parts == [(4, [], "nothing_moves"), (5, ["ONE"], None), (6, [], "recording_ends")]
    (read,) = [row for row in rows if row["record"] == "read"]
    assert list(read) == HEAD + [key for key in READING_KEYS if key != "recording"]
    assert read["recording"] == recording and read["status"] == "read"


def test_without_triggers_and_for_people(capsys, recording):
    status, out, _ = run(capsys, "watch", recording)
    assert (status, out) == (0, ["read      ONE", "part 0: ONE"])


def test_nothing_read(capsys, tmp_path):
    path = tmp_path / "noise.h5"
    save_recording(path, noise(2_000, 5_000, width=64, height=48))
    gates = tmp_path / "gates.csv"
    gates.write_text("1000,pulse\n")
    status, out, _ = run(capsys, "watch", path, "--trigger", gates, "--pulse-us", 500, 1500)
    assert (status, len(out)) == (1, 1)
    assert out[0].startswith("part 0 (trigger 0): NO READ: nothing moves")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_sigterm_and_ctrl_c_end_it_and_lose_no_part(capsys, recording, tmp_path, number):
    handler = signal.getsignal(number)
    gates = tmp_path / "gates.csv"
    gates.write_text("0,start,1\n5000,start,2\n")
    timer = threading.Timer(0.6, os.kill, (os.getpid(), number))
    timer.start()
    began = time.monotonic()
    status, out, _ = run(capsys, "watch", recording, "--json", "--trigger", gates, "--speed", 0.002)
    rows = [json.loads(line) for line in out]
    timer.join()
    assert status == 0 and time.monotonic() - began < 8.0
    assert [(row["record"], row["trigger"]) for row in rows] == [("part", 1), ("part", 2)]
    assert signal.getsignal(number) is handler


def test_events_and_triggers_over_a_connection(capsys, events):
    def send(server):
        try:
            with server.accept()[0] as connected, connected.makefile("wb") as file:
                writer = PackedWriter(file, (events.width, events.height))
                writer.trigger(20_000, "start", index=9)
                writer.trigger(27_000, "end", index=9)
                writer.events(events.t, events.x, events.y, events.p)
                writer.time(300_000)
            server.accept()[0].close()  # who comes again has taken all that was sent
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(20.0)
        sending = threading.Thread(target=send, args=(server,))
        sending.start()
        where = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        status, out, err = run(capsys, "watch", where, "--json", "--trigger", "stream")
        sending.join()
    rows = [json.loads(line) for line in out]
    assert (status, [row["record"] for row in rows]) == (0, ["read", "part", "gap"])
    assert (rows[1]["trigger"], rows[1]["texts"]) == (9, ["ONE"])
    assert rows[2]["reason_code"] == "interrupted" and rows[2]["t_from_us"] == 300_000
    assert len(err) == 1 and "the other side has ended the connection; trying again" in err[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["x.h5", "--pulse-us", 1, 2], "--pulse-us says what pulses ask for: name them with --trigger"),
        (["tcp://a:1", "--speed", 2], "--speed is for recordings"),
        (["tcp://a:1", "--repeat"], "--repeat is for recordings"),
        (["camera", "--repeat"], "--repeat is for recordings"),  # whether its package is installed or not
        (["missing.h5"], "missing.h5"),
        (["x.h5", "--trigger", "missing.csv"], "missing.csv: cannot be read"),
    ],
)
def test_bad_use_is_one_line(capsys, arguments, said):
    status, out, err = run(capsys, "watch", *arguments)
    assert (status, out, len(err)) == (2, [], 1)
    assert said in err[0]


def test_errors_are_records_too(capsys):
    status, out, _ = run(capsys, "watch", "missing.h5", "--json")
    assert status == 2
    (row,) = map(json.loads, out)
    assert (row["record"], row["status"], row["reason_code"]) == ("error", "error", "source_error")


def test_a_recording_is_played_at_its_speed(events, recording):
    with open_recording(recording) as opened:
        began = time.monotonic()
        pieces = list(Playing(opened, "line3", speed=0.5).pieces())
        took = time.monotonic() - began
    sent = [piece for piece in pieces if isinstance(piece, Events)]
    assert sum(len(piece.columns.t) for piece in sent) == len(events)
    duration_s = 1e-6 * int(events.t[-1] - events.t[0])
    assert 2.0 * duration_s - 0.002 <= took < 2.0 * duration_s + 1.0


def test_silences_of_a_recording_are_passed_over(tmp_path):
    part = noise(500, 3_000, width=64, height=48)
    path = tmp_path / "pause.h5"
    save_recording(path, joined(part, part, gap_us=40_000))
    with open_recording(path) as opened:
        pieces = list(Playing(opened, "pause").pieces())[1:]
    assert [type(piece) for piece in pieces] == [Events, TimePasses, Events]
    assert pieces[1].t_us == int(pieces[2].columns.t[0])
