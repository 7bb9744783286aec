"""What codes could be made up of what is seen, and how well each agrees with what all of its size show.

Of three finder patterns and of two; of two where the third is hidden; of one alone; of straight edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.search.bulls_eyes import codes_of_bulls_eyes
from evqr.search.confirm import are_read
from evqr.search.corners import codes_of_edges
from evqr.search.edges import straight_edges
from evqr.search.finder import Found
from evqr.search.hypothesis import Hypotheses
from evqr.search.models import kinds_of
from evqr.search.pairs import codes_of_pairs
from evqr.search.pyramid import Pyramid
from evqr.search.score import score
from evqr.search.searched import SearchedWindow
from evqr.search.singles import codes_of_singles
from evqr.search.triples import codes_of_triples
from evqr.symbology import Symbology
from evqr.workspace import Workspace


def made_up(found: Sequence[Found], cfg: ReadConfig, *, last: bool) -> list[Hypotheses]:
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


def score_next(
    windows: list[SearchedWindow], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace, clock: StageClock
) -> bool:
    """Score the next hypotheses of all windows; False where there are none."""
    asked = [(window, now) for window in windows if (now := window.next_to_score()) is not None]
    if not asked:
        return False
    with clock("pose"):
        _score_all(asked, pyramid, cfg.finder.min_match, cfg, workspace)
    return True


def score_hidden(
    windows: list[SearchedWindow], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace, clock: StageClock
) -> bool:
    """Score pairs of finder patterns as all that is seen of codes; False where there are none."""
    least = cfg.finder.hidden_below
    doubtful = [one for one in windows if not any(code.score >= least for code in one.codes)]
    weak = [(window, code) for window in doubtful for code in window.codes]
    can_read = are_read([code for _, code in weak], cfg, workspace, clock)
    for (window, code), can in zip(weak, can_read, strict=True):
        if can:
            window.read.append(code)
    with clock("pose"):
        asked = [(window, window.next_hidden()) for window in doubtful if not window.read]
        _score_all(asked, pyramid, cfg.finder.min_hidden_match, cfg, workspace)
    return any(len(made) for _, made in asked)


def score_singles(
    windows: list[SearchedWindow],
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


def score_edges(
    windows: list[SearchedWindow], pyramid: Pyramid, cfg: ReadConfig, workspace: Workspace, clock: StageClock
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
    asked: list[tuple[SearchedWindow, Hypotheses]],
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
