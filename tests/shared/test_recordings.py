"""Recordings of other simulators are read; nothing is read where there is no code, as in the real ones."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scenes import at, true_corners

import evqr
from evqr.results import ReadStatus

SHARED = Path(__file__).parents[3] / "shared"
SIMULATED = sorted((SHARED / "recordings").glob("*.h5"))
REAL = sorted(
    path
    for path in (SHARED / "real-recordings").rglob("*")
    if path.suffix in {".aedat4", ".bag", ".dat", ".hdf5", ".raw"}
)

#: The one file that does not tell: 240x180 by its README, with an event in row 181.
SENSOR = {"event_vision_library_event.hdf5": (240, 182)}

pytestmark = pytest.mark.skipif(not SIMULATED or not REAL, reason="no folder ../shared beside the repository")


@pytest.mark.parametrize("path", [p for p in SIMULATED if p.stem != "no_code"], ids=lambda path: path.stem)
def test_reads_what_is_printed(path):
    with h5py.File(path) as file:
        truth = file["truth"]
        printed = {name: truth.attrs[name] for name in ("payload", "version", "ec_level", "mask")}
        truth = {name: truth[name][:] for name in ("modules", "t_us", "H", "velocity")}
    result = evqr.read_codes(path)
    assert result.status is ReadStatus.READ, result.reason
    (reading,) = result.readings
    assert reading.text == printed["payload"]
    assert (reading.version, reading.ec_level, reading.mask) == tuple(
        printed[name] for name in ("version", "ec_level", "mask")
    )
    np.testing.assert_array_equal(reading.modules, 1 - 2 * truth["modules"].astype(np.int8))
    corners = true_corners(truth, reading.t_read_us)
    module_px = np.hypot(*(corners[1] - corners[0])) / len(truth["modules"])
    # one noisy window of pixels that lag by up to a module: no more than it takes to read
    assert np.abs(reading.corners_px - corners).max() < 0.9 * module_px
    velocity = at(truth, "velocity", reading.t_read_us)
    assert np.hypot(*(reading.motion_px_per_s - velocity)) < 0.2 * np.hypot(*velocity)


def test_nothing_is_read_where_there_is_no_code():
    result = evqr.read_codes(SHARED / "recordings" / "no_code.h5")
    assert result.status is ReadStatus.NO_READ
    assert result.readings == ()
    assert result.reason


@pytest.mark.parametrize("path", REAL, ids=lambda path: path.name)
def test_nothing_is_read_in_scenes_without_codes(path):
    if path.suffix not in {".hdf5"}:
        pytest.importorskip("eventcv", reason='needs pip install "evqr[formats]"')
    result = evqr.read_codes(path, sensor=SENSOR.get(path.name))
    assert result.status is ReadStatus.NO_READ
    assert result.readings == ()
    assert result.seen["events"] > 0
    assert result.reason
