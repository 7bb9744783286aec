#!/usr/bin/env python3
"""What a GPU would be asked to do: launches as the CUDA variants make them, uploads and downloads, counted.

usage: counting.py [--over numpy|warp]

Prints how often, for a window read from cold and for one that is followed.  The counting backend computes
with another one on the CPU (``--over``), but its arrays are its own, as a GPU's are: what the host does not
bring there or back is not there.  Kernels are those that Warp's launchers of CUDA variants launch for the
same sizes; nothing is compiled for a GPU.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pipeline
from numpy.typing import DTypeLike, NDArray

from evqr import EventArray, Solver, open_recording
from evqr.demo import demo_recording
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr_kernels import OPERATIONS, get_backend, register_backend
from evqr_kernels.backend import Calls
from evqr_kernels.operation import Array

ARCHITECTURE = 90


class Held:
    """An array of the counting backend: another backend's, out of the host's reach."""

    def __init__(self, array: Any) -> None:
        self.array = array
        self.shape = tuple(array.shape)

    def __getitem__(self, key: Any) -> Held:
        return Held(self.array[key])

    def reshape(self, shape: tuple[int, ...]) -> Held:
        """View it in another shape."""
        return Held(self.array.reshape(shape))


@dataclass(frozen=True)
class Launch:
    """One kernel, as a GPU would be asked to run it.

    Attributes
    ----------
    op          operation that it is a part of
    kernel      Warp's; None: an array is cleared
    threads     how many
    given       the operation's arguments by name: shapes of arrays, values of settings
    n_bytes     of all arrays of the operation
    """

    op: str
    kernel: Any
    threads: int
    given: tuple[tuple[str, Any], ...]
    n_bytes: int

    @property
    def name(self) -> str:
        """Operation and kernel."""
        return f"{self.op}.{self.kernel.func.__name__}" if self.kernel else self.op


@dataclass
class Counts:
    """What a device was asked to do.

    Attributes
    ----------
    launches    kernels launched one by one, arrays cleared among them
    recorded    kernels launched as a part of a recorded sequence, likewise
    graphs      recorded sequences
    uploads, downloads, up_bytes, down_bytes
                copies, and what they moved
    made        each kernel, recorded or not
    kernels     by operation
    """

    launches: int = 0
    recorded: int = 0
    graphs: int = 0
    uploads: int = 0
    downloads: int = 0
    up_bytes: int = 0
    down_bytes: int = 0
    made: Counter[Launch] = field(default_factory=Counter)

    @property
    def kernels(self) -> Counter[str]:
        """Count by operation."""
        counted: Counter[str] = Counter()
        for launch, count in self.made.items():
            counted[launch.op] += count
        return counted


class CountingBackend:
    """Computes with another backend, on arrays that the host does not share, and counts.

    Parameters
    ----------
    over : str
        The backend that computes.

    Attributes
    ----------
    counts : Counts
        Since it was last replaced.
    """

    name = "counting"

    def __init__(self, over: str = "numpy") -> None:
        self._over = get_backend(over)
        self._steps: list[tuple[list[Launch], Callable[[], None]]] | None = None  # while it records
        self._known: dict[Any, list[Launch]] = {}
        self.counts = Counts()

    def __getattr__(self, op: str) -> Callable[..., None]:
        """Give the launcher of an operation."""
        if op not in OPERATIONS:
            raise AttributeError(op)

        def launch(*arguments: Any, **settings: Any) -> None:
            arrays = [a.array if isinstance(a, Held) else a for a in arguments]
            launches = self._launches(op, arguments, settings)
            self._do(launches, lambda: self._compute(op, arrays, settings))

        return launch

    def _compute(self, op: str, arrays: list[Any], settings: dict[str, Any]) -> None:
        getattr(self._over, op)(*arrays, **settings)

    def _do(self, launches: list[Launch], step: Callable[[], None]) -> None:
        if self._steps is not None:
            self._steps.append((launches, step))
            return
        self.counts.launches += len(launches)
        self.counts.made.update(launches)
        step()

    def _launches(self, op: str, arguments: tuple[Any, ...], settings: dict[str, Any]) -> list[Launch]:
        """List what Warp's launcher launches on a GPU for arrays of such shapes."""
        operation = OPERATIONS[op].arguments
        key = op, *(a.shape if isinstance(a, Held) else a for a in arguments), *settings.items()
        if key not in self._known:
            given = [
                _nowhere(a.shape, declared.dtype(np.float32))
                if isinstance(a, Held) and isinstance(declared, Array)
                else a
                for a, declared in zip(arguments, operation, strict=False)
            ]
            named = tuple(
                (declared.name, a.shape if isinstance(a, Held) else a)
                for a, declared in zip(arguments, operation, strict=False)
            )
            n_bytes = sum(a.capacity for a in given if hasattr(a, "capacity"))
            self._known[key] = [
                Launch(op, kernel, math.prod(np.atleast_1d(threads).tolist()), named, n_bytes)
                for kernel, threads in _launched(op, given, settings)
            ]
        return self._known[key]

    def devices(self) -> tuple[str, ...]:
        """Name the one device."""
        return ("cpu",)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> Held:
        """Make an array."""
        return Held(self._over.empty(shape, dtype, "cpu"))

    def from_host(self, array: NDArray[Any], device: str) -> Held:
        """Bring a copy there."""
        self._moved(up=array.nbytes)
        return Held(self._over.from_host(array.copy(), "cpu"))

    def to_host(self, array: Held) -> NDArray[Any]:
        """Bring a copy back."""
        back = np.array(self._over.to_host(array.array))
        self._moved(down=back.nbytes)
        return back

    def assign(self, array: Held, values: NDArray[Any]) -> None:
        """Copy into an array."""
        self._moved(up=values.nbytes)
        self._over.assign(array.array, values)

    def part(self, block: Held, first: int, shape: tuple[int, ...], dtype: DTypeLike) -> Held:
        """View some words of a block."""
        return Held(self._over.part(block.array, first, shape, dtype))

    def _moved(self, up: int | None = None, down: int | None = None) -> None:
        self.counts.uploads += up is not None
        self.counts.downloads += down is not None
        self.counts.up_bytes += up or 0
        self.counts.down_bytes += down or 0

    def clear(self, array: Held) -> None:
        """Fill with zeros."""
        shape = array.shape
        n_bytes = math.prod(shape) * np.dtype(np.float32).itemsize
        cleared = Launch("clear", None, math.prod(shape), (("array", shape),), n_bytes)
        self._do([cleared], lambda: self._over.clear(array.array))

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what is launched."""
        self._steps = steps = []
        try:
            run()
        finally:
            self._steps = None

        def replay() -> None:
            self.counts.graphs += 1
            for launches, step in steps:
                self.counts.recorded += len(launches)
                self.counts.made.update(launches)
                step()

        return replay

    def synchronize(self, device: str) -> None:
        """Do nothing."""

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """Tell what the other one says."""
        return self._over.supports(op, dtype, "cpu")

    def tile(self, op: str, device: str) -> int:
        """Give that of a CPU, which computes."""
        return self._over.tile(op, "cpu")

    def needs_compile(self, device: str, calls: Calls) -> bool:
        """Tell what the other one says."""
        return self._over.needs_compile("cpu", calls)

    def load(self, device: str, calls: Calls) -> None:
        """Load the other one's kernels."""
        self._over.load("cpu", calls)


def _nowhere(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
    """Make an array of Warp's without memory, for launches that never happen."""
    import warp as wp

    return wp.array(ptr=1 << 20, dtype=wp.dtype_from_numpy(dtype), shape=shape, device="cpu")


def _launched(op: str, arguments: list[Any], settings: dict[str, Any]) -> list[Any]:
    """List the kernels that Warp's launcher launches on a GPU, and their threads."""
    from evqr_kernels.warp_backend import language

    launcher = getattr(get_backend("warp"), op)
    with _as_a_gpu():
        return language.launches_of(lambda: launcher(*arguments, **settings))


@contextlib.contextmanager
def _as_a_gpu() -> Iterator[None]:
    """Let launchers take Warp's CPU for a GPU, for as long as they launch nothing."""
    import warp as wp

    device: Any = wp.get_device("cpu")
    kind, plain = type(device), type(device).is_cpu
    kind.is_cpu, device.arch = property(lambda _: False), ARCHITECTURE
    try:
        yield
    finally:
        kind.is_cpu, device.arch = plain, 0


def load() -> CountingBackend:
    """Make the backend, over NumPy; the registry calls it."""
    return CountingBackend()


def load_over_warp() -> CountingBackend:
    """Make the backend, over Warp."""
    return CountingBackend("warp")


LOADS = {"numpy": "load", "warp": "load_over_warp"}


def counted(solver: Solver, run: Callable[[], Any]) -> tuple[Counts, Any]:
    """Give what a function asks of the device the second time that it runs, and what it returns."""
    backend: Any = solver.workspace.backend
    run()  # makes buffers and records
    solver.workspace.events(EventBatch.of([make_window(_one_event(), 0, 1)]))  # events are to come again
    backend.counts = Counts()
    result = run()
    return backend.counts, result


def _one_event() -> EventArray:
    t, x, p = np.zeros(1, np.int64), np.zeros(1, np.uint16), np.ones(1, np.int8)
    return EventArray(t, x, x, p, 8, 8)


def line(name: str, counts: Counts) -> str:
    """Lines to print: of a window, and of the operations with most kernels."""
    most = ", ".join(f"{op} {count}" for op, count in counts.kernels.most_common(7))
    return (
        f"{name:8} {counts.launches:8} {counts.recorded:8} {counts.graphs:7} {counts.uploads:8} "
        f"{counts.up_bytes / 1e3:9.1f} {counts.downloads:10} {counts.down_bytes / 1e3:9.1f}\n         {most}"
    )


def main() -> int:
    """Count and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--over", choices=LOADS, default="warp")
    over = parser.parse_args().over
    register_backend("counting", f"{__name__}:{LOADS[over]}")
    solver, recording = Solver(backend="counting"), demo()
    print(f"{'':8} launches recorded  graphs  uploads        kB  downloads        kB")
    for job in pipeline.prepare(recording, solver):
        for method in ("cold", "tracked"):
            if pipeline.can_run(method, job):
                counts, text = counted(solver, functools.partial(pipeline.RUN[method], job, solver))
                print(line(method, counts), f"-> {text!r}")
    return 0


def demo() -> pipeline.Recording:
    """Give the demo and one window of it."""
    with demo_recording() as path, open_recording(path) as opened:
        chunks = list(opened.chunks())
    columns = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("t", "x", "y", "p"))
    events = EventArray(*columns, chunks[0].width, chunks[0].height)
    middle = (int(events.t[0]) + int(events.t[-1])) // 2
    return pipeline.Recording("demo", events, frozenset(), (middle,))


if __name__ == "__main__":
    sys.exit(main())
