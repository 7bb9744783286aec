"""Cells: what one holds, that it is kept, and that it does not matter who computes it."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evqr.errors import UsageError
from evqr.paper.dataset.manifest import load_manifest, load_sequence
from evqr.paper.evaluate import cell as cells_module
from evqr.paper.evaluate.cell import Cell, run_cells
from evqr.paper.evaluate.table import TIMES, table_of
from evqr.paper.evaluate.trial import run_trial
from evqr.paper.methods.method import Outcome

METHODS = ("image", "evqr", "evqr_fused", "integrate")
CELLS = [
    Cell(recording=name, method=method, trials=2) for name in ("belt-00", "belt-30") for method in METHODS
]


def lines(results):
    """The table, without what differs from run to run."""
    return [line.record(times=False) for line in table_of(results)]


@pytest.fixture(scope="module")
def results(tiny, tmp_path_factory):
    return run_cells(tiny, CELLS, tmp_path_factory.mktemp("kept"))


def test_each_method_reads_its_trials(results):
    scores = {(r.entry.angle, r.cell.method): r.score for r in results}
    assert scores[30, "evqr"].yield_rate == scores[30, "integrate"].image_read_rate == 1.0
    assert scores[0, "image"].read_rate == 1.0 and scores[0, "image"].trials == 1
    assert scores[30, "evqr"].trials == 2 and scores[30, "evqr"].mode_accuracy == 1.0
    assert scores[30, "evqr_fused"].windows == 1.0
    for score in scores.values():
        assert score.false_read_rate == 0.0 and score.seconds > 0.0


def test_a_trial_knows_its_events(results):
    trial = next(r for r in results if r.cell.method == "evqr").trials[0]
    assert 3.0 < trial.events_per_edge < 100.0
    assert trial.confidence > 0.999 and trial.modules.dtype == np.int8
    fused = next(r for r in results if r.cell.method == "evqr_fused").trials[0]
    # read from the first of its windows: the events of the others were not needed
    assert fused.windows == 1 and 3.0 < fused.events_per_edge < 1.5 * trial.events_per_edge


def test_time_ends_where_a_method_ends(tiny):
    sequence = load_sequence(tiny, load_manifest(tiny)[0])

    class Slow:
        takes, windows, matched = "events", 1, False

        def read(self, seen, watch):
            for iteration in (1, 2, 3):
                watch(iteration, np.zeros((21, 21)), iteration >= 2)
                time.sleep(0.2)
            return Outcome(search_seconds=0.125)

    trial, _ = run_trial(Slow(), sequence.window(0, 1), sequence)
    assert 0.19 < trial.seconds < 0.4 and trial.search_seconds == 0.125


def test_full_and_quick_runs_keep_cells_of_their_own():
    names = {
        replace(CELLS[0], trials=trials, quick=quick).name for trials in (None, 2, 5) for quick in (0, 1)
    }
    assert len(names) == 6


def test_a_result_is_the_same_when_it_was_kept(tiny, tmp_path):
    fresh = run_cells(tiny, CELLS[:2], tmp_path)
    kept = run_cells(tiny, CELLS[:2], tmp_path)
    for a, b in zip(fresh, kept, strict=True):
        assert a.score == b.score
        np.testing.assert_array_equal(a.picture, b.picture)
        np.testing.assert_array_equal(a.trials[0].modules, b.trials[0].modules)


def test_only_what_is_not_kept_is_computed(tiny, tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(
        cells_module,
        "run_cell",
        lambda folder, entry, cell: done.append(cell.name) or real(folder, entry, cell),
    )
    real = _REAL
    run_cells(tiny, CELLS[:3], tmp_path)
    assert done == [cell.name for cell in CELLS[:3]]
    (tmp_path / f"{CELLS[1].name}.json").write_text('{"half a ce')
    told = []
    run_cells(tiny, CELLS[:4], tmp_path, progress=lambda cell: told.append(cell.name))
    assert done[3:] == [CELLS[1].name, CELLS[3].name]
    assert told == [cell.name for cell in CELLS[:4]]
    run_cells(tiny, [replace(CELLS[0], trials=1)], tmp_path)
    assert len(done) == 6


_REAL = cells_module.run_cell


def test_fewer_events_and_longer_windows(tiny, tmp_path):
    base = Cell(recording="belt-30", method="evqr", trials=1)
    whole, thin, long = run_cells(tiny, [base, replace(base, keep=0.5), replace(base, stretch=2.0)], tmp_path)
    events = [result.trials[0].events_per_edge for result in (whole, thin, long)]
    assert events[1] == pytest.approx(0.5 * events[0], rel=0.1)
    assert events[2] == pytest.approx(2.0 * events[0], rel=0.2)


def test_a_method_that_was_revised_is_computed_again_and_others_are_not(tiny, tmp_path, monkeypatch):
    both = [Cell(recording="belt-30", method=method, trials=1) for method in ("image", "integrate")]
    run_cells(tiny, both, tmp_path)
    revised = replace(cells_module.METHODS["image"], revision=7)
    monkeypatch.setattr(cells_module, "METHODS", {**cells_module.METHODS, "image": revised})
    computed = []
    real = cells_module.run_cell
    monkeypatch.setattr(cells_module, "run_cell", lambda *a: (computed.append(a[-1].method), real(*a))[1])
    run_cells(tiny, both, tmp_path)
    assert computed == ["image"]


def test_the_paper_s_method_says_how_it_got_there(tiny, tmp_path):
    (result,) = run_cells(tiny, [Cell(recording="belt-30", method="descent", trials=1)], tmp_path)
    (trial,) = result.trials
    assert trial.start in ("paper", "solver") and trial.pose_iterations >= 1
    assert trial.iterations_to_few >= trial.iterations_to_read >= 1


def test_a_recording_that_is_not_there(tiny, tmp_path):
    with pytest.raises(UsageError, match="no recording 'belt-99'"):
        run_cells(tiny, [Cell(recording="belt-99", method="evqr")], tmp_path)


def test_a_process_pool_gives_the_same_table(tiny, tmp_path, results):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert lines(run_cells(tiny, CELLS, tmp_path, executor=pool)) == lines(results)


def test_a_dask_cluster_gives_the_same_table(tiny, tmp_path, results):
    distributed = pytest.importorskip("distributed", reason="extra 'distributed' is not installed")
    local = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        assert lines(run_cells(tiny, CELLS, tmp_path, executor=client.get_executor())) == lines(results)


WAITING = """
import os, sys, time
from evqr.cli.workers import workers
if __name__ == "__main__":
    with workers(2) as pool:
        print(*{job.result() for job in [pool.submit(os.getpid) for _ in range(20)]}, flush=True)
        time.sleep(60)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks /proc what runs")
def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "waiting.py"
    script.write_text(WAITING)
    run = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        workers = [int(pid) for pid in run.stdout.readline().split()]
        assert workers
    finally:
        run.kill()
        run.wait()
        run.stdout.close()
    deadline = time.monotonic() + 10
    while any(is_running(pid) for pid in workers):
        assert time.monotonic() < deadline, "workers outlive their parent"
        time.sleep(0.05)


def is_running(pid):
    """Whether a process does anything: one that has ended and that nobody asks about is still there."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


def test_a_run_that_is_killed_goes_on_where_it_was(tiny, tmp_path, results):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "evqr", "table1", "--dataset", str(tiny), "--out", str(out)]
    command += ["--methods", ",".join(METHODS), "--trials", "2", "--no-sweep"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        while len(list(out.glob("cells/*.json"))) < 2:
            assert run.poll() is None and time.monotonic() < deadline, "the run ended before it was killed"
            time.sleep(0.005)
        os.kill(run.pid, signal.SIGKILL)
    finally:
        run.kill()
        run.wait()
    before = {path: path.stat().st_mtime_ns for path in out.glob("cells/*.json")}
    assert not (out / "table1.json").exists()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "report.html" in done.stdout
    assert {path: path.stat().st_mtime_ns for path in before} == before
    table = json.loads((out / "table1.json").read_text())["lines"]
    assert [{k: v for k, v in line.items() if k not in TIMES} for line in table] == lines(results)
