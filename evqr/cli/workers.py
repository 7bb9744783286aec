"""Where commands compute: in this process, in processes beside it, or on the workers of a Dask scheduler."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from evqr.cli.options import debugging
from evqr.errors import MissingExtra, UsageError


@contextmanager
def workers(jobs: int, dask: str | None = None) -> Iterator[Executor | None]:
    """Give what computes ``jobs`` things at a time; None: this process does, one after another.

    Parameters
    ----------
    jobs : int
        Processes; workers start as fresh ones, since kernels and their threads do not survive a fork.
    dask : str, optional
        Address of a Dask scheduler, whose workers compute instead.

    Raises
    ------
    MissingExtra
        Dask is not installed.
    UsageError
        No scheduler answers at the address.
    """
    if dask is not None:
        with _dask_workers(dask) as executor:
            yield executor
        return
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(
        jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin_worker,
        initargs=(debugging(),),
    )
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _begin_worker(debug: bool = False) -> None:
    """Let a worker end at once, without a traceback, on Ctrl-C, which reaches it too, and with its parent.

    A worker of a parent that was killed would work on what was handed out, and then wait for ever.
    With ``debug`` it prints the tracebacks that results have no room for.
    """
    if debug:
        faults = logging.getLogger("evqr.many")
        faults.addHandler(logging.StreamHandler())
        faults.setLevel(logging.DEBUG)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


@contextmanager
def _dask_workers(address: str) -> Iterator[Executor]:
    from evqr_kernels.extras import install_command

    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtra(
            f"computing with Dask needs distributed: {install_command('distributed')}"
        ) from error
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {address}: no scheduler answers there ({error})") from error
    with client:
        yield client.get_executor()
