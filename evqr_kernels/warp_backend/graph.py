"""A recorded sequence of launches on a GPU as one CUDA graph.

Warp has one stream a device for all threads, and what any of them asks of it while one captures is taken for
part of the graph.  So whatever asks something of a GPU here holds a lock; as there is one stream, what waits
for the lock would wait for the device.
"""

import contextlib
import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import warp as wp

LOCK = threading.RLock()
"""Held by who launches on a GPU, copies there or back, or captures."""

_NO_LOCK = contextlib.nullcontext()


def turn_on(is_cpu: bool) -> AbstractContextManager[Any]:
    """Give what is to be held by who asks a device for something: the lock, unless it is the CPU."""
    return _NO_LOCK if is_cpu else LOCK


_log = logging.getLogger(__name__)


class Graph:
    """Launches on one device: step by step the first time, as kernels are loaded then, and later as a graph.

    Where the device cannot capture them they stay steps; so they do while they are part of a larger graph.

    Parameters
    ----------
    calls : list of callable
        Each asks the device for one thing, and allocates nothing.
    device : wp.Device
        Of all of them.
    """

    def __init__(self, calls: list[Callable[[], Any]], device: wp.Device) -> None:
        self._calls, self._device = calls, device
        self._ran = self._failed = False
        self._graph: Any = None

    def __call__(self) -> None:
        """Ask the device for all of it."""
        with LOCK:
            if self._device.is_capturing or self._failed or not self._ran:
                self._one_by_one()
                self._ran = True
                return
            if self._graph is None:
                self._capture()
            if self._graph is None:
                self._one_by_one()
            else:
                wp.capture_launch(self._graph)

    def _one_by_one(self) -> None:
        for call in self._calls:
            call()

    def _capture(self) -> None:
        try:
            with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                self._one_by_one()
            self._graph = capture.graph
        except RuntimeError as error:  # launches were captured then, not made
            self._failed = True
            _log.warning("%s captures no graph, kernels are launched one by one: %s", self._device, error)
