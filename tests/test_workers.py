"""Pools of the command line: who loads the kernels, and what becomes of it where that fails."""

from __future__ import annotations

import threading
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor

import pytest

from evqr.cli.workers import prepare, workers
from evqr.errors import BackendError


@pytest.fixture
def prepared(monkeypatch):
    """Who prepared kernels, by name of the thread, and for what."""
    calls = []
    monkeypatch.setattr(
        "evqr.cli.options.prepare", lambda *given: calls.append((threading.current_thread().name, given))
    )
    return calls


def test_kernels_are_prepared_by_one_worker_and_not_by_who_waits_for_it(prepared):
    with ThreadPoolExecutor(3, thread_name_prefix="worker") as pool:
        prepare(pool, 3, "numpy", "cpu")
        assert [(name[:6], given) for name, given in prepared] == [("worker", ("numpy", "cpu"))]
    prepare(None, 1, "numpy", "cpu")
    assert prepared[1:] == [(threading.current_thread().name, ("numpy", "cpu"))]


def test_what_a_worker_refuses_is_raised_where_it_is_waited_for():
    with workers(2) as pool, pytest.raises(BackendError, match="cuda:99"):
        prepare(pool, 2, "numpy", "cuda:99")


def test_a_pool_that_broke_is_left_to_those_who_wait_for_results(monkeypatch):
    def broken(*given):
        raise BrokenExecutor("a worker was killed")

    monkeypatch.setattr("evqr.cli.options.prepare", broken)
    with ThreadPoolExecutor(1) as pool:
        prepare(pool, 1, "numpy", "cpu")
