"""From what was seen to parts: exactly one a trigger, whatever happens; or one a code that passes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_steps import CFG, GOOD, Line, again, left, read, searched, unread

from evqr.config import ReadConfig, SchedulerConfig
from evqr.line.history import MOST_KEPT
from evqr.reason import Reason

# ---- without triggers


def test_a_code_that_has_left_is_a_part():
    line = Line()
    line.take(read(0, "A", 1_000), read(1, "B", 1_200))
    assert line.rows == []
    line.take(left(1, 9_000), left(0, 12_000))
    assert line.rows == [(None, ["B"], None), (None, ["A"], None)]
    fields = line.told[1].fields()
    assert (fields["t_first_us"], fields["t_read_us"], fields["t_last_us"]) == (1_000, 1_500, 12_000)
    assert "t_start_us" not in fields and "trigger" not in fields


def test_a_code_that_comes_back_is_the_same_part():
    line = Line()
    line.take(read(0, "A", 1_000), left(0, 5_000), again(0, 8_000), left(0, 9_000))
    assert line.rows == [(None, ["A"], None)]


def test_a_code_that_was_seen_and_not_read_is_a_part_once_nothing_reads_it():
    line = Line()
    line.take(unread(1_000, 9_000), searched(9_000), searched(28_000))
    assert line.rows == []
    line.take(searched(29_500))
    assert line.rows == [(None, [], Reason.NOT_DECODED)]
    assert "agreement 0.90 over windows: 5, 62% of its modules clear, 3.1 events an edge" in str(
        line.told[0].verdict
    )


def test_what_hardly_agrees_is_no_part():
    line = Line()
    line.take(unread(1_000, 9_000, score=GOOD - 0.01), searched(60_000))
    line.end(70_000)
    assert line.rows == []


def test_what_is_read_later_is_one_part():
    line = Line()
    line.take(unread(1_000, 3_000, x=100.0), read(0, "A", 6_000, x=110.0), searched(40_000), left(0, 9_000))
    assert line.rows == [(None, ["A"], None)]


def test_what_is_followed_in_vain_twice_is_told_once():
    line = Line()
    line.take(unread(1_000, 3_000, x=100.0), unread(4_000, 6_000, x=106.0), searched(40_000))
    line.take(unread(41_000, 43_000, x=180.0), searched(80_000))
    assert line.rows == [(None, [], Reason.NOT_DECODED)]
    line.take(unread(41_000, 43_000, x=400.0), searched(80_000))
    assert len(line.rows) == 2


def test_without_triggers_none_is_taken():
    with pytest.raises(ValueError, match="triggers must be set"):
        Line().trigger(5)


def test_what_is_held_when_the_stream_ends_is_told():
    line = Line()
    line.take(unread(1_000, 9_000))
    line.end(10_000)
    assert line.rows == [(None, [], Reason.NOT_DECODED)]


# ---- one a trigger


def test_a_gate_has_the_codes_that_were_seen_in_it():
    line = Line(after_us=10_000)
    for k, t_us in enumerate((0, 50_000, 100_000)):
        line.trigger(t_us, index=10 + k)
    line.take(read(0, "A", 2_000), read(1, "B", 3_000), left(0, 8_000), left(1, 9_000))
    line.until(10_000)
    assert line.rows == [(10, ["A", "B"], None)]
    line.take(searched(52_000), read(2, "C", 102_000))
    line.until(60_000)
    assert line.rows[1:] == [(11, [], Reason.NOTHING_MOVES)]
    line.until(200_000)
    assert line.rows[2:] == [(12, ["C"], None)]
    fields = line.told[2].fields()
    assert (fields["t_start_us"], fields["t_end_us"], fields["t_last_us"]) == (100_000, 110_000, 110_000)


def test_a_code_that_is_lost_and_comes_back_within_a_gate_is_told_once():
    line = Line(after_us=10_000, until_codes=2)
    line.trigger(0, index=4)
    line.take(read(3, "A", 1_000), left(3, 4_000), again(3, 6_000))
    assert not line.told
    line.take(left(3, 8_000))
    line.until(10_000)
    (part,) = line.told
    (reading,) = part.readings
    assert (reading.text, reading.t_first_us, reading.t_last_us) == ("A", 1_000, 8_000)


def test_a_gate_waits_for_what_is_still_to_be_searched_of_it():
    line = Line(after_us=10_000, deadline_us=30_000)
    line.trigger(0)
    line.until(20_000, settled_us=9_000)
    assert line.rows == []
    line.take(read(0, "A", 9_000, read_us=21_000))
    line.until(22_000, settled_us=10_000)
    assert line.rows == [(0, ["A"], None)]


def test_no_gate_waits_longer_than_its_deadline():
    line = Line(after_us=10_000, deadline_us=30_000)
    line.trigger(0)
    line.take(searched(1_000))
    line.until(39_900, settled_us=4_000)
    assert line.rows == []
    line.until(40_000, settled_us=4_000)
    assert line.rows == [(0, [], Reason.DEADLINE)]
    assert "searched up to 4000 us, the gate closed at 10000 us" in str(line.told[0].verdict)


def test_a_code_that_is_followed_and_not_read_when_its_gate_ends_was_seen():
    line = Line(after_us=10_000)
    line.trigger(0)
    line.until(10_000, following=[unread(2_000, 9_900)])
    assert line.rows == [(0, [], Reason.NOT_DECODED)]


@pytest.mark.parametrize("codes", [1, 2])
def test_a_part_is_told_as_soon_as_so_many_codes_are_read(codes):
    line = Line(after_us=50_000, until_codes=codes)
    line.trigger(0)
    line.take(read(0, "A", 2_000))
    assert len(line.rows) == (codes == 1)
    line.take(read(1, "B", 3_000))
    assert line.rows == [(0, ["A", "B"][:codes], None)]
    line.until(60_000)
    assert len(line.rows) == 1


def test_a_trigger_may_come_later_than_its_events():
    line = Line(after_us=10_000, lateness_us=30_000)
    line.take(read(0, "A", 2_000), left(0, 8_000), searched(35_000))
    line.trigger(1_000)
    line.until(35_000)
    assert line.rows == [(0, ["A"], None)]


def test_a_trigger_that_comes_too_late_has_its_part_all_the_same():
    line = Line(after_us=10_000, lateness_us=30_000)
    line.take(read(0, "A", 2_000), left(0, 8_000), searched(200_000))
    line.trigger(1_000)
    line.until(200_000)
    assert line.rows == [(0, [], Reason.TRIGGER_LATE)]


def test_codes_of_gates_that_overlap_go_where_they_are_nearest_to_the_middle():
    """Pulses each 10 ms that ask for 20 ms: each code is in two gates."""
    line = Line(before_us=10_000, after_us=10_000)
    for k in range(4):
        line.trigger(10_000 * k)
        line.take(read(k, f"{k}", 10_000 * k - 4_000, x=100.0 * k), left(k, 10_000 * k + 5_000))
    line.until(90_000)
    assert line.rows == [(k, [f"{k}"], None) for k in range(4)]


def test_a_second_trigger_of_one_part_says_so():
    line = Line(after_us=10_000)
    line.trigger(0, index=1)
    line.take(read(0, "A", 2_000))
    line.until(10_000)
    line.trigger(12_000, index=2)
    line.until(22_000)
    assert line.rows == [(1, ["A"], None), (2, [], Reason.OTHER_PART)]
    assert str(line.told[1].verdict).endswith("that of trigger 1")


def test_a_lost_end_is_made_up_for():
    line = Line(longest_us=20_000)
    line.trigger(0, "start", 1)
    line.take(read(0, "A", 2_000), left(0, 6_000))
    line.until(19_000)
    assert line.rows == []
    line.until(20_000)
    line.trigger(21_000, "end", 1)
    line.until(90_000)
    assert line.rows == [(1, ["A"], None)]


def test_an_end_that_comes_late_closes_where_it_says():
    line = Line(longest_us=50_000)
    line.trigger(0, "start")
    line.take(read(0, "A", 2_000), left(0, 6_000), read(1, "B", 15_000), left(1, 18_000))
    line.until(20_000)
    line.trigger(10_000, "end")
    line.until(20_000)
    assert line.rows == [(0, ["A"], None)]


def test_a_belt_that_stands_blocks_nothing():
    line = Line(ticks=(10.0, 20.0), longest_us=30_000)
    line.trigger(0, ticks=5.0)
    line.until(29_000)
    assert line.rows == []
    line.until(31_000)
    assert line.rows == [(0, [], Reason.NOTHING_MOVES)]
    assert "t_start_us" not in line.told[0].fields()


def test_gates_that_the_stream_ends_before_are_told():
    line = Line(after_us=10_000)
    line.trigger(0)
    line.trigger(50_000)
    line.take(read(0, "A", 2_000))
    line.end(5_000)
    assert line.rows == [(0, ["A"], None), (1, [], Reason.RECORDING_ENDS)]


def test_triggers_of_a_clock_that_was_reset_stay_for_it():
    line = Line(after_us=10_000, lateness_us=1_000)
    for t_us in (1_000, 900_000):
        line.trigger(t_us)
    line.take(read(0, "A", 2_000))
    line.end(4_000, goes_on=True)
    assert line.rows == [(0, ["A"], None)]
    line.take(read(0, "B", 902_000))
    line.until(1_000_000)
    assert line.rows[1:] == [(1, ["B"], None)]


def test_what_is_remembered_is_bounded():
    cfg = ReadConfig(scheduler=SchedulerConfig(remembered_codes=4))
    line = Line(cfg=cfg, after_us=1_000, lateness_us=5_000)
    for k in range(500):
        t_us = 2_000 * k
        line.trigger(t_us)
        line.take(searched(t_us), read(k, "A", t_us, x=100.0), left(k, t_us + 900), unread(t_us, t_us + 9))
        line.until(t_us + 1_500)
    history = line.parts.history
    assert max(len(history.searches), len(history.unread), len(history.sights)) < 10
    assert len(history._readings) <= 5 and not line.parts._gates.waiting
    assert len(line.rows) == 500 and all(texts == ["A"] for _, texts, _ in line.rows)
    assert history.searches.maxlen == MOST_KEPT


@settings(max_examples=60, deadline=None)
@given(
    gates=st.lists(
        st.tuples(st.integers(0, 200), st.integers(1, 30), st.booleans(), st.integers(0, 60)),
        min_size=1, max_size=12,
    ),
    codes=st.lists(st.tuples(st.integers(0, 200), st.integers(1, 20)), max_size=12),
)  # fmt: skip
def test_each_trigger_has_exactly_one_part_and_each_code_is_in_one_at_most(gates, codes):
    """Gates of any times that overlap, come late or lose their ends; in units of 1 ms."""
    line = Line(longest_us=40_000, lateness_us=30_000)
    happening = []
    for k, (start, length, lost, late) in enumerate(gates):
        happening.append((start + late, 0, lambda k=k, s=start: line.trigger(1_000 * s, "start", k)))
        if not lost:
            end = start + length
            happening.append((end + late, 1, lambda k=k, e=end: line.trigger(1_000 * e, "end", k)))
    for k, (start, length) in enumerate(codes):
        happening.append((start, 2, lambda k=k, s=start: line.take(read(k, f"{k}", 1_000 * s))))
        end = start + length
        happening.append((end, 3, lambda k=k, e=end: line.take(left(k, 1_000 * e))))
    for when, _, happen in sorted(happening, key=lambda each: each[:2]):
        line.take(searched(1_000 * when))
        line.until(1_000 * when)
        happen()
    line.end(400_000)
    assert sorted(trigger for trigger, _, _ in line.rows) == list(range(len(gates)))
    texts = [text for _, texts, _ in line.rows for text in texts]
    assert len(texts) == len(set(texts)) <= len(codes)
    assert all((reason is None) == bool(texts) for _, texts, reason in line.rows)


def test_the_settings_say_what_agrees():
    assert CFG.align.good_score == GOOD
