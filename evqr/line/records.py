"""What a reader of a line gives: codes as soon as they decode, one record a part, and what happened else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from evqr.reason import Reason
from evqr.results import CodeReading
from evqr.symbol.messages import Message
from evqr.values import FrozenDict, Value, plain


@dataclass(frozen=True, eq=False, kw_only=True)
class LineRecord(Value):
    """What a reader of a line gives; all kinds begin alike.

    Attributes
    ----------
    sequence : int
        Counts the records of a reader.
    line, camera : str
        Names that the reader was given.
    epoch : int
        Which clock the times are of: counts the resets of the source's clock.
    t_utc : str
        When the events came that the record needed, in UTC; does not count in comparisons.
    latency_ms : float [ms]
        From then to the record; does not count in comparisons.
    """

    record: ClassVar[str]

    sequence: int
    line: str = ""
    camera: str = ""
    epoch: int = 0
    t_utc: str = field(default="", compare=False)
    latency_ms: float = field(default=0.0, compare=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain values.

        Returns
        -------
        record : dict
            Key by field, after ``record``, which says its kind.
        """
        return {"record": self.record, **super().to_dict(), "latency_ms": plain(self.latency_ms, 3)}

    def _head(self) -> dict[str, Any]:
        """Return what all records begin with."""
        names = ("sequence", "line", "camera", "epoch", "t_utc")
        head = {name: getattr(self, name) for name in names}
        return {"record": self.record, **head, "latency_ms": plain(self.latency_ms, 3)}


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadRecord(LineRecord):
    """A code has been read, for the first time.

    Attributes
    ----------
    code : int
        Its number in the stream.
    reading : CodeReading
        As it is known when the code decodes.
    message : Message or None
        That it is a part of, of those that were read lately; None for a code alone.
    """

    record: ClassVar[str] = "read"

    code: int
    reading: CodeReading
    message: Message | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain values.

        Returns
        -------
        record : dict
            What all records begin with, and what `evqr read --json` prints of a reading.
        """
        reading = self.reading.to_dict()
        return {**self._head(), "code": self.code, **reading, "message": plain(self.message)}


@dataclass(frozen=True, eq=False, kw_only=True)
class PartRecord(LineRecord):
    """A part has passed; without texts it is a NO READ.

    Attributes
    ----------
    part : int
        Counts the parts of a reader.
    trigger : int or None
        Index of its trigger; None where there are no triggers.
    ticks : float or None
        Of the encoder at its trigger, where they were given.
    job : str
        Name of the job that it was read for; "" for none.
    texts : tuple of str
        What its codes say, in order of time.
    matches : bool or None
        Whether they are what the job expects; None where it expects nothing.
    reason : str
        Why there are no texts, or why they do not match, in words; "" where all is well.
    reason_code : Reason or None
        The same for programs.
    t_start_us, t_end_us : int or None [us]
        Bounds of its gate; None without triggers, and where a gate never opened.
    t_first_us, t_last_us : int or None [us]
        First and last sight of its codes, or of what came nearest to one.
    t_read_us : int or None [us]
        When the first of its codes decoded.
    windows : int
        Windows that its first code took, or that what came nearest was followed for.
    motion_px_per_s : (2,) float64 or None [px/s]
        Velocity of its first code, or of what came nearest.
    corners_px : (4, 2) float64 or None [px]
        Outer corners of its first code, or of what came nearest.
    confidence : float or None
        That all texts are right, 0 to 1; None without texts.
    readings : tuple of CodeReading
        Its codes, in order of time.
    compute_ms : mapping of str to float [ms]
        What its codes took until they were read, by stage, and "total"; does not count in comparisons.
    """

    record: ClassVar[str] = "part"

    part: int
    trigger: int | None = None
    ticks: float | None = None
    job: str = ""
    texts: tuple[str, ...] = ()
    matches: bool | None = None
    reason: str = ""
    reason_code: Reason | None = None
    t_start_us: int | None = None
    t_end_us: int | None = None
    t_first_us: int | None = None
    t_last_us: int | None = None
    t_read_us: int | None = None
    windows: int = 0
    motion_px_per_s: NDArray[np.float64] | None = None
    corners_px: NDArray[np.float64] | None = None
    confidence: float | None = None
    readings: tuple[CodeReading, ...] = ()
    compute_ms: Mapping[str, float] = field(default_factory=FrozenDict, compare=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain values.

        Returns
        -------
        record : dict
            Key by field, but ``codes`` for the readings, in short.
        """
        fields = {name: value for name, value in super().to_dict().items() if name != "readings"}
        return {
            **fields,
            "motion_px_per_s": plain(self.motion_px_per_s, 2),
            "corners_px": plain(self.corners_px, 3),
            "confidence": plain(self.confidence, 4),
            "codes": [_code(reading) for reading in self.readings],
            "compute_ms": plain(self.compute_ms, 3),
        }


def _code(reading: CodeReading) -> dict[str, Any]:
    """Return a code of a part in short."""
    keys = (
        "text",
        "bytes_base64",
        "symbology",
        "version",
        "ec_level",
        "t_first_us",
        "t_last_us",
        "t_read_us",
    )
    keys += ("windows", "corners_px", "motion_px_per_s", "confidence", "log10_chance")
    keys += ("errors_corrected", "unused_correction", "grade")
    record = reading.to_dict()
    return {key: record[key] for key in keys}


@dataclass(frozen=True, eq=False, kw_only=True)
class GapRecord(LineRecord):
    """Events are missing.

    Attributes
    ----------
    t_from_us, t_to_us : int [us]
        The newest before, and the first after.
    dropped : int
        Events that came and were left out.
    reason : str
        Why, in words.
    reason_code : Reason
        SILENCE, INTERRUPTED, or EVENTS_DROPPED: wrong, or later than is sorted.
    """

    record: ClassVar[str] = "gap"

    t_from_us: int
    t_to_us: int
    dropped: int = 0
    reason: str = ""
    reason_code: Reason = Reason.SILENCE


@dataclass(frozen=True, eq=False, kw_only=True)
class ClockRecord(LineRecord):
    """The source's clock was reset, or went round; times from here on are of a new epoch.

    Attributes
    ----------
    t_before_us, t_after_us : int [us]
        Its last time before, and its first after.
    """

    record: ClassVar[str] = "clock"

    t_before_us: int
    t_after_us: int


@dataclass(frozen=True, eq=False, kw_only=True)
class OverloadRecord(LineRecord):
    """Events came faster than they could be read, and searches were skipped.

    Attributes
    ----------
    t_from_us, t_to_us : int [us]
        Time of events in which no code was searched for; those that were followed already still were.
    windows : int
        Searches that were skipped, about.
    behind_ms : float [ms]
        How far behind the events reading was.
    """

    record: ClassVar[str] = "overload"

    t_from_us: int
    t_to_us: int
    windows: int
    behind_ms: float
