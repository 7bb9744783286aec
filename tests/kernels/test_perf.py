"""What measures operations: every problem and rival agrees with the specification, and rows come out right.

No time is judged.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "perf"))

import on_gpu
import op_times
import ops
import peers
import table
import timing
from peers import PEERS
from problems import TOLERANCE, Prepared, Problem, Size, distance

from evqr_kernels import OPERATIONS

PERF = Path(__file__).parents[2] / "perf"
SMALL = Size(batch=2, events=60, side=40, modules=21)


def from_specification(op, size=SMALL):
    problem = ops.build(op, size)
    return problem, Prepared(problem, "numpy", "cpu").results()


@pytest.mark.parametrize("op", ops.PROBLEMS)
def test_every_problem_agrees_and_replays_alike(op):
    problem, expected = from_specification(op)
    prepared = Prepared(problem, "warp", "cpu")
    assert distance(prepared.results(), expected) <= TOLERANCE[np.dtype(np.float32)]
    assert any(np.any(array) for array in expected)
    assert problem.items > 0
    assert problem.bytes > 0
    assert problem.madds > 0
    if problem.passes == 1:
        prepared.record()
        again = prepared.results()
        assert distance(again, expected) <= TOLERANCE[np.dtype(np.float32)]


def test_every_operation_has_a_problem():
    assert {ops.build(name, SMALL).op for name in ops.PROBLEMS} - {"cost"} == set(OPERATIONS)


@pytest.mark.parametrize("op", ops.PROBLEMS)
def test_a_batch_is_as_much_work_as_its_windows(op):
    one, three = (ops.build(op, replace(SMALL, batch=batch)) for batch in (1, 3))
    assert three.items == 3 * one.items
    if op != "motion_correlation":  # that counts the pixels that it finds
        assert three.madds == pytest.approx(3 * one.madds)


@pytest.mark.filterwarnings("ignore")  # rivals' own
@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: f"{peer.op}-{peer.name}")
def test_every_rival_computes_the_same(peer):
    if peer.missing:
        pytest.skip(peer.missing)
    problem, expected = from_specification(peer.op)
    got = [np.asarray(array) for array in peer.prepare(problem)()]
    assert distance(got, expected) <= peer.tolerance


def test_a_rival_that_is_not_there_says_so():
    peer = peers.Peer("bin_events", "none", "no_such_module", lambda problem: list)
    assert peer.missing == "no_such_module is not installed"


def test_what_a_call_changes_is_restored():
    problem = ops.build("solve_code", SMALL)
    prepared = Prepared(problem, "warp", "cpu")
    first, second = prepared.results(), prepared.results()
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_bytes_count_scratch_twice_and_sums_as_often_as_they_are_touched():
    a = np.zeros(10, np.float32)
    problem = Problem("op", [a, 2.0], [a, a, a], items=1, madds=1, scratch=1, passes=2)
    assert problem.bytes == 40 * (1 + 2 + 2 * 2)


def test_distance_of_what_is_not_finite():
    assert distance([np.array([np.nan])], [np.array([1.0])]) == np.inf
    assert distance([np.array([1.0, 2.5])], [np.array([1.0, 2.0])]) == 0.25


def test_everyone_is_measured_every_round():
    calls = []
    contestants = {name: lambda name=name: calls.append(name) or 1.0 for name in "abc"}
    assert timing.interleaved(contestants, 4) == {name: [1.0] * 4 for name in "abc"}
    rounds = [calls[k : k + 3] for k in range(0, 12, 3)]
    assert all(sorted(order) == list("abc") for order in rounds)
    assert len({tuple(order) for order in rounds}) > 1


def test_rounds_beside_other_work_do_not_count():
    rounds = [{"control": 1.1}, {"control": 1.98}, {"control": 1.5}]
    assert op_times.undisturbed(rounds) == rounds[1:2]


def test_a_result_is_named_after_commit_and_case(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "__file__", str(tmp_path / "table.py"))
    path = table.save("cuda:0", {"commit": "abc"}, [], "operations", "threads")
    assert path.parent == tmp_path / "results" / "cuda-0"
    assert path.name.endswith("-abc-operations-threads.csv")


def test_rows_are_judged_printed_and_compared(tmp_path):
    rows = [
        table.row("op ms", "production", "splat", "warp", [2.0, 2.0], rate=1.0, share="", bound=""),
        table.row("ratio", "production", "splat", "numba / warp", [0.5, 0.5], required=1.0),
        table.row("growth", "events", "splat", "warp", [1.01], expected=1.0),
    ]
    assert [table.met(r) for r in rows] == [True, False, True]
    saved = tmp_path / "base.csv"
    saved.write_text(table.as_csv({"commit": "abc"}, rows))
    rows[0]["median"] = 1.0
    table.compare(rows, saved)
    assert rows[0]["base"] == 2.0
    text = table.as_human({"commit": "abc"}, rows)
    assert "required 1.0: MISSED" in text
    assert "base 2.00 x" in text


def test_every_command_is_in_the_list():
    listed = (PERF / "README.md").read_text()
    commands = [path.name for path in PERF.glob("*.py") if '__name__ == "__main__"' in path.read_text()]
    assert len(commands) > 20
    assert [name for name in commands if name not in listed] == []


def test_what_parts_print_becomes_a_page_and_a_table(tmp_path):
    printed = (
        "way tracked, windows 8, device cuda:0, median_ms 0.5\n"
        "tracked, B = 8, 10000 events a window: 14 launches\n"
        "  H100     PCIe 4:       810 windows/s, 1.23 ms: Python 0.49\n"
    )
    tell = on_gpu.Part("windows", [sys.executable, "-c", f"print({printed!r})"], 60)
    fail = on_gpu.Part("tests", [sys.executable, "-c", "import sys; sys.exit('no such device')"], 60)
    done = [on_gpu.run(part, 60) for part in (tell, fail)]
    assert [each.outcome for each in done] == ["done", "exit status 1"]
    assert done[0].rows[1]["windows_a_second"] == "810"
    on_gpu.write(tmp_path, done, [replace(tell, name="model")], "cuda:0")
    page = (tmp_path / "on_gpu.md").read_text()
    assert "| tracked | 8 | cuda:0 | 0.5 |" in page and "no such device" in page and "time: model." in page
    assert "windows,done,tracked,8,cuda:0,0.5" in (tmp_path / "on_gpu.csv").read_text()


def test_a_part_that_takes_too_long_is_ended():
    slow = on_gpu.Part("slow", [sys.executable, "-c", "import time; time.sleep(60)"], 60)
    assert on_gpu.run(slow, 0.5).outcome == "took longer than 0 s"
