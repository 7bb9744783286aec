"""Why a part has no text: each reason, and what comes before what."""

import pytest
from line_steps import CFG, GOOD, SIZE, Line, read, searched, unread

from evqr.line.history import Skipped
from evqr.line.verdict import verdict_on
from evqr.reason import Reason


def verdict(unread=(), searches=()):
    return verdict_on(unread, searches, SIZE, CFG)


def test_nothing_moved():
    searches = [searched(0), searched(2_000, reason=Reason.TOO_FEW_EVENTS)]
    assert verdict(searches=searches).reason is Reason.NOTHING_MOVES
    assert verdict().reason is Reason.NOTHING_MOVES


def test_nothing_like_a_code():
    searches = [searched(0), searched(2_000, reason=Reason.DISAGREES, closest=0.43, speed=3_000.0)]
    found = verdict(searches=searches)
    assert found.reason is Reason.NOTHING_LIKE_A_CODE
    assert str(found) == "nothing like a code: closest agreement 0.43, searches: 2, 3.00 px/ms"
    followed = verdict([unread(0, 9_800, score=0.55, windows=11)], searches)
    assert followed.reason is Reason.NOTHING_LIKE_A_CODE and followed.nearest is not None
    assert "closest agreement 0.55, followed over windows: 11" in str(followed)


def test_a_code_was_seen():
    """By the mean over its windows, not by the one that agreed best."""
    found = verdict([unread(0, 9_000, score=GOOD), unread(0, 9_000, score=0.5, x=400.0)])
    assert found.reason is Reason.NOT_DECODED and found.nearest.mean_score == GOOD
    assert found.motion.speed == 2_000.0


def test_a_code_was_never_wholly_in_view():
    assert verdict([unread(0, 1_000, x=-10.0, speed=2_000.0)]).reason is Reason.PARTLY_IN_VIEW
    # it comes in while it is seen
    assert verdict([unread(0, 20_000, x=-10.0, speed=2_000.0)]).reason is Reason.NOT_DECODED


def test_pixels_that_lag_by_modules():
    found = verdict([unread(0, 9_000, speed=10_000.0, tau_us=(300.0, 700.0))])
    assert found.reason is Reason.TOO_FAST and "pixels lag by 1.8 modules" in str(found)


@pytest.mark.parametrize(("speed", "reason"), [(30.0, Reason.TOO_SLOW), (150_000.0, Reason.TOO_FAST)])
def test_speeds_that_no_window_suits(speed, reason):
    searches = [searched(0, reason=Reason.NO_FINDER_PATTERNS, speed=speed)]
    assert verdict(searches=searches).reason is reason


def test_searches_that_were_skipped():
    line = Line(after_us=10_000)
    line.trigger(0)
    line.take(searched(1_000))
    line.parts.history.skipped.append(Skipped(2_000, 5_000))
    line.until(10_000)
    assert line.rows == [(0, [], Reason.OVERLOAD)]


def test_what_was_seen_says_more_than_that_searches_were_skipped():
    line = Line(after_us=10_000)
    line.trigger(0)
    line.parts.history.skipped.append(Skipped(2_000, 5_000))
    line.take(unread(1_000, 9_000))
    line.until(10_000)
    assert line.rows == [(0, [], Reason.NOT_DECODED)]


def test_what_was_followed_where_a_code_was_read_is_that_code():
    line = Line(after_us=10_000)
    line.trigger(0, index=1)
    line.take(read(0, "A", 2_000, x=100.0), unread(8_000, 9_900, x=115.0))
    line.until(10_000)
    line.trigger(8_000, index=2)
    line.until(30_000)
    assert line.rows == [(1, ["A"], None), (2, [], Reason.OTHER_PART)]
