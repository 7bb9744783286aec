"""An archive of recordings, read into a database; what loses its worker is read again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from evqr.many import read_many
from evqr.output.database import ReadingsDatabase
from evqr.reason import Reason
from evqr.results import ReadResult

AT_ONCE = 256
"""Recordings handed out together: enough that the end of one lot, where workers wait, is rare."""

TRIES = 3
"""How often a recording may lose a worker that reads nothing else before that is what is said of it."""


def read_archive(
    recordings: Sequence[Path],
    database: ReadingsDatabase,
    *,
    workers: Callable[[], AbstractContextManager[Executor | None]],
    **reading: Any,
) -> Iterator[tuple[Path, ReadResult]]:
    """Read recordings into a database.

    A pool of processes ends with any of its workers, and does not say which recording that one had.  So what
    was lost is read again by a new pool, half of it at a time, until only the one to blame is lost.

    Parameters
    ----------
    recordings : sequence of Path
        Those that are still to be read, `ReadingsDatabase.pending`.
    database : ReadingsDatabase
        Takes what each gave as soon as it is known.
    workers : callable
        Gives a new executor, or None, as a context manager.
    **reading : as for `read_many`
        Configuration, options of recordings and so on.

    Yields
    ------
    recording, result : Path, ReadResult
        When they are in the database.
    """
    lots = [list(recordings[first : first + AT_ONCE]) for first in range(0, len(recordings), AT_ONCE)]
    alone: Counter[Path] = Counter()  # how often each was lost with nothing else to blame
    while lots:
        with workers() as executor:
            broken = False
            while lots and not broken:
                lot, lost = lots.pop(0), []
                for path, result in zip(lot, read_many(lot, executor=executor, **reading), strict=True):
                    if result.reason_code is Reason.WORKER_LOST:
                        broken = True
                        alone[path] += len(lot) == 1
                        if alone[path] < TRIES:
                            lost.append(path)
                            continue
                    database.add(path, result)
                    yield path, result
                half = (len(lost) + 1) // 2
                lots[:0] = [part for part in (lost[:half], lost[half:]) if part]
