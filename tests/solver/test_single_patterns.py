"""Symbols with a single finder pattern, found from cold in one window; and what only looks like one."""

import numpy as np
import pytest
from scenes import at, corners, find, noise, scene, window_of

from evqr.events.window import make_window
from evqr.fit.detection import Detection
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.simulate import CodePlacement
from evqr.solver import Solver
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.space import Symbology

TEXTS = {"M1": "40961", "M2": "DEV-55", "M3": "EVQR-07", "M4": "HELLO-EVQR-7"}


@pytest.fixture(scope="module")
def solver():
    return Solver()


def micro(version, angle=20.0, direction=35.0, **options):
    placement = CodePlacement(
        text=TEXTS[version], symbology="microqr", version=version, ec="L", module_px=5.0, angle=angle
    )
    return scene(codes=(placement,), direction=direction, **options)


def found_in(window, solver):
    return find(solver, window, solver.motion_in(window).motion)


def decoded(detection, solver):
    return decode_grid(solver.solve([detection])[0].q, detection.space)


@pytest.mark.parametrize("version", TEXTS)
@pytest.mark.parametrize(("angle", "direction"), [(0.0, 35.0), (110.0, 215.0), (200.0, 300.0), (315.0, 80.0)])
def test_every_size_is_found_in_one_window_however_it_is_turned(version, angle, direction, solver):
    made = micro(version, angle, direction)
    detection = found_in(window_of(made), solver)
    assert isinstance(detection, Detection), str(detection)
    assert (detection.space.symbology, detection.space.version) == (Symbology.MICRO_QR_CODE, version)
    truth = next(iter(made.truth.values()))
    true = corners(at(truth, "H", detection.time_us), detection.space.size)
    assert np.abs(detection.target.outline() - true).max() < 0.5 * 5.0
    outcome = decoded(detection, solver)
    if isinstance(outcome, Decoded):
        assert outcome.text == TEXTS[version]
    else:  # M1 bears no wrong module: more windows tell
        assert (version, outcome.reason) == ("M1", Reason.POSSIBLY_CHANCE)


@pytest.mark.parametrize("options", [{"version": 2}, {"version": 4, "module_px": 4.0}, {"preset": "fast"}])
def test_a_qr_code_stays_one(options, solver):
    detection = found_in(window_of(scene(**options)), solver)
    assert isinstance(detection, Detection)
    assert detection.space.symbology is Symbology.QR_CODE


@pytest.mark.parametrize("shown", ["one", "two"])
@pytest.mark.parametrize("angle", [0.0, 33.0])
def test_a_qr_code_partly_in_view_is_read_as_nothing(shown, angle, solver):
    """Its finder patterns are as a Micro QR code's; what is beside them is not."""
    made = scene(angle=angle)
    window = window_of(made)
    detection = found_in(window, solver)
    x, y = detection.motion.at(window.middle_us).transport(window.x, window.y, window.t)
    u, v, z = np.linalg.inv(detection.pose) @ (x, y, np.ones_like(x))
    part = (u / z < 17.0) & (v / z < 17.0) if shown == "one" else v / z < 14.0
    partly = found_in(window.keep(part), solver)
    if isinstance(partly, Detection):
        assert not isinstance(decoded(partly, solver), Decoded)


def test_noise_is_nothing(solver):
    window = make_window(noise(20_000, 2_000), 0, 2_000)
    found = find(solver, window, Motion(np.array([2_000.0, 1_000.0]), 1_000))
    assert not isinstance(found, Detection)
    assert found.reason in (Reason.NO_FINDER_PATTERNS, Reason.DISAGREES)


def test_another_size_agrees_less(solver):
    """A neighbouring size, stretched to the place, agrees with the finder pattern as well."""
    window = window_of(micro("M2", 45.0, 170.0))
    detection = found_in(window, solver)
    assert detection.space.version == "M2"
    assert detection.score > solver.config.align.good_score


@pytest.mark.parametrize("tilt", [10.0, 25.0])
def test_a_tilted_one_is_found(tilt, solver):
    """Its perspective is left out: one finder pattern cannot hold it, and a small symbol has little."""
    detection = found_in(window_of(micro("M4", tilt=tilt)), solver)
    assert detection.space.version == "M4"
    assert isinstance(decoded(detection, solver), Decoded)
