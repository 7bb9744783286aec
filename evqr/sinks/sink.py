"""What a sink is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

JsonRecord = Mapping[str, Any]
"""A record as plain values, such as `PartRecord.to_dict` gives; it has a ``record``, which says its kind."""


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
        OSError
            It is not there; it will be tried again.
        """
        ...

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Deliver records; returns when they are safe where they go.

        Parameters
        ----------
        records : sequence of mapping
            In order. After a failure the same come again, so some may arrive twice.

        Returns
        -------
        refused : str
            Why they never will be delivered; "" where they are.

        Raises
        ------
        OSError
            Not all of them are delivered; `ConnectionError` where it is no file's.
        """
        ...

    def close(self) -> None:
        """Let go; `open` may follow."""
        ...
