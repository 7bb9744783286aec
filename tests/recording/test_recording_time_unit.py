"""The unit of the time stamps is known, decided with a reason, or asked for; never guessed."""

import numpy as np
import pytest

from evqr.errors import RecordingError, UsageError
from evqr.recording import open_recording
from evqr.recording.time_unit import decide_time_unit, odd_if_asked

SENSOR = (640, 480)
COUNT = 50_000


def stamps(
    rate_per_pixel: float, per_second: float, *, decimals: int | None, start_s: float = 3.0
) -> np.ndarray:
    """Sorted random stamps at so many events a pixel and second, in units of ``1 / per_second`` s."""
    seconds = COUNT / (rate_per_pixel * SENSOR[0] * SENSOR[1])
    s = start_s + np.sort(np.random.default_rng(0).uniform(0, seconds, COUNT))
    t = s * per_second
    return t if decimals is None else np.round(t, decimals)


def whole(t: np.ndarray) -> np.ndarray:
    return t.astype(np.int64)


@pytest.mark.parametrize(
    ("t", "unit", "reason"),
    [
        (whole(stamps(100, 1e6, decimals=0)), "us", "whole numbers; 100 events"),
        (whole(stamps(0.01, 1e6, decimals=0)), "us", "whole numbers; 0.01 events"),
        (stamps(100, 1e6, decimals=0), "us", "whole numbers"),
        (stamps(100, 1e6, decimals=0, start_s=1.7e9), "us", "whole numbers"),
        (stamps(100, 1, decimals=6), "s", "finer than a thousandth"),
        (stamps(100, 1, decimals=6, start_s=1.7e9), "s", "finer than a thousandth"),
        (stamps(100, 1, decimals=9), "s", "finer than a thousandth"),
        (stamps(0.5, 1e3, decimals=3), "ms", "at most three decimals"),
        (whole(stamps(100, 1e9, decimals=0, start_s=1.7e9)), "ns", "whole numbers, but us impossible"),
        (whole(stamps(0.5, 1e6, decimals=0)) * 1000, "ns", "whole multiples of 1000"),
    ],
)
def test_decided(t, unit, reason):
    decided = decide_time_unit(t, SENSOR, "name")
    assert decided.unit == unit
    assert reason in decided.reason


@pytest.mark.parametrize(
    "t",
    [
        pytest.param(whole(stamps(1, 1e6, decimals=0)) // 1000 * 1000, id="us of a 1 kHz simulation, or ns"),
        pytest.param(whole(stamps(1e-5, 1e6, decimals=0)), id="nearly silent in us"),
        pytest.param(stamps(100, 1e6, decimals=None), id="fractions of us"),
        pytest.param(whole(stamps(100, 1e3, decimals=0)), id="whole ms, or s"),
        pytest.param(
            stamps(100, 1e3, decimals=3), id="ms of a microsecond clock, or s of a millisecond clock"
        ),
        pytest.param(np.full(COUNT, 1e30), id="beyond all units"),
    ],
)
def test_undecidable(t):
    with pytest.raises(
        RecordingError, match=r'^name: unit .* undecidable: .*; pass time_unit="us\|ms\|s\|ns"$'
    ):
        decide_time_unit(t, SENSOR, "name")


def test_float32_seconds_are_seconds():
    assert decide_time_unit(stamps(100, 1, decimals=6).astype(np.float32), SENSOR, "name").unit == "s"


def test_seconds_that_are_microseconds_are_noticed():
    t = np.arange(0, 5_000_000, 50)
    advice = r'each at a whole second: they are no seconds; leave out time_unit=, or pass time_unit="us"$'
    with pytest.raises(UsageError, match=advice):
        odd_if_asked(t, "s", (320, 240), "name")
    columns = (t, t % 64, t % 48, t % 2)
    said = r"^arrays: times in s, as asked, are 0\.02 events/s over 3,276,750 s"
    with pytest.raises(UsageError, match=said):
        open_recording(columns, sensor=(64, 48), time_unit="s")


@pytest.mark.parametrize(
    ("t", "asked", "told"),
    [
        (np.arange(0, 5_000_000, 50), "us", ""),
        (np.arange(0, 5_000_000, 50) * 1e-6, "s", ""),
        (np.arange(0, 5_000_000, 500), "ms", "fewer than the noise of any sensor; are they in us?"),
        (np.arange(0, 50_000, 1) // 30, "ns", "more than any sensor gives; are they in us?"),
        (np.zeros(5_000), "s", ""),
        (np.arange(900), "s", ""),  # too few to tell
        (np.arange(0, 5_000_000, 50) + 0.25, "s", "fewer than the noise of any sensor"),  # and no other unit
    ],
)
def test_odd_units_are_noticed(t, asked, told):
    (note,) = odd_if_asked(t, asked, (320, 240), "name") or ("",)
    assert note.endswith(told) and bool(note) == bool(told)
