"""What a live source is, and how one that is lost is opened again."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Protocol

from evqr.errors import RecordingError
from evqr.live.pieces import Idle, Interrupted, Piece

IDLE_S = 0.05
"""How long nothing may come before that is said [s]."""

RETRY_S = 0.1, 5.0
"""First and longest time between two tries to open a source [s]; they grow by doubling."""


class LiveSource(Protocol):
    """What feeds a reader.

    Attributes
    ----------
    name : str
        What it is called.
    """

    name: str

    def stop(self) -> None:
        """End `pieces` soon; any thread, and the handler of a signal, may say so."""
        ...

    def pieces(self) -> Iterator[Piece]:
        """Give what comes, until it ends or is stopped."""
        ...


class Reopened(ABC):
    """A source that is opened again, at growing intervals, whenever it is lost.

    Parameters
    ----------
    name : str
        What it is called.
    retry_s : (float, float) [s]
        First and longest time between two tries to open it.
    """

    def __init__(self, name: str, retry_s: tuple[float, float] = RETRY_S) -> None:
        self.name = name
        self._retry_s = retry_s
        self._stopped = threading.Event()

    def stop(self) -> None:
        """End `pieces` soon; any thread, and the handler of a signal, may say so."""
        self._stopped.set()

    @abstractmethod
    def _opened(self) -> Iterator[Piece]:
        """Open it, and give what comes until it is lost or stopped.

        Yields
        ------
        piece : Piece
            The size of the sensor first; `Idle` where nothing comes.

        Raises
        ------
        OSError, RecordingError
            Why it was lost or cannot be opened: a reason to try again. Without one the other side has ended.
        """

    def pieces(self) -> Iterator[Piece]:
        """Give what comes, until it is stopped.

        Yields
        ------
        piece : Piece
            `Idle` where nothing comes; `Interrupted` once for each time that the source is lost or cannot be
            opened.
        """
        pause_s, lost = self._retry_s[0], False
        while not self._stopped.is_set():
            try:
                for piece in self._opened():
                    if not isinstance(piece, Idle):
                        pause_s, lost = self._retry_s[0], False
                    yield piece
                reason = "the other side has ended the connection"
            except (OSError, RecordingError) as error:
                reason = getattr(error, "strerror", None) or str(error)
            if self._stopped.is_set():
                return
            if not lost:
                lost = True
                yield Interrupted(" ".join(reason.split()))
            self._stopped.wait(pause_s)
            pause_s = min(2.0 * pause_s, self._retry_s[1])
            yield Idle()
