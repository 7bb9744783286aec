"""What times whole processes: that they are run, one after the other; no time is judged."""

import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "perf"))

import processes

# A child is confined to cores before its program begins; JAX, where a test has imported it, warns of that.
pytestmark = pytest.mark.filterwarnings(r"ignore:os\.fork\(\) was called:RuntimeWarning")


def python(code):
    return [sys.executable, "-c", code]


def test_a_run_tells_when_the_first_line_came_when_it_ended_and_what_it_took(tmp_path, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    said = tmp_path / "said"
    code = """
import os, time
print("first", flush=True)
open("said", "w").write(os.environ.get("OPENBLAS_NUM_THREADS", "free"))
end = time.process_time() + 0.2
while time.process_time() < end:
    pass
"""
    run = processes.run(python(code), tmp_path)
    assert 0.0 < run.first < run.whole and run.processor > 0.2
    assert said.read_text() == "free"


def test_a_run_that_fails_says_why(tmp_path):
    with pytest.raises(SystemExit, match="ended with 3: no such luck"):
        processes.run(python("import sys; print('no such luck', file=sys.stderr); sys.exit(3)"), tmp_path)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_who_is_timed_and_its_neighbour_share_a_core(tmp_path):
    mine, neighbours = processes.two_cores()
    assert neighbours < mine or len(os.sched_getaffinity(0)) == 1
    code = "import os; assert os.sched_getaffinity(0) == {0}"
    with processes.neighbour(neighbours):
        processes.run(python(code.format(set(mine))), tmp_path, mine)


def test_two_that_count_take_twice_as_much(tmp_path):
    one, two = (processes.run(processes.counting(n, steps=2_000_000), tmp_path).processor for n in (1, 2))
    assert two > 1.5 * one


def test_all_run_once_a_round_and_the_first_round_does_not_count():
    calls = []

    def contestant(name):
        return lambda: calls.append(name) or len(calls)

    trials = list(processes.rounds_of({name: contestant(name) for name in "abc"}, 4))
    assert len(trials) == 4 and all(trial.keys() == set("abc") for trial in trials)
    turns = [calls[k : k + 3] for k in range(0, len(calls), 3)]
    assert len(turns) == 5 and all(sorted(turn) == list("abc") for turn in turns)
    assert len(set(map(tuple, turns))) > 1
    assert min(min(trial.values()) for trial in trials) == 4


def test_recordings_are_written_once_and_linked_for_as_many_as_are_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(processes.cases, "PIPELINE", {"a-1": {}, "b": {}})
    monkeypatch.setattr(processes.reader_times, "simulated", lambda name: SimpleNamespace(events=name))
    monkeypatch.setattr(processes, "save_recording", lambda path, events: path.write_text(events))
    for copies in (2, 3):
        paths = processes.stored(tmp_path, copies)
        assert [path.read_text() for path in paths] == ["a-1", "b"] * copies
    assert len(set(paths)) == 6
