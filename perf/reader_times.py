"""Times of the reader: a window by each method, windows a second by threads, and what is paid once."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cases
import h5py
import limits
import numpy as np
import pipeline
import timing
import without_code
from table import Row, row

from evqr import EventArray, ReadConfig, open_recording, read_codes, read_windows
from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import Detection, NotFound
from evqr.search.motion_estimate import MotionEstimate
from evqr.simulate import simulate
from evqr.solver import Solver

RATIOS = (("integrate", "cold", 1.0), ("integrate", "tracked", 4.0), ("descent", "tracked", 20.0))
THREADS_RATIO = 1.7
POSE_TOLERANCE_PX = 0.05  # float32 sums in another order move a converged pose by less
CODE_TOLERANCE = 0.02


def check(device: str) -> float:
    """Refuse to go on unless the backend is right; return how long the first window took [ms]."""
    solvers = {"auto": Solver(device=device), "numpy": Solver(backend="numpy")}
    events = simulate(**cases.GATE).events
    buffer = EventBuffer.of(events)
    start = int(events.t[0]) + 500
    found = {}
    for backend, solver in solvers.items():
        begin = time.perf_counter()
        seen = buffer.answer(solver.motion_at(start))
        if isinstance(seen, MotionEstimate):
            motion = seen.motion
            window = buffer.window(start, start + solver.window_us(motion))
            (codes,) = solver.find(EventBatch.of([window]), [motion])
            seen = codes if isinstance(codes, NotFound) else codes[0]
        first_ms = 1e3 * (time.perf_counter() - begin)
        if not isinstance(seen, Detection):
            sys.exit(f"gate: backend {backend} finds no code in the known scene: {seen}")
        q = solver.solve([seen])[0].q
        found[backend] = (seen.target.outline(), q, first_ms)
    (corners, q, first_ms), (true_corners, true_q, _) = found["auto"], found["numpy"]
    apart = float(np.abs(corners - true_corners).max())
    differ = float(np.abs(q - true_q).max() / np.abs(true_q).max())
    if apart > POSE_TOLERANCE_PX or differ > CODE_TOLERANCE:
        sys.exit(
            f"gate: backend and specification differ: corners by {apart:.3f} px, modules by {differ:.1%}"
        )
    texts = [reading.text for reading in read_codes(events, device=device).readings]
    if texts != [cases.GATE["text"]]:
        sys.exit(f"gate: the known scene reads {texts}, not {cases.GATE['text']!r}")
    return first_ms


def load_seconds(device: str) -> tuple[float, float]:
    """Time to a ready solver in a fresh process: with nothing compiled, then with all of it in the cache."""
    script = (
        "import time; t = time.perf_counter(); from evqr import Solver; Solver(device={!r}); "
        "print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-c", script.format(device)]
        environment = {**os.environ, "WARP_CACHE_PATH": cache}
        cold, warm = (
            float(
                subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
                .stdout.strip()
                .splitlines()[-1]
            )
            for _ in range(2)
        )
    return cold, warm


def simulated(name: str) -> pipeline.Recording:
    case = {**cases.PIPELINE, **cases.WITHOUT_CODE, **cases.VIEWS}[name]
    if "print" in case:
        events = without_code.simulated(case["print"], **case["scene"])
    else:
        events = simulate(**case["scene"]).events
    texts = {case["scene"]["text"]} if "text" in case["scene"] else set()
    return _recording(name, events, texts, case["windows"])


def recorded(path: Path, windows: int = 8) -> pipeline.Recording | None:
    """Return a recording while its code is in view, or None where it has no truth."""
    with h5py.File(path) as file:
        if "truth/modules" not in file:
            return None
        truth = file["truth"]
        texts = {str(file[g].attrs["payload"]) for g in file if g.startswith("truth")}
        times = truth["t_us"][:][truth["in_view"][:].astype(bool)]
    with open_recording(path) as recording:
        events = recording.read().between(int(times[0]), int(times[-1]) + 1)
    return _recording(path.stem, events, texts, windows)


def _recording(name: str, events: EventArray, texts: set[str], windows: int) -> pipeline.Recording:
    first, last = int(events.t[0]), int(events.t[-1])
    # from a tenth of the way, so that there is a window before, to two thirds, so that long ones end in time
    starts = np.linspace(first + 0.1 * (last - first), first + 0.67 * (last - first), windows)
    return pipeline.Recording(name, events, frozenset(texts), tuple(int(start) for start in starts))


def time_pipeline(recordings: list[pipeline.Recording], device: str, rounds: int) -> list[Row]:
    """Time all methods; rows of milliseconds a window by stage, then rows of ratios."""
    solver = Solver(device=device)
    jobs = [job for recording in recordings for job in pipeline.prepare(recording, solver)]
    timings = list(pipeline.run_interleaved(jobs, solver, rounds))
    rows = []
    for case in (*dict.fromkeys(t.case for t in timings), "all"):
        for method in pipeline.METHODS:
            of_method = [t for t in timings if t.method == method and case in (t.case, "all")]
            if not of_method:
                continue
            read = sum(t.verdict == "read" for t in of_method) / len(of_method)
            false = sum(t.verdict == "FALSE" for t in of_method)
            share = f"{read:.0%}" + (f", {false} false" if false else "")
            rows.append(row("window ms", case, method, "total", [t.total for t in of_method], read=share))
            for stage in dict.fromkeys(stage for t in of_method for stage in t.ms) if case == "all" else ():
                values = [t.ms.get(stage, 0.0) for t in of_method]
                rows.append(row("window ms", case, method, stage, values))
    # the same window in the same round, one method after the other
    keyed: dict[tuple, list[float]] = {}
    for t in timings:
        keyed.setdefault((t.job, t.method), []).append(t.total)
    for slow, fast, required in RATIOS:
        pairs = [
            a / b
            for (job, method), times in keyed.items()
            if method == slow and (job, fast) in keyed
            for a, b in zip(times, keyed[job, fast], strict=True)
        ]
        rows.append(row("ratio", "all", f"{slow} / {fast}", "total", pairs, required=required))
    return rows


def time_threads(device: str) -> list[Row]:
    """Time one thread against two on many windows of every scene, in turns.

    Beside them runs what shares nothing, multiply-adds in registers: less than 2 there is what the machine
    has not to give.
    """
    config = ReadConfig(max_windows=cases.THREADS["windows"])
    scenes = {name: simulate(**case["scene"]).events for name, case in cases.PIPELINE.items()}
    control = [limits.control("float32") for _ in range(2)]
    rows, ratios, given = [], [], []
    with ThreadPoolExecutor(2) as pool:
        alone, both = (timing.measured_together(control[:count], pool) for count in (1, 2))
        for name, events in scenes.items():
            rates: dict[int, list[float]] = {1: [], 2: []}
            for _ in range(cases.THREADS["rounds"]):
                for threads, of_threads in rates.items():
                    begin = time.perf_counter()
                    windows = read_windows(events, config=config, device=device, threads=threads)
                    count = sum(1 for _ in windows)
                    of_threads.append(count / (time.perf_counter() - begin))
                given.append(2.0 * alone() / both())
            for threads, of_threads in rates.items():
                rows.append(row("windows/s", name, f"{threads} threads", "total", of_threads))
            ratios += [two / one for one, two in zip(rates[1], rates[2], strict=True)]
    rows.append(row("ratio", "all", "2 threads / 1", "total", ratios, required=THREADS_RATIO))
    rows.append(row("ratio", "all", "multiply-adds, 2 / 1", "total", given))
    return rows
