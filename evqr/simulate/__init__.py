"""Simulate a printed code that passes an event camera, with its truth.

The scene (`SceneConfig`) is drawn once, as a texture; each pixel (`SensorConfig`) then follows its own path
through it and says when it crosses its thresholds, in continuous time.
"""

from evqr.simulate.config import PRESET_SPEEDS_PX_MS, PRESETS, CodePlacement, SceneConfig, SensorConfig
from evqr.simulate.shuffle import shuffled
from evqr.simulate.simulation import Simulation, simulate, simulate_scene

__all__ = [
    "PRESETS",
    "PRESET_SPEEDS_PX_MS",
    "CodePlacement",
    "SceneConfig",
    "SensorConfig",
    "Simulation",
    "shuffled",
    "simulate",
    "simulate_scene",
]
