"""What the modules of codes that were found say of them: whether they are codes, and of which size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evqr.clock import StageClock
from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.detection import Detection
from evqr.fit.modules import solve_modules, weight_of
from evqr.fit.refine import complete, refine
from evqr.geometry import compose
from evqr.search.screen import Candidate
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.space import Landmark
from evqr.symbol.symbols import SYMBOLS
from evqr.workspace import Workspace


def is_core(code: Detection) -> bool:
    """Whether only the middle of a code is known, for what it says of the rest was not read."""
    return code.space.version in SYMBOLS[code.space.symbology].cores


def confirmed(codes: list[Detection], cfg: ReadConfig, workspace: Workspace, clock: StageClock) -> list[bool]:
    """Tell whether codes are what they are taken for: those without a finder pattern, where they can be read.

    So are those of which one pattern is hidden, for it may be made up.  Many things have straight edges, and
    the quiet zone of a symbol on a label looks like the light sides of a larger, inverted one; around the
    middle of a finder pattern known modules of an Aztec code are few.
    """
    sure = [
        code.space.anchors[0].kind is Landmark.FINDER_PATTERN and code.space.hidden is None for code in codes
    ]
    asked = [k for k, one in enumerate(sure) if not (one or is_core(codes[k]))]
    read = are_read([codes[k] for k in asked], cfg, workspace, clock)
    for k, each in zip(asked, read, strict=True):
        sure[k] = each
    return sure


def are_read(
    codes: Sequence[Detection], cfg: ReadConfig, workspace: Workspace, clock: StageClock
) -> list[bool]:
    """Tell which codes their windows say enough of, each alone, to decode them."""
    if not codes:
        return []
    with clock("stage_two"):
        weights = [weight_of(code.noise) for code in codes]
        equations = [code.equations for code in codes]
        grids = solve_modules(equations, cfg.modules, workspace=workspace, weights=weights)
    outcomes = [
        decode_grid(grid.q, code.space, config=cfg.decode, effort="full")
        for grid, code in zip(grids, codes, strict=True)
    ]
    return [isinstance(outcome, Decoded) for outcome in outcomes]


def as_shown(
    batch: EventBatch,
    codes: list[Detection],
    cfg: ReadConfig,
    workspace: Workspace,
    clock: StageClock,
) -> list[Detection]:
    """Give codes, of a window each, as their modules say that they are, where known modules do not tell."""
    asked = [k for k, code in enumerate(codes) if SYMBOLS[code.space.symbology].shown]
    if not asked:
        return codes
    with clock("stage_two"):
        weights = [weight_of(codes[k].noise) for k in asked]
        equations = [codes[k].equations for k in asked]
        grids = solve_modules(equations, cfg.modules, workspace=workspace, weights=weights)
    larger: list[tuple[int, Candidate]] = []
    for k, grid in zip(asked, grids, strict=True):
        found = codes[k]
        shown = SYMBOLS[found.space.symbology].shown
        said = shown(grid.q.astype(np.float64), found.space) if shown else None
        if said is not None:
            space, to_found = said
            larger.append((k, Candidate(space, compose(found.target.pose, to_found), found.score, 0)))
    if not larger:
        return codes
    picked, taus = batch.pick([k for k, _ in larger]), [codes[k].target.tau_us for k, _ in larger]
    with clock("stage_one"):
        refined = refine(
            picked, [codes[k].target.motion for k, _ in larger], [[each] for _, each in larger], taus, cfg,
            workspace=workspace,
        )  # fmt: skip
    again = complete(picked, refined, taus, cfg, workspace=workspace, clock=clock)
    shown_as = {k: code for (k, _), code in zip(larger, again, strict=True)}
    return [shown_as.get(k, code) for k, code in enumerate(codes)]
