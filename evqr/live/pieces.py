"""What a live source gives, piece by piece."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from evqr.recording.source import RawColumns
from evqr.recording.triggers import TriggerKind


@dataclass(frozen=True)
class Sensor:
    """The source says what its sensor is; the first piece of each connection that does.

    Attributes
    ----------
    width, height : int [px]
        Its size.
    """

    width: int
    height: int


@dataclass(frozen=True, eq=False)
class Events:
    """Some events, unchecked.

    Attributes
    ----------
    columns : RawColumns
        Times in us.
    """

    columns: RawColumns


@dataclass(frozen=True)
class TriggerSeen:
    """A trigger in the stream of events.

    Attributes
    ----------
    t_us : int [us]
        By the clock of the events.
    kind : "pulse", "start" or "end"
        What it means.
    index : int or None
        Its number, where the source counts.
    ticks : float or None
        Of an encoder.
    """

    t_us: int
    kind: TriggerKind
    index: int | None = None
    ticks: float | None = None


@dataclass(frozen=True)
class TimePasses:
    """All events before a time are there, whether or not there were any.

    Attributes
    ----------
    t_us : int [us]
        By the clock of the events.
    """

    t_us: int


@dataclass(frozen=True)
class Idle:
    """Nothing has come for a moment; a time at which other things can be done."""


@dataclass(frozen=True)
class Interrupted:
    """The connection was lost, and is tried again.

    Attributes
    ----------
    reason : str
        Why, in words.
    """

    reason: str


Piece: TypeAlias = "Sensor | Events | TriggerSeen | TimePasses | Idle | Interrupted"
