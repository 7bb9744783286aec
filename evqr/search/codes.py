"""All codes of windows: from finder patterns to detections that do not overlap.

Hypotheses are scored many at once by what all symbols of their size show, and the best are looked at closely:
aligned with all that is known of the size, then on an image of their own.  Finder patterns within a code that
agrees well are its own, so that hypotheses with one of them are dropped; the next round looks at the best of
those that are left, as many at once as do not share patterns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.detection import NO_LAG, Detection, NotFound, Target
from evqr.fit.refine import complete, refine
from evqr.motion import Motion
from evqr.search.confirm import as_shown, confirmed, is_core
from evqr.search.curved import bends_of, unrolled
from evqr.search.features import made_up, score_edges, score_hidden, score_next, score_singles
from evqr.search.finder import finding
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import sizes
from evqr.search.pyramid import Pyramid
from evqr.search.screen import Candidate, screen
from evqr.search.searched import Row, SearchedWindow
from evqr.search.tilted import Patterns, codes_of_tilted, patterns_of_triples
from evqr.symbol.space import Landmark
from evqr.symbology import Symbology
from evqr.workspace import Workspace


def find_codes(
    batch: EventBatch,
    motions: Sequence[Motion],
    tau_us: Sequence[tuple[float, float] | None],
    cfg: ReadConfig,
    *,
    workspace: Workspace,
    clock: StageClock,
    thorough: bool,
) -> list[tuple[Detection, ...] | NotFound]:
    """Find all codes of windows, along one motion each.

    Parameters
    ----------
    batch : EventBatch
        B windows.
    motions : sequence of Motion
        Of the codes of each, at the middle of the window.
    tau_us : sequence of (float, float) or None [us]
        Time constants of the pixels, a window; None: not known.
    cfg : ReadConfig
        Settings.
    workspace : Workspace
        Buffers.
    clock : StageClock
        To which the times are added, by stage.
    thorough : bool
        Whether tilted codes, and those of which a finder pattern is hidden, are searched for where nothing
        is found.

    Returns
    -------
    found : list of tuple of Detection, or NotFound
        For each window its codes, best first, or why there is none.  It does not depend on the others.
    """
    with clock("finder"):
        finder = finding(
            batch, motions, cfg.finder, workspace=workspace,
            lags_px=[NO_LAG if tau == NO_LAG else None for tau in tau_us],
        )  # fmt: skip
        pyramid = finder.pyramid
    windows = [
        SearchedWindow(k, motion, tau, cfg)
        for k, (motion, tau) in enumerate(zip(motions, tau_us, strict=True))
    ]
    upright = [k for k, one in enumerate(cfg.finder.passes) if one.slack <= 1.0]
    tilted = [k for k, one in enumerate(cfg.finder.passes) if one.slack > 1.0]
    if Symbology.QR_CODE not in cfg.symbologies:
        tilted = []  # no others have three patterns
    if not workspace.shared:
        upright = upright[-1:]  # to ask a device once more takes longer than to look for all at once
    for which in upright + tilted:
        left = [window for window in windows if not window.sure]
        if which in tilted and not thorough:
            left = [window for window in left if window.agrees]
        if not left:
            break
        with clock("finder"):
            all_found = finder.find(which, [window.index for window in left], first=which == upright[0])
            found = [all_found[window.index] for window in left]
            last = which not in upright[:-1]
            if which in tilted:
                numbers = [window.index for window in left]
                ways = np.array([window.motion.direction for window in left])
                patterns = patterns_of_triples(found, numbers, ways, pyramid, cfg.align, workspace=workspace)
                every = codes_of_tilted(patterns, len(left))
            else:
                patterns, every = None, made_up(found, cfg, last=last)
            for window, one, made in zip(left, found, every, strict=True):
                window.take(one, made, last=last, at_once=not workspace.shared)
        while score_next(left, pyramid, cfg, workspace, clock):
            while rows := [row for window in left for row in window.rows()]:
                _try(batch, rows, pyramid, cfg, workspace, clock)
        if patterns is not None:
            _find_curved(batch, left, patterns, cfg, workspace, clock)
    doubted = windows if thorough else [window for window in windows if window.agrees]
    for score_others, those in ((score_hidden, doubted), (score_singles, windows), (score_edges, windows)):
        if score_others(those, pyramid, cfg, workspace, clock):
            while rows := [row for window in windows for row in window.rows()]:
                _try(batch, rows, pyramid, cfg, workspace, clock)
    return [window.result() for window in windows]


def _find_curved(
    batch: EventBatch,
    windows: list[SearchedWindow],
    patterns: Patterns,
    cfg: ReadConfig,
    workspace: Workspace,
    clock: StageClock,
) -> None:
    """Search windows as if they were unrolled, where three patterns suggest how a code is bent."""
    upright = tuple(one for one in cfg.finder.passes if one.slack <= 1.0)[-1:]
    finder = replace(cfg.finder, passes=upright, single_patterns=0)
    flat = replace(cfg, symbologies=(Symbology.QR_CODE,), finder=finder)
    asked = [(window, bend) for k, window in enumerate(windows) for bend in bends_of(patterns, k)]
    for nearly in (False, True):
        tried = [
            (window, one)
            for window, bend in asked
            if not window.sure
            for one in (bend.beside() if nearly else [bend])
        ]
        if not tried:
            return
        every = [unrolled(batch.windows[window.index], window.motion, bend) for window, bend in tried]
        motions, taus = [window.motion for window, _ in tried], [window.tau_us for window, _ in tried]
        found = find_codes(
            EventBatch.of(every), motions, taus, flat, workspace=workspace, clock=clock, thorough=False
        )
        for (window, _), codes in zip(tried, found, strict=True):
            if not isinstance(codes, NotFound) and codes[0].score >= cfg.align.good_score:
                window.found(codes[0])


def _try(
    batch: EventBatch,
    rows: list[Row],
    pyramid: Pyramid,
    cfg: ReadConfig,
    workspace: Workspace,
    clock: StageClock,
) -> None:
    """Look at hypotheses closely, those of all windows at once."""
    one = cfg.align
    with clock("pose"):
        candidates = _candidates(rows, pyramid, cfg, workspace)
    left = []
    for row, some in zip(rows, candidates, strict=True):
        if some[0].score < one.coarse_score:
            row.window.failed(some[0].score, Target(some[0].space, some[0].pose, row.window.motion))
        else:
            left.append((row, [candidate for candidate in some if candidate.score >= one.coarse_score]))
    if not left:
        return
    picked = batch.pick([row.window.index for row, _ in left])
    with clock("stage_one"):
        refined = refine(
            picked,
            [row.window.motion for row, _ in left],
            [some for _, some in left],
            [row.window.tau_us for row, _ in left],
            cfg,
            workspace=workspace,
        )
    good = []
    for k, ((row, some), refinement) in enumerate(zip(left, refined, strict=True)):
        steps = refinement.iterations + sum(candidate.iterations for candidate in some)
        if refinement.score < one.min_score:
            row.window.failed(refinement.score, refinement.detection.target)
        else:
            good.append((k, row.window, refinement.altered(iterations=steps)))
    if not good:
        return
    codes = complete(
        picked.pick([k for k, _, _ in good]),
        [refinement for _, _, refinement in good],
        [window.tau_us for _, window, _ in good],
        cfg,
        workspace=workspace,
        clock=clock,
    )
    codes = as_shown(picked.pick([k for k, _, _ in good]), codes, cfg, workspace, clock)
    sure_of_each = confirmed(codes, cfg, workspace, clock)
    for (_, window, _), code, sure in zip(good, codes, sure_of_each, strict=True):
        if is_core(code) or (code.space.single_pattern and code.score < one.single_score):
            window.failed(code.score, code.target)
        elif sure:
            window.found(code)
        else:
            window.unconfirmed(code)


def _sizes_of(hypotheses: Hypotheses, most: int) -> list[Candidate]:
    """Give the best of hypotheses of one pattern, in each size and direction: only a closer look tells.

    So many of each symbology: those that show few modules match well more easily.
    """
    quarters = np.round(np.arctan2(hypotheses.pose[:, 1, 0], hypotheses.pose[:, 0, 0]) / (0.5 * math.pi))
    of_kind: dict[tuple[int, float], int] = {}
    for k, kind in enumerate(zip(hypotheses.size.tolist(), quarters.tolist(), strict=True)):
        of_kind.setdefault(kind, k)
    chosen: dict[Symbology, list[int]] = {}
    for k in of_kind.values():
        chosen.setdefault(sizes()[hypotheses.size[k]].symbology, []).append(k)
    best = [k for of_one in chosen.values() for k in of_one[:most]]
    return [Candidate(hypotheses.space(k), hypotheses.pose[k], 1.0, 0) for k in best]


def _candidates(
    rows: list[Row], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace
) -> list[list[Candidate]]:
    """Give what may be refined of each place, best first: aligned coarsely, unless a pattern was so alone."""
    one = cfg.align
    most = one.refined_candidates
    several = [row for row in rows if not row.hypotheses.single]
    screened = iter(())
    if several:
        every = Hypotheses.joined([row.hypotheses for row in several])
        windows = [row.window.index for row in several for _ in range(len(row.hypotheses))]
        screened = iter(screen(every, windows, pyramid, one, workspace=workspace))
    found = []
    for row in rows:
        count = len(row.hypotheses)
        if row.hypotheses.single:
            # with solid sides it was aligned with all that is known
            aligned = row.hypotheses.space(0).anchors[0].kind is Landmark.SOLID_CORNER
            some = _sizes_of(row.hypotheses, most if aligned else cfg.finder.single_candidates)
        else:
            some = sorted(islice(screened, count), key=lambda candidate: -candidate.score)[:most]
        found.append(some)
    return found
