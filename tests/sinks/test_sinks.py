"""Sinks, each against a server or a file: what arrives, what comes twice, what is down and back."""

from __future__ import annotations

import asyncio
import http.server
import json
import socket
import sqlite3
import threading
import time

import pytest

from evqr.sinks.database import Database
from evqr.sinks.json_lines import JsonLines
from evqr.sinks.line_format import LineFormat
from evqr.sinks.mqtt import Mqtt
from evqr.sinks.outlet import Outlet
from evqr.sinks.tcp import TcpServer
from evqr.sinks.webhook import Webhook

QUICK = (0.01, 0.1)


def part(k, *texts, **more):
    head = {
        "record": "part",
        "sequence": k,
        "line": "L1",
        "camera": "c",
        "t_utc": f"2026-01-01T00:00:{k:02d}Z",
    }
    return {**head, "part": k, "trigger": None, "texts": list(texts), "reason_code": None, **more}


# ---- JSON lines


def test_json_lines_go_on_in_the_same_file(tmp_path):
    path = tmp_path / "parts.jsonl"
    for k in range(2):
        sink = JsonLines(path)
        sink.open()
        sink.write([part(2 * k, "a"), part(2 * k + 1, "ü\n")])
        sink.close()
    assert [json.loads(line)["sequence"] for line in path.read_text().splitlines()] == [0, 1, 2, 3]


@pytest.mark.parametrize("cut", [b"", b'{"half', b"x" * 9000])
def test_a_line_that_was_cut_is_taken_away(tmp_path, cut):
    path = tmp_path / "parts.jsonl"
    path.write_bytes(b'{"sequence": 7}\n' + cut)
    sink = JsonLines(path)
    sink.open()
    sink.write([part(8)])
    sink.close()
    assert [json.loads(line)["sequence"] for line in path.read_bytes().splitlines()] == [7, 8]


def test_a_file_that_is_rotated_is_made_anew(tmp_path):
    path = tmp_path / "parts.jsonl"
    sink = JsonLines(path)
    sink.open()
    sink.write([part(0)])
    path.rename(tmp_path / "parts.jsonl.1")
    sink.write([part(1)])
    sink.close()
    assert json.loads(path.read_text())["sequence"] == 1


# ---- SQLite


def test_rows_are_there_once(tmp_path):
    path = tmp_path / "parts.db"
    sink = Database(path)
    sink.open()
    sink.write([part(0, "a", "b"), part(1)])
    sink.write([part(1), part(2, "c")])
    sink.close()
    with sqlite3.connect(path) as db:
        assert db.execute("SELECT sequence, text FROM records").fetchall() == [
            (0, "a\nb"),
            (1, None),
            (2, "c"),
        ]
    db.close()


def test_old_rows_go_and_that_is_noted(tmp_path, monkeypatch):
    monkeypatch.setattr("evqr.sinks.database.PRUNE_EVERY", 1)
    sink = Database(tmp_path / "parts.db", keep_rows=3)
    sink.open()
    for k in range(10):
        sink.write([part(k)])
    sink.close()
    with sqlite3.connect(tmp_path / "parts.db") as db:
        assert [k for (k,) in db.execute("SELECT sequence FROM records")] == [7, 8, 9]
        assert db.execute("SELECT sum(records), max(last_t_utc) FROM pruned").fetchone() == (
            7,
            part(6)["t_utc"],
        )
    db.close()
    young = Database(tmp_path / "parts.db", keep_days=1)
    young.open()
    young.write([part(10)])
    young.close()
    old = Database(tmp_path / "parts.db", keep_days=-1)  # so that all are too old
    old.open()
    old.write([part(11)])
    old.close()
    with sqlite3.connect(tmp_path / "parts.db") as db:
        assert db.execute("SELECT count(*) FROM records").fetchone() == (0,)
    db.close()


def test_a_database_that_is_locked_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr("evqr.output.sqlite_file.WAIT_S", 0.05)
    path = tmp_path / "parts.db"
    other = Database(path)
    other.open()
    other.close()
    lock = sqlite3.connect(path, isolation_level=None)
    lock.execute("BEGIN EXCLUSIVE")
    with Outlet(Database(path), retry_s=QUICK) as outlet:
        outlet.put(part(0, "a"))
        while not outlet.status.failures:
            time.sleep(0.01)
        assert "locked" in outlet.status.error
        lock.execute("ROLLBACK")
        lock.close()
    assert outlet.close().delivered == 1


# ---- lines for a PLC


@pytest.mark.parametrize(
    ("format", "record", "line"),
    [
        ("{text}", part(0, "A", "B"), "A|B"),
        ("{text}", part(0), "NOREAD"),
        ("{part:06d};{text}", part(7, "x\r\ny"), "000007;xy"),
        ("{trigger};{trigger:04d};{text:>5}", part(7, "é"), ";;    é"),
        ("{{{sequence}}}", part(7), "{7}"),
        ("{nothing:>3}.", part(7), "   ."),
    ],
)
def test_lines(format, record, line):
    assert LineFormat(format).fill(record) == line


@pytest.mark.parametrize("format", ["{", "{text.upper}", "{0}", "{text!r}", "{texts[0]}", "{}"])
def test_a_format_that_asks_for_more_is_refused(format):
    with pytest.raises(ValueError):
        LineFormat(format)


def lines_of(connection, count):
    with connection.makefile("r", encoding="utf-8", newline="") as file:
        return [file.readline() for _ in range(count)]


def test_lines_wait_for_a_client():
    sink = TcpServer(line=LineFormat("{sequence};{text}"), needs_client=True)
    sink.open()
    try:
        with pytest.raises(ConnectionError):
            sink.write([part(0, "first")])
        with socket.create_connection((sink.host, sink.port), 10) as one:
            until(lambda: len(sink._clients) == 1)
            sink.write([part(0, "first"), {"record": "gap", "sequence": 1}])
            with socket.create_connection((sink.host, sink.port), 10) as two:
                until(lambda: len(sink._clients) == 2)
                sink.write([part(2)])
                assert lines_of(one, 2) == ["0;first\r\n", "2;NOREAD\r\n"]
                assert lines_of(two, 1) == ["2;NOREAD\r\n"]
        until(lambda: not sink._clients)
    finally:
        sink.close()


def test_a_client_that_does_not_read_is_dropped(monkeypatch):
    monkeypatch.setattr("evqr.sinks.tcp.MOST_UNSENT", 1000)
    sink = TcpServer(line=LineFormat("{text}"))
    sink.open()
    try:
        with socket.create_connection((sink.host, sink.port), 10):
            until(lambda: len(sink._clients) == 1)
            for k in range(200):
                sink.write([part(k, "x" * 100_000)])
                if not sink._clients:
                    break
            until(lambda: not sink._clients)
    finally:
        sink.close()


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def until(condition):
    ends = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.005)


# ---- a web address


@pytest.fixture
def server():
    answers, got = [], []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            status = answers.pop(0) if answers else 200
            if status == 200:
                got.append((self.path, self.headers["Authorization"], json.loads(body)))
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{running.server_address[1]}/parts", answers, got
        running.shutdown()
        thread.join()


def test_a_post_of_several(server):
    pytest.importorskip("httpx", reason="extra 'line' is not installed")
    url, answers, got = server
    answers += [503, 429, 200]
    with Outlet(Webhook(url, headers={"Authorization": "Bearer t"}), retry_s=QUICK) as outlet:
        outlet.put(part(0, "é"))
    assert outlet.status.failures == 2
    assert got[0][:2] == ("/parts", "Bearer t") and got[0][2] == [part(0, "é")]


def test_a_post_that_is_refused_or_goes_nowhere(server):
    pytest.importorskip("httpx", reason="extra 'line' is not installed")
    url, answers, _ = server
    answers.append(404)
    sink = Webhook(url)
    sink.open()
    assert "404" in sink.write([part(0)])
    sink.close()
    nowhere = Webhook("http://user:secret@127.0.0.1:9/x?token=secret")
    assert "secret" not in nowhere.name
    nowhere.open()
    with pytest.raises(ConnectionError):
        nowhere.write([part(0)])
    nowhere.close()


# ---- OPC UA


def test_the_last_part_is_served():
    sync = pytest.importorskip("asyncua.sync", reason="extra 'opcua' is not installed")
    from evqr.sinks.opcua import NAMESPACE, OpcUa

    endpoint = f"opc.tcp://127.0.0.1:{free_port()}/evqr"
    with Outlet(OpcUa(endpoint), retry_s=QUICK) as outlet:
        outlet.put(part(6))
        outlet.put({"record": "gap", "sequence": 7})
        outlet.put(part(7, "a", "b", trigger=3))
        until(lambda: outlet.status.delivered == 3)
        with sync.Client(endpoint) as client:
            space = client.get_namespace_index(NAMESPACE)
            line = client.nodes.objects.get_child(f"{space}:Line")
            names = ("Part", "Trigger", "Text", "Read", "PartsRead", "PartsNotRead")
            values = [line.get_child(f"{space}:{name}").read_value() for name in names]
    assert values == [7, 3, "a|b", True, 1, 1]


# ---- MQTT


@pytest.fixture
def broker():
    """A broker on a free port, in a thread: start and stop."""
    amqtt = pytest.importorskip("amqtt.broker", reason="extra 'test' is not installed")
    port = free_port()

    class Running:
        def __init__(self):
            self.port = port

        def start(self):
            self.loop = asyncio.new_event_loop()
            self.thread = threading.Thread(target=self.loop.run_forever)
            self.thread.start()
            asyncio.run_coroutine_threadsafe(self._start(), self.loop).result(10)

        async def _start(self):
            self.broker = amqtt.Broker(
                {
                    "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
                    "plugins": {
                        "amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}
                    },
                }
            )
            await self.broker.start()

        def stop(self):
            asyncio.run_coroutine_threadsafe(self.broker.shutdown(), self.loop).result(10)
            self.loop.call_soon_threadsafe(self.loop.stop)
            self.thread.join()
            self.loop.close()

    return Running()


def test_published_to_a_broker_that_comes_later(broker):
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    got, subscribed = [], threading.Event()
    with Outlet(Mqtt("127.0.0.1", broker.port), retry_s=QUICK) as outlet:
        outlet.put(part(0, "early"))
        until(lambda: outlet.status.failures)
        broker.start()
        try:
            until(lambda: outlet.status.delivered == 1)
            reader = Client(CallbackAPIVersion.VERSION2)
            reader.on_message = lambda client, data, message: got.append((message.topic, message.payload))
            reader.on_subscribe = lambda *arguments: subscribed.set()
            reader.connect("127.0.0.1", broker.port)
            reader.subscribe("evqr/#", 1)
            reader.loop_start()
            assert subscribed.wait(10)
            outlet.put(part(1, "a/b", camera="c#1/x"))
            until(lambda: got)
            reader.disconnect()
            reader.loop_stop()
            outlet.close()
        finally:
            broker.stop()
    (topic, payload) = got[0]
    assert topic == "evqr/L1/c1x/part" and json.loads(payload)["texts"] == ["a/b"]
