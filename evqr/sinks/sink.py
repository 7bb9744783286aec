"""What a sink is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

JsonRecord = Mapping[str, Any]
"""A record as plain values, such as `PartRecord.to_dict` gives; it has a ``record``, which says its kind."""


class SinkUnavailable(Exception):
    """A sink cannot take records now: they will be offered again."""


class RecordsRefusedError(Exception):
    """A sink will never take these records: they are counted, and not offered again."""


class Sink(Protocol):
    """Takes records; all calls come from one thread.

    Attributes
    ----------
    name : str
        Kind and place, for messages and counters.
    """

    name: str

    def open(self) -> None:
        """Connect, or open what is written to.

        Raises
        ------
        SinkUnavailable, OSError
            It is not there; it will be tried again.
        """
        ...

    def write(self, records: Sequence[JsonRecord]) -> None:
        """Deliver records; returns when they are safe where they go.

        Parameters
        ----------
        records : sequence of mapping
            In order. After a failure the same come again, so some may arrive twice.

        Raises
        ------
        SinkUnavailable, OSError
            Not all of them are delivered.
        RecordsRefusedError
            They never will be.
        """
        ...

    def close(self) -> None:
        """Let go; `open` may follow."""
        ...
