"""Files that users brought and evqr once refused or misread: what the README beside each says is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evqr.errors import RecordingError, StreamChoice
from evqr.recording import open_recording

FOLDER = Path(__file__).parents[3] / "shared" / "cases"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="no folder ../shared/cases beside the repository")

SENSOR = {"sensor": (64, 48)}

# file: options, events, unit
READ = {
    "advice_that_does_not_help/geometry_as_array.h5": ({}, 400, "us"),
    "advice_that_does_not_help/geometry_spaced.raw": ({}, 400, "us"),
    "advice_that_does_not_help/npz_says_ms.npz": ({}, 400, "ms"),
    "advice_that_does_not_help/unit_usecs.h5": ({}, 400, "us"),
    "advice_that_does_not_help/units_as_array.h5": ({}, 400, "us"),
    "aedat4_two_event_streams/events_and_filtered.aedat4": ({"stream": "events"}, 400, "us"),
    "aedat4_two_event_streams/stereo.aedat4": ({"stream": "L/events"}, 400, "us"),
    "dat_that_is_no_cd/version1.dat": ({}, 400, "us"),
    "evt2_data_starts_with_percent/good_64us_later.raw": ({}, 500, "us"),
    "evt2_data_starts_with_percent/refused.raw": ({}, 500, "us"),
    "evt2_data_starts_with_percent/silent_loss.raw": ({}, 500, "us"),
    "hdf5_layouts_refused/m3ed_two_cameras.h5": ({"stream": "left"}, 400, "us"),
    "hdf5_layouts_refused/matlab_columns.h5": (SENSOR, 400, "us"),
    "hdf5_layouts_refused/mvsec.h5": (SENSOR, 400, "s"),
    "hdf5_layouts_refused/v2e.h5": (SENSOR, 400, "us"),
    "hdf5_layouts_refused/virtual.h5": (SENSOR, 400, "us"),
    "ros_bags_refused/driver_restarted.bag": ({}, 400, "ns"),
    "ros_bags_refused/prophesee_event_msgs.bag": ({}, 400, "ns"),
    "ros_bags_refused/stereo.bag": ({"stream": "/davis/left/events"}, 400, "ns"),
    "text_first_time_whole/zero.txt": ({}, 400, "s"),
    "text_first_time_whole/zero_point_zero.txt": ({}, 400, "s"),
    "text_metavision_csv/decoder.csv": ({}, 400, "us"),
    "text_metavision_csv/file_to_csv.csv": (SENSOR, 400, "us"),
}

REFUSED = {
    "aedat4_two_event_streams/events_and_filtered.aedat4": (StreamChoice, r"streams \(events, filtered\)"),
    "aedat4_two_event_streams/stereo.aedat4": (StreamChoice, r"streams \(L/events, R/events\)"),
    "aedat4_two_event_streams/frames_only.aedat4": (RecordingError, r"no event stream .* \(it has: frame\)"),
    "dat_that_is_no_cd/ext_trigger.dat": (RecordingError, r"no event stream .*type 14 \(external triggers\)"),
    "hdf5_layouts_refused/m3ed_two_cameras.h5": (StreamChoice, r"groups \(prophesee/left, prophesee/right\)"),
    "raw_evt21_genx320/evt21.raw": (
        RecordingError,
        r"the recording is empty: Prophesee EVT2\.1 with 0 events",
    ),
    "ros_bags_refused/stereo.bag": (StreamChoice, r"topics \(/davis/left/events, /davis/right/events\)"),
}


@pytest.mark.parametrize("name", READ)
def test_read(name):
    options, count, unit = READ[name]
    if not (FOLDER / name).exists():
        pytest.skip("not among the cases at hand")
    pytest.importorskip("eventcv")
    with open_recording(FOLDER / name, **options) as recording:
        events = recording.read()
        assert (len(events), recording.time_unit) == (count, unit)
        assert recording.counts.left_out == 0
        assert (recording.width, recording.height) == ((640, 480) if "evt2_" in name else (64, 48))
        assert events.t[-1] - events.t[0] > 1_000
        assert len(np.unique(events.p)) == 2


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    kind, message = REFUSED[name]
    if not (FOLDER / name).exists():
        pytest.skip("not among the cases at hand")
    with pytest.raises(kind, match=message):
        open_recording(FOLDER / name)
