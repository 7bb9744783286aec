"""Settings of a production line: triggers, what is expected, the order of events and what is skipped."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from evqr.config.settings import Count, Positive, Range, Settings
from evqr.symbology import Symbology

WholeTime = Annotated[int, Range(least=0)]


@dataclass(frozen=True, kw_only=True)
class TriggerConfig(Settings):
    """When a part is read, as triggers say.

    Attributes
    ----------
    before_us : int [us]
        A pulse asks for what passes from so long before it. Chosen: from the pulse on.
    after_us : int [us]
        A pulse asks for what passes until so long after it. Chosen: 10 cm at 1 m/s.
    ticks : tuple of 2 floats, optional
        A pulse asks for what passes between these positions of the encoder after it, and not for a time.
        Default: by time.
    longest_us : int [us]
        A part is told at the latest so long after its trigger: where its end is lost, or the belt stands.
        Chosen.
    lateness_us : int [us]
        How much later than the events that it is of a trigger may come. Chosen: a slow PLC's cycle.
    deadline_us : int [us]
        Time of events after the end of a gate for what is still to be searched of it; then its part is told.
        Chosen: the longest window, and room.
    until_codes : int, optional
        A part is told as soon as so many codes are read. Default: at the end of its gate.
    """

    before_us: WholeTime = 0
    after_us: Count = 100_000
    ticks: tuple[float, float] | None = None
    longest_us: Count = 1_000_000
    lateness_us: WholeTime = 50_000
    deadline_us: WholeTime = 100_000
    until_codes: Count | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ticks is not None and not self.ticks[0] < self.ticks[1]:
            raise ValueError(f"ticks must be two positions, the second after the first, got {self.ticks}")


@dataclass(frozen=True, kw_only=True)
class JobConfig(Settings):
    """What the codes of one product are: a part that says something else does not match.

    Attributes
    ----------
    text : str, optional
        What each code says. Default: anything.
    pattern : str, optional
        A regular expression that each text matches as a whole. Default: anything.
    symbology : Symbology, optional
        Kind of symbol. Default: any.
    codes : int, optional
        How many codes a part has. Default: any number but none.
    """

    text: str | None = None
    pattern: str | None = None
    symbology: Symbology | None = None
    codes: Count | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pattern is not None:
            try:
                re.compile(self.pattern)
            except re.error as error:
                raise ValueError(
                    f"pattern must be a regular expression, got {self.pattern!r} ({error})"
                ) from None


@dataclass(frozen=True, kw_only=True)
class LineConfig(Settings):
    """How a stream that comes bit by bit is taken.

    Attributes
    ----------
    disorder_us : int [us]
        Events that come so much later than others are sorted, which costs as much delay; those that come
        later still are left out. Chosen: none, as of sources that sort.
    silence_us : int [us]
        A jump ahead of the stamps that is told as a gap. Chosen.
    hot_pixel_hz : float [1/s], optional
        A pixel that fires so often all the time, and eight times as often as those around it, is left out;
        none is where this is None. Chosen: noise is at 0.1 to 50.
    behind_us : int [us], optional
        How far reading may fall behind the events before searches are skipped. Default: none ever is, as for
        recordings.
    """

    disorder_us: Annotated[int, Range(least=0, most=50_000)] = 0
    silence_us: Count = 1_000_000
    hot_pixel_hz: Positive | None = 500.0
    behind_us: Count | None = None
