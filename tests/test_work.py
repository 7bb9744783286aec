"""Reading side by side: what is asked for of one stage is done at once, the earliest stage first."""

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import segno

from evqr.clock import StageClock
from evqr.config import DecodeConfig
from evqr.events.array import EventArray
from evqr.events.buffer import EventBuffer
from evqr.symbol import qr
from evqr.work import Decode, Estimate, Find, Follow, Solve, answer, decoded, do, together, with_windows

NOBODY: Any = None
"""Stands in for a solver that is not asked."""


def works(kind, *names) -> list[Any]:
    """Works that are told apart by their first field."""
    return [kind(name, *[None] * (len(kind._fields) - 1)) for name in names]


def asking(*requests):
    """Asks for works in turn and gives all answers."""
    answers = []
    for request in requests:
        answers.append((yield request))
    return answers


def served(working):
    """Answer each work with its name in capitals; what was asked for, and what came of it."""
    asked, done = [], None
    while True:
        try:
            now = working.send(done)
        except StopIteration as end:
            return asked, end.value
        assert len({type(work) for work in now}) <= 1
        asked.append("".join(work[0] for work in now))
        done = [work[0].upper() for work in now]


def test_those_ahead_wait_for_those_behind():
    asked, answers = served(
        together(
            [
                asking(works(Find, "a"), works(Solve, "b")),
                asking(works(Estimate, "c"), works(Estimate, "d"), works(Find, "e"), works(Solve, "f", "g")),
                asking(works(Follow, "h"), works(Decode, "i")),
            ]
        )
    )
    assert asked == ["c", "d", "ae", "h", "bfg", "i"]
    assert answers == [
        [["A"], ["B"]],
        [["C"], ["D"], ["E"], ["F", "G"]],
        [["H"], ["I"]],
    ]


def test_groups_are_put_together_too():
    def pair(first, second):
        return together([asking(works(Follow, first)), asking(works(Follow, second))])

    asked, answers = served(together([pair("a", "b"), pair("c", "d")]))
    assert asked == ["abcd"]
    assert answers == [[[["A"]], [["B"]]], [[["C"]], [["D"]]]]


def test_who_asked_for_work_that_failed_is_told():
    """One of them makes do without, one does not, and one had not asked."""

    def careful():
        try:
            yield works(Find, "a")
        except ZeroDivisionError:
            return (yield works(Solve, "b"))

    working = together([careful(), asking(works(Solve, "c"))])
    assert next(working)[0].window == "a"
    asked = working.throw(ZeroDivisionError())
    assert [work.equations for work in asked] == ["b", "c"]
    with pytest.raises(StopIteration) as end:
        working.send(["B", "C"])
    assert end.value.value == [["B"], [["C"]]]

    working = together([careful(), asking(works(Find, "c"))])
    next(working)
    with pytest.raises(ZeroDivisionError):
        working.throw(ZeroDivisionError())


def test_nobody_and_nothing_to_do_are_no_special_cases():
    assert served(together([])) == ([], [])
    assert served(together([asking([]), asking(works(Solve, "a"))]))[1] == [[[]], [["A"]]]
    assert do([], NOBODY) == []


def test_windows_are_given_as_they_are_asked_for():
    def activity():
        window = yield 10, 30
        (answer,) = yield works(Decode, "a")
        return window.events.t.tolist(), answer

    t = np.arange(0, 60, 5)
    column = np.zeros(len(t), np.uint16)
    buffer = EventBuffer.of(EventArray(t, column, column, np.ones(len(t), np.int8), 8, 8))
    assert served(with_windows(activity(), buffer)) == (["a"], ([10, 15, 20, 25], "A"))


def test_a_wrong_grid_is_refused_where_it_is_decoded():
    work = Decode(np.zeros((3, 3)), qr.space(1), DecodeConfig(), "full", StageClock())
    with pytest.raises(ValueError, match="q must have shape"):
        do([work], NOBODY)


# ---- decoding


class Noted(ThreadPoolExecutor):
    """Threads that say how much they were asked to do, and begin only when they may."""

    def __init__(self):
        super().__init__(2)
        self.asked, self.may = 0, threading.Event()

    def submit(self, call, *given):
        self.asked += 1
        return super().submit(lambda: (self.may.wait(20), call(*given))[1])


def grids(*signs):
    """Grids of one symbol with noise, of which those that are told have an error."""
    rng = np.random.default_rng(3)
    made = np.where(np.array(segno.make("AHEAD", version=1, error="M", mask=0).matrix, bool), -1.0, 1.0)
    for wrong in signs:
        q = made * np.abs(rng.normal(1.0, 0.2, made.shape))
        q[12, 12] *= -1.0 if wrong else 1.0
        yield q


def decodes(*signs):
    clock = StageClock()
    return [Decode(q, qr.space(1), DecodeConfig(), "full", clock) for q in grids(*signs)], clock


def test_grids_with_errors_are_decoded_on_other_threads_and_nobody_waits_before_all_else_is_done():
    works_, clock = decodes(False, True, True, False)
    order = []

    def reading():
        outcomes = yield from decoded(works_)
        order.append("decoded")
        return outcomes

    def other():
        order.append((yield [Estimate(NOBODY)]))
        order.append((yield [Solve(NOBODY, clock)]))
        pool.may.set()

    class Fast:
        @staticmethod
        def motions(windows, **_):
            return ["motion"]

        @staticmethod
        def solve(equations):
            return ["modules"]

    with Noted() as pool:
        solver: Any = Fast()
        (outcomes, _) = answer(together([reading(), other()]), solver, pool)
    assert pool.asked == 2
    assert order == [["motion"], ["modules"], "decoded"]
    assert [outcome.errors_corrected for outcome in outcomes] == [0, 1, 1, 0]
    assert outcomes == answer(decoded(works_), NOBODY)  # as without threads
    assert clock.ms["decode"] > 0.0


def test_what_is_wrong_with_a_grid_is_raised_for_who_waits_for_it():
    works_, _ = decodes(True)
    wrong = works_[0]._replace(q=np.full((21, 21), np.nan))
    with Noted() as pool, pytest.raises(ValueError, match="q must be finite"):
        pool.may.set()
        answer(decoded([wrong]), NOBODY, pool)
