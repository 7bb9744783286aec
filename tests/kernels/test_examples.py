"""The examples on the demo recording: they end well, that is, find what they look for."""

import importlib
import sys
from pathlib import Path

import pytest

import evqr

pytest.importorskip("torch", reason="PyTorch is not installed")

ROOT = Path(__file__).parents[2]
DEMO = Path(evqr.__file__).parent / "data" / "demo.h5"


@pytest.mark.parametrize("name", ["patch_flow_torch", "voxel_grid_torch", "rotation_torch", "depth_torch"])
def test_example(name, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    monkeypatch.setattr(sys, "argv", [name, str(DEMO)])
    assert importlib.import_module(name).main() == 0
