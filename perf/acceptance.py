#!/usr/bin/env python3
"""Read simulated recordings of every kind, with codes and without; exit 1 when the read rate falls short.

usage: acceptance.py [--scenes 200] [--no-code 500] [--jobs 2] [--seed 0] [--only NAME] [--log FILE]

Scenes are named code-0, code-1, ... (a code passes), decoy-0, decoy-2, ... (things that look a little like
one) and shuffled-1, shuffled-3, ... (a code's events with the pixels shuffled).  A scene follows from the
seed and its name alone, whatever the numbers of scenes are: --only NAME runs one again.  With --log each
outcome is appended to a file of JSON lines, and scenes that it holds already are not run again.

Required: at least 99 % of the codes read, and nothing read that is not there.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported: the processes share the cores

import argparse
import json
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

import evqr
from evqr import simulate
from evqr.symbol.qr_codewords import codeword_layout
from evqr.symbol.qr_tables import LEVELS

MIN_READ_RATE = 0.99
PRESETS = ("clean", "slow", "fast")
VERSIONS = (1, 10)
SPEED_PX_MS = (0.5, 10.0)
MODULE_PX = (3.5, 8.0)
WIDTH, HEIGHT = 640, 480
TRAVEL_PX = 40.0
MARGIN_PX = 8.0  # the code stays so far from the edge of the view
QUIET_MODULES = 4
ALPHANUMERIC = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ $%*+-./:"


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is simulated under a name; all of it drawn at random except ``name``."""

    name: str
    preset: str
    text: str
    version: int
    ec: str
    angle: float
    direction: float
    speed_px_ms: float
    module_px: float
    start: tuple[float, float]
    seed: int

    @property
    def kind(self) -> str:
        """Return "code", "decoy" or "shuffled"."""
        return self.name.split("-")[0]


def draw_scene(name: str, seed: int, preset: str | None) -> Scene:
    """Draw the parameters of a scene: uniform where they may lie, modules as large as the view allows."""
    kind, index = name.split("-")
    rng = np.random.default_rng([seed, ("code", "decoy", "shuffled").index(kind), int(index)])
    drawn_preset = PRESETS[rng.integers(len(PRESETS))]
    version = int(rng.integers(VERSIONS[0], VERSIONS[1] + 1))
    ec = LEVELS[rng.integers(len(LEVELS))]
    angle, direction = rng.uniform(0.0, 360.0, 2).tolist()
    speed = rng.uniform(*SPEED_PX_MS)

    heading = np.array([math.cos(math.radians(direction)), math.sin(math.radians(direction))])
    free = np.array([WIDTH, HEIGHT]) - 1 - 2 * MARGIN_PX - TRAVEL_PX * np.abs(heading)
    slant = sum(abs(f(math.radians(angle))) for f in (math.cos, math.sin))
    modules = 17 + 4 * version + 2 * QUIET_MODULES
    largest = min(MODULE_PX[1], free.min() / (modules * slant))
    module = rng.uniform(MODULE_PX[0], largest)

    room = free - modules * slant * module
    middle = (np.array([WIDTH, HEIGHT]) - 1) / 2 + rng.uniform(-0.5, 0.5, 2) * room
    start = middle - 0.5 * TRAVEL_PX * heading
    return Scene(
        name=name,
        preset=preset or drawn_preset,
        text=_text(rng, version, ec),
        version=version,
        ec=ec,
        angle=round(angle, 2),
        direction=round(direction, 2),
        speed_px_ms=round(speed, 3),
        module_px=round(module, 3),
        start=(round(float(start[0]), 2), round(float(start[1]), 2)),
        seed=int(rng.integers(2**31)),
    )


def _text(rng: np.random.Generator, version: int, ec: str) -> str:
    """Return alphanumeric text that fills some share of the symbol, from a few characters to all of it."""
    data_bits = 8 * sum(block.n_data for block in codeword_layout(version, ec).blocks)
    capacity = int((data_bits - 4 - (9 if version < 10 else 11)) / 5.5)
    length = rng.integers(4, capacity, endpoint=True)
    return "".join(rng.choice(list(ALPHANUMERIC), length))


@cache
def _solver_ready() -> bool:
    """Load the kernels once a process, so that no scene's time contains it."""
    evqr.Solver()
    return True


def run_scene(name: str, seed: int, preset: str | None) -> dict:
    """Simulate a scene, read it, and judge: "read", "missed", "silent" (as it should) or "false"."""
    _solver_ready()
    scene = draw_scene(name, seed, preset)
    recording = simulate.simulate(
        scene.text,
        version=scene.version,
        ec=scene.ec,
        angle=scene.angle,
        direction=scene.direction,
        speed_px_ms=scene.speed_px_ms,
        module_px=scene.module_px,
        preset=scene.preset,
        code=scene.kind != "decoy",
        start=scene.start,
        duration_us=round(TRAVEL_PX / scene.speed_px_ms * 1000.0),
        width=WIDTH,
        height=HEIGHT,
        seed=scene.seed,
        threads=1,
    )
    events = recording.events
    if scene.kind == "shuffled":
        events = simulate.shuffled(events, scene.seed)
    started = time.perf_counter()
    result = evqr.read_codes(events)
    seconds = time.perf_counter() - started
    texts = [reading.text for reading in result.readings]
    expected = {scene.text} if scene.kind == "code" else set()
    if set(texts) - expected:
        verdict = "false"
    elif expected:
        verdict = "read" if texts else "missed"
    else:
        verdict = "silent"
    return {
        "name": name,
        "run_seed": seed,
        "verdict": verdict,
        "texts": texts,
        "reason": result.reason,
        "seconds": round(seconds, 3),
        "windows": [reading.windows for reading in result.readings],
        "events": len(events),
        **{k: v for k, v in asdict(scene).items() if k != "name"},
    }


def _logged(log: Path | None, seed: int) -> dict[str, dict]:
    if log is None or not log.exists():
        return {}
    outcomes = (json.loads(line) for line in log.read_text().splitlines())
    return {outcome["name"]: outcome for outcome in outcomes if outcome["run_seed"] == seed}


def _describe(outcome: dict) -> str:
    wrong = f" read {outcome['texts']}," if outcome["verdict"] == "false" else ""
    return (
        f"{outcome['verdict'].upper():6s} {outcome['name']:12s}{wrong} {outcome['preset']}, "
        f"{outcome['version']}-{outcome['ec']}, angle {outcome['angle']}, direction {outcome['direction']}, "
        f"{outcome['speed_px_ms']} px/ms, {outcome['module_px']} px a module, "
        f"{len(outcome['text'])} characters, "
        f"{outcome['events']} events, {outcome['seconds']} s: {outcome['reason']}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200, help="with a code")
    parser.add_argument("--no-code", type=int, default=500, help="without one: decoys and shuffled, in turn")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", metavar="NAME", help="run one scene again, such as code-17")
    parser.add_argument("--preset", choices=sorted(simulate.PRESETS), help="one sensor instead of three")
    parser.add_argument("--log", type=Path, help="JSON lines to append to, and to go on from")
    arguments = parser.parse_args()

    names = [f"code-{k}" for k in range(arguments.scenes)]
    names += [f"{('decoy', 'shuffled')[k % 2]}-{k}" for k in range(arguments.no_code)]
    if arguments.only:
        names = [arguments.only]
    done = _logged(arguments.log, arguments.seed)
    outcomes = [done[name] for name in names if name in done]
    run = partial(run_scene, seed=arguments.seed, preset=arguments.preset)
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(run, name) for name in names if name not in done]
        for job in tqdm(as_completed(jobs), total=len(jobs), smoothing=0.05, unit="scene"):
            outcome = job.result()
            outcomes.append(outcome)
            if outcome["verdict"] in ("missed", "false"):
                tqdm.write(_describe(outcome), file=sys.stdout)
                sys.stdout.flush()
            if arguments.log is not None:
                with arguments.log.open("a") as log:
                    log.write(json.dumps(outcome) + "\n")
    return report(outcomes)


def report(outcomes: list[dict]) -> int:
    """Print rates, over all and by preset, and say whether they suffice."""
    with_code = [o for o in outcomes if o["name"].startswith("code")]
    read = [o for o in with_code if o["verdict"] == "read"]
    false = [o for o in outcomes if o["verdict"] == "false"]
    for preset in sorted({o["preset"] for o in with_code}):
        of_preset = [o for o in with_code if o["preset"] == preset]
        print(f"  {preset:6s} {sum(o['verdict'] == 'read' for o in of_preset)} of {len(of_preset)} read")
    rate = len(read) / len(with_code) if with_code else 1.0
    print(
        f"read {len(read)} of {len(with_code)} scenes with a code "
        f"({rate:.2%}, {MIN_READ_RATE:.0%} required)\n"
        f"{len(false)} false texts in {len(outcomes)} scenes, "
        f"{len(outcomes) - len(with_code)} of them without a code (none allowed)"
    )
    return 0 if rate >= MIN_READ_RATE and not false else 1


if __name__ == "__main__":
    sys.exit(main())
