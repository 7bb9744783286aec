"""A data set that takes a second: one code, two recordings, a few windows."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from evqr.paper.dataset.manifest import Entry, save_manifest
from evqr.recording.writing import save_recording
from evqr.simulate import simulate


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """Two recordings of 200x160 px, 12 windows each."""
    folder = tmp_path_factory.mktemp("tiny")
    first = Entry(
        name="belt-00", scene="belt", angle=0, recording="belt-00.h5", text="TINY", version=1, level="H",
        window_us=300, start_us=0, end_us=3600,
    )  # fmt: skip
    entries = [first, replace(first, name="belt-30", angle=30, recording="belt-30.h5")]
    for entry in entries:
        made = simulate(
            "TINY", version=1, ec="H", angle=entry.angle, module_px=4.5, speed_px_ms=5.0, width=200,
            height=160, duration_us=3600, seed=7, threads=1,
        )  # fmt: skip
        save_recording(folder / entry.recording, made.events, truth=made.truth)
        with h5py.File(folder / entry.recording, "a") as file:
            dark = np.kron(np.pad(made.truth["truth"]["modules"], 4), np.ones((5, 5), np.uint8))
            file["frames/image"] = np.where(dark, 20, 200).astype(np.uint8)[None]
            file["frames/t"] = [1000]
    save_manifest(folder, entries)
    return folder
