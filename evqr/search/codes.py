"""All codes of windows: from finder patterns to detections that do not overlap.

Hypotheses are scored many at once by what all symbols of their size show, and the best are looked at closely:
aligned with all that is known of the size, then on an image of their own.  Finder patterns within a code that
agrees well are its own, so that hypotheses with one of them are dropped; the next round looks at the best of
those that are left, as many at once as do not share patterns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.detection import NO_LAG, Detection, NotFound, Target
from evqr.fit.refine import complete, refine
from evqr.geometry import inverse
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.bulls_eyes import codes_of_bulls_eyes
from evqr.search.confirm import as_shown, confirmed, is_core
from evqr.search.corners import codes_of_edges, with_solid_corners
from evqr.search.curved import bends_of, unrolled
from evqr.search.edges import Edges, straight_edges
from evqr.search.finder import Found, Peaks, finding
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import cores, kinds_of, sizes
from evqr.search.pairs import codes_of_pairs
from evqr.search.pyramid import Pyramid
from evqr.search.score import score
from evqr.search.screen import Candidate, screen
from evqr.search.singles import codes_of_singles, with_single_patterns
from evqr.search.tilted import Patterns, codes_of_tilted, patterns_of_triples
from evqr.search.triples import codes_of_triples
from evqr.symbol.space import Landmark
from evqr.symbology import Symbology
from evqr.workspace import Workspace


@dataclass(frozen=True, eq=False)
class _Row:
    """Hypotheses of one place in one window, best first: those of the same finder patterns."""

    window: _Window
    hypotheses: Hypotheses


class _Window:
    """What is known of the codes of one window while it is searched."""

    def __init__(
        self, index: int, motion: Motion, tau_us: tuple[float, float] | None, cfg: ReadConfig
    ) -> None:
        self.index, self.motion, self.tau_us = index, motion, tau_us
        self.codes: list[Detection] = []
        self._unconfirmed: list[Detection] = []
        self.tried = 0
        # what agrees best: of what was looked at closely, and of what was only scored
        self._closest: tuple[float, Target | None] = 0.0, None
        self._best_match: tuple[float, Hypotheses | None] = 0.0, None
        self._cfg = cfg

    def take(self, found: Found, made: Hypotheses, *, last: bool, at_once: bool) -> None:
        """Take what a pass found and the codes that are made up of it, instead of what those before did.

        They are scored all at once, or the most promising first.
        """
        cfg = self._cfg
        self.peaks, self._last = found.peaks, last
        self._taken = np.zeros(len(found.peaks), bool)
        # where the most promising is no code a more thorough pass will tell, rather than the next ones
        self._failures, self._most = 0, cfg.finder.tries if last else 1
        most, first = cfg.finder.hypotheses, cfg.finder.first_hypotheses
        made, first = made[:most], most if at_once else first
        self._waiting = [part for part in (made[:first], made[first:] if last else made[:0]) if len(part)]
        self._matching = made[:0]
        self._match = np.zeros(0, np.float32)

    @property
    def sure(self) -> bool:
        """Whether there is a code that agrees well."""
        return any(code.score >= self._cfg.align.good_score for code in self.codes)

    @property
    def agrees(self) -> bool:
        """Whether there is something that agrees with a code, well or not."""
        return bool(self.codes or self._unconfirmed)

    def next_to_score(self) -> Hypotheses | None:
        """Give the hypotheses that are to be scored now; None where all are."""
        if not self._waiting:
            return None
        now = self._free(self._waiting.pop(0))
        self.tried += len(now)
        return now

    def next_singles(self) -> NDArray[np.intp]:
        """Give the finder patterns that are each tried as the only one of a code."""
        self._failures, self._most = 0, self._cfg.finder.single_tries
        self._matching, self._match = self._matching[:0], self._match[:0]
        asked = self._cfg.symbologies
        none = self.sure or not (with_single_patterns(asked) or Symbology.AZTEC in asked)
        return np.flatnonzero(~self._taken)[: 0 if none else self._cfg.finder.single_patterns]

    @property
    def by_edges(self) -> bool:
        """Whether symbols with solid sides are looked for, now."""
        return not self.sure and with_solid_corners(self._cfg.symbologies)

    def take_edges(self, edges: Edges) -> None:
        """Take straight edges, numbered behind the finder patterns, as what a code may be found by."""
        table = np.zeros((len(edges), 5), np.float32)
        table[:, 1:3] = 0.5 * (edges.start + edges.end)
        self.peaks = Peaks(np.concatenate([self.peaks.table, table]))
        self._taken = np.concatenate([self._taken, np.zeros(len(edges), np.bool_)])
        self._failures, self._most = 0, self._cfg.edges.failures
        self._matching, self._match = self._matching[:0], self._match[:0]

    def scored(self, hypotheses: Hypotheses, scores: NDArray[np.float32], least: float) -> None:
        """Take scores (N, 2) of hypotheses: those that match are looked at, best first."""
        match = np.concatenate([self._match, 0.5 * (scores[:, 0] + scores[:, 1])])
        both = Hypotheses.joined([self._matching, hypotheses])
        order = np.argsort(-match, kind="stable")
        best = order[match[order] >= least]
        if not both.single and match[order[0]] > self._best_match[0]:
            self._best_match = float(match[order[0]]), both[order[:1]]
        self._matching, self._match = both[best], match[best]

    def rows(self) -> list[_Row]:
        """Give what is looked at next: the best, and others that share no finder pattern with those before.

        Only what is clearly a code while others are still to be scored or found, or where there is one
        already; and one alone while it is not known how the pixels lag, for it will tell.
        """
        finder = self._cfg.finder
        clear_only = bool(self._waiting) or self.sure or not self._last
        chosen: list[_Row] = []
        used: set[int] = set()
        while len(chosen) < self._most - self._failures:
            free = self._are_free(self._matching, used)
            k = int(free.argmax()) if len(free) else 0
            if not len(free) or not free[k]:
                break
            clear = bool(self._match[k] >= finder.clear_match)
            if clear_only and not clear:
                break
            patterns = self._matching.peaks[k]
            same = (self._matching.peaks == patterns).all(axis=1)
            # a bull's eye agrees with a finder pattern too well to be weighed against it
            same &= cores()[self._matching.size] == cores()[self._matching.size[k]]
            chosen.append(_Row(self, self._matching[same]))
            self._matching, self._match = self._matching[~same], self._match[~same]
            used.update(patterns.tolist())
            if clear and self.tau_us is None:
                break
        return chosen

    def _are_free(self, hypotheses: Hypotheses, used: set[int]) -> NDArray[np.bool_]:
        """Whether hypotheses have no finder pattern of a code, and none of those in use."""
        taken = self._taken
        if used:
            taken = taken.copy()
            taken[list(used)] = True
        return ~np.any(taken[hypotheses.peaks], axis=1)

    def _free(self, hypotheses: Hypotheses) -> Hypotheses:
        """Give the hypotheses that have no finder pattern of a code."""
        return hypotheses[self._are_free(hypotheses, set())] if self._taken.any() else hypotheses

    def failed(self, score: float, target: Target) -> None:
        """Note that what was looked at is no code."""
        self._failures += 1
        closest, nearest = self._closest
        if nearest is None or score > closest:
            self._closest = max(score, 0.0), target

    def unconfirmed(self, code: Detection) -> None:
        """Note a code that agrees, though its modules cannot be read in this window."""
        self._failures += 1
        self._unconfirmed.append(code)

    def found(self, code: Detection) -> None:
        """Take a code.  Where it agrees well, the finder patterns within it are its own."""
        self.codes.append(code)
        if code.score < self._cfg.align.good_score:
            self._failures += 1
            return
        self._failures = 0
        if self.tau_us is None:
            self.tau_us = code.tau_us
        x, y = self.peaks.position.T.astype(np.float64)
        self._taken |= _inside(code.target, x, y, margin=1.0)

    def result(self) -> tuple[Detection, ...] | NotFound:
        """Give the codes, best first, none over another; or why there is none."""
        kept = apart(self.codes or self._unconfirmed)
        if kept:
            return kept
        if not self.tried:
            return NotFound(Reason.NO_FINDER_PATTERNS, f"{len(self.peaks)} candidates")
        closest, nearest = self._closest
        match, best = self._best_match
        if nearest is None and best is not None:
            closest = match
            nearest = Target(best.space(0), best.pose[0], self.motion)
        detail = f"{closest:.2f}, the best of {self.tried} candidates"
        return NotFound(Reason.DISAGREES, detail, closest, nearest)


def apart(codes: Sequence[Detection]) -> tuple[Detection, ...]:
    """Give codes, best first, of those that lie over each other the best alone."""
    kept: list[Detection] = []
    for code in sorted(codes, key=lambda code: -code.score):
        if not any(_overlap(code.target, other.target) for other in kept):
            kept.append(code)
    return tuple(kept)


def _inside(
    target: Target, x: NDArray[np.float64], y: NDArray[np.float64], margin: float
) -> NDArray[np.bool_]:
    """Whether places [px] lie within a code and a margin [modules]."""
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in inverse(target.pose).tolist())
    across, down = target.space.columns / 2.0, target.space.rows / 2.0
    return (np.abs(u / w - across) < across + margin) & (np.abs(v / w - down) < down + margin)


def _overlap(one: Target, other: Target) -> bool:
    """Whether the centre of one of two codes lies within the other."""
    return any(bool(_inside(a, *b.centre[:, None], margin=0.0)[0]) for a, b in ((one, other), (other, one)))


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
        Whether tilted codes are searched for where nothing is found.

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
        _Window(k, motion, tau, cfg) for k, (motion, tau) in enumerate(zip(motions, tau_us, strict=True))
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
                patterns, every = None, _made_up(found, cfg, last=last)
            for window, one, made in zip(left, found, every, strict=True):
                window.take(one, made, last=last, at_once=not workspace.shared)
        while _score(left, pyramid, cfg, workspace, clock):
            while rows := [row for window in left for row in window.rows()]:
                _try(batch, rows, pyramid, cfg, workspace, clock)
        if patterns is not None:
            _find_curved(batch, left, patterns, cfg, workspace, clock)
    if _score_singles(windows, pyramid, cfg, workspace, clock):
        while rows := [row for window in windows for row in window.rows()]:
            _try(batch, rows, pyramid, cfg, workspace, clock)
    if _score_edges(windows, pyramid, cfg, workspace, clock):
        while rows := [row for window in windows for row in window.rows()]:
            _try(batch, rows, pyramid, cfg, workspace, clock)
    return [window.result() for window in windows]


def _find_curved(
    batch: EventBatch,
    windows: list[_Window],
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


def _made_up(found: Sequence[Found], cfg: ReadConfig, *, last: bool) -> list[Hypotheses]:
    """Give the codes that what was found in each window could be the corners of.

    In the end where one of them is missing, too.
    """
    ends = np.cumsum([len(one.peaks) for one in found])
    begins = ends - [len(one.peaks) for one in found]
    triples = np.concatenate([one.triples for one in found])
    # peaks of all windows are numbered through
    triples[:, 1:4] += begins.repeat([len(one.triples) for one in found])[:, None]
    made = codes_of_triples(np.concatenate([one.peaks.table for one in found]), triples, cfg.finder)
    made = made[kinds_of(cfg.symbologies)[made.size]]
    window = np.searchsorted(ends, made.peaks[:, 0], side="right")
    made.peaks[...] -= begins[window, None]
    ends = np.searchsorted(window, np.arange(len(found)), side="right").tolist()
    parts = [made[first:end] for first, end in pairwise([0, *ends])]
    if last:
        others = codes_of_pairs([one.peaks.table for one in found], cfg.finder)
        others = [some[kinds_of(cfg.symbologies)[some.size]] for some in others]
        parts = [Hypotheses.joined(both) for both in zip(parts, others, strict=True)]
    return parts


def _score(
    windows: list[_Window], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace, clock: StageClock
) -> bool:
    """Score the next hypotheses of all windows; False where there are none."""
    asked = [(window, now) for window in windows if (now := window.next_to_score()) is not None]
    if not asked:
        return False
    with clock("pose"):
        _score_all(asked, pyramid, cfg.finder.min_match, cfg, workspace)
    return True


def _score_singles(
    windows: list[_Window],
    pyramid: Pyramid,
    cfg: ReadConfig,
    workspace: Workspace,
    clock: StageClock,
) -> bool:
    """Score finder patterns as the only ones of codes; False where there are none."""
    which = [window.next_singles() for window in windows]
    counts = np.array([len(some) for some in which])
    if not counts.sum():
        return False
    with clock("pose"):
        peaks = np.concatenate([one.peaks.table[some] for one, some in zip(windows, which, strict=True)])
        of_window = np.repeat(np.arange(len(windows)), counts)
        hypotheses, of_each = codes_of_singles(
            peaks,
            np.concatenate(which),
            of_window,
            np.array([window.motion.direction for window in windows])[of_window],
            pyramid,
            cfg.align,
            cfg.symbologies,
            workspace=workspace,
        )
        parts = [hypotheses[of_each == k] for k in range(len(windows))]
        _score_all(
            list(zip(windows, parts, strict=True)), pyramid, cfg.finder.min_single_match, cfg, workspace
        )
        if Symbology.AZTEC in cfg.symbologies:
            hypotheses, of_each, scores = codes_of_bulls_eyes(
                peaks, np.concatenate(which), of_window, pyramid, cfg.align, workspace=workspace
            )
            for k in np.unique(of_each).tolist():
                its = of_each == k
                both = np.column_stack([scores[its], scores[its]])
                windows[k].scored(hypotheses[its], both, cfg.finder.min_single_match)
    return True


def _score_edges(
    windows: list[_Window], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace, clock: StageClock
) -> bool:
    """Score straight edges as sides of codes; False where there are none."""
    asked = [window for window in windows if window.by_edges]
    if not asked:
        return False
    which = [window.index for window in asked]
    directions = np.array([window.motion.direction for window in asked])
    with clock("finder"):
        edges = straight_edges(pyramid, which, directions, cfg.edges, workspace=workspace)
    with clock("pose"):
        first = [len(window.peaks) for window in asked]
        hypotheses, of_each, scores = codes_of_edges(
            edges, which, directions, first, pyramid, cfg, workspace=workspace
        )
        for window, its in zip(asked, edges, strict=True):
            window.take_edges(its)
            mine = of_each == window.index
            if mine.any():
                both = np.column_stack([scores[mine], scores[mine]])
                window.scored(hypotheses[mine], both, cfg.edges.min_score)
    return True


def _score_all(
    asked: list[tuple[_Window, Hypotheses]],
    pyramid: Pyramid,
    least: float,
    cfg: ReadConfig,
    workspace: Workspace,
) -> None:
    """Score hypotheses of windows in one launch."""
    asked = [(window, some) for window, some in asked if len(some)]
    if not asked:
        return
    scores = score(
        pyramid,
        np.concatenate([np.full(len(some), window.index) for window, some in asked]),
        np.concatenate([some.size for _, some in asked]),
        np.concatenate([some.pose for _, some in asked]),
        cfg.align,
        workspace=workspace,
    )
    end = 0
    for window, some in asked:
        window.scored(some, scores[end : end + len(some)], least)
        end += len(some)


def _try(
    batch: EventBatch,
    rows: list[_Row],
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
    rows: list[_Row], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace
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
