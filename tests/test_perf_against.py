"""What times two commits against each other: the processes that read, the pairs, and what is made of them.

No time is judged; the trees are made up, and read what a file says.
"""

import os
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "perf"))

import against
import cases
import table
from against import NOTHING, Trial, Window

EVQR = """
import os
from dataclasses import dataclass

@dataclass
class EventArray:
    t: object
    x: object
    y: object
    p: object
    width: int
    height: int

class Solver:
    def __init__(self, device):
        self.device = device
        os.system("echo a library greets")
"""

PIPELINE = """
import os
from collections import namedtuple

Recording = namedtuple("Recording", "case events texts starts_us")
Job = namedtuple("Job", "recording start_us")

def prepare(recording, solver):
    print("so do I")
    return [Job(recording, start) for start in recording.starts_us]

def can_run(method, job):
    return method == "cold" or job.start_us > 1000

RUN = {
    "cold": lambda job, solver: " ".join([
        solver.device, *sorted(job.recording.texts), *map(str, job.recording.events.t), TREE,
        str(job.recording.events.width), os.environ.get("OPENBLAS_NUM_THREADS", "free"),
    ]),
    "tracked": lambda job, solver: None,
}
"""


def made_up(tree, name):
    for path, text in (("evqr/__init__.py", EVQR), ("perf/pipeline.py", f"TREE = {name!r}\n{PIPELINE}")):
        (tree / path).parent.mkdir(parents=True)
        (tree / path).write_text(text)
    return against.Tree(tree, Path(sys.executable))


def recording(case, texts, starts):
    events = SimpleNamespace(
        t=np.array([5, 7]), x=np.array([1, 2]), y=np.array([3, 4]), p=np.array([1, -1]), width=64, height=48
    )
    return SimpleNamespace(case=case, events=events, texts=frozenset(texts), starts_us=starts)


def test_a_tree_reads_with_its_own_files_and_nothing_set(tmp_path, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    (tmp_path / "stored").mkdir()
    against.store([recording("a", ["TEXT"], (500, 2000))], tmp_path / "stored")
    workers = [
        against.Worker(made_up(tmp_path / name, name), "cpu", tmp_path / "stored") for name in ("one", "two")
    ]
    for worker, name in zip(workers, ("one", "two"), strict=True):
        windows, versions = worker.ready()
        assert windows == {Window("a", 500, "cold"), Window("a", 2000, "cold"), Window("a", 2000, "tracked")}
        assert versions["numpy"] == np.__version__
        answer = worker.ask(Window("a", 500, "cold"))
        assert answer["text"] == f"cpu TEXT 5 7 {name} 64 free" and answer["ms"] > 0.0
        assert worker.ask(Window("a", 2000, "tracked"))["text"] is None
        worker.close()


def test_a_tree_that_cannot_read_says_which(tmp_path, capfd):
    worker = against.Worker(against.Tree(tmp_path, Path(sys.executable)), "cpu", tmp_path)
    with pytest.raises(SystemExit, match="ended with 1"):
        worker.ready()
    worker.close()
    assert "No module named 'pipeline'" in capfd.readouterr().err


class Reader:
    def __init__(self, name, calls):
        self.name, self.calls = name, calls

    def ask(self, window):
        self.calls.append((self.name, window))
        return {"ms": float(len(self.calls)), "text": self.name}


def test_all_read_a_window_one_right_after_the_other_and_the_first_round_does_not_count():
    calls = []
    readers = {name: Reader(name, calls) for name in "abcd"}
    windows = [Window("case", start, "cold") for start in range(5)]
    trials = list(against.run_trials(readers, windows, rounds=3))
    assert len(trials) == 15 and len(calls) == 4 * 20
    turns = [calls[k : k + 4] for k in range(0, len(calls), 4)]
    assert all(sorted(name for name, _ in turn) == list("abcd") for turn in turns)
    assert all(len({window for _, window in turn}) == 1 for turn in turns)
    assert len({tuple(name for name, _ in turn) for turn in turns}) > 4
    rounds = [[turn[0][1] for turn in turns[k : k + 5]] for k in range(0, 20, 5)]
    assert all(sorted(w.start_us for w in order) == list(range(5)) for order in rounds)
    assert len({tuple(order) for order in rounds}) > 1
    assert min(trials[0].ms.values()) == 21.0 and trials[0].text == dict(zip("abcd", "abcd", strict=True))


def test_what_the_other_commit_leaves_out_is_read_by_this_tree_alone():
    calls = []
    readers = {name: Reader(name, calls) for name in (*against.THIS, *against.OTHER)}
    both, mine = Window("case", 1, "cold"), Window("noise", 1, "cold")
    trials = list(against.run_trials(readers, [both, mine], 1, alone={mine}))
    assert {trial.window: set(trial.ms) for trial in trials} == {both: set(readers), mine: set(against.THIS)}
    assert {name for name, window in calls if window == mine} == set(against.THIS)


TEXTS = {"code": frozenset({"RIGHT"}), "boxes": frozenset()}
COLD, BOXES = Window("code", 1, "cold"), Window("boxes", 1, "cold")


def trial(window, this, other, text="RIGHT", other_text="RIGHT"):
    ms = {"this": this, "this again": this, "other": other, "other again": other / 2}
    texts = {"this": text, "this again": text, "other": other_text, "other again": other_text}
    return Trial(window, ms, texts)


def rows(windows, trials):
    made = against.rows_of("ref", TEXTS, windows, trials)
    return {(r["part"], r["case"], r["method"], r["stage"]): r for r in made}


def test_ratios_are_medians_of_pairs():
    made = rows([COLD, BOXES], [*[trial(COLD, 2.0, 4.0)] * 2, trial(BOXES, 3.0, 9.0, None, None)])
    ratio = made["ratio", "all", "cold", "ref / this"]
    # the second process of the other commit takes half of the time: pairs of 2 and 1
    assert (ratio["median"], ratio["n"], ratio["required"]) == (1.5, 4, against.REQUIRED)
    assert made["ratio", "code", "cold", "ref / ref"]["median"] == 2.0
    assert made["ratio", "all", NOTHING, "ref / this"]["required"] == ""
    assert made["window ms", "all", "cold", "this"]["median"] == 2.0
    assert made["window ms", "all", "cold", "ref"]["read"] == "100%"
    assert made["window ms", "boxes", NOTHING, "this"]["read"] == ""
    assert all(map(table.met, made.values()))


def test_slower_by_more_than_the_margin_is_missed():
    required = {
        this: table.met(rows([COLD], [trial(COLD, this, 2.0)])["ratio", "all", "cold", "ref / this"])
        for this in (1.57, 1.59)
    }
    assert required == {1.57: True, 1.59: False}  # against pairs of 2 and 1


@pytest.mark.parametrize(
    ("text", "other_text", "good"),
    [
        ("RIGHT", "RIGHT", 1.0), ("RIGHT", None, 1.0), (None, None, 1.0), ("WRONG", "WRONG", 1.0),
        (None, "RIGHT", 0.5), ("WRONG", "RIGHT", 0.5), ("WRONG", None, 0.5),
    ],
)  # fmt: skip
def test_a_text_that_is_lost_or_false_is_missed(text, other_text, good):
    second = Window("code", 2, "cold")
    made = rows([COLD, second], [trial(COLD, 1.0, 1.0, text, other_text), trial(second, 1.0, 1.0)])
    row = made["same text", "all", "cold", "share"]
    assert (row["median"], row["n"]) == (good, 2) and table.met(row) == (good == 1.0)
    assert ("same text", "code", "cold", "share") in made or good == 1.0


def test_a_window_that_this_tree_cannot_read_is_lost():
    made = rows([COLD, Window("code", 2, "cold")], [trial(COLD, 1.0, 1.0)])
    assert made["same text", "all", "cold", "share"]["median"] == 0.5
    assert rows([COLD], [])["same text", "all", "cold", "share"]["median"] == 0.0


def test_packages_that_differ_are_named():
    there = {"evqr": "0.1", "numpy": "2.0", "pip": "1", "h5py": "3.1", "gone": "1"}
    here = {"evqr": "0.2", "numpy": "2.1", "pip": "2", "h5py": "3.1", "new": "1"}
    assert against.differing(there, here) == ["numpy 2.0, here 2.1"]


def test_an_unknown_commit_is_refused(monkeypatch):
    monkeypatch.setattr(against, "git", lambda *arguments, check=True: "")
    with pytest.raises(SystemExit, match="--against nowhere: this clone has no such commit"):
        against.checked_out("nowhere")


def test_what_holds_threads_back_or_byte_code_is_not_passed_on(monkeypatch):
    monkeypatch.setenv("RAYON_NUM_THREADS", "1")
    left_out = {"PYTHONPATH": "/elsewhere", "PYTHONDONTWRITEBYTECODE": "1"}
    for name, value in left_out.items():
        monkeypatch.setenv(name, value)
    kept = against.environment()
    assert kept.keys() == {k for k in os.environ if not k.endswith("_THREADS") and k not in left_out}


def test_windows_without_a_code_are_compared_with_the_other_commits_code_in_their_round():
    texts = {
        "code": frozenset({"RIGHT"}),
        "boxes-a": frozenset(),
        "boxes-b": frozenset(),
        "noise-a": frozenset(),
    }
    cold, a, b, noise = (Window(case, 1, "cold") for case in texts)
    nothing = {"text": None, "other_text": None}
    trials = [
        replace(trial(window, this, other, **more), round=(0, round_))
        for round_, scale in ((1, 1.0), (2, 10.0))
        for window, this, other, more in (
            (cold, 99.0, 4.0 * scale, {}), (a, 6.0 * scale, 1.0, nothing), (b, 12.0 * scale, 1.0, nothing),
            (noise, 1.0 * scale, 1.0, nothing),
        )
    ]  # fmt: skip
    made = {r["case"]: r for r in against.rows_without_code("ref", texts, trials)}
    # processes of the other commit take 4 and 2 on a code, 40 and 20 in the second round: 3 and 30
    assert made["boxes"]["median"] == pytest.approx((3 / 6 + 3 / 12) / 2)
    assert (made["boxes"]["n"], made["boxes"]["required"]) == (8, 0.5)
    assert made["noise"]["median"] == 3.0 and made["noise"]["required"] == 2.0
    assert against.rows_without_code("ref", texts, [t for t in trials if t.window != cold]) == []
    rows = against.rows_of("ref", texts, [cold], trials)  # where the other commit leaves out what shows none
    assert {r["case"] for r in rows if r["stage"] == "ref with a code / this"} == {"boxes", "noise"}
    assert all(r["case"] == "code" or r["case"] == "all" or r["method"] == NOTHING for r in rows)


def test_views_are_compared_window_by_window():
    small, large = (
        [Window(case, start, method) for start in (1, 2) for method in ("cold", "tracked")]
        for case in cases.VIEWS
    )
    trials = [trial(w, 2.0 if w in small else 2.5 * w.start_us, 1.0) for w in (*small, *large)]
    (made,) = against.rows_of_views(trials)
    assert (made["median"], made["n"], made["required"]) == (0.6, 4, cases.VIEWS_RATIO)
    assert against.rows_of_views(trials[:4]) == []
