"""`read_archive` and `evqr batch`: rows, going on, changed files, lost workers, files that are not ours."""

from __future__ import annotations

import os
import sqlite3
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path

import pytest
import sample_results

from evqr.archive import TRIES, read_archive
from evqr.cli.workers import workers
from evqr.demo import demo_recording
from evqr.errors import RecordingError, UsageError
from evqr.main import run
from evqr.output.database import APPLICATION_ID, SCHEMA, ReadingsDatabase
from evqr.output.sqlite_file import SqliteFile
from evqr.results import ReadStatus

UNLIKE = {"compute_ms", "t_utc"}
"""Columns that differ from run to run."""


def rows(path):
    """All that a database says of recordings and parts, but for times of day and of computing."""
    with sqlite3.connect(path) as db:
        db.row_factory = sqlite3.Row
        found = [
            dict(row) for table in ("recordings", "parts") for row in db.execute(f"SELECT * FROM {table}")
        ]
    db.close()
    return [{name: value for name, value in row.items() if name not in UNLIKE} for row in found]


@pytest.fixture
def archive(tmp_path, monkeypatch):
    """Files, and a reader that finds in each what its name says; with what it was asked for."""
    asked = []

    def read_codes(source, **options):
        asked.append(Path(source).name)
        kind = Path(source).stem.split("-")[0]
        if kind == "bad":
            raise RecordingError(f"{source}: is empty; record it again")
        return sample_results.read_result() if kind == "read" else sample_results.no_read_result()

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    paths = [tmp_path / f"{kind}-{k}.h5" for k, kind in enumerate(["read", "none", "bad", "read", "none"])]
    for path in paths:
        path.write_bytes(b"events")
    return paths, asked


def read_all(paths, out, executor=None):
    with ReadingsDatabase(out, {}) as database:
        pending = database.pending(paths)
        return [path for path, _ in read_archive(pending, database, workers=lambda: nullcontext(executor))]


def test_a_row_a_part(archive, tmp_path):
    paths, _ = archive
    assert read_all(paths, tmp_path / "out.db") == paths
    found = rows(tmp_path / "out.db")
    recordings, parts = found[:5], found[5:]
    assert [row["path"] for row in recordings] == [str(path) for path in paths]
    assert [row["status"] for row in recordings] == ["read", "no_read", "error", "read", "no_read"]
    assert "is empty" in recordings[2]["reason"] and recordings[2]["reason_code"] == "source_error"
    readings = sample_results.read_result().readings
    assert [row["recording"] for row in parts] == [1] * len(readings) + [2] + [4] * len(readings) + [5]
    assert [row["text"] for row in parts[: len(readings)]] == [reading.text for reading in readings]
    assert parts[0]["content"] == readings[0].data
    nothing = parts[len(readings)]
    assert nothing["text"] is None and nothing["reason"] == sample_results.no_read_result().reason


def test_goes_on_where_it_was(archive, tmp_path):
    paths, asked = archive
    out = tmp_path / "out.db"
    with ReadingsDatabase(out, {}) as database:
        running = read_archive(database.pending(paths), database, workers=nullcontext)
        next(running)
        next(running)
        running.close()
    before = rows(out)
    asked.clear()
    assert read_all(paths, out) == paths[2:]
    assert rows(out)[:2] == before[:2]
    whole = tmp_path / "whole.db"
    read_all(paths, whole)
    assert rows(out) == rows(whole)


def test_reads_again_what_changed_and_what_failed(archive, tmp_path):
    paths, _ = archive
    out = tmp_path / "out.db"
    read_all(paths, out)
    paths[1].write_bytes(b"more events")
    before = rows(out)
    assert read_all(paths, out) == [paths[1], paths[2]]
    after = rows(out)
    assert [row for row in after if row["id" if "id" in row else "recording"] != 2] == [
        row for row in before if row["id" if "id" in row else "recording"] != 2
    ]
    assert len(after) == len(before)


def test_the_same_rows_from_threads_and_from_dask(archive, tmp_path):
    distributed = pytest.importorskip("distributed", reason="extra 'distributed' is not installed")
    paths, _ = archive
    read_all(paths, tmp_path / "one.db")
    with ThreadPoolExecutor(2) as threads:
        read_all(paths, tmp_path / "threads.db", threads)
    local = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        read_all(paths, tmp_path / "dask.db", client.get_executor())
    assert rows(tmp_path / "one.db") == rows(tmp_path / "threads.db") == rows(tmp_path / "dask.db")


class BreaksOn(ThreadPoolExecutor):
    """Ends, as a pool of processes does, with a worker that meets one of some recordings."""

    def __init__(self, names):
        super().__init__(1)
        self.names = names
        self.broken = False

    def submit(self, work, source):
        if self.broken or source.name in self.names:
            self.broken = True
            raise BrokenExecutor("a worker has ended")
        return super().submit(work, source)


def test_only_what_is_to_blame_stays_lost(archive, tmp_path):
    paths, _ = archive
    made = []

    @contextmanager
    def pools():
        made.append(None)
        with BreaksOn({"read-3.h5"}) as pool:
            yield pool

    with ReadingsDatabase(tmp_path / "out.db", {}) as database:
        found = dict(read_archive(database.pending(paths), database, workers=pools))
    assert set(found) == set(paths)
    assert found[paths[3]].reason_code == "worker_lost"
    assert [found[path].status for path in paths if path != paths[3]] == [
        ReadStatus.READ, ReadStatus.NO_READ, ReadStatus.ERROR, ReadStatus.NO_READ
    ]  # fmt: skip
    assert len(made) <= 3 + TRIES


class EndsItsWorker(type(Path())):
    """A recording that takes its worker down on arrival."""

    def __reduce__(self):
        return os._exit, (3,)


def test_a_process_that_ends(tmp_path, monkeypatch):
    monkeypatch.setattr("evqr.archive.TRIES", 1)
    other, deadly = tmp_path / "none.h5", EndsItsWorker(tmp_path / "deadly.h5")
    with ReadingsDatabase(tmp_path / "out.db", {}) as database:
        found = dict(read_archive(database.pending([deadly, other]), database, workers=lambda: workers(2)))
    assert found[deadly].reason_code == "worker_lost"
    assert "no such file" in found[other].reason


@pytest.mark.parametrize(
    "content", [b"SQLite format 3\0" + bytes(200), b"no database at all, but long enough"]
)
def test_a_file_that_is_no_database_is_refused(tmp_path, content):
    out = tmp_path / "out.db"
    out.write_bytes(content)
    with pytest.raises(UsageError, match=r"out\.db: cannot be used as a database"):
        ReadingsDatabase(out, {})
    assert out.read_bytes() == content


def test_other_databases_are_refused(tmp_path):
    out = tmp_path / "out.db"
    with sqlite3.connect(out) as db:
        db.execute("CREATE TABLE mine (a)")
    with pytest.raises(UsageError, match="none of readings"):
        ReadingsDatabase(out, {})
    db.close()
    later = tmp_path / "later.db"
    ReadingsDatabase(later, {}).__exit__(None, None, None)
    with sqlite3.connect(later) as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(UsageError, match="schema 99"):
        ReadingsDatabase(later, {})


def test_one_file_has_one_kind_of_settings(tmp_path):
    out = tmp_path / "out.db"
    ReadingsDatabase(out, {"window_us": 500}).__exit__(None, None, None)
    with pytest.raises(UsageError, match=r'settings \{"window_us": 500\}, not \{\}'):
        ReadingsDatabase(out, {})


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(UsageError, match="cannot be used as a database"):
        ReadingsDatabase(tmp_path / "nowhere" / "out.db", {})


def test_the_command(tmp_path, capsys):
    with demo_recording() as demo:
        (tmp_path / "archive").mkdir()
        recording = tmp_path / "archive" / "demo.h5"
        recording.write_bytes(demo.read_bytes())
    (tmp_path / "archive" / "cut.h5").write_bytes(b"")
    out = tmp_path / "archive" / "out.db"
    command = ["batch", str(tmp_path / "archive"), "--out", str(out), "--max-windows", "2"]
    assert run(command) == 2
    printed = capsys.readouterr()
    assert (
        "2 recordings, 0 of them there already; 1 with codes, 0 without, 1 could not be read" in printed.out
    )
    assert "cut.h5" in printed.err and printed.err.count("\n") <= 2
    assert run(command) == 2
    assert "1 of them there already" in capsys.readouterr().out
    parts = [row for row in rows(out) if "part" in row]
    assert [row["text"] for row in parts] == ["Read in passing, 8 px/ms"]
    assert run([*command, "--window-us", "400"]) == 2
    assert "--out" not in (said := capsys.readouterr().err) and '"max_windows": 2' in said
    assert run(["batch", "-", "--out", str(out)]) == 2
    assert "standard input" in capsys.readouterr().err


def test_a_file_of_the_first_version_gets_the_columns_that_came_later(tmp_path):
    path = tmp_path / "old.db"
    with (
        closing(
            SqliteFile(path, application_id=APPLICATION_ID, what="readings", migrations=(SCHEMA,))
        ) as old,
        old.together(),
    ):
        old.db.execute("INSERT INTO settings VALUES ('{}')")
    with ReadingsDatabase(path, {}) as now:
        columns = [row[1] for row in now._db.execute("PRAGMA table_info(parts)")]
    assert columns[-3:] == ["log10_chance", "unused_correction", "grade"]
