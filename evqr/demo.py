"""The recording that comes with the package: simulated with the preset ``hard`` (CONTRIBUTING says how)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@contextmanager
def demo_recording() -> Iterator[Path]:
    """Give the recording as a file, also where the package is not unpacked."""
    with resources.as_file(resources.files("evqr") / "data" / "demo.h5") as path:
        yield path


def demo_truth(path: Path) -> NDArray[np.int8]:
    """Return the true modules of a simulated recording: (r, r), -1 dark, +1 light."""
    import h5py

    with h5py.File(path) as file:
        dark = np.asarray(file["truth/modules"]) > 0
    return np.where(dark, -1, 1).astype(np.int8)
