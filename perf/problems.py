"""A call of an operation, as data: what goes in, what comes out, and what it takes at the least."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr_kernels import OPERATIONS, KernelBackend, get_backend
from evqr_kernels.operation import Scratch, Written, buffers_behind

TOLERANCE = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 1e-12}
"""Largest error relative to the largest value: some hundred roundings, in another order."""


@dataclass(frozen=True)
class Size:
    """How large a problem is: a batch of windows with so many events, an image and a code each.

    Attributes
    ----------
    events    of a window
    side      of the image [px]
    modules   of the code, along a side
    """

    batch: int
    events: int
    side: int
    modules: int


def call(backend: KernelBackend, op: str, problem: Problem, arrays: list[Any], outputs: list[Any]) -> None:
    """Call the backend's method of that name; what most problems are."""
    getattr(backend, op)(*arrays, *outputs, *problem.tail)


@dataclass
class Problem:
    """One operation on one set of inputs.

    Attributes
    ----------
    op, inputs, outputs, tail
                  the method of a backend and its arguments, in this order; arrays are NumPy's
    items, unit   what its throughput is counted in
    madds         multiply-adds, a division or a root counted as one and an exponential as none
    scratch       so many of the first outputs are scratch
    inout         input or output that a call must find as it was: restored before every launch
    passes        how often the outputs are touched, 2 where a call adds to them
    run           launches it, where that is not one call
    """

    op: str
    inputs: list[Any]
    outputs: list[Any]
    items: int
    madds: float
    unit: str = "pixel"
    tail: tuple = ()
    scratch: int = 0
    inout: int | None = None
    passes: int = 1
    run: Callable[[KernelBackend, str, Problem, list[Any], list[Any]], None] = call

    @property
    def bytes(self) -> int:
        """What must be moved: inputs read once, scratch written and read, outputs written."""
        touched = [(array, 1) for array in self.inputs]
        touched += [(array, 2) for array in self.outputs[: self.scratch]]
        touched += [(array, self.passes) for array in self.outputs[self.scratch :]]
        return sum(times * array.nbytes for array, times in touched if isinstance(array, np.ndarray))


def problem(
    op: str, inputs: list[Any], items: int, madds: float, unit: str = "pixel", *, tail: tuple = (),
    start: NDArray[Any] | None = None, **sizes: Any,
) -> Problem:  # fmt: skip
    """Make the problem of an operation, with the outputs and scratch of the table.

    ``start`` is what is overwritten in place; ``sizes`` are those that no input tells, and settings.
    """
    operation = OPERATIONS[op]
    buffers = buffers_behind(operation, inputs, sizes, operation.variant("warp", "cpu").tile)
    written = [getattr(buffer.array, "written", None) for buffer in buffers]
    inout = written.index(Written.IN_PLACE) if Written.IN_PLACE in written else None
    outputs = [np.zeros(buffer.shape, buffer.dtype) for buffer in buffers]
    if inout is not None:
        outputs[inout] = start
    scratch = sum(isinstance(buffer.array, Scratch) for buffer in buffers)
    passes = 2 if operation.accumulates else 1
    return Problem(op, inputs, outputs, items, madds, unit, tail, scratch, inout, passes)


class Prepared:
    """A problem with its arrays on a device, to be launched again and again."""

    def __init__(self, problem: Problem, backend: str, device: str) -> None:
        self.problem, self.device = problem, device
        self.backend = get_backend(backend)
        self._inputs = [self._put(argument) for argument in problem.inputs]
        self._outputs = [self._put(argument) for argument in problem.outputs]
        self._start = None
        if problem.inout is not None:
            self._start = problem.outputs[problem.inout].copy(), self._outputs[problem.inout]
        self._replay: Callable[[], None] | None = None

    def _put(self, argument: Any) -> Any:
        return (
            self.backend.from_host(argument.copy(), self.device)
            if isinstance(argument, np.ndarray)
            else argument
        )

    def launch(self) -> None:
        """Launch once, unrecorded; does not wait."""
        self.problem.run(self.backend, self.problem.op, self.problem, self._inputs, self._outputs)

    def record(self) -> None:
        """From now on `__call__` replays the launches, as the reader does."""
        self._replay = self.backend.record(self.launch)

    def __call__(self) -> None:
        if self._start is not None:
            values, array = self._start
            self.backend.assign(array, values)
        (self._replay or self.launch)()

    def wait(self) -> None:
        """Wait for the device."""
        self.backend.synchronize(self.device)

    def results(self) -> list[NDArray[Any]]:
        """Launch and give copies of what came out, without scratch."""
        self()
        self.wait()
        outputs = self._outputs[self.problem.scratch :]
        return [np.array(self.backend.to_host(a)) for a in outputs]


def distance(got: list[NDArray[Any]], expected: list[NDArray[Any]]) -> float:
    """Largest difference, relative to the largest value of each array; infinite where one is not finite."""
    worst = 0.0
    for a, b in zip(got, expected, strict=True):
        scale = max(float(np.abs(b).max(initial=0.0)), 1e-30)
        apart = float(np.abs(a.astype(np.float64) - b).max(initial=0.0)) / scale
        worst = max(worst, apart if math.isfinite(apart) else math.inf)
    return worst
