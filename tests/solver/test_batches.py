"""Windows side by side: what comes out of each is what comes out of it alone."""

from dataclasses import replace

import numpy as np
import pytest
from backends import BACKENDS
from scenes import at, corners, middle_us, motion_at, moved, noise, scene, window_of

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.events.array import EventArray
from evqr.events.batch import EventBatch
from evqr.events.window import make_window
from evqr.fit.detection import NO_LAG, Detection, NotFound, Target
from evqr.fit.measure import measure
from evqr.fit.modules import CodeEstimate, NormalEquations
from evqr.fit.refine import complete, refine
from evqr.fit.targets import Targets
from evqr.motion import Motion
from evqr.simulate import CodePlacement
from evqr.solver import Solver
from evqr.symbol import micro_qr, qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded

CONFIG = ReadConfig()
SEVERAL = [("numpy", 16), ("warp", 16), ("warp", 128)]


def micro(version, **options):
    placement = CodePlacement(
        text="EVQR-07", symbology="microqr", version=version, ec="L", module_px=5.0, angle=20.0
    )
    return scene(codes=(placement,), **options)


CODES = {
    "qr 2": (qr.space(2), lambda: scene()),
    "qr 2, back": (qr.space(2), lambda: scene(direction=215.0, angle=110.0)),
    "qr 1, inverted": (qr.space(1), lambda: scene(version=1, invert=True)),
    "qr 4, tilted": (qr.space(4), lambda: scene(version=4, module_px=4.0, tilt=10.0)),
    "qr 2, fast": (qr.space(2), lambda: scene(preset="fast", speed_px_ms=8.0)),
    "qr 2, wide": (qr.space(2), lambda: scene(width=400, height=200, module_px=3.5)),
    "micro qr M3": (micro_qr.space("M3"), lambda: micro("M3")),
    "micro qr M4": (micro_qr.space("M4"), lambda: micro("M4", direction=80.0)),
}
"""Codes of several kinds and sizes, motions and sensors."""


@pytest.fixture(scope="module")
def windows():
    """Windows, and what is looked for in each: codes a little off, and those that are not there."""
    made = [(space, make()) for space, make in CODES.values()]
    found = []
    for space, simulation in made:
        truth = next(iter(simulation.truth.values()))
        time = middle_us(simulation)
        pose = moved(at(truth, "H", time), space.columns, shift=(0.25, -0.2))
        motion = motion_at(truth, time)
        found.append((window_of(simulation), Target(space, pose, motion, (30.0, 50.0))))
    nothing = EventArray(*(np.zeros(0, d) for d in (np.int64, np.uint16, np.uint16, np.int8)), 320, 240)
    for events in (noise(4_000, 2_000), nothing):
        window = make_window(events, 750, 1250)
        target = replace(found[0][1], motion=found[0][1].motion.at(window.middle_us))
        found.append((window, target))
    return found


@pytest.fixture(scope="module")
def solvers():
    made = {}
    return lambda name: made.setdefault(name, Solver(backend=name))


def detections(windows, solver):
    """Of the targets as they are, whatever the windows show of them."""
    found = []
    for window, target in windows:
        targets = Targets([target])
        regions = targets.regions(CONFIG.align)
        measured = measure(EventBatch.of([window]), targets, regions, CONFIG, workspace=solver.workspace)
        found.append(replace(measured.detections(targets, regions)[0], target=target))
    return found


def many(count, of):
    """Places of so many windows, all of them among the first, then in another order each time."""
    rng = np.random.default_rng(count)
    return [k for _ in range(-(-count // of)) for k in rng.permutation(of)][:count]


@pytest.mark.parametrize(("name", "count"), SEVERAL)
def test_following_side_by_side_is_following_alone(name, count, windows, solvers):
    """To the bit, modules included, for codes of all kinds, for noise and for windows without an event."""
    solver = solvers(name)
    known = detections(windows, solver)
    alone = [
        solver.follow(EventBatch.of([window]), [detection])[0]
        for (window, _), detection in zip(windows, known, strict=True)
    ]
    places = many(count, len(windows))
    batch = EventBatch.of([windows[k][0] for k in places])
    together = solver.follow(batch, [known[k] for k in places])
    assert together == [alone[k] for k in places]
    assert sum(isinstance(found, Detection) for found in alone) == len(CODES)
    codes = [found for found in together if isinstance(found, Detection)]
    solved = solver.solve(codes)
    by_code = {id(found): solver.solve([found])[0] for found in alone if isinstance(found, Detection)}
    expected = [by_code[id(alone[k])] for k in places if isinstance(alone[k], Detection)]
    for one, other in zip(solved, expected, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        assert one.iterations == other.iterations


@pytest.mark.parametrize(("name", "count"), SEVERAL)
def test_sums_with_earlier_windows_side_by_side_are_those_alone(name, count, windows, solvers):
    """Of first windows, of later ones, and of some that are not asked for; none of what agrees too little."""
    solver = solvers(name)
    known = detections(windows, solver)
    nothing = [NormalEquations.nothing(target.space) for _, target in windows]
    before = [
        (None, each, code.weighted)[k % 3] for k, (code, each) in enumerate(zip(known, nothing, strict=True))
    ]
    alone = [
        solver.follow(EventBatch.of([window]), [code], [said])[0]
        for (window, _), code, said in zip(windows, known, before, strict=True)
    ]
    places = many(count, len(windows))
    batch = EventBatch.of([windows[k][0] for k in places])
    together = solver.follow(batch, [known[k] for k in places], [before[k] for k in places])
    assert together == [alone[k] for k in places]
    for found, said in zip(alone, before, strict=True):
        if isinstance(found, Detection):
            assert (found.fused is None) == (said is None)
    asked = [k for k, found in enumerate(alone) if isinstance(found, Detection) and found.fused]
    assert len(asked) > len(CODES) // 2
    for k in asked:
        found, said = alone[k], before[k]
        on_the_host = said + found.weighted
        np.testing.assert_allclose(found.fused.equations.rhs, on_the_host.rhs, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(found.fused.equations.stencil, on_the_host.stencil, rtol=1e-4, atol=1e-3)
        (estimate,) = solver.solve([on_the_host])
        np.testing.assert_allclose(found.fused.estimate.q, estimate.q, atol=0.02)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_batch_of_any_size_leaves_nothing_to_the_next(count, windows, solvers):
    """Rows that a smaller batch does not fill, and codes that were larger, do not show."""
    solver = solvers("warp")
    known = detections(windows, solver)
    batch = EventBatch.of([window for window, _ in windows])
    whole = solver.follow(batch, known)
    places = [3, 7, 0, 8, 6][:count]
    assert solver.follow(batch.pick(places), [known[k] for k in places]) == [whole[k] for k in places]
    assert solver.follow(batch, known) == whole
    assert solver.follow(batch.pick([]), []) == []
    assert solver.solve([]) == []


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_reads_the_same_side_by_side(backend, windows, solvers):
    """The same texts and reasons; poses within a hundredth of a module."""
    if backend == "numpy":
        pytest.skip("is what the others are compared with")
    truth, solver = solvers("numpy"), solvers(backend)
    known = detections(windows, truth)
    batch = EventBatch.of([window for window, _ in windows])
    expected, found = truth.follow(batch, known), solver.follow(batch, known)
    for one, other in zip(found, expected, strict=True):
        assert type(one) is type(other)
        if isinstance(one, NotFound):
            assert one.reason == other.reason
            continue
        size = other.space.columns
        off = np.abs(corners(one.pose, size) - corners(other.pose, size)).max()
        assert off < 0.01 * 3.5
        assert text_of(one, solver) == text_of(other, truth)


def text_of(detection, solver):
    outcome = decode_grid(solver.solve([detection])[0].q, detection.space)
    return outcome.text if isinstance(outcome, Decoded) else None


# ---- from the search


class Guess:
    """Where a code might be."""

    def __init__(self, space, pose):
        self.space, self.pose = space, pose


def guesses(windows):
    """Candidates of each window: some wrong ones, and those of codes that are there, at any place."""
    rng = np.random.default_rng(3)
    candidates = []
    for k, (_, target) in enumerate(windows):
        size = target.space.columns
        wrong = [Guess(qr.space(3), moved(target.pose, size, shift=rng.uniform(3, 6, 2))) for _ in range(2)]
        off = [Guess(target.space, moved(target.pose, size, shift=(1.0, 0.0), turn_deg=0.5))]
        candidates.append([wrong + off, off + wrong, wrong[:1] + off + wrong[1:]][k % 3])
    return candidates


def refined(batch, motions, candidates, tau_us, solver):
    found = refine(batch, motions, candidates, tau_us, CONFIG, workspace=solver.workspace)
    clock = StageClock()
    return complete(batch, found, tau_us, CONFIG, workspace=solver.workspace, clock=clock)


@pytest.mark.parametrize(("name", "count"), [("numpy", 10), ("warp", 10), ("warp", 32)])
@pytest.mark.parametrize("tau_us", [None, NO_LAG, (30.0, 50.0)], ids=["lags", "none", "known"])
def test_refining_side_by_side_is_refining_alone(tau_us, name, count, windows, solvers, monkeypatch):
    """Lags that are estimated included; and no matter how many candidates are looked at together."""
    if name == "numpy" and tau_us is not None:
        pytest.skip("takes long, and less of it is seen")
    solver = solvers(name)
    candidates = guesses(windows)
    motions = [target.motion for _, target in windows]
    alone = [
        refined(EventBatch.of([window]), [motion], [tried], [tau_us], solver)[0]
        for (window, _), motion, tried in zip(windows, motions, candidates, strict=True)
    ]
    places = many(count, len(windows))
    batch = EventBatch.of([windows[k][0] for k in places])
    given = [motions[k] for k in places], [candidates[k] for k in places], [tau_us] * count
    assert refined(batch, *given, solver) == [alone[k] for k in places]
    monkeypatch.setitem(solver.workspace.__dict__, "shared", False)  # as where launches are dear
    assert refined(batch, *given, solver) == [alone[k] for k in places]
    good = [found.score >= CONFIG.align.min_score for found in alone]
    assert sum(good[: len(CODES)]) == len(CODES)
    assert not any(good[len(CODES) :])


def test_a_motion_that_is_not_the_same_everywhere_is_refused(windows):
    (window, target), *_ = windows
    turning = replace(target, motion=Motion([1000.0, 0.0, 0.0, -10.0, 10.0, 0.0], window.middle_us))
    with pytest.raises(NotImplementedError, match="motions of 2 parameters"):
        Targets([turning])


def test_estimates_are_nobody_elses(windows, solvers):
    """What came out stays as it was when buffers are used again."""
    solver = solvers("warp")
    known = detections(windows, solver)
    batch = EventBatch.of([window for window, _ in windows])
    found = [each for each in solver.follow(batch, known) if isinstance(each, Detection)]
    estimates: list[CodeEstimate] = solver.solve(found)
    kept = [
        (each.equations.rhs.copy(), estimate.q.copy())
        for each, estimate in zip(found, estimates, strict=True)
    ]
    solver.solve(solver.follow(batch.pick([1, 0, 2]), [known[k] for k in (1, 0, 2)]))
    for (rhs, q), each, estimate in zip(kept, found, estimates, strict=True):
        np.testing.assert_array_equal(each.equations.rhs, rhs)
        np.testing.assert_array_equal(estimate.q, q)
