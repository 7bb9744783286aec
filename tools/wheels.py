#!/usr/bin/env python3
"""Ask whether every dependency and every extra has wheels, for the oldest and the newest Python.

usage: wheels.py [--python 3.10 ...] [--platform linux ...]

Needs uv and Python 3.11. Nothing is installed: uv resolves the versions and says whether they have wheels.
Exits with 1 where one that is not in `KNOWN` has none.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import tomllib

ROOT = Path(__file__).parents[1]

PYTHONS = ("3.10", "3.13")

PLATFORMS = {
    "linux": "x86_64-manylinux_2_34",
    "macos": "aarch64-apple-darwin",
    "windows": "x86_64-pc-windows-msvc",
}
"""What uv calls them."""

NO_AEDAT = "aedat has none for Macs: pip builds it, which needs Rust"
KNOWN = {
    ("formats", "macos"): NO_AEDAT,
    ("test", "macos"): NO_AEDAT,
    ("dev", "macos"): NO_AEDAT,
    ("live", "macos"): "neither neuromorphic-drivers nor dv-processing has any for Macs",
    ("portability", "macos"): "NVIDIA's disassembler is for Linux and Windows",
}
"""Extra and system of what has no wheels, with any Python, and why."""


def resolved(extra: str, python: str, platform: str) -> str:
    """Return "" where all that an extra brings has wheels, else what uv says."""
    command = [
        "uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate", "--only-binary", ":all:",
        "--python-version", python, "--python-platform", PLATFORMS[platform],
        *(["--extra", extra] if extra else []), str(ROOT / "pyproject.toml"),
    ]  # fmt: skip
    told = subprocess.run(
        command, capture_output=True, text=True, check=False, env=dict(os.environ, NO_COLOR="1")
    )
    return "" if told.returncode == 0 else " ".join(told.stderr.split())


def main() -> int:
    """Ask, and print a line for each extra, Python and system."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--python", nargs="+", default=PYTHONS)
    parser.add_argument("--platform", nargs="+", choices=PLATFORMS, default=list(PLATFORMS))
    given = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = ["", *project["optional-dependencies"]]
    asked = [
        (extra, python, platform)
        for platform in given.platform
        for python in given.python
        for extra in extras
    ]
    faults = 0
    with ThreadPoolExecutor(4) as pool:
        for (extra, python, platform), problem in zip(
            asked, pool.map(lambda each: resolved(*each), asked), strict=True
        ):
            known = KNOWN.get((extra, platform))
            outcome = (
                "wheels" if not problem else f"none, as is known: {known}" if known else f"NONE: {problem}"
            )
            faults += bool(problem) and known is None
            print(f"{platform:8s} {python:5s} {extra or '(none)':12s} {outcome}", flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
