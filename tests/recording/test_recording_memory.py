"""Reading is bounded in memory: many chunks cost no more than one."""

import tracemalloc

import h5py
import numpy as np
import pytest

from evqr.recording import convert_recording, open_recording

COUNT = 2_000_000
CHUNK = 50_000
LIMIT_BYTES = 12 << 20  # the columns of all events take 26 MB


@pytest.fixture(scope="module")
def columns():
    rng = np.random.default_rng(0)
    return {
        "t": np.sort(rng.integers(0, 2_000_000, COUNT)),
        "x": rng.integers(0, 64, COUNT).astype(np.uint16),
        "y": rng.integers(0, 48, COUNT).astype(np.uint16),
        "p": rng.integers(0, 2, COUNT).astype(np.int8),
    }


def write_h5(path, columns):
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"events/{name}", data=values, chunks=(1 << 14,))


def write_npz(path, columns):
    with open(path, "wb") as file:
        np.savez(file, **columns)


def write_npy(path, columns):
    array = np.empty(COUNT, [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        array[name] = values
    with open(path, "wb") as file:
        np.save(file, array)


@pytest.mark.parametrize("writer", [write_h5, write_npz, write_npy])
def test_peak_of_streaming(tmp_path, columns, writer):
    writer(tmp_path / "a", columns)
    tracemalloc.start()
    try:
        with open_recording(tmp_path / "a", sensor=(64, 48), time_unit="us", chunk_events=CHUNK) as recording:
            assert sum(map(len, recording.chunks())) == COUNT
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < LIMIT_BYTES


@pytest.mark.parametrize("suffix", [".npz"])
def test_peak_of_converting(tmp_path, columns, suffix):
    write_npy(tmp_path / "a", columns)
    options = {"sensor": (64, 48), "time_unit": "us", "chunk_events": CHUNK, "end_us": 1_000_000}
    tracemalloc.start()
    try:
        with open_recording(tmp_path / "a", **options) as recording:
            convert_recording(recording, tmp_path / f"b{suffix}")
            assert recording.n_events == np.searchsorted(columns["t"], 1_000_000)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < LIMIT_BYTES
