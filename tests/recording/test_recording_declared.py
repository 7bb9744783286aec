"""Units and sizes in the spellings in use; the user's word before the file's."""

import doctest

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events

import evqr.recording.declared
from evqr.errors import RecordingError, UsageError
from evqr.recording import open_recording
from evqr.recording.declared import (
    PER_SECOND,
    UNIT_NAMES,
    DeclaredSensor,
    find_sensor,
    parse_size,
    parse_unit,
    split_unit,
)

EVENTS = make_events(200)
SCALE = {"s": 1e-6, "ms": 1e-3, "us": 1, "ns": 1000}


def test_examples_of_the_documentation():
    assert doctest.testmod(evqr.recording.declared).failed == 0


UNIT_DRESSES = ["{}", "[{}]", "({})", " {} ", "{}.", "1 {}", "{} since 1970-01-01", "1e0 {}"]
SIZE_DRESSES = [
    *("{}x{}", "{} x {}", "{}X{}", "{}×{}", "{} × {}", "({}, {})", "[{} {}]", "{},{}", "{};{}", "{}*{}"),  # noqa: RUF001
    *("{} by {}", "{}px x {}px", "{}.0 {}.0", "width={} height={}", "{{'width': {}, 'height': {}}}"),
]
UNITS_IN_NAMES = {
    "t_us": ("t", "us"),
    "t": ("t", None),
    "Time/ms": ("time", "ms"),
    "x [px]": ("x", None),
    "s": ("s", None),
    "pol_s": ("pol", "s"),
    "time in ns": ("time", "ns"),
    "t[µs]": ("t", "us"),
}


@given(
    st.sampled_from(sorted(UNIT_NAMES)),
    st.sampled_from(UNIT_DRESSES),
    st.sampled_from([str.lower, str.upper, str.title]),
)
def test_units_in_any_dress(name, dress, case):
    assert parse_unit(case(dress.format(name))) == UNIT_NAMES[name]
    assert parse_unit(np.array([case(name)], object)) == UNIT_NAMES[name]
    assert parse_unit(dress.format(name).encode()) == UNIT_NAMES[name]


@pytest.mark.parametrize("unit", PER_SECOND)
def test_units_as_numbers_of_seconds(unit):
    scale = 1 / PER_SECOND[unit]
    for value in (scale, np.float32(scale), np.array([scale]), f"{scale:g}", f"{scale:.9f} s", f"{scale:e}"):
        assert parse_unit(value) == unit


@pytest.mark.parametrize(
    "said", ["ticks", "", "minutes", "frames", "0", 0, 7, 0.5, "us ms", None, True, [], "px"]
)
def test_no_unit(said):
    assert parse_unit(said) is None


size = st.integers(1, 5000)


@given(size, size, st.sampled_from(SIZE_DRESSES))
def test_sizes_in_any_dress(width, height, dress):
    text = dress.format(width, height)
    assert parse_size(text) == (width, height)
    assert parse_size(np.array([text.encode()])) == (width, height)
    assert find_sensor({"Sensor_Resolution": text}) == DeclaredSensor((width, height))


@pytest.mark.parametrize(
    "said", ["64", "", "wide", "64x", "x48", "-64x48", "64x48x3", "1.5x2", 64, [64], [1, 2, 3]]
)
def test_no_size(said):
    assert parse_size(said) is None


@pytest.mark.parametrize(
    ("said", "size", "odd"),
    [
        ({"width": 64, "height": 48}, (64, 48), False),
        ({"sensor_width": b"64", "sensor_height": [48]}, (64, 48), False),
        ({"Width": np.float64(64), "HEIGHT": "48"}, (64, 48), False),
        ({"sizeX": 64, "sizeY": 48}, (64, 48), False),
        ({"resolution": [64, 48]}, (64, 48), False),
        ({"resolution": np.array([48, 64])}, (64, 48), True),
        ({"shape": (48, 64)}, (64, 48), False),
        ({"sensor_size": "64x48"}, (64, 48), False),
        ({"sensor": "48x64"}, (48, 64), False),
        ({"geometry": ["64x48"]}, (64, 48), False),
    ],
)
def test_sizes_under_their_names(said, size, odd):
    found = find_sensor(said)
    assert isinstance(found, DeclaredSensor)
    assert (found.size, bool(found.odd)) == (size, odd)


def test_names_that_say_no_size():
    assert find_sensor({"size": 400, "shape": (1, 2, 3), "events": 5, "dtype": "u2"}) is None


@pytest.mark.parametrize(("name", "split"), UNITS_IN_NAMES.items())
def test_units_in_names(name, split):
    assert split_unit(name) == split


def write(path, *, unit=None, sensor=None, scale=1, **attributes):
    with h5py.File(path, "w") as file:
        file["events/t"] = EVENTS.t * scale
        for column in "xy":
            file[f"events/{column}"] = getattr(EVENTS, column)
        file["events/p"] = EVENTS.p > 0
        if unit is not None:
            file["events/t"].attrs["units"] = unit
        if sensor is not None:
            file.attrs["geometry"] = sensor
        file.attrs.update(attributes)


@pytest.mark.parametrize("unit", ["usecs", np.array(["us"], object), b"microseconds", "1e-6 s", "[us]"])
@pytest.mark.parametrize("sensor", ["64 x 48", np.array([b"64x48"]), [64, 48], "(64, 48)", b"64X48"])
def test_hdf5_attributes(tmp_path, unit, sensor):
    write(tmp_path / "a", unit=unit, sensor=sensor)
    with open_recording(tmp_path / "a") as recording:
        assert_same_events(recording.read(), EVENTS)
        assert recording.notes == ()


def test_what_is_unclear_is_asked_for_and_the_answer_is_taken(tmp_path):
    write(tmp_path / "a", unit="ticks", sensor="wide")
    with pytest.raises(
        RecordingError, match=r"'wide' in geometry is no pair of whole numbers: pass sensor=.WxH."
    ):
        open_recording(tmp_path / "a")
    with pytest.raises(
        RecordingError, match=r"units of /events/t is 'ticks', no known unit; pass time_unit=.us"
    ):
        open_recording(tmp_path / "a", sensor=(WIDTH, HEIGHT))
    with open_recording(tmp_path / "a", sensor="64x48", time_unit="us") as recording:
        assert_same_events(recording.read(), EVENTS)
        assert ["was asked for" in note for note in recording.notes] == [True, True]


@pytest.mark.parametrize("unit", PER_SECOND)
def test_npz_units(tmp_path, unit):
    columns = {"t": EVENTS.t * SCALE[unit], "x": EVENTS.x, "y": EVENTS.y, "p": EVENTS.p}
    np.savez(
        tmp_path / "a.npz",
        **columns,
        time_unit=f"{unit}ec" if unit != "s" else "seconds",
        resolution=[64, 48],
    )
    with open_recording(tmp_path / "a.npz") as recording:
        assert_same_events(recording.read(), EVENTS)
        assert recording.time_unit_reason.startswith("time_unit in the file says")


def test_a_sensor_that_is_none_is_misuse():
    with pytest.raises(UsageError, match="sensor '64' is no size"):
        open_recording(EVENTS, sensor="64")
