#!/usr/bin/env python3
"""What batches of windows would take on a GPU that is not there: a model on what can be counted without one.

usage: device_model.py [--batches 1 25 128 512] [--events 10000 36000] [--code FILE] [--kernels 10]

Counted: launches with their threads, and copies (counting.py), of a window of the demo, its events thinned or
repeated to the number that is asked for, as often as the batch has windows; machine code of the kernels
(machine_code.py: compiled here, kept in FILE if one is given).  Measured: processor time of the host's
Python, with kernels that do nothing and copies that bring what a run before brought; and of decoding.  The
rest is assumed, and printed.  Good to a factor of 2 or 3.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import counting
import machine_code
import numpy as np
import pipeline
from counting import CountingBackend, Counts, Held, Launch
from device_work import ATOMICS, BUSY, FOUND, WORK, Sizes, instructions, work_of
from machine_code import Code
from numpy.typing import NDArray

from evqr import EventArray, Solver
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.events.window import Window
from evqr.fit.detection import Detection, NotFound
from evqr.search.motion_estimate import MotionEstimate, estimate_motions
from evqr.symbol.decode import decode_grid
from evqr_kernels import OPERATIONS, register_backend


@dataclass(frozen=True)
class Device:
    """A GPU.

    Attributes
    ----------
    arch        90 for sm_90
    processors  streaming multiprocessors, each with four schedulers
    clock       [Hz]
    memory      [bytes/s]
    cache       second-level cache [bytes]
    atomics     additions to float32 in the second-level cache [1/s]
    """

    name: str
    arch: int
    processors: int
    clock: float
    memory: float
    cache: float
    atomics: float


DEVICES = (
    Device("H100", 90, 132, 1.755e9, 3.35e12, 50e6, 1e11),
    Device("RTX 4090", 89, 128, 2.52e9, 1.01e12, 72e6, 1e11),
)
BUSES = {4: 24e9, 5: 50e9}
"""Bytes/s of copies, by the generation of PCIe."""

CPI = 2.5
"""Cycles from an instruction of a warp to its next, where no other warp is in the scheduler's way."""

BLOCK, WARP, SCHEDULERS = 256, 32, 4
GAP, LAUNCH, GRAPH, UPLOAD, DOWNLOAD = 2e-6, 4e-6, 10e-6, 12e-6, 20e-6
"""Seconds: between two kernels on the device, a launch from Python, one of a recorded sequence, which is a
graph there, a copy either way besides its bytes."""

GOALS = {("tracked", 128, 36_000): 10_000, ("cold", 128, 36_000): 1_500}
"""Windows/s, by method, windows a batch and events a window."""

ASSUMED = (
    f"assumed: an instruction of a warp every {CPI} cycles, of a scheduler every one; blocks of {BLOCK};",
    f"  {1e6 * GAP:.0f} us between kernels; {1e6 * LAUNCH:.0f} us a launch from Python, {1e6 * GRAPH:.0f} us "
    "one of a recorded sequence, as a graph, while the device works;",
    f"  {1e6 * UPLOAD:.0f} us an upload, {1e6 * DOWNLOAD:.0f} us a download, PCIe "
    + ", ".join(f"{n}: {rate / 1e9:.0f} GB/s" for n, rate in BUSES.items())
    + ", while nothing else happens;",
    *(
        f"  {d.name}: sm_{d.arch}, {d.processors} SMs, {d.clock / 1e9:.2f} GHz, {d.memory / 1e12:.2f} TB/s, "
        f"{d.cache / 1e6:.0f} MB of cache, {d.atomics / 1e9:.0f} G atomic additions/s;"
        for d in DEVICES
    ),
    "  an operation's arrays that are larger than the cache go through memory once a kernel;",
    "  Python and decoding take what they take here;",
    f"  a thread's instructions as device_work.py tells from sizes and from iterations that the run took, "
    f"{BUSY:.0%} of pixels busy, {FOUND} maxima a window, no branch left out;",
    "  of kernels that it does not have (marked ?) a thread walks along the longest axis of an array.",
)


Called = tuple[str, tuple[tuple[str, Any], ...]]
"""An operation and its arguments, as of `Launch`."""


class TracedBackend(CountingBackend):
    """Counts, notes down iterations and downloads, and does nothing but give those again while it idles.

    Attributes
    ----------
    turns       by operation and its arguments: iterations, and samples in all of them, the most of any
                thread, for each launch
    downloads   what was brought back
    idle        downloads that are left to give; None: it works
    """

    def __init__(self, over: str = "warp") -> None:
        super().__init__(over)
        self.turns: defaultdict[Called, list[tuple[float, float]]] = defaultdict(list)
        self._called: Called = "", ()
        self.downloads: list[NDArray[Any]] = []
        self.idle: list[NDArray[Any]] | None = None

    def _compute(self, op: str, arrays: list[Any], settings: dict[str, Any]) -> None:
        super()._compute(op, arrays, settings)
        if op not in ("solve_code", "align_poses"):
            return
        names = (argument.name for argument in OPERATIONS[op].arguments)
        given = dict(zip(names, arrays, strict=False))
        if op == "solve_code":
            turns, samples = given["iterations_out"].numpy(), np.zeros(1)
        else:
            turns = given["result_out"].numpy()[:, 4]
            ends = given["table_ptr"].numpy()[given["table_idx"].numpy()]
            samples = (turns + 1) * (ends[:, 1] - ends[:, 0])
        self.turns[self._called].append((float(turns.max(initial=0)), float(samples.max(initial=0))))

    def to_host(self, array: Held) -> NDArray[Any]:
        if self.idle is not None:
            return self.idle.pop(0)
        back = super().to_host(array)
        self.downloads.append(back.copy())
        return back

    def assign(self, array: Held, values: NDArray[Any]) -> None:
        if self.idle is None:
            super().assign(array, values)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        replay = super().record(run)

        def unless_idle() -> None:
            if self.idle is None:
                replay()

        return unless_idle

    def _do(self, launches: list[Launch], step: Callable[[], None]) -> None:
        def called() -> None:
            self._called = launches[0].op, launches[0].given
            step()

        if launches and (self.idle is None or self._steps is not None):
            super()._do(launches, called)


def load_traced() -> TracedBackend:
    """Make the backend; the registry calls it."""
    return TracedBackend()


@dataclass(frozen=True)
class Observed:
    """What was counted and measured of a batch.

    Attributes
    ----------
    windows     of the batch
    events      of a window
    counts      of doing it
    turns       by operation and arguments: iterations and samples, means over launches
    host, copied, decode
                processor time of doing it [s], and what of it copies events to where they go up from
    right       whether all windows were read
    """

    windows: int
    events: int
    counts: Counts
    turns: dict[Called, tuple[float, float]]
    host: float
    copied: float
    decode: float
    right: bool


@dataclass
class Part:
    """A kernel's share of a batch."""

    name: str
    launches: int = 0
    threads: int = 0
    instructions: float = 0.0
    seconds: float = 0.0
    bounds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))

    @property
    def bound(self) -> str:
        """Name what takes most of it."""
        return max(self.bounds, key=lambda name: self.bounds[name])


@dataclass(frozen=True)
class Modelled:
    """Seconds of a batch.

    Attributes
    ----------
    python, launching, copies, bus, device
                host; launches from it; calls that copy; bytes that they move; kernels and what is between
    parts       kernels, largest first
    """

    python: float
    launching: float
    copies: float
    bus: float
    device: float
    parts: tuple[Part, ...]

    @property
    def total(self) -> float:
        """Of all but decoding: launches and kernels hide each other."""
        return self.python + self.copies + self.bus + max(self.launching, self.device)


def model(observed: Observed, code: dict[str, Code], device: Device, bus: float) -> Modelled:
    """Model a batch on a device.

    Parameters
    ----------
    observed : Observed
        What it is asked for.
    code : dict of Code
        Machine code, as `machine_code.compile_kernels` names it.
    device : Device
        Which.
    bus : float [bytes/s]
        Of copies.

    Returns
    -------
    modelled : Modelled
        Its times.
    """
    counts, parts = observed.counts, {}
    for launch, count in counts.made.items():
        part = parts.setdefault(launch.name, Part(launch.name))
        per_thread, bounds = _bounds(launch, observed, code, device)
        largest = max(bounds, key=lambda name: bounds[name])
        part.launches += count
        part.threads = max(part.threads, launch.threads)
        part.instructions = max(part.instructions, per_thread)
        part.seconds += count * (bounds[largest] + GAP)
        part.bounds[largest] += count * bounds[largest]
        part.bounds["gap"] += count * GAP
    return Modelled(
        observed.host,
        LAUNCH * counts.launches + GRAPH * counts.graphs,
        UPLOAD * counts.uploads + DOWNLOAD * counts.downloads,
        (counts.up_bytes + counts.down_bytes) / bus,
        sum(part.seconds for part in parts.values()),
        tuple(sorted(parts.values(), key=lambda part: -part.seconds)),
    )


def _bounds(
    launch: Launch, observed: Observed, code: dict[str, Code], device: Device
) -> tuple[float, dict[str, float]]:
    """Give instructions a thread, and the seconds that each thing takes that may keep a launch busy."""
    memory = {"memory": launch.n_bytes / device.memory if launch.n_bytes > device.cache else 0.0}
    if launch.kernel is None:
        return 0.0, memory
    sizes = Sizes(
        dict(launch.given),
        observed.events,
        launch.threads,
        *observed.turns.get((launch.op, launch.given), ()),
    )
    known = code[machine_code.key_of(launch.kernel, device.arch)]
    per_thread = instructions(known, work_of(launch.name, sizes))
    blocks = math.ceil(launch.threads / BLOCK)
    warps = min(BLOCK, launch.threads) / WARP
    waiting = math.ceil(blocks / device.processors) * max(1.0, warps / SCHEDULERS)
    atomics = ATOMICS[launch.name](sizes) if launch.name in ATOMICS else 0.0
    return per_thread, {
        "chain": per_thread * CPI / device.clock,
        "issue": per_thread * waiting / device.clock,
        "atomics": atomics / device.atomics,
        **memory,
    }


@dataclass(frozen=True)
class Scene:
    """A window to be read, and the code as it was seen one window earlier."""

    buffers: tuple[EventBuffer, EventBuffer]
    start_us: int
    length_us: int
    before: Detection
    text: str

    @property
    def window(self) -> Window:
        """Events of its own, as of another camera."""
        shared = self.buffers[0].window(self.start_us, self.start_us + self.length_us)
        return self.again(shared)

    def again(self, window: Window) -> Window:
        """Give a window whose events, packed when they were pushed to a buffer, are to go up again."""
        return Window(window.events, window.start_us, window.end_us, stamps=window.packed.stamp)


def make_scene(solver: Solver, n_events: int) -> Scene:
    """Give the demo's window with so many events: thinned, or some of them more than once."""
    demo = counting.demo()
    (job,) = pipeline.prepare(demo, solver)
    length = len(job.buffer.window(job.start_us, job.start_us + job.window_us))
    events, rate = demo.events, n_events / length
    chosen = (np.arange(int(len(events) * rate)) / rate).astype(np.int64)
    taken = EventArray(
        *(getattr(events, name)[chosen] for name in ("t", "x", "y", "p")), events.width, events.height
    )
    made = pipeline.Recording("demo", taken, demo.texts, demo.starts_us)
    (job,) = pipeline.prepare(made, solver)
    if job.before is None:
        sys.exit(f"device_model.py: the demo with {n_events} events a window is not read")
    text = pipeline.run_tracked(job, solver)
    buffers = job.buffer, EventBuffer.of(taken)
    return Scene(buffers, job.start_us, job.window_us, job.before, text or "")


def follow(scene: Scene, windows: int, solver: Solver) -> Callable[[], list[Any]]:
    """Make what follows codes in so many windows and solves for them, all at once."""
    cut = [scene.window for _ in range(windows)]

    def run() -> list[Any]:
        fresh = [scene.again(each) for each in cut]
        said = [scene.before.weighted] * windows
        found = solver.follow(EventBatch.of(fresh), [scene.before] * windows, said)
        seen = [each for each in found if isinstance(each, Detection)]
        return [(each.fused.estimate, each) for each in seen if each.fused]

    return run


def find(scene: Scene, windows: int, solver: Solver) -> Callable[[], list[Any]]:
    """Make what reads so many windows from cold, all at once: motion, coarsely and precisely, and codes."""
    cut = [scene.window for _ in range(windows)]

    def run() -> list[Any]:
        fresh = [scene.again(each) for each in cut]
        cfg, workspace = solver.config.motion, solver.workspace
        estimate_motions(fresh, cfg, workspace=workspace, reduction=cfg.reduction)
        moving = estimate_motions(fresh, cfg, workspace=workspace)
        motions = [each.motion for each in moving if isinstance(each, MotionEstimate)]
        if len(motions) < windows:
            return []
        found = solver.find(EventBatch.of(fresh), motions)
        seen = [codes[0] for codes in found if not isinstance(codes, NotFound)]
        return list(zip(solver.solve(seen), seen, strict=True))

    return run


METHODS = {"tracked": follow, "cold": find}
"""How each is made."""


def observe(method: str, scene: Scene, windows: int, events: int, solver: Solver) -> Observed:
    """Count what a batch asks for, and measure the host's share of it."""
    backend: Any = solver.workspace.backend
    run = METHODS[method](scene, windows, solver)
    run()  # makes buffers and records
    backend.counts, backend.turns, backend.downloads = Counts(), defaultdict(list), []
    found = run()
    counts, turns = backend.counts, {op: _mean(of) for op, of in backend.turns.items()}
    host, copied = _host_time(solver, run)
    texts: list[str | None] = []

    def decode() -> None:
        texts[:] = [getattr(decode_grid(each.q, seen.space), "text", None) for each, seen in found[:8]]

    decoding = min(_time(decode) for _ in range(3)) * len(found) / max(len(texts), 1)
    right = len(found) == windows and set(texts) == {scene.text}
    return Observed(windows, events, counts, turns, host, copied, decoding, right)


def _mean(turns: Sequence[tuple[float, float]]) -> tuple[float, float]:
    iterations, samples = np.mean(turns, axis=0).tolist()
    return iterations, samples


def _host_time(solver: Solver, run: Callable[[], Any], rounds: int = 5) -> tuple[float, float]:
    """Measure the host alone, and its copying of events, in the fastest of some rounds.

    Kernels do nothing, and downloads are those that were brought before.
    """
    backend: Any = solver.workspace.backend
    workspace: Any = solver.workspace
    load, copied, times = workspace.events, [0.0], []

    def events(batch: EventBatch) -> Any:
        begin = time.process_time()
        room = load(batch)
        copied[0] += time.process_time() - begin
        return room

    for _ in range(rounds):
        backend.idle = [values.copy() for values in backend.downloads]
        copied[0], workspace.events = 0.0, events
        try:
            times.append((_time(run), copied[0]))
        finally:
            backend.idle, workspace.events = None, load
    return min(times)


def _time(run: Callable[[], Any]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def lines(method: str, observed: Observed, code: dict[str, Code], kernels: int) -> list[str]:
    """Give what to print of a batch: a line a device and bus, and the largest kernels on each device."""
    counts = observed.counts
    goal = GOALS.get((method, observed.windows, observed.events))
    made = [
        f"{method}, B = {observed.windows}, {observed.events} events a window: "
        f"{counts.launches + counts.recorded} launches in {counts.graphs} graphs, {counts.uploads} uploads "
        f"({counts.up_bytes / 1e6:.2f} MB), {counts.downloads} downloads "
        f"({counts.down_bytes / 1e6:.2f} MB)" + ("" if observed.right else "  NOT READ"),
    ]
    ms, us = 1e3, 1e6 / observed.windows
    made.append(
        f"  Python a window: {us * (observed.host - observed.copied):.1f} us, "
        f"and {us * observed.copied:.1f} us to copy its events"
    )
    for device in DEVICES:
        for name, bus in BUSES.items():
            m = model(observed, code, device, bus)
            made.append(
                f"  {device.name:8} PCIe {name}: {observed.windows / m.total:9.0f} windows/s"
                + (f" (goal {goal})" if goal else "")
                + f", {ms * m.total:.2f} ms: Python {ms * m.python:.2f}, copies {ms * m.copies:.2f}, "
                f"bus {ms * m.bus:.2f}, launching {ms * m.launching:.2f} beside kernels {ms * m.device:.2f}"
            )
    decode = observed.decode
    made.append(
        f"  decoding, one core: {ms * decode:.2f} ms, {observed.windows / max(decode, 1e-9):.0f} windows/s"
    )
    for device in DEVICES if kernels else ():
        m = model(observed, code, device, BUSES[4])
        title = f"largest on {device.name}"
        made.append(f"  {title:44} launches   threads  instr./thread         ms  share  bound by")
        made += [
            f"    {part.name + '?' * _guessed(part.name):44} {part.launches:6} {part.threads:9} "
            f"{part.instructions:14.0f} {ms * part.seconds:10.3f} {part.seconds / m.device:6.1%}  "
            f"{part.bound}"
            for part in m.parts[:kernels]
        ]
    return made


def _guessed(name: str) -> bool:
    return "." in name and name not in WORK


def code_of(kernels: set[Any], path: Path | None) -> dict[str, Code]:
    """Give the machine code of kernels, compiling only what a file does not have."""
    archs = [device.arch for device in DEVICES]
    code = machine_code.load(path) if path and path.exists() else {}
    missing = {k for k in kernels if any(machine_code.key_of(k, arch) not in code for arch in archs)}
    if missing:
        code |= machine_code.compile_kernels(missing, archs)
        if path:
            machine_code.save(path, code)
    return code


def main() -> int:
    """Count, compile, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 25, 128, 512])
    parser.add_argument("--events", type=int, nargs="+", default=[10_000, 36_000])
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--code", type=Path, help="where machine code is kept")
    parser.add_argument("--kernels", type=int, default=10, help="how many to print, of batches with a goal")
    arguments = parser.parse_args()
    register_backend("traced", f"{__name__}:load_traced")
    code: dict[str, Code] = {}
    print("\n".join(ASSUMED))
    for events in arguments.events:
        scene = make_scene(Solver(backend="traced"), events)
        for method in arguments.methods:
            for windows in arguments.batches:
                # another one each time: room for events that has grown stays, and all of it goes up
                observed = observe(method, scene, windows, events, Solver(backend="traced"))
                code |= code_of({launch.kernel for launch in observed.counts.made} - {None}, arguments.code)
                shown = arguments.kernels if (method, windows, events) in GOALS else 0
                print("\n".join(lines(method, observed, code, shown)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
