"""The service: settings that make no sense, records where they are to go, restarts, alarms, and its end."""

from __future__ import annotations

import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from importlib.resources import files
from types import SimpleNamespace

import pytest
from scenes import joined, noise, scene

from evqr.config.settings import Settings, kinds
from evqr.errors import UsageError
from evqr.main import run
from evqr.recording import open_recording, save_recording
from evqr.service.schema import json_schema
from evqr.service.sequence import SequenceFile
from evqr.service.service import Service
from evqr.service.settings import ServiceSettings, parse_settings
from evqr.service.systemd import Notifier

EXAMPLE = (files("evqr") / "data" / "watch.toml").read_text(encoding="utf-8")
VIEW = {"width": 200, "height": 120, "direction": 0.0}
SOURCE = '[source]\nwhere = "here.h5"\n'


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A code that passes amid noise."""
    code = scene(text="ONE", version=1, module_px=4.0, travel_px=24.0, **VIEW).events
    still = noise(2_000, 20_000, width=VIEW["width"], height=VIEW["height"])
    path = tmp_path_factory.mktemp("service") / "line3.h5"
    save_recording(path, joined(still, code, still))
    return path


# ---- settings


def test_the_example_is_right_and_says_what_is_not_default():
    settings, jobs = parse_settings(EXAMPLE, "watch.toml")
    assert settings.source.where == "tcp://127.0.0.1:7000" and settings.page.enabled
    assert jobs["cartons"].codes == 1
    assert settings.changed()["database"][0]["keep_days"] == 90.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "source.where must say"),
        ("[source", "is no TOML"),
        (SOURCE + 'nothing = "?"', "nothing"),
        (
            SOURCE + "[page]\nport = 70000",
            "port must be a whole number, at least 0 and at most 65535, got 70000",
        ),
        (SOURCE + "[[database]]\nkeep_days = 3", "database.path is needed"),
        (SOURCE + '[[tcp]]\nwhen_full = "wait"', "when_full must be one of 'block', 'drop', got 'wait'"),
        (SOURCE + '[jobs.a]\npattern = "("', "pattern must be a regular expression"),
        (SOURCE + "[jobs]\na = 1", "jobs must be tables"),
        ('job = "b"\n' + SOURCE + "[jobs.a]\ncodes = 1", "job must be one of a, got 'b'"),
        (SOURCE + "[read]\nwidow_us = 5", "widow_us"),
        (SOURCE + '[read.line]\nbehind_us = "soon"', "behind_us must be"),
    ],
)
def test_what_makes_no_sense_is_one_line(text, message):
    with pytest.raises(UsageError, match=r"line\.toml: ") as refused:
        parse_settings(text, "line.toml")
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_the_schema_has_every_setting_and_no_other():
    def compare(schema, settings, path=""):
        assert schema["properties"].keys() - {"jobs"} == kinds(settings).keys(), path
        for name, each in schema["properties"].items():
            assert each != {}, name

    schema = json_schema()
    compare(schema, ServiceSettings)
    given, _ = parse_settings(EXAMPLE, "watch.toml")

    def known(values, schema):
        for name, value in values.items():
            assert name in schema["properties"], name
            inner = schema["properties"][name]
            if isinstance(value, dict):
                known(value, inner)
            elif isinstance(value, list) and value and isinstance(value[0], dict):
                known(value[0], inner["items"])

    known(given.to_dict(), schema)
    assert json.loads(json.dumps(schema)) == schema
    port = schema["properties"]["page"]["properties"]["port"]
    assert port == {"type": "integer", "minimum": 0, "maximum": 65535}
    assert issubclass(ServiceSettings, Settings)


# ---- the service


def settings_of(recording, tmp_path, more=""):
    text = f"""
line = "L3"
triggers = "none"
[source]
where = {json.dumps(str(recording))}
[[json_lines]]
path = {json.dumps(str(tmp_path / "parts.jsonl"))}
[[database]]
path = {json.dumps(str(tmp_path / "parts.db"))}
spool = {json.dumps(str(tmp_path / "parts.spool"))}
[watch]
sequence_file = {json.dumps(str(tmp_path / "sequence"))}
{more}"""
    return parse_settings(text, "line.toml")


def test_records_are_where_they_are_to_be_and_numbers_go_on(recording, tmp_path):
    seen = []
    for _ in range(2):
        assert Service(*settings_of(recording, tmp_path), out=seen.append).run()
    rows = [json.loads(line) for line in (tmp_path / "parts.jsonl").read_text().splitlines()]
    assert rows == json.loads(json.dumps(seen))
    numbered = [row for row in rows if "sequence" in row]
    assert [row["sequence"] for row in numbered] == list(range(len(numbered)))
    assert [row["texts"] for row in rows if row["record"] == "part"] == [["ONE"], ["ONE"]]
    assert {row["line"] for row in rows} == {"L3"} and rows[0]["record"] == "heartbeat"
    with sqlite3.connect(tmp_path / "parts.db") as db:
        assert db.execute("SELECT count(*) FROM records WHERE record = 'part'").fetchone() == (2,)
    db.close()


def test_parts_that_do_not_match_are_kept_and_raise_an_alarm(recording, tmp_path, caplog):
    folder = tmp_path / "kept"
    more = f"""least_read_rate = 0.5
alarm_parts = 1
self_check = {json.dumps(str(recording))}
[recorder]
folder = {json.dumps(str(folder))}
[jobs.two]
text = "TWO"
"""
    settings, jobs = settings_of(recording, tmp_path, more)
    seen = []
    service = Service(ServiceSettings.from_dict({**settings.to_dict(), "job": "two"}), jobs, out=seen.append)
    assert service.run()
    (part,) = [row for row in seen if row["record"] == "part"]
    (alarm,) = [row for row in seen if row["record"] == "alarm"]
    assert part["matches"] is False and alarm["on"] and alarm["read_rate"] == 0.0
    assert "alarm: 0.0 % of the last 1 parts are read" in caplog.text
    with open_recording(part["events"]) as kept:
        events = kept.read()
    assert len(events) > 1000 and events.t[0] <= part["t_first_us"] and events.t[-1] >= part["t_last_us"]
    assert service.state.snapshot()["no_reads"][0]["file"] == os.path.basename(part["events"])


def test_a_self_check_that_fails_is_told_all_along(recording, tmp_path):
    save_recording(tmp_path / "noise.h5", noise(500, 5_000, width=64, height=48))
    more = f"self_check = {json.dumps(str(tmp_path / 'noise.h5'))}"
    seen = []
    service = Service(*settings_of(recording, tmp_path, more), out=seen.append)
    service.run()
    assert seen[0]["record"] == "heartbeat" and not seen[0]["ready"]
    assert "the self-check read nothing" in service.state.problems[0]


def test_the_command(recording, tmp_path, capsys):
    path = tmp_path / "line.toml"
    path.write_text(f"[source]\nwhere = {json.dumps(str(recording))}\n[[tcp]]\nline = '{{text!r}}'\n")
    assert run(["watch", "--config", str(path), "--check"]) == 2
    assert "tcp.line: format must name keys of records alone" in capsys.readouterr().err
    assert run(["watch", "--example"]) == 0 and capsys.readouterr().out == EXAMPLE
    assert run(["watch", "--schema"]) == 0 and json.loads(capsys.readouterr().out) == json_schema()
    assert run(["watch", str(recording), "--config", str(path)]) == 2
    assert "leave out SOURCE" in capsys.readouterr().err
    assert run(["watch"]) == 2 and "name a SOURCE" in capsys.readouterr().err


def test_it_ends_cleanly_when_it_is_told_to(recording, tmp_path):
    """A real process: its log is JSON, and SIGTERM ends it with all delivered."""
    listening = socket.create_server(("127.0.0.1", 0))
    path = tmp_path / "line.toml"
    path.write_text(
        f'[source]\nwhere = "tcp://127.0.0.1:{listening.getsockname()[1]}"\n'
        f"[[json_lines]]\npath = {json.dumps(str(tmp_path / 'parts.jsonl'))}\n"
    )
    command = [sys.executable, "-m", "evqr", "watch", "--config", str(path)]
    with listening, subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as service:
        connected, _ = listening.accept()
        with connected:
            time.sleep(0.2)
            service.send_signal(signal.SIGTERM)
            _, said = service.communicate(timeout=60)
    assert service.returncode == 0
    log = [json.loads(line) for line in said.splitlines()]
    assert log[-1]["message"].endswith("has ended") and {line["level"] for line in log} == {"info"}
    assert json.loads((tmp_path / "parts.jsonl").read_text().splitlines()[0])["record"] == "heartbeat"


# ---- what is around it


def test_systemd_is_told(tmp_path, monkeypatch):
    where = tmp_path / "notify"
    monkeypatch.setenv("NOTIFY_SOCKET", str(where))
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(where))
        notifier = Notifier()
        notifier.tell("READY=1", "STATUS=reading")
        assert systemd.recv(100) == b"READY=1\nSTATUS=reading"
    assert notifier.watchdog_s == 3.0
    notifier.tell("WATCHDOG=1")  # nobody is there any more, which is no reason to end
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert Notifier().watchdog_s is None


def test_a_number_goes_on(tmp_path):
    path = tmp_path / "sequence"
    for expected in (0, 12_345):
        held = SequenceFile(path)
        assert held.next == expected
        held.keep(12_345)
        held.close()
    path.write_text("something else")
    with pytest.raises(UsageError, match="no number"):
        SequenceFile(path)
    with pytest.raises(UsageError, match="cannot be written"):
        SequenceFile(tmp_path / "nowhere" / "sequence")


def test_the_job_can_be_changed_while_it_runs():
    settings, jobs = parse_settings('[source]\nwhere = "-"\n[jobs.cartons]\ncodes = 1\n', "line.toml")
    service, used = Service(settings, jobs), []
    service._reader = SimpleNamespace(use=used.append)
    service.use("cartons")
    assert service.state.snapshot()["job"] == "cartons"
    with pytest.raises(ValueError, match="job must be one of cartons, got 'lids'"):
        service.use("lids")
    service.use("")
    assert used == ["cartons", ""]
