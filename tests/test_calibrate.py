"""Profiles of sensors: found out from a recording, kept in checked files, taken by commands."""

import json

import numpy as np
import pytest
from scenes import scene
from test_cli import compiled_kernels, run

from evqr import ReadConfig, read_windows
from evqr import calibrate as calibrating
from evqr.errors import UsageError
from evqr.sensor_profile import FORMAT, SensorProfile, read_profile
from evqr.simulate import SensorConfig

__all__ = ["compiled_kernels"]  # a fixture

TAU_US = 1300.0


@pytest.fixture(scope="module")
def slow():
    """Pixels that lag by a module of 5 px."""
    sensor = SensorConfig(tau_us=TAU_US, tau_follows_light=False, threshold_spread=0.03)
    return scene(ec="H", preset=sensor, travel_px=10.0).events


def test_what_is_found_out_reads(slow, monkeypatch):
    monkeypatch.setattr(calibrating, "TAU_ON_US", (0.0, TAU_US, 20.0 * TAU_US))
    told = []
    profile = calibrating.calibrate(
        slow, config=ReadConfig(max_windows=2), progress=lambda *done: told.append(done)
    )
    assert profile is not None
    assert profile.tau_on_us == TAU_US
    assert told == [(k + 1, 5) for k in range(5)]
    assert profile.bandwidth_hz[0] == pytest.approx(1e6 / (2.0 * np.pi * TAU_US))
    read = read_windows(slow, config=ReadConfig(max_windows=2, lag_us=profile.lag_us))
    assert [window.text for window in read] == ["EVQR-07"] * 2


def test_a_profile_is_kept_in_a_file(tmp_path):
    profile = SensorProfile(tau_on_us=5300.0, tau_off_us=10600.0)
    profile.write(tmp_path / "sensor.json")
    assert read_profile(tmp_path / "sensor.json") == profile
    with pytest.raises(UsageError, match="cannot be written"):
        profile.write(tmp_path / "none" / "sensor.json")


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (None, "cannot be read"),
        ("{", "is no sensor profile"),
        ("[]", "is no sensor profile"),
        ({"format": FORMAT, "tau_on_us": 1.0}, "tau_off_us is None, but must be 0 to 100000 us"),
        ({"format": FORMAT, "tau_on_us": -1.0, "tau_off_us": 1.0}, "tau_on_us is -1.0, but must be"),
        ({"format": FORMAT, "tau_on_us": True, "tau_off_us": 1.0}, "tau_on_us is True, but must be"),
        ({"format": FORMAT, "tau_on_us": 1.0, "tau_off_us": 1.0, "gain": 1}, "gain is unknown"),
    ],
)
def test_what_is_no_profile_is_told_in_a_line(said, message, tmp_path, capsys):
    path = tmp_path / "sensor.json"
    if said is not None:
        path.write_text(said if isinstance(said, str) else json.dumps(said))
    with pytest.raises(UsageError, match=message):
        read_profile(path)
    status, _, (line,) = run(capsys, "read", tmp_path / "a.h5", "--sensor-profile", path)
    assert status == 2
    assert message in line


def test_the_command_writes_what_was_found_out(slow, tmp_path, capsys, monkeypatch):
    out, found = tmp_path / "sensor.json", iter([SensorProfile(tau_on_us=300.0, tau_off_us=600.0), None])
    monkeypatch.setattr(calibrating, "calibrate", lambda *given, **options: next(found))
    status, (line,), _ = run(capsys, "calibrate", tmp_path / "slow.h5", out)
    assert status == 0
    assert "ON events lag by 300 us, OFF events by 600 us" in line
    status, _, (line,) = run(capsys, "calibrate", tmp_path / "slow.h5", out)
    assert (status, "is there already" in line) == (2, True)
    status, _, (line,) = run(capsys, "calibrate", tmp_path / "slow.h5", out, "--force")
    assert (status, "no window is read" in line) == (1, True)
    both = run(capsys, "read", tmp_path / "slow.h5", "--sensor-profile", out, "--lag-us", "1,2")
    assert (both[0], "leave out one" in both[2][0]) == (2, True)
