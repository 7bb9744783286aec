"""Many recordings, read one after the other or on any executor."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import islice
from os import PathLike, fsdecode
from typing import TYPE_CHECKING, Any

import numpy as np

from evqr.errors import EvqrError
from evqr.events.array import EventArray
from evqr.reason import Reason
from evqr.recording import Recording
from evqr.recording.arrays import is_table
from evqr.recording.options import check_names
from evqr.results import ReadResult, ReadStatus

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from evqr.config import ReadConfig
    from evqr.recording import RecordingOptions
    from evqr.solver import Solver
    from evqr.solvers import KeptSolvers
    from evqr.work import Working

_LOG = logging.getLogger(__name__)

SIDE_BY_SIDE = 16
"""Recordings that are read at once on a device; each holds its newest events."""


def read_many(
    sources: Any,
    *,
    executor: Executor | None = None,
    config: ReadConfig | None = None,
    backend: str = "auto",
    device: str = "cpu",
    threads: int | None = None,
    **opening: Unpack[RecordingOptions],
) -> Iterator[ReadResult]:
    """Read many recordings; one that cannot be read is a result with its error and stops nothing.

    Parameters
    ----------
    sources : iterable
        What `read_codes` takes: paths, event arrays, ..., or one of these alone.  They travel to the workers
        of ``executor``: on other machines, a path must lead to the same file.
    executor : concurrent.futures.Executor, optional
        Any, Dask's ``client.get_executor()`` included; the caller closes it.  Each of its threads keeps
        buffers from one recording to the next, until it ends.  None: in this thread, one by one on a CPU,
        some side by side on a device.
    config, backend, device, threads, **opening : as for `read_codes`
        The same for every source.

    Yields
    ------
    result : ReadResult
        In the order of ``sources``, each as soon as it and those before it are done.  Status ERROR, with the
        message as ``reason`` and a ``reason_code``, where a source could not be read or its worker was lost.

    Raises
    ------
    TypeError
        When the first result is asked for: ``sources`` are none, or a keyword is unknown.
    """
    if isinstance(sources, (str, PathLike, EventArray, Recording, np.ndarray, Mapping)) or is_table(sources):
        sources = [sources]
    elif not isinstance(sources, Iterable):
        raise TypeError(
            f"sources must be what read_codes takes, or many of them, got {type(sources).__name__}"
        )
    check_names("read_many", opening)
    options = {"config": config, "backend": backend, "device": device, "threads": threads, **opening}
    if executor is None:
        from evqr.solvers import KeptSolvers

        kept, count = KeptSolvers(), _at_once(device, threads)
        if count == 1:
            yield from map(partial(_read_one, kept, **options), sources)
            return
        waiting = iter(sources)
        while batch := list(islice(waiting, count)):
            yield from _read_together(kept, batch, **options)
        return
    read = partial(_read_in_worker, **options)
    # All are submitted at once: an executor does not say how many workers it has, and none should wait.
    jobs = [(_name(source), _submitted(executor, read, source)) for source in sources]
    try:
        for name, job in jobs:
            try:
                yield job.result()
            except Exception as error:  # the worker was lost, or the source cannot travel to it
                yield replace(failed(name, error), reason_code=_lost(error))
    finally:
        for _, job in jobs:
            job.cancel()


def _read_in_worker(source: Any, **options: Any) -> ReadResult:
    from evqr.solvers import KeptSolvers

    return _read_one(KeptSolvers.of_this_thread(), source, **options)


def _read_one(kept: KeptSolvers, source: Any, **options: Any) -> ReadResult:
    from evqr.offline import read_codes

    try:
        with kept.used():
            return read_codes(source, **options)
    except Exception as error:
        return _failed(source, error)


def _at_once(device: str, threads: int | None) -> int:
    """Give how many recordings are read side by side."""
    return 1 if device == "cpu" or (threads or 1) > 1 else SIDE_BY_SIDE


def _read_together(
    kept: KeptSolvers,
    sources: list[Any],
    *,
    config: ReadConfig | None,
    backend: str,
    device: str,
    threads: int | None,
    **opening: Unpack[RecordingOptions],
) -> list[ReadResult]:
    """Read recordings side by side, with one solver: what is due of all of them is done at once."""
    from evqr.offline import open_source, reading_codes
    from evqr.solvers import solvers_for
    from evqr.work import answer, together

    def reading(source: Any, solvers: list[Solver]) -> Working[ReadResult]:
        started = time.perf_counter()
        try:
            with ExitStack() as stack:
                recording, path = open_source(source, opening, stack)
                return (yield from reading_codes(recording, path, solvers, started))
        except Exception as error:
            return _failed(source, error)

    try:
        with kept.used(), solvers_for(1, config, backend=backend, device=device) as solvers:
            return answer(together(reading(source, solvers) for source in sources), solvers[0])
    except Exception as error:  # there is no solver
        return [_failed(source, error) for source in sources]


def _failed(source: Any, error: Exception) -> ReadResult:
    """Make the result of a source with which something is wrong that must not end the others."""
    if not isinstance(error, EvqrError):
        _LOG.debug("%s", _name(source), exc_info=True)  # a result has no room for where it happened
    return failed(_name(source), error)


def failed(name: str, error: Exception) -> ReadResult:
    """Make the result of a source that could not be read.

    Parameters
    ----------
    name : str
        Of the source, "" for arrays.
    error : Exception
        Why.

    Returns
    -------
    result : ReadResult
        With status ERROR.
    """
    # The messages of our own errors are complete; of any other, the kind is part of the message.
    reason = str(error) if isinstance(error, EvqrError) else f"{type(error).__name__}: {error}"
    code = error.reason if isinstance(error, EvqrError) else Reason.FAILED
    return ReadResult(ReadStatus.ERROR, " ".join(reason.split()), source=name, reason_code=code)


def _submitted(executor: Executor, read: Callable[[Any], ReadResult], source: Any) -> Future[ReadResult]:
    """Hand a source to an executor; one whose workers have ended by then loses it as the others."""
    try:
        return executor.submit(read, source)
    except BrokenExecutor as error:
        lost: Future[ReadResult] = Future()
        lost.set_exception(error)
        return lost


def _lost(error: Exception) -> Reason:
    """Tell whether it was the worker that ended; each kind of executor has its own error for that."""
    lost = isinstance(error, (BrokenExecutor, CancelledError)) or type(error).__name__ == "KilledWorker"
    return Reason.WORKER_LOST if lost else Reason.FAILED


def _name(source: Any) -> str:
    return fsdecode(source) if isinstance(source, (str, PathLike)) else ""
