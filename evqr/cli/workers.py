"""Where commands compute: in this process, in processes beside it, or on the workers of a Dask scheduler."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager, suppress

import click
from click.globals import push_context

from evqr.cli import options
from evqr.cli.options import debugging, is_quiet
from evqr.cli.running import collect_garbage_rarely, logged_as_notes
from evqr.errors import UsageError
from evqr.extras import needs_extra


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
        initargs=(debugging(), is_quiet()),
    )
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def prepare(pool: Executor | None, jobs: int, backend: str, device: str) -> None:
    """Do what `options.prepare` does where it is worked: one of the workers does, while the others start.

    So kernels are loaded by those who launch them alone, and by all of them at the same time.

    Parameters
    ----------
    pool : Executor, optional
        Of `workers`; None: this process.
    jobs : int
        Processes of the pool.
    backend, device : str
        As of `Solver`.

    Raises
    ------
    BackendError
        The backend or the device is not there, or kernels can be kept nowhere.
    """
    if pool is None:
        options.prepare(backend, device)
        return
    with suppress(BrokenExecutor):  # those who wait for results are told
        prepared = pool.submit(_prepare, backend, device)
        for _ in range(jobs - 1):
            pool.submit(_import, backend, device)
        prepared.result()


def _prepare(backend: str, device: str) -> None:
    with logged_as_notes():
        options.prepare(backend, device)


def _import(backend: str, device: str) -> None:
    """Import what reads, and start the backend."""
    from evqr.device import kernels_on

    importlib.import_module("evqr.offline")
    kernels_on(backend, device)


def _begin_worker(debug: bool = False, quiet: bool = False) -> None:
    """Let a worker end at once, without a traceback, on Ctrl-C, which reaches it too, and with its parent.

    A worker of a parent that was killed would work on what was handed out, and then wait for ever.
    With ``debug`` it prints the tracebacks that results have no room for.
    """
    context = click.Context(click.Command("worker"))
    context.meta.update(debug=debug, quiet=quiet)
    push_context(context)
    collect_garbage_rarely()
    logging.getLogger("evqr_kernels").addHandler(logging.NullHandler())  # what all find is said by one
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
    with needs_extra("computing with Dask", "distributed", "distributed"):
        from distributed import Client
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {address}: no scheduler answers there ({error})") from error
    with client:
        yield client.get_executor()
