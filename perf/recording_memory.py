"""Peak memory and speed of streaming a large recording, in a process of its own.

    python perf/recording_memory.py [--format h5|npz|text|dat|evt3] [--gigabytes 1]

Writes a recording of random events at 100 million events a second (what a fast code makes at close range),
streams it once and prints events, seconds and the peak resident memory of the reading process.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np

WIDTH, HEIGHT = 640, 480
BLOCK = 1 << 20
BLOCK_US = BLOCK // 100
Columns = dict[str, np.ndarray]


def blocks(count: int) -> Iterator[Columns]:
    """Blocks of sorted random events."""
    rng = np.random.default_rng(0)
    for i in range(count):
        yield {
            "t": i * BLOCK_US + np.sort(rng.integers(0, BLOCK_US, BLOCK)),
            "x": rng.integers(0, WIDTH, BLOCK).astype(np.uint16),
            "y": rng.integers(0, HEIGHT, BLOCK).astype(np.uint16),
            "p": rng.integers(0, 2, BLOCK).astype(np.int8),
        }


def write_h5(path: Path, count: int) -> None:
    with h5py.File(path, "w") as file:
        for name, dtype in (("t", "i8"), ("x", "u2"), ("y", "u2"), ("p", "i1")):
            file.create_dataset(f"events/{name}", (count * BLOCK,), dtype, chunks=(1 << 16,))
        for i, columns in enumerate(blocks(count)):
            for name, values in columns.items():
                file[f"events/{name}"][i * BLOCK : (i + 1) * BLOCK] = values


def write_npz(path: Path, count: int) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, dtype in (("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "|i1")):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = {"descr": dtype, "fortran_order": False, "shape": (count * BLOCK,)}
                np.lib.format.write_array_header_1_0(member, header)
                for columns in blocks(count):
                    member.write(columns[name].astype(dtype).tobytes())


def write_text(path: Path, count: int) -> None:
    with path.open("w") as file:
        for columns in blocks(count):
            np.savetxt(file, np.stack(list(columns.values()), axis=1), fmt="%d")


def write_dat(path: Path, count: int) -> None:
    with path.open("wb") as file:
        file.write(b"% Version 2\n% Width 640\n% Height 480\n\x0c\x08")
        for columns in blocks(count):
            c = {name: values.astype(np.uint32) for name, values in columns.items()}
            file.write(np.stack([c["t"], c["x"] | c["y"] << 14 | c["p"] << 28], axis=1).tobytes())


def write_evt3(path: Path, count: int) -> None:
    with path.open("wb") as file:
        file.write(b"% evt 3.0\n% geometry 640x480\n% end\n")
        for columns in blocks(count):
            t, x, y, p = (
                values.astype(np.uint16) for values in (columns["t"] & 0xFFF, *list(columns.values())[1:])
            )
            high = (columns["t"] >> 12 & 0xFFF).astype(np.uint16)
            words = np.stack([0x8000 | high, 0x6000 | t, y, 0x2000 | x | p << 11], axis=1)
            file.write(words.astype("<u2").tobytes())


# The writer and the bytes it takes an event.
WRITERS: dict[str, tuple[Callable[[Path, int], None], float]] = {
    "h5": (write_h5, 13),
    "npz": (write_npz, 13),
    "text": (write_text, 18),
    "dat": (write_dat, 8),
    "evt3": (write_evt3, 8),
}


def read(path: str) -> None:
    """Stream the recording and print what it took."""
    from evqr.recording import open_recording

    started = time.perf_counter()
    with open_recording(path, sensor=(WIDTH, HEIGHT)) as recording:
        events = sum(map(len, recording.chunks()))
        seconds = time.perf_counter() - started
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        size = Path(path).stat().st_size / 1e9
        print(
            f"{recording.format}: {size:.2f} GB, {events:,} events in {seconds:.1f} s"
            f" ({events / seconds / 1e6:.1f} Mev/s), peak {peak:.0f} MiB"
        )


def main() -> None:
    """Write, then read in a fresh process."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--format", choices=WRITERS, default="h5")
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--read", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        read(options.read)
        return
    write, bytes_per_event = WRITERS[options.format]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording"
        write(path, max(1, round(options.gigabytes * 1e9 / bytes_per_event / BLOCK)))
        subprocess.run([sys.executable, __file__, "--read", str(path)], check=True)


if __name__ == "__main__":
    main()
