"""Scenes: the truth fits the events, options do what they say, and what cannot be is refused."""

from itertools import pairwise

import numpy as np
import pytest
import segno

from evqr.errors import UsageError
from evqr.simulate import PRESETS, CodePlacement, SceneConfig, SensorConfig, shuffled, simulate
from evqr.simulate.geometry import code_corners, plan_motion, transform
from evqr.simulate.printed import make_symbol
from evqr.simulate.texture import gaussian_blur
from evqr.symbol import micro_qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.symbols import space_of
from evqr.symbology import Symbology

#: A sensor that hardly says anything, for tests of the truth alone.
QUIET = SensorConfig(threshold=2.0)
SMALL = {"text": "EVQR-07", "module_px": 4.0, "width": 240, "height": 200, "duration_us": 4000}


def pose_at(truth, t_us):
    """The truth's homography at one of its times."""
    return truth["H"][np.searchsorted(truth["t_us"], t_us)]


def compensated(events, velocity, t_from, t_to):
    """Sum of polarities where each event's edge is at the middle of the window, blurred a little."""
    window = events.between(t_from, t_to)
    ahead = (0.5 * (t_from + t_to) - window.t) * 1e-6
    x = np.rint(window.x + velocity[0] * ahead).astype(int)
    y = np.rint(window.y + velocity[1] * ahead).astype(int)
    inside = (x >= 0) & (x < events.width) & (y >= 0) & (y < events.height)
    image = np.zeros((events.height, events.width), np.float32)
    np.add.at(image, (y[inside], x[inside]), window.p[inside])
    return gaussian_blur(image, (0.7, 0.7))


def expected(truth, pose, velocity, shape, *, shift=(0.0, 0.0)):
    """Change of the printed light along the motion, drawn from the truth alone, and where the label is."""
    n = len(truth["modules"])
    rows, columns = np.mgrid[0 : shape[0] * 3, 0 : shape[1] * 3]
    px = np.stack([(columns + 0.5) / 3 - 0.5 - shift[0], (rows + 0.5) / 3 - 0.5 - shift[1]], axis=-1)
    u, v = np.moveaxis(transform(np.linalg.inv(pose), px), -1, 0)
    light = np.pad(1.0 - 2.0 * truth["modules"], 4, constant_values=1.0)
    cells = [np.clip(np.floor(c).astype(int) + 4, 0, n + 7) for c in (v, u)]
    fine = light[cells[0], cells[1]].reshape(shape[0], 3, shape[1], 3).mean(axis=(1, 3))
    fine = gaussian_blur(fine.astype(np.float32), (0.9, 0.9))
    inside = ((u > -2) & (u < n + 2) & (v > -2) & (v < n + 2))[1::3, 1::3]
    slope_y, slope_x = np.gradient(fine)
    return -(velocity[0] * slope_x + velocity[1] * slope_y) * inside, inside


def correlation(simulation, truth, *, shift=(0.0, 0.0)):
    """How well a window of 2 px of travel in the middle of the recording fits a truth's print."""
    middle = int(truth["t_us"][len(truth["t_us"]) // 2])
    half = 1000.0 / simulation.scene.speed_px_ms
    velocity = truth["velocity"][len(truth["t_us"]) // 2]
    image = compensated(simulation.events, velocity, middle - half, middle + half)
    drawn, inside = expected(truth, pose_at(truth, middle), velocity, image.shape, shift=shift)
    return np.corrcoef(image[inside], drawn[inside])[0, 1]


@pytest.mark.parametrize(
    "options",
    [
        {"angle": 0.0},
        {"angle": 31.0, "direction": 180.0},
        {"angle": -110.0, "direction": 63.0},
        {"tilt": 20.0, "direction": 120.0},
        {"speed_px_ms": 9.0, "duration_us": 2000, "start": (112.0, 97.0)},
    ],
    ids=lambda options: "-".join(options),
)
def test_events_lie_where_the_truth_says(options):
    made = simulate(**{**SMALL, **options})
    truth = made.truth["truth"]
    assert correlation(made, truth) > 0.85
    assert correlation(made, truth, shift=(1.5, 1.5)) < correlation(made, truth) - 0.15


def test_an_inverted_print_flips_the_polarity_and_keeps_the_symbol():
    made = simulate(**SMALL, invert=True)
    assert correlation(made, made.truth["truth"]) < -0.85
    np.testing.assert_array_equal(made.truth["truth"]["modules"], simulate(**SMALL).truth["truth"]["modules"])


def test_the_truth_has_the_layout_of_recordings():
    made = simulate(**SMALL, version=2, ec="Q", mask=5, speed_px_ms=3.0, direction=90.0)
    truth = made.truth["truth"]
    assert list(made.truth) == ["truth"]
    assert (truth["payload"], truth["version"], truth["ec_level"], truth["mask"]) == ("EVQR-07", 2, "Q", 5)
    code = segno.make("EVQR-07", version=2, error="q", mask=5, boost_error=False, micro=False)
    np.testing.assert_array_equal(truth["modules"], np.array(code.matrix))
    assert truth["modules"].dtype == np.uint8
    k = len(truth["t_us"])
    assert truth["t_us"].dtype == np.int64 and truth["t_us"][0] == 0 and truth["t_us"][-1] == 4000
    assert truth["H"].shape == (k, 3, 3) and truth["in_view"].shape == (k,) and truth["in_view"].dtype == bool
    np.testing.assert_allclose(truth["velocity"], np.tile([0.0, 3000.0], (k, 1)), atol=1e-3)
    # The truth's own poses move with its velocity, and half of the travel centres the code.
    centre = transform(truth["H"], np.full((1, 2), 12.5))
    np.testing.assert_allclose(centre[-1] - centre[0], [0.0, 3.0 * 4.0], atol=1e-6)
    np.testing.assert_allclose(centre[k // 2], [119.5, 99.5], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "version", "level", "size"),
    [
        ({"text": "12345", "version": "M1"}, "M1", "", 11),
        ({"text": "DEV-55", "ec": "L"}, "M2", "L", 13),
        ({"text": "DEV-55", "version": "M4", "ec": "Q", "mask": 3}, "M4", "Q", 17),
    ],
)
def test_micro_qr_codes_are_printed_too(options, version, level, size):
    made = simulate(**{**SMALL, **options}, symbology="MICROQR", tilt=10.0)
    truth = made.truth["truth"]
    assert (truth["symbology"], truth["version"], truth["ec_level"]) == ("MicroQRCode", version, level)
    assert (truth["rows"], truth["cols"], truth["modules"].shape) == (size, size, (size, size))
    assert truth["mask"] == options.get("mask", truth["mask"])
    decoded = decode_grid(1.0 - 2.0 * truth["modules"], micro_qr.space(version))
    assert isinstance(decoded, Decoded) and decoded.text == options["text"]
    # the quiet zone of two modules ends where the label does
    corners = code_corners(make_symbol(made.scene.codes[0]), margin=2.0)
    np.testing.assert_array_equal(corners[[0, 2]], [[-2.0, -2.0], [size + 2.0, size + 2.0]])
    assert correlation(made, truth) > 0.8


@pytest.mark.parametrize(
    ("options", "symbology", "version", "level"),
    [
        ({"symbology": "rmqr", "ec": "H"}, Symbology.RMQR_CODE, "R13x27", "H"),
        ({"symbology": "rmqr", "version": "R7x43"}, Symbology.RMQR_CODE, "R7x43", "M"),
        ({"symbology": "datamatrix"}, Symbology.DATA_MATRIX, "14x14", ""),
        ({"symbology": "datamatrix", "version": "8x48"}, Symbology.DATA_MATRIX, "8x48", ""),
        ({"symbology": "aztec"}, Symbology.AZTEC, "C1", ""),
        ({"symbology": "aztec", "version": "F1"}, Symbology.AZTEC, "F1", ""),
    ],
)
def test_symbols_of_other_kinds_are_printed_too(options, symbology, version, level):
    made = simulate(**{**SMALL, **options})
    truth = made.truth["truth"]
    assert (truth["symbology"], truth["version"], truth["mask"]) == (symbology.value, version, -1)
    assert truth["ec_level"] == level
    space = space_of(symbology, version)
    assert (truth["rows"], truth["cols"]) == truth["modules"].shape == space.shape
    decoded = decode_grid(1.0 - 2.0 * truth["modules"], space)
    assert isinstance(decoded, Decoded) and decoded.text == "EVQR-07"
    assert correlation(made, truth) > 0.8


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"symbology": "Code39"}, "symbology must be one of QRCode"),
        ({"symbology": "aztec", "version": "M2"}, "version is 'M2', but must be C1 to F32"),
        ({"symbology": "microqr", "version": 2}, "version is 2, but must be M1 to M4"),
        ({"version": "M2"}, "version is 'M2', but must be 1 to 40"),
        ({"symbology": "microqr", "mask": 4}, "mask is 4, but must be 0 to 3"),
        ({"symbology": "microqr", "version": "M2", "ec": "Q", "text": "1"}, "not fit version M2 at level Q"),
        ({"symbology": "microqr", "ec": "H"}, "MicroQRCode cannot say 'EVQR-07': Error correction"),
        ({"symbology": "microqr", "version": "M1", "text": "A"}, "does not fit version M1"),
        ({"symbology": "microqr", "text": "A" * 40}, "does not fit any version at level M"),
        ({"symbology": "rmqr", "text": "A" * 40, "version": "R7x43"}, "not fit version R7x43 at level M"),
        ({"symbology": "rmqr", "ec": "L"}, "RMQRCode cannot say 'EVQR-07': Error 576"),
        (
            {"symbology": "rmqr", "mask": 0},
            "mask is 0, but must be left out: RMQRCode has none to",
        ),
        ({"symbology": "rmqr", "charset": "utf-8"}, "charset is 'utf-8', but must be left out for RMQRCode"),
    ],
)
def test_symbols_that_cannot_be_printed(options, message):
    with pytest.raises(UsageError, match=message):
        simulate(**{**SMALL, **options})


def test_in_view_follows_the_corners():
    passing = {"duration_us": 20_000, "start": (-20.0, 99.5), "speed_px_ms": 16.0, "preset": QUIET}
    made = simulate(**{**SMALL, **passing})
    truth = made.truth["truth"]
    corners = transform(truth["H"][:, None], code_corners(make_symbol(made.scene.codes[0])))
    inside = ((corners > -0.5) & (corners < [239.5, 199.5])).all(axis=(1, 2))
    np.testing.assert_array_equal(truth["in_view"], inside)
    assert 0 < inside.sum() < len(inside)
    assert not truth["in_view"][0] and not truth["in_view"][-1]


def test_codes_side_by_side_are_both_there():
    codes = [
        CodePlacement(text="left", module_px=3.5, angle=20.0, offset_px=(0.0, -65.0)),
        CodePlacement(text="right", module_px=3.5, angle=75.0, offset_px=(0.0, 65.0)),
    ]
    made = simulate(codes=codes, width=240, height=260, duration_us=3000)
    assert [t["payload"] for t in made.truth.values()] == ["left", "right"]
    assert list(made.truth) == ["truth", "truth2"]
    for truth in made.truth.values():
        assert correlation(made, truth) > 0.85


def test_codes_after_one_another_pass_completely():
    ahead = CodePlacement(text="1st", module_px=2.0, offset_px=(50.0, 0.0))
    behind = CodePlacement(text="2nd", module_px=2.0, offset_px=(-50.0, 0.0))
    made = simulate(codes=[ahead, behind], width=120, height=90, speed_px_ms=20.0, preset=QUIET)
    for truth in made.truth.values():
        assert truth["in_view"].any() and not truth["in_view"][0] and not truth["in_view"][-1]
    first, second = (t["in_view"].nonzero()[0].mean() for t in made.truth.values())
    assert first < second


def test_several_texts_are_printed_one_behind_the_other():
    made = simulate(["first to pass", "2", "3"], angle=20.0, direction=70.0, module_px=2.5, preset=QUIET)
    assert [t["payload"] for t in made.truth.values()] == ["first to pass", "2", "3"]
    heading = np.array([np.cos(np.deg2rad(70.0)), np.sin(np.deg2rad(70.0))])
    along = [
        (transform(pose_at(truth, 0), code_corners(make_symbol(placement), margin=4.0)) @ heading)
        for truth, placement in zip(made.truth.values(), made.scene.codes, strict=True)
    ]
    for ahead, behind in pairwise(along):
        assert ahead.min() > behind.max()


def test_a_scene_without_a_code_has_as_many_events_and_no_truth():
    made = simulate(code=False, duration_us=3000)
    assert made.truth == {}
    assert len(made.events) > 50_000


def test_the_same_seed_gives_the_same_events_and_another_seed_others():
    first, again, other = (simulate(**SMALL, preset="hard", seed=s).events for s in (3, 3, 4))
    for name in "txyp":
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert len(first) != len(other)


@pytest.mark.parametrize("preset", list(PRESETS))
def test_every_preset_gives_a_valid_recording(preset):
    events = simulate(**SMALL, preset=preset).events
    assert (np.diff(events.t) >= 0).all() and events.t[0] >= 0 and events.t[-1] < SMALL["duration_us"]
    assert events.x.max() < 240 and events.y.max() < 200
    assert set(np.unique(events.p)) == {-1, 1}
    assert 0.35 < (events.p > 0).mean() < 0.65


def test_presets_get_harder():
    # At the same speed: fewer events, and fewer of them where the truth has edges.
    made = [simulate(**SMALL, preset=p, speed_px_ms=6.0) for p in ("clean", "slow", "fast", "hard")]
    counts = [len(m.events) for m in made]
    fits = [correlation(m, m.truth["truth"]) for m in made]
    assert counts == sorted(counts, reverse=True)
    assert fits == sorted(fits, reverse=True)
    assert fits[-1] < 0.5


def test_a_shuffled_recording_keeps_each_pixels_series_and_nothing_else():
    made = simulate(**SMALL, preset="fast")
    mixed = shuffled(made.events, seed=1)
    np.testing.assert_array_equal(mixed.t, made.events.t)
    np.testing.assert_array_equal(mixed.p, made.events.p)

    def counts(events):
        return np.bincount(events.y.astype(int) * events.width + events.x, minlength=240 * 200)

    np.testing.assert_array_equal(np.sort(counts(mixed)), np.sort(counts(made.events)))
    truth = made.truth["truth"]
    middle = int(truth["t_us"][-1]) // 2
    image = compensated(mixed, truth["velocity"][0], middle - 250, middle + 250)
    drawn, inside = expected(truth, pose_at(truth, middle), truth["velocity"][0], image.shape)
    assert abs(np.corrcoef(image[inside], drawn[inside])[0, 1]) < 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"text": "x" * 40, "version": 1}, "does not fit version 1"),
        ({"text": ""}, "text is ''"),
        ({"version": 41}, "version is 41"),
        ({"ec": "X"}, "ec is 'X'"),
        ({"mask": 8}, "mask is 8"),
        ({"module_px": 0.5}, "module_px is 0.5"),
        ({"version": 10, "module_px": 9.0}, "take module_px below"),
        ({"preset": "dark"}, "unknown preset 'dark'"),
        ({"speed_px_ms": 0.0}, "speed_px_ms is 0.0"),
        ({"duration_us": 0}, "duration_us is 0"),
        ({"tilt": 70.0}, "tilt is 70.0"),
        ({"tilt": 59.0, "width": 2000, "height": 2000}, "shows the horizon"),
        ({"width": 4}, "width is 4"),
        ({"seed": -1}, "seed is -1"),
        ({"angle": float("nan")}, "angle is nan"),
        ({"codes": [CodePlacement(text="a"), CodePlacement(text="b", offset_px=(60.0, 0.0))]}, "overlaps"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(options, message):
    with pytest.raises(UsageError, match=message) as caught:
        simulate(**options)
    assert "\n" not in str(caught.value)


def test_a_sensor_with_impossible_values_is_refused():
    with pytest.raises(UsageError, match=r"drop_rate is 1\.0"):
        SensorConfig(drop_rate=1.0)
    with pytest.raises(UsageError, match="tau_us is nan"):
        SensorConfig(tau_us=float("nan"))


def test_a_tilted_plane_keeps_its_scale_at_the_centre_and_loses_it_with_depth():
    placement = CodePlacement(text="tilted", module_px=4.0, angle=35.0)
    scene = SceneConfig(codes=(placement,), tilt=30.0, speed_px_ms=1.0, duration_us=2)
    symbol = make_symbol(placement)
    truth = simulate(codes=[placement], tilt=30.0, speed_px_ms=1.0, duration_us=2).truth["truth"]
    corners = transform(truth["H"][0], code_corners(symbol)[[0, 1, 2, 3, 0]])
    edges = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    size = symbol.space.columns * placement.module_px
    # The axis lies along the rows: these keep their length on average, and the columns shrink by cos 30.
    assert edges[[0, 2]].mean() == pytest.approx(size, rel=0.01)
    assert edges[[1, 3]].mean() == pytest.approx(size * np.cos(np.pi / 6), rel=0.01)
    assert abs(edges[0] - edges[2]) > 0.02 * size
    assert plan_motion(scene, [symbol]).duration_us == 2
