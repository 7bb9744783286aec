"""From triggers to gates: pulses, starts and ends, positions of an encoder."""

import math

import pytest

from evqr.config import TriggerConfig
from evqr.errors import UsageError
from evqr.line.gates import MOST_GATES, Gates, Trigger, TriggerKind


def gates_of(*triggers, **settings):
    gates = Gates(TriggerConfig(**settings))
    for t_us, kind, *more in triggers:
        trigger = Trigger(t_us, TriggerKind(kind), *more)
        gates.check(trigger)
        gates.take(trigger)
    return gates


def bounds(gates):
    return [(gate.index, gate.opened_us, gate.closed_us) for gate in gates.waiting]


def test_a_pulse_asks_for_a_time_around_it():
    gates = gates_of((1_000, "pulse"), (5_000, "pulse", 7), before_us=200, after_us=3_000)
    assert bounds(gates) == [(0, 800, 4_000), (7, 4_800, 8_000)]
    assert [gate.check_us for gate in gates.waiting] == [4_000, 8_000]


def test_an_end_closes_the_gate_of_its_index_or_the_last():
    gates = gates_of(
        (0, "start", 4), (10, "start", 5), (20, "start", 6), (30, "end", 4), (40, "end"), (50, "end")
    )
    assert bounds(gates) == [(4, 0, 30), (5, 10, 50), (6, 20, 40)]


def test_ends_that_close_nothing_are_counted():
    gates = gates_of((5, "end"), (10, "start", 1), (20, "end", 2), (30, "end", 1), (40, "end", 1))
    assert bounds(gates) == [(1, 10, 30)]
    assert gates.ignored == 3


def test_a_lost_end_closes_by_time():
    assert bounds(gates_of((10, "start"), longest_us=500)) == [(0, 10, 510)]
    assert bounds(gates_of((10, "start"), (600, "end"), longest_us=500)) == [(0, 10, 510)]


def test_an_end_before_its_start_closes_at_once():
    assert bounds(gates_of((100, "start"), (40, "end"))) == [(0, 100, 100)]


def test_pulses_and_starts_are_counted_together_where_they_have_no_index():
    gates = gates_of((0, "start"), (1, "end"), (2, "pulse"), (3, "start"))
    assert [gate.index for gate in gates.waiting] == [0, 1, 2]


def test_an_encoder_opens_and_closes():
    """Parts of 100 ticks, 400 ticks behind the barrier; 1 tick is 10 us until the belt slows down to half."""
    gates = gates_of(
        (1_000, "pulse", 3, 50.0), (4_000, "ticks", None, 350.0), (7_000, "ticks", None, 500.0),
        ticks=(400.0, 500.0), longest_us=100_000,
    )  # fmt: skip
    assert bounds(gates) == [(3, 6_000, 101_000)]
    gates.take(Trigger(9_000, TriggerKind.TICKS, ticks=600.0))
    assert bounds(gates) == [(3, 6_000, 8_000)]


def test_what_stands_still_closes_by_time():
    gates = gates_of((0, "pulse", 0, 0.0), (500, "ticks", None, 0.0), ticks=(10.0, 20.0), longest_us=900)
    (gate,) = gates.waiting
    assert math.isinf(gate.start_us)
    assert bounds(gates) == [(0, 900, 900)]


def test_an_encoder_that_turns_back_closes_nothing():
    gates = gates_of(
        (0, "pulse", 0, 100.0), (100, "ticks", None, 105.0), (200, "ticks", None, 90.0),
        (300, "ticks", None, 105.0), ticks=(0.0, 10.0), longest_us=5_000,
    )  # fmt: skip
    assert bounds(gates) == [(0, 0, 5_000)]
    gates.take(Trigger(400, TriggerKind.TICKS, ticks=115.0))
    assert bounds(gates) == [(0, 0, 350)]


def test_ticks_do_not_move_gates_that_have_ends():
    gates = gates_of((0, "start", 0, 0.0), (10, "ticks", None, 100.0), ticks=(1.0, 2.0), longest_us=1_000)
    assert bounds(gates) == [(0, 0, 1_000)]


@pytest.mark.parametrize("kind", ["pulse", "ticks"])
def test_ticks_that_are_missing_are_refused(kind):
    with pytest.raises(UsageError, match=f"the {kind} trigger at 5 us must have ticks"):
        gates_of((5, kind), ticks=(1.0, 2.0))


def test_too_many_that_wait_are_refused():
    gates = gates_of(*((each, "pulse") for each in range(MOST_GATES)))
    with pytest.raises(UsageError, match="4096 triggers wait"):
        gates.check(Trigger(0))
    gates.check(Trigger(0, TriggerKind.END))
    assert len(gates.waiting) == MOST_GATES


def test_positions_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="ticks must be two positions, the second after the first"):
        TriggerConfig(ticks=(5.0, 5.0))
