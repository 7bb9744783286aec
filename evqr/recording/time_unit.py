"""Which unit the time stamps of a recording are in, and why.

The unit is, in this order: what the user says; what the file or its format says; what the numbers say.  The
numbers are judged by their granularity (a microsecond clock leaves whole numbers in us, three decimals in ms,
six in s), by the year that the last stamp would be, and by how many events a pixel would have fired a second.
Where two units remain, or none, the answer is an error and not a guess.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError, UsageError
from .declared import PER_SECOND, DeclaredUnit, TimeUnit

# Mean events a pixel and second.  Above the upper bound no pixel recovers and no readout follows; below the
# lower one the recording would be quieter than the noise of any sensor.
MIN_RATE, MAX_RATE = 1e-3, 2e4

MANY_EVENTS = 1_000
"""Rates of fewer events mean nothing where the user has named the unit."""

# No recording is younger than this [s since 1970]: the year 2100.
MAX_EPOCH_S = 4.1e9


def decide_time_unit(t: NDArray, sensor: tuple[int, int], name: str) -> DeclaredUnit:
    """Judge the unit from a sample of stored time stamps.

    Parameters
    ----------
    t : (E,) number
        The first stored stamps, finite and not negative.
    sensor : (int, int) [px]
        Width and height.
    name : str
        Of the recording, for the message.

    Returns
    -------
    unit : DeclaredUnit
        With what it was judged by.

    Raises
    ------
    RecordingError
        When none or more than one unit is plausible.
    """
    pixels = sensor[0] * sensor[1]
    span, last = float(t.max()) - float(t.min()), float(t.max())

    def rate(unit: TimeUnit) -> float:
        return len(t) / pixels * PER_SECOND[unit] / span if span else 0.0

    possible: list[TimeUnit] = [
        u for u in PER_SECOND if last <= MAX_EPOCH_S * PER_SECOND[u] and rate(u) <= MAX_RATE
    ]
    likely = [u for u in possible if span == 0 or rate(u) >= MIN_RATE]
    usual, finding = _usual_units(t)
    # Leave what is usual only where it is impossible; a recording may just be quiet.
    expected: list[TimeUnit] = [u for u in usual if u in possible] or possible
    chosen: list[TimeUnit] = [u for u in expected if u in likely]
    if len(chosen) == 1:
        reason = finding if chosen[0] in usual else f"{finding}, but {' and '.join(usual)} impossible"
        return DeclaredUnit(chosen[0], f"{reason}; {rate(chosen[0]):.3g} events per pixel and second")
    rates = ", ".join(f"{rate(u):.2g} in {u}" for u in expected)
    judged = f"{rates} per pixel and second" if rates else "impossible in every unit"
    raise RecordingError(
        f"{name}: unit of the time stamps undecidable: {finding}, {t.min()} to {t.max()}, {len(t):,} events"
        f' ({judged}); pass time_unit="us|ms|s|ns"'
    )


def odd_if_asked(t: NDArray, asked: TimeUnit, sensor: tuple[int, int], name: str) -> tuple[str, ...]:
    """Say what is odd about times in the unit that the user names.

    Parameters
    ----------
    t : (E,) number
        The first stored stamps, finite and not negative.
    asked : "s", "ms", "us" or "ns"
        Their unit, as asked for.
    sensor : (int, int) [px]
        Width and height.
    name : str
        Of the recording, for the message.

    Returns
    -------
    notes : tuple of str
        At most one.

    Raises
    ------
    UsageError
        They cannot be in it: whole seconds of a sensor that would be quieter than any.
    """
    if len(t) < MANY_EVENTS:
        return ()
    between = np.sort(np.diff(np.sort(t.astype(np.float64))))[: -len(t) // 100]  # silences are no fault
    if not between.any():
        return ()
    rate = len(between) / float(between.sum()) * PER_SECOND[asked]
    span = (float(t.max()) - float(t.min())) / PER_SECOND[asked]
    per_pixel = rate / (sensor[0] * sensor[1])
    if MIN_RATE <= per_pixel <= MAX_RATE:
        return ()
    likely = [
        unit for unit, count in PER_SECOND.items()
        if MIN_RATE <= per_pixel * count / PER_SECOND[asked] <= MAX_RATE and unit in _usual_units(t)[0]
    ]  # fmt: skip
    are = f"times in {asked}, as asked, are {rate:,.3g} events/s over {span:,.{0 if span >= 10 else 6}f} s"
    if asked == "s" and likely and _multiples_of(t, 0):
        raise UsageError(
            f"{name}: {are}, each at a whole second: they are no seconds; leave out time_unit=, or pass"
            f' time_unit="{likely[0]}"'
        )
    little = "fewer than the noise of any sensor" if per_pixel < MIN_RATE else "more than any sensor gives"
    return (f"{are}, {little}" + (f"; are they in {' or '.join(likely)}?" if likely else ""),)


def _usual_units(t: NDArray) -> tuple[tuple[TimeUnit, ...], str]:
    """Units that numbers of this granularity usually have, and the finding in words."""
    if _multiples_of(t, 0):
        if t.max() > 0 and not np.any(t % 1000):
            return ("us", "ns"), "whole multiples of 1000"
        return ("us",), "whole numbers"
    if _multiples_of(t, 3):
        return ("ms", "s"), "at most three decimals"
    return ("s",), "fractions finer than a thousandth"


def _multiples_of(t: NDArray, decimals: int) -> bool:
    """Whether all numbers have at most so many decimals, as far as their floating-point type can tell."""
    if t.dtype.kind in "iu":
        return True
    scaled = t.astype(np.float64) * 10.0**decimals
    # Rounding tails of text and of float32; but never so wide that anything would pass.
    tolerance = np.minimum(1e-6 + 4 * float(np.finfo(t.dtype).eps) * scaled, 0.1)
    return bool(np.all(np.abs(scaled - np.rint(scaled)) <= tolerance))
