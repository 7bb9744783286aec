#!/usr/bin/env python3
"""Ask a machine with a GPU all that it can tell, in one command of minutes: right, fast, as modelled.

usage: on_gpu.py [--device cuda:0] [--recordings DIR] [--out FOLDER] [--minutes 8] [--dry]

Parts come in the order of what they tell, each in processes of its own, so that what fails takes no other
with it.  After each, FOLDER has a page (on_gpu.md) and a table (on_gpu.csv) of all so far.  What is left when
the minutes are over is named there.  ``--dry``: the same on a CPU with the least of everything, to see
that it runs; its figures say nothing.
"""

from __future__ import annotations

import argparse
import csv
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
PYTEST = sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"

OPERATIONS = (
    "solve_code", "align_poses", "deposit_events", "splat_events", "splat_events_adjoint", "bin_events",
    "motion_correlation", "lag_operator", "code_rhs", "render_code", "brightness_cost",
)  # fmt: skip
"""Those that windows take longest for, and those that PyTorch has a rival of."""

FIGURE = re.compile(r"([A-Za-z_]+) ([^,]+)(?:, |$)")
"""Of a line of a target for profilers."""

MODELLED = re.compile(
    r"^(?P<way>\w+), B = (?P<windows>\d+), (?P<events>\d+)|"
    r"^  (?P<device>.+?) +PCIe (?P<bus>\d): +(?P<rate>\d+) windows/s"
)


@dataclass(frozen=True)
class Part:
    """Something to run.

    Attributes
    ----------
    name      of the part: those with one stand together on the page
    command   arguments of a process
    most      seconds that it may take
    """

    name: str
    command: Sequence[str]
    most: float


@dataclass
class Done:
    """What came of a part.

    Attributes
    ----------
    outcome   "done", or why not
    rows      its figures
    printed      the last lines that it printed
    """

    part: Part
    outcome: str
    seconds: float = 0.0
    rows: list[dict[str, str]] = field(default_factory=list)
    printed: str = ""


def parts(device: str, recordings: Path | None, dry: bool) -> list[Part]:
    """List what to run, the most telling first."""
    windows = "1" if dry else "1,8,64,128,512"
    few = ["--launches", "2", "--warm-ups", "1"] if dry else []
    target = ["--device", device, "--windows", windows, *few]

    def script(name: str, *arguments: str) -> list[str]:
        return [sys.executable, str(HERE / f"{name}.py"), *arguments]

    def tests(backend: str, *which: str) -> list[str]:
        chosen = f"{backend} and {'stops_at_the_tolerance' if dry else device.partition(':')[0]}"
        return [*PYTEST, *which, "--device", device, "-k", chosen]

    blocks = [f"tests/kernels/test_{name}.py" for name in ("solve", "align")]
    made = [
        Part("tests of blocks, Warp", tests("warp", *blocks), 90),
        Part("windows", script("profile_window", *target), 90),
    ]
    if recordings:
        found = sorted(path for path in recordings.iterdir() if path.suffix in (".h5", ".raw", ".aedat4"))
        for path in found[:1] if dry else found:
            read = [sys.executable, "-m", "evqr", "read", "--text", "--device", device, str(path)]
            made.append(Part("recordings", read, 60))
    made += [
        Part("operations", script("profile_kernel", op, "--graph", *target, *(["--events", "200"] * dry)), 60)
        for op in (OPERATIONS[:2] if dry else OPERATIONS)
    ]
    batches = ["1"] if dry else ["1", "128"]
    made += [
        Part("PyTorch", script("on_gpu", "--torch", "--device", device, *(["--dry"] * dry)), 60),
        Part(
            "model", script("device_model", "--events", "10000", "--batches", *batches, "--kernels", "0"), 120
        ),
        Part("tests, Warp", tests("warp", "tests/kernels"), 240),
        Part("tests, Taichi", tests("taichi", "tests/kernels"), 240),
    ]
    # the model compiles for a minute, and a dry run is to see that commands run
    return [part for part in made if not (dry and part.name in ("model", "tests, Warp", "tests, Taichi"))]


def run(part: Part, left: float) -> Done:
    """Run a part within the seconds that are left."""
    most, begin = min(part.most, left), time.perf_counter()
    try:
        made = subprocess.run(
            part.command, cwd=ROOT, capture_output=True, text=True, timeout=most, check=False
        )
        printed, outcome = made.stdout, "done" if made.returncode == 0 else f"exit status {made.returncode}"
        said = made.stdout + (made.stderr if made.returncode else "")
    except subprocess.TimeoutExpired as error:
        said = printed = (error.stdout or b"").decode(errors="replace")
        outcome = f"took longer than {most:.0f} s"
    took = time.perf_counter() - begin
    return Done(part, outcome, took, rows_of(printed), "\n".join(said.splitlines()[-6:]))


def rows_of(printed: str) -> list[dict[str, str]]:
    """Find the figures in what a part printed."""
    rows, of = [], {}
    for line in printed.splitlines():
        modelled = MODELLED.match(line)
        if modelled and modelled["way"]:
            of = {"way": modelled["way"], "windows": modelled["windows"], "events": modelled["events"]}
        elif modelled:
            where = f"{modelled['device']}, PCIe {modelled['bus']}, modelled"
            rows.append({**of, "device": where, "windows_a_second": modelled["rate"]})
        elif line.startswith(("op ", "way ")):
            rows.append(dict(FIGURE.findall(line)))
    return rows


def page(done: Sequence[Done], left_out: Sequence[Part], title: str) -> str:
    """Write down all so far."""
    lines = [f"# {title}", ""]
    for name in dict.fromkeys(each.part.name for each in done):
        lines += [f"## {name[0].upper()}{name[1:]}", ""]
        of_it = [each for each in done if each.part.name == name]
        rows = [row for each in of_it for row in each.rows]
        if rows:
            heads = list(dict.fromkeys(head for row in rows for head in row))
            lines += ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
            lines += ["| " + " | ".join(row.get(head, "") for head in heads) + " |" for row in rows]
            lines.append("")
        for each in of_it:
            if each.outcome != "done" or not each.rows:
                command = " ".join(each.part.command[1:]).replace(str(ROOT) + "/", "")
                lines += [f"`{command}`: {each.outcome}, {each.seconds:.0f} s", ""]
                lines += ["```text", each.printed, "```", ""]
    if left_out:
        lines += [
            f"Not run, for want of time: {', '.join(dict.fromkeys(part.name for part in left_out))}.",
            "",
        ]
    return "\n".join(lines)


def write(folder: Path, done: Sequence[Done], left_out: Sequence[Part], title: str) -> None:
    """Write the page and the table."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "on_gpu.md").write_text(page(done, left_out, title))
    rows = [{"part": e.part.name, "outcome": e.outcome} | row for e in done for row in (e.rows or [{}])]
    heads = list(dict.fromkeys(head for row in rows for head in row))
    with (folder / "on_gpu.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, heads)
        writer.writeheader()
        writer.writerows(rows)


def torch_baselines(device: str, dry: bool) -> int:
    """Time what a user of PyTorch writes, on the same device; a line an operation and batch."""
    import cases
    import ops
    import torch
    from peers import PEERS
    from problems import Size

    torch.set_default_device(device)
    wait = torch.cuda.synchronize if device.startswith("cuda") else lambda: None
    plain = cases.SIZES["production"]
    for peer in (peer for peer in PEERS if peer.needs == "torch"):
        for windows in (1,) if dry else (1, 8, 64):
            size = Size(windows, 200 if dry else plain["events"], plain["side"], plain["modules"])
            call = peer.prepare(ops.build(peer.op, size, "float32"))
            call()
            times = []
            for _ in range(2 if dry else 10):
                wait()
                begin = time.perf_counter()
                call()
                wait()
                times.append(time.perf_counter() - begin)
            median = 1e3 * statistics.median(times)
            print(f"op {peer.op}, rival {peer.name}, windows {windows}, median_ms {median:.4f}", flush=True)
    return 0


def main() -> int:
    """Run one part after the other; exit 1 when one of them failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--recordings", type=Path, help="folder of recordings to read")
    parser.add_argument("--out", type=Path, default=Path("on_gpu"), help="folder for the page and the table")
    parser.add_argument("--minutes", type=float, default=8.0, help="in all")
    parser.add_argument("--dry", action="store_true", help="the least of everything, on a CPU")
    parser.add_argument("--torch", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    device = "cpu" if options.dry else options.device
    if options.torch:
        return torch_baselines(device, options.dry)
    import profilers

    profilers.require("warp", device)
    end, done = time.perf_counter() + 60 * options.minutes, []
    waiting = parts(device, options.recordings, options.dry)
    title = f"{device}, {time.strftime('%Y-%m-%d')}" + ", a dry run" * options.dry
    while waiting and (left := end - time.perf_counter()) > 1:
        done.append(run(waiting.pop(0), left))
        write(options.out, done, waiting, title)
        each = done[-1]
        print(f"{each.part.name}: {each.outcome}, {each.seconds:.0f} s", flush=True)
    return 1 if waiting or any(each.outcome != "done" for each in done) else 0


if __name__ == "__main__":
    sys.exit(main())
