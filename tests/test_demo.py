"""The recording that comes with the package, read by the real reader through the real command line."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from backends import BACKENDS

from evqr.demo import demo_recording, demo_truth

TEXT = "Read in passing, 8 px/ms"


def evqr(*arguments):
    command = [sys.executable, "-m", "evqr", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    said = [line for line in done.stderr.splitlines() if "compiling kernels" not in line]
    return done.returncode, done.stdout.splitlines(), said


def test_demo(tmp_path):
    pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")
    picture = tmp_path / "demo.png"
    status, out, said = evqr("demo", "--picture", picture)
    assert (status, out[0], said) == (0, TEXT, [])
    assert out[-1] == f"picture: {picture}"
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_reads_it(backend):
    with demo_recording() as path:
        status, out, said = evqr("read", path, "--backend", backend, "--text")
    assert (status, out, said) == (0, [TEXT], [])


def test_windows_one_by_one():
    with demo_recording() as path:
        truth = demo_truth(path)
        status, out, said = evqr("read", path, "--each-window", "--max-windows", 4, "--json")
    windows = [json.loads(line) for line in out]
    assert (status, said) == (0, [])
    assert 1 <= len(windows) <= 4
    assert {window["text"] for window in windows} <= {TEXT, None}
    for window in windows:
        if window["status"] == "read":
            dark = np.array([[module == "1" for module in row] for row in window["modules"]])
            assert (dark == (truth < 0)).mean() > 0.9


def test_many_in_worker_processes(tmp_path):
    empty = tmp_path / "empty.h5"
    empty.touch()
    with demo_recording() as path:
        status, out, said = evqr("read", path, empty, path, "--json", "--jobs", 2)
    first, second, third = map(json.loads, out)
    assert (status, said) == (2, [])
    assert first["text"] == third["text"] == TEXT
    assert (second["status"], second["recording"]) == ("error", str(empty))
