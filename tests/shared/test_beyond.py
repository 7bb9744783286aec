"""Recordings beyond plain QR codes: what is printed is read where it can be, and nothing else ever."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import evqr
from evqr.results import ReadStatus

FOLDER = Path(__file__).parents[3] / "shared" / "recordings-beyond"
RECORDINGS = sorted(FOLDER.glob("*.h5"))

#: Symbologies and codes that cannot be read yet.
NOT_YET = {"aztec", "data_matrix_rectangle", "data_matrix_square", "rmqr", "small_2.2px", "two_finders"}

pytestmark = pytest.mark.skipif(not RECORDINGS, reason="no folder ../shared/recordings-beyond")


def printed_in(path):
    with h5py.File(path) as file:
        truths = [file[name] for name in file if name.startswith("truth")]
        return {str(truth.attrs["payload"]) for truth in truths}


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_nothing_is_read_that_is_not_printed(path):
    result = evqr.read_codes(path)
    texts = {reading.text for reading in result.readings}
    assert texts <= printed_in(path)
    if path.stem not in NOT_YET:
        assert texts == printed_in(path)
    assert len(result.readings) == len(texts)


def test_a_micro_qr_code_is_read_whole():
    path = FOLDER / "micro_qr.h5"
    with h5py.File(path) as file:
        modules = file["truth"]["modules"][:]
    result = evqr.read_codes(path)
    assert result.status is ReadStatus.READ, result.reason
    (reading,) = result.readings
    assert (reading.symbology, reading.version) == ("MicroQRCode", "M2")
    np.testing.assert_array_equal(reading.modules, 1 - 2 * modules.astype(np.int8))
    with h5py.File(path) as file:
        last_us = file["events"]["t"][-1]
    whole = [window for window in evqr.read_windows(path) if window.t_end_us <= last_us]
    assert len(whole) >= 9 and all(window.status is ReadStatus.READ for window in whole)
