"""Finder patterns and the codes they could belong to, in windows whose motion is known."""

import functools

import numpy as np
import pytest
from scenes import at, corners, middle_us, motion_at, scene, transform, window_of

from evqr.config import FinderConfig
from evqr.events.batch import EventBatch
from evqr.motion import Motion
from evqr.search.finder import find_patterns, in_order
from evqr.search.triples import codes_of_triples, leg_tolerances
from evqr_kernels import match_corners

CONFIG = FinderConfig()


def searched(made, workspace):
    """Peaks and hypotheses along the true motion, the true pose, and the pyramid."""
    truth = made.truth["truth"]
    motion = motion_at(truth, middle_us(made))
    (found,), pyramid = find_patterns(EventBatch.of([window_of(made)]), [motion], CONFIG, workspace=workspace)
    hypotheses = codes_of_triples(found.peaks.table, found.triples, CONFIG)
    return found.peaks, hypotheses, at(truth, "H", middle_us(made)), pyramid


def of_finders(peaks, pose, size, module_px):
    """Index of the strongest peak within a module of each of the three finder patterns."""
    centres = transform(pose, np.array([[3.5, 3.5], [size - 3.5, 3.5], [3.5, size - 3.5]]))
    found = []
    for centre in centres:
        near = np.flatnonzero(np.hypot(*(peaks.position - centre).T) < module_px)
        assert len(near), f"no peak near {centre}"
        found.append(near[np.abs(peaks.response[near]).argmax()])
    return np.array(found)


def fitting(hypotheses, truth, pose, module_px):
    """Which are the true code, to 2.5 modules at the corners: the coarse look does the rest."""
    size = len(truth["modules"])
    return [
        k
        for k in range(len(hypotheses))
        if hypotheses.space(k).version == truth["version"]
        and np.abs(corners(hypotheses.pose[k], size) - corners(pose, size)).max() < 2.5 * module_px
    ]


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0, 80.0])
@pytest.mark.parametrize("preset", ["clean", "fast"])
def test_three_finder_patterns_are_among_the_best_peaks(angle, preset, workspace):
    made = scene(angle=angle, preset=preset)
    peaks, hypotheses, pose, _ = searched(made, workspace)
    best = of_finders(peaks, pose, 25, 5.0)
    assert (best < 8).all()
    assert (peaks.response[best] > 0.5).all()
    # The bank has a filter every 11 degrees, and neighbouring ones respond nearly alike.
    off = (np.rad2deg(peaks.angle[best]) - angle + 45.0) % 90.0 - 45.0
    assert np.abs(off).max() < 12.0
    assert np.abs(np.log(peaks.module_px[best] / 5.0)).max() < 0.25
    right = fitting(hypotheses[:6], made.truth["truth"], pose, 5.0)
    assert any(not hypotheses.inverted[k] for k in right)


def test_pixels_that_lag_are_seen_through(workspace):
    """A little lag is undone before any is known."""
    made = scene(preset="hard", angle=0.0, direction=0.0, speed_px_ms=10.0, module_px=5.0, travel_px=30.0)
    truth, window = made.truth["truth"], window_of(made, 2.5)
    motion, pose = motion_at(truth, middle_us(made)), at(truth, "H", middle_us(made))
    centres = transform(pose, np.array([[3.5, 3.5], [21.5, 3.5], [3.5, 21.5]]))

    def strength(lag_px):
        (found,), _ = find_patterns(
            EventBatch.of([window]), [motion], CONFIG, workspace=workspace, lags_px=[lag_px]
        )
        peaks = found.peaks
        near = np.hypot(*(peaks.position[:, None] - centres).transpose(2, 0, 1)) < 5.0
        return np.where(near, peaks.response[:, None], 0.0).max(axis=0)

    assert strength(None).mean() > strength((0.0, 0.0)).mean() + 0.03
    assert (strength(None) > CONFIG.passes[-1].min_response).all()


def test_an_inverted_code_answers_with_the_other_sign(workspace):
    made = scene(invert=True)
    peaks, hypotheses, pose, _ = searched(made, workspace)
    best = of_finders(peaks, pose, 25, 5.0)
    assert (peaks.response[best] < -0.5).all()
    right = fitting(hypotheses[:6], made.truth["truth"], pose, 5.0)
    assert any(hypotheses.inverted[k] for k in right)


@pytest.mark.parametrize(("version", "module_px"), [(1, 6.0), (2, 5.0), (4, 4.0), (7, 4.0), (10, 3.5)])
def test_the_true_version_and_pose_are_among_the_hypotheses(version, module_px, workspace):
    made = scene(version=version, module_px=module_px, angle=30.0, width=320, height=320)
    _, hypotheses, pose, _ = searched(made, workspace)
    assert fitting(hypotheses, made.truth["truth"], pose, module_px)


@pytest.mark.parametrize("module_px", [3.5, 8.0])
def test_small_and_large_modules(module_px, workspace):
    made = scene(version=1, module_px=module_px)
    _, hypotheses, pose, _ = searched(made, workspace)
    assert fitting(hypotheses, made.truth["truth"], pose, module_px)


def test_results_are_in_order_and_within_their_limits(workspace):
    made = scene()
    motion = motion_at(made.truth["truth"], middle_us(made))
    (found,), pyramid = find_patterns(EventBatch.of([window_of(made)]), [motion], CONFIG, workspace=workspace)
    peaks, strength = found.peaks, np.abs(found.peaks.response)
    assert (np.diff(strength) <= 0).all()
    assert len(strength) <= CONFIG.peaks
    assert (strength >= CONFIG.passes[-1].min_response).all()
    assert strength.max() <= 1.0 + 1e-3
    assert ((peaks.angle >= 0.0) & (peaks.angle < np.pi / 2)).all()
    assert (np.diff(found.triples[:, 0]) <= 1e-9).all()
    corner, along, down = found.triples[:, 1:4].T.astype(int)
    np.testing.assert_allclose(
        found.triples[:, 0], strength[corner] + strength[along] + strength[down], rtol=1e-5
    )
    assert (np.diff([level.cell for level in pyramid.levels]) > 0).all()


def test_pyramid_levels_show_the_same_place(workspace):
    """Centre of mass in px, through each level's own map; of ON events only, so that nothing cancels."""
    made = scene()
    window = window_of(made)
    inside = (np.abs(window.x - 160) < 60) & (np.abs(window.y - 120) < 60)
    motion = motion_at(made.truth["truth"], middle_us(made))
    part = window.keep((window.p > 0) & inside)
    _, pyramid = find_patterns(EventBatch.of([part]), [motion], CONFIG, workspace=workspace)
    whole = workspace.get(pyramid.images.device)[0].astype(np.float64)
    count = len(pyramid.levels)
    modules = np.array([level.cell for level in pyramid.levels])[:, None, None] * np.eye(3)
    places = pyramid.places(np.zeros(count, np.intp), modules, 1.0)
    centre = np.tile(np.eye(3), (count, 1, 1))
    for (top, height, width), of_level in zip(places.image_part.tolist(), centre, strict=True):
        image = whole[top : top + height, :width]
        rows, columns = np.mgrid[:height, :width]
        of_level[:2, 2] = np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()
    np.testing.assert_allclose(places.in_cells(places.in_px(centre)), centre, atol=1e-9)
    centres = places.in_px(centre)[:, :2, 2]
    # The finest level has its strongest cells clipped; half a cell of the coarsest would be 9 px.
    np.testing.assert_allclose(centres, np.broadcast_to(centres[-1], (count, 2)), atol=0.3)


def test_what_is_searched_holds_the_code_and_little_else(workspace):
    """A window with all of its events in a part of a large sensor, whose cells are those of the whole."""
    made = scene(width=640, height=480)
    window = window_of(made)
    inside = (np.abs(window.x - 320) < 90) & (np.abs(window.y - 240) < 90)
    motion = motion_at(made.truth["truth"], middle_us(made))
    _, pyramid = find_patterns(EventBatch.of([window.keep(inside)]), [motion], CONFIG, workspace=workspace)
    (region,) = pyramid.regions
    assert region.height * region.width * region.cell**2 < 0.5 * 640 * 480
    for corner, middle, cells in ((region.x, 320, region.width), (region.y, 240, region.height)):
        assert corner < middle - 90 - 4
        assert corner + cells * region.cell > middle + 90 + 4
        assert (corner + 0.5) / region.cell == pytest.approx(round((corner + 0.5) / region.cell))


# ---- triples, without an image


@functools.cache
def _ideal(version, angle_deg, module_px):
    turn = np.deg2rad(angle_deg)
    u = module_px * np.array([np.cos(turn), np.sin(turn)])
    v = module_px * np.array([-np.sin(turn), np.cos(turn)])
    legs = 10 + 4 * version
    corner = np.array([100.0, 80.0])
    return np.array([corner, corner + legs * u, corner + legs * v]), np.column_stack([u, v])


def matched(workspace, response, position, module_px, angle):
    """Hypotheses of some peaks."""
    table = np.column_stack([response, position, module_px, angle]).astype(np.float32)
    peaks = np.concatenate([table, np.zeros((2, 5), np.float32)])  # with room left
    triples = match_corners(peaks[None], leg_tolerances(CONFIG, 1.0), most=CONFIG.triples_a_corner)
    return codes_of_triples(table, in_order(triples)[0], CONFIG)


@pytest.mark.parametrize("version", [1, 2, 6, 13, 25, 40])
@pytest.mark.parametrize("angle", [0.0, 33.0, 90.0, -140.0])
def test_three_ideal_peaks_make_the_code(version, angle, workspace):
    position, axes = _ideal(version, angle, 4.0)
    response, angles = np.array([0.9, 0.8, 0.7]), np.full(3, np.deg2rad(angle % 90))
    hypotheses = matched(workspace, response, position, np.full(3, 4.0), angles)
    # large versions differ by less than the tolerance of a pattern's size
    (right,) = [k for k in range(len(hypotheses)) if hypotheses.space(k).version == version]
    pose = hypotheses.pose[right]
    np.testing.assert_allclose(pose[:2, :2], axes, atol=1e-5)
    np.testing.assert_allclose(pose @ (3.5, 3.5, 1.0), [*position[0], 1.0], atol=1e-5)
    assert np.linalg.det(pose[:2, :2]) > 0
    assert hypotheses.peaks[right].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    "wrong",
    [
        {"response": np.array([0.9, -0.8, 0.7])},
        {"module_px": np.array([4.0, 9.0, 4.0])},
        {"angle": np.array([0.0, 0.0, np.pi / 4])},
        {"position": np.array([[100.0, 80.0], [172.0, 80.0], [100.0, 200.0]])},
        {"position": np.array([[100.0, 80.0], [172.0, 80.0], [150.0, 130.0]])},
    ],
    ids=["signs", "sizes", "angles", "legs", "corner"],
)
def test_three_peaks_that_do_not_fit_make_none(wrong, workspace):
    ideal = {
        "response": np.array([0.9, 0.8, 0.7]),
        "position": _ideal(2, 0.0, 4.0)[0],
        "module_px": np.full(3, 4.0),
        "angle": np.zeros(3),
    }
    assert len(matched(workspace, **ideal))
    assert not len(matched(workspace, **(ideal | wrong)))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_peaks_make_none(count, workspace):
    position = _ideal(2, 0.0, 4.0)[0][:count]
    assert not len(matched(workspace, np.full(count, 0.9), position, np.full(count, 4.0), np.zeros(count)))


def test_an_empty_window_has_no_peaks(workspace):
    made = scene()
    window = window_of(made)
    empty = window.keep(np.zeros(len(window), bool))
    (found,), _ = find_patterns(
        EventBatch.of([empty]), [Motion(np.array([1000.0, 500.0]))], CONFIG, workspace=workspace
    )
    assert len(found.peaks) == len(found.triples) == 0
    assert not len(codes_of_triples(found.peaks.table, found.triples, CONFIG))
