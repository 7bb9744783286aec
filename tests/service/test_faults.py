"""The service as a whole, ended in the middle of its work: all parts are accounted for."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from evqr.live.packed_stream import PackedWriter

EACH_US = 10_000


class Line(threading.Thread):
    """A source that sends noise, and a trigger each 10 ms of its time, to who connects."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.where = f"tcp://127.0.0.1:{self.listening.getsockname()[1]}"
        self.sent = 0

    def run(self) -> None:
        while True:
            try:
                connected, _ = self.listening.accept()
            except OSError:
                return
            with contextlib.suppress(OSError), connected, connected.makefile("wb") as file:
                self._send(file)

    def _send(self, file) -> None:
        rng = np.random.default_rng(0)
        writer = PackedWriter(file, (64, 48))
        for at_us in range(0, 1 << 40, EACH_US):
            writer.trigger(at_us, "pulse", index=self.sent)
            self.sent += 1
            t = at_us + np.sort(rng.integers(0, EACH_US, 20))
            writer.events(t, rng.integers(0, 64, 20), rng.integers(0, 48, 20), rng.integers(0, 2, 20))
            writer.flush()
            time.sleep(0.001)


@pytest.fixture
def line():
    source = Line()
    source.start()
    yield source
    source.listening.close()


def parts_in(path):
    """Numbers and triggers of the parts that arrived; none where there is no database yet."""
    try:
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as db:
            rows = db.execute("SELECT sequence, trigger, record FROM records ORDER BY id").fetchall()
    except sqlite3.OperationalError:
        return []
    finally:
        if "db" in locals():
            db.close()
    return [(sequence, trigger) for sequence, trigger, record in rows if record == "part"]


def until(condition, process):
    ends = time.monotonic() + 100.0
    while not condition():
        if process.poll() is not None or time.monotonic() > ends:
            process.kill()
            pytest.fail(f"it ended with {process.returncode}")
        time.sleep(0.02)


def test_killed_in_the_middle_of_its_work_and_told_to_end_under_load(line, tmp_path):
    database, held = tmp_path / "parts.db", tmp_path / "sequence"
    config = tmp_path / "line.toml"
    config.write_text(
        f'backend = "numpy"\ntriggers = "stream"\n[trigger]\nafter_us = 5000\n'
        f"[source]\nwhere = {json.dumps(line.where)}\n"
        f"[[database]]\npath = {json.dumps(str(database))}\nspool = {json.dumps(str(tmp_path / 'spool'))}\n"
        f"[watch]\nsequence_file = {json.dumps(str(held))}\n"
    )
    command = [sys.executable, "-m", "evqr", "watch", "--config", str(config)]

    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as service:
        until(lambda: len(parts_in(database)) >= 60, service)
        service.kill()
    before_kill, next_number = line.sent, int(held.read_text())

    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as service:
        until(lambda: len({s for s, _ in parts_in(database) if s >= next_number}) >= 60, service)
        service.send_signal(signal.SIGTERM)
        _, log = service.communicate(timeout=60)
    assert service.returncode == 0 and log.splitlines()[-1].count("has ended")

    arrived = parts_in(database)
    # a number stands for one part, however often it arrived, and triggers come in their order
    by_number = dict(arrived)
    assert len(set(arrived)) == len(by_number)
    triggers = [by_number[number] for number in sorted(by_number)]
    assert triggers == sorted(set(triggers))
    # before the kill: all that had a number arrived by way of the spool, but the one that was being written
    first = [number for number in by_number if number < next_number]
    assert next_number - len(first) <= 1 and max(first) < next_number
    # after it: nothing is lost, up to the end that was asked for under load
    later = sorted(number for number in by_number if number >= next_number)
    assert later == list(range(next_number, int(held.read_text())))
    asked = [trigger for trigger in triggers if trigger >= before_kill]
    assert asked == list(range(asked[0], asked[-1] + 1))
