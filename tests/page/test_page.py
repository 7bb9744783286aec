"""What a page tells of a line, and whom."""

from __future__ import annotations

import asyncio
import base64
import threading
import urllib.error
import urllib.request

import httpx
import numpy as np
import pytest
from lines import DOWN, HOSTILE, UP, events, line, part

from evqr.errors import UsageError
from evqr.page.app import make_app
from evqr.page.serve import PageServer
from evqr.page.state import EDGES_MS, RECENT, SHOWN, SLOT_S, LineState
from evqr.recording import save_recording


class client:
    """Asks an application in this process; keeps cookies."""

    def __init__(self, state, **given):
        self._transport = httpx.ASGITransport(make_app(state, **given))
        self._cookies = httpx.Cookies()

    def __call__(self, method, path, *, follow_redirects=True, **given):
        async def ask():
            async with httpx.AsyncClient(
                transport=self._transport, base_url="http://localhost", cookies=self._cookies
            ) as asks:
                answer = await asks.request(method, path, follow_redirects=follow_redirects, **given)
                self._cookies.update(asks.cookies)
                return answer

        return asyncio.run(ask())

    def get(self, path, **given):
        return self("GET", path, **given)


# ---- the state


def test_parts_are_counted_by_what_became_of_them():
    state = LineState("L")
    state.take(part(0, "a"))
    state.take(part(1, "b", matches=False, reason="not what is expected", reason_code="no_match"))
    state.take(part(2, reason="nothing moved", reason_code="nothing_moves"))
    now = state.snapshot()
    assert now["counts"]["parts_read"] == 1 and now["counts"]["parts_not_read"] == 2
    assert now["reasons"] == {"no_match": 1, "nothing_moves": 1}
    assert now["read_rate"] == pytest.approx(1 / 3)
    assert [each["part"] for each in now["parts"]] == [2, 1, 0]
    assert [each["part"] for each in now["no_reads"]] == [2, 1]


def test_what_is_kept_is_bounded():
    now = [0.0]
    state = LineState(clock=lambda: now[0])
    for k in range(50_000):
        now[0] += 1.0
        state.take(part(k, "a"))
        if k % 100 == 0:
            state.saw(events(50))
    told = state.snapshot()
    assert len(told["parts"]) == SHOWN and told["read_rate_of"] == RECENT
    assert sum(slot[1] for slot in told["history"]["slots"][-10:-1]) == 9 * SLOT_S
    assert len(told["history"]["slots"]) == 120
    assert len(state._view) <= 20_000 // 50 + 1 and len(state._rate) <= 2


def test_histograms_count_all():
    state = LineState()
    for ms in (0.5, 1.0, 1.1, 4_999.0, 5_001.0):
        state.take(part(0, "a", latency_ms=ms))
    assert state.snapshot()["latency_ms"] == [2, 1, *[0] * (len(EDGES_MS) - 3), 1, 1]


def test_the_picture_is_of_the_newest_events():
    state = LineState()
    assert state.view() is None
    state.saw(events(100, 640, 480))
    seen = events(100, 640, 480)
    view = state.view()
    assert (view["columns"], view["rows"]) == (320, 240)
    cells = np.frombuffer(base64.b64decode(view["cells"]), np.int8).reshape(240, 320)
    expected = np.zeros((240, 320), int)
    np.add.at(expected, (seen.y // 2, seen.x // 2), seen.p)
    assert np.array_equal(cells, expected)


def test_what_is_wrong_is_told():
    state = LineState()
    assert state.problems == ["source: not connected yet"]
    state.connected("tcp://c:1")
    assert state.problems == []
    state.watch_sinks(lambda: [("a", UP), ("b", DOWN)])
    assert state.problems == ["b: Connection refused"]
    state.connected("tcp://c:1", "gone")
    assert state.problems[0] == "tcp://c:1: gone" and state.snapshot()["counts"]["interruptions"] == 1


def test_threads_may_look_while_it_works():
    state, errors = LineState(), []

    def look():
        try:
            for _ in range(200):
                state.snapshot()
                state.view()
        except Exception as error:
            errors.append(error)

    looking = [threading.Thread(target=look) for _ in range(3)]
    for thread in looking:
        thread.start()
    for k in range(500):
        state.take(part(k, "a"))
        state.saw(events(20))
    for thread in looking:
        thread.join()
    assert not errors


# ---- the application


@pytest.mark.parametrize("kind", ["empty", "busy", "failing"])
def test_all_of_it_answers(kind):
    asks = client(line(kind))
    for path in (
        "/",
        "/static/page.js",
        "/static/page.css",
        "/static/icon.svg",
        "/api/state",
        "/metrics",
    ):
        answer = asks.get(path)
        assert answer.status_code == 200, path
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert asks.get("/healthz").text == "ok"
    assert asks.get("/readyz").status_code == (200 if kind == "busy" else 503)
    assert asks.get("/static/page.html").status_code == asks.get("/static/..%2fapp.py").status_code == 404
    for method in ("POST", "PUT", "DELETE"):
        assert asks(method, "/api/state").status_code == 405


def test_metrics_are_what_prometheus_reads():
    from prometheus_client.parser import text_string_to_metric_families

    asks = client(line("failing"))
    text = asks.get("/metrics").text
    found = {family.name: family for family in text_string_to_metric_families(text)}
    counted = {s.name: s.value for family in found.values() for s in family.samples if not s.labels}
    assert counted["evqr_parts_read_total"] + counted["evqr_parts_not_read_total"] == 200
    assert counted["evqr_up"] == 0 and counted["evqr_latency_seconds_count"] == 200
    assert found["evqr_sink_waiting"].samples[1].value == 312
    assert {s.labels["reason"] for s in found["evqr_parts_by_reason"].samples} == {"not_decoded"}


def test_a_token_is_asked_for():
    state = line("busy")
    asks = client(state, token="secret é")
    assert asks.get("/").status_code == asks.get("/api/state").status_code == 401
    assert asks.get("/?token=wrong").status_code == 401
    assert asks.get("/healthz").status_code == 200
    by_header = {"Authorization": b"Bearer wrong"}
    assert asks.get("/api/state", headers=by_header).status_code == 401
    there = asks.get("/", params={"token": "secret é"}, follow_redirects=False)
    assert there.status_code == 307 and "token" not in there.headers["Location"]
    assert "HttpOnly" in there.headers["Set-Cookie"] and "SameSite=strict" in there.headers["Set-Cookie"]
    asks = client(state, token="plain")
    assert asks.get("/api/state", headers={"Authorization": "Bearer plain"}).status_code == 200
    asks.get("/?token=plain")
    assert asks.get("/api/state").status_code == 200  # by the cookie


def test_other_names_are_refused_on_this_machine():
    asks = client(line("busy"), hosts=("localhost", "127.0.0.1"))
    assert asks.get("/api/state").status_code == 200
    assert asks.get("/api/state", headers={"Host": "evil.example"}).status_code == 400


def test_files_of_no_reads_and_no_others(tmp_path):
    save_recording(tmp_path / "part-7.h5", events(500))
    (tmp_path / "secret.txt").write_text("no")
    asks = client(line("busy"), no_reads=tmp_path)
    got = asks.get("/no-reads/part-7.h5/events")
    assert got.content == (tmp_path / "part-7.h5").read_bytes()
    assert "part-7.h5" in got.headers["Content-Disposition"]
    picture = asks.get("/no-reads/part-7.h5/picture")
    assert picture.headers["Content-Type"] == "image/svg+xml" and b"<svg" in picture.content
    for name in ("part-8.h5", "secret.txt", "..%2fsecret.txt", "%2e%2e", "*"):
        assert asks.get(f"/no-reads/{name}/events").status_code == 404
    asks = client(line("busy"))
    assert asks.get("/no-reads/part-7.h5/events").status_code == 404


# ---- the server


def test_it_serves_from_a_thread():
    with PageServer(line("busy"), port=0) as server:
        with urllib.request.urlopen(server.url + "healthz", timeout=10) as answer:
            assert answer.read() == b"ok"
        with pytest.raises(UsageError, match="name another port"):
            PageServer(line("empty"), port=server.port)
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(server.url, timeout=1)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "line3.example"])
def test_others_need_a_token(host):
    with pytest.raises(UsageError, match="set a token"):
        PageServer(line("empty"), host, 0)


def test_hostile_texts_are_data():
    asks = client(line("busy"))
    assert HOSTILE not in asks.get("/").text
    assert asks.get("/api/state").json()["last"]["text"] == HOSTILE


# ---- the job


def test_the_job_is_changed_by_who_has_the_token_alone():
    used = []

    def use(job):
        if job != "cartons":
            raise ValueError(f"job must be one of cartons, got {job!r}")
        used.append(job)
        state.uses(job, ["cartons"])

    state = LineState("L")
    state.uses("", ["cartons"])
    body = {"json": {"job": "cartons"}}
    assert client(state, use=use)("POST", "/api/job", **body).status_code == 403  # there is no token
    asks = client(state, token="t", use=use)
    assert asks("POST", "/api/job", **body).status_code == 401 and used == []
    given = {"Authorization": "Bearer t"}
    done = asks("POST", "/api/job", headers=given, **body)
    assert (done.status_code, done.json(), used) == (200, {"job": "cartons"}, ["cartons"])
    assert asks("GET", "/api/state", headers=given).json()["job"] == "cartons"
    for wrong in ({"json": {"job": "no"}}, {"json": [1]}, {"content": b"{"}, {"json": {}}):
        refused = asks("POST", "/api/job", headers=given, **wrong)
        assert refused.status_code == 400 and "\n" not in refused.text
    assert asks("GET", "/api/job", headers=given).status_code == 405 and used == ["cartons"]


def test_the_events_of_the_last_code_stay():
    state = LineState("L")
    state.saw(events())  # one a microsecond, up to 4999
    assert not state.view()["of_code"]
    moves = {"motion_px_per_s": [10_000.0, 0.0], "t_read_us": 3_000, "text": "a"}
    state.take({"record": "read", **moves})
    seen = state.view()
    cells = np.frombuffer(base64.b64decode(seen["cells"]), np.int8)
    assert seen["of_code"] and 0 < np.count_nonzero(cells) <= 401  # 4 px at 10 px/ms
    state.saw(events())
    assert state.view() == seen
