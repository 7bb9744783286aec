"""The codes of one window, and what is known of them while it is searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evqr.config import ReadConfig
from evqr.fit.detection import Detection, NotFound, Target
from evqr.geometry import inverse
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.corners import with_solid_corners
from evqr.search.edges import Edges
from evqr.search.finder import Found, Peaks
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import cores, kinds_of
from evqr.search.pairs import codes_of_pairs
from evqr.search.singles import with_single_patterns
from evqr.symbology import Symbology


@dataclass(frozen=True, eq=False)
class Row:
    """What is looked at closely, together.

    Attributes
    ----------
    window : SearchedWindow
        Where it is.
    hypotheses : Hypotheses
        Those of one place, of the same finder patterns, best first.
    """

    window: SearchedWindow
    hypotheses: Hypotheses


class SearchedWindow:
    """What is known of the codes of one window while it is searched."""

    def __init__(
        self, index: int, motion: Motion, tau_us: tuple[float, float] | None, cfg: ReadConfig
    ) -> None:
        self.index, self.motion, self.tau_us = index, motion, tau_us
        self._given_tau_us = tau_us
        self.codes: list[Detection] = []
        self._unconfirmed: list[Detection] = []
        self.read: list[Detection] = []  # those of them that are known to be read
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

    def _begin(self, tries: int) -> None:
        """Begin to look for codes in another way, with so many failures in a row at most."""
        self._failures, self._most = 0, tries
        self._matching, self._match = self._matching[:0], self._match[:0]

    def next_hidden(self) -> Hypotheses:
        """Give the codes of which two finder patterns could be all that is seen.

        What was found before says nothing: with a third pattern that is none it is where the code is.
        """
        cfg = self._cfg
        self._begin(cfg.finder.hidden_tries)
        self._taken[:] = False
        self.tau_us = self._given_tau_us
        (made,) = codes_of_pairs([self.peaks.table], cfg.finder, hidden=True)
        made = made[kinds_of(cfg.symbologies)[made.size]][: cfg.finder.hidden_hypotheses]
        self.tried += len(made)
        return made

    def next_singles(self) -> NDArray[np.intp]:
        """Give the finder patterns that are each tried as the only one of a code."""
        self._begin(self._cfg.finder.single_tries)
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
        self._begin(self._cfg.edges.failures)

    def scored(self, hypotheses: Hypotheses, scores: NDArray[np.float32], least: float) -> None:
        """Take scores (N, 2) of hypotheses: those that match are looked at, best first."""
        match = np.concatenate([self._match, 0.5 * (scores[:, 0] + scores[:, 1])])
        both = Hypotheses.joined([self._matching, hypotheses])
        order = np.argsort(-match, kind="stable")
        best = order[match[order] >= least]
        if not both.single and match[order[0]] > self._best_match[0]:
            self._best_match = float(match[order[0]]), both[order[:1]]
        self._matching, self._match = both[best], match[best]

    def rows(self) -> list[Row]:
        """Give what is looked at next: the best, and others that share no finder pattern with those before.

        Only what is clearly a code while others are still to be scored or found, or where there is one
        already; and one alone while it is not known how the pixels lag, for it will tell.
        """
        finder = self._cfg.finder
        clear_only = bool(self._waiting) or self.sure or not self._last
        chosen: list[Row] = []
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
            chosen.append(Row(self, self._matching[same]))
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
        if code.space.hidden is not None:
            self.read.append(code)
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
        kept = apart(self.codes or self._unconfirmed, self.read)
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


def apart(codes: Sequence[Detection], read: Sequence[Detection] = ()) -> tuple[Detection, ...]:
    """Give codes, best first, of those that lie over each other the best alone.

    Those that are known to be read are right, however well the others agree.
    """
    kept: list[Detection] = []
    are_right = {*map(id, read)}
    for code in sorted(codes, key=lambda code: (id(code) not in are_right, -code.score)):
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
