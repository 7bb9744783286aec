"""Single steps of the solver, which runs them as parts of larger ones, for one window."""

from types import SimpleNamespace

import numpy as np

from evqr.config import AlignConfig
from evqr.events.batch import EventBatch
from evqr.fit.image import Deposit, Sharpen, cells_for
from evqr.fit.modules import Equations, solve_modules
from evqr.fit.region import regions_of
from evqr.fit.tables import Codes, room_for
from evqr.motion import Motions


def deposit(window, motion, region, *, workspace):
    """Events on a region's cells."""
    return deposited(EventBatch.of([window]), [motion], [region], workspace=workspace)


def deposited(batch, motions, regions, *, workspace):
    """Events of windows on cells of a region each, unless they are there already."""
    motions, regions = Motions.of(motions), regions_of(regions)
    cells, events = cells_for(regions, workspace=workspace), workspace.events(batch)
    if cells.take(batch, motions, regions):
        step = cells.once(("deposit", events.size), lambda: Deposit(events, cells, workspace))
        step.write(batch, motions, regions)
        step.run()
    return cells


def sharpen(cells, motion, region, lags_px, *, workspace):
    """Images (N, height, width) for some pairs of lags [px]."""
    step = Sharpen(cells, AlignConfig().blur_cells, workspace, each=len(lags_px))
    step.write(Motions.of([motion]), regions_of([region]), [lags_px])
    step.run()
    return step.images


def normal_equations(images, pose, gain, space, sigma, cfg, *, workspace):
    """Stage two's equations for an image, a pose (3, 3) in its pixels and a gain (2,)."""
    codes = Codes.of(workspace)
    number = codes.number(space)
    values = {
        "pose": pose.reshape(1, 9).astype(np.float32),
        "gain": np.array([gain], np.float32),
        "number": np.array([number], np.int32),
    }
    poses = SimpleNamespace(**{name: workspace.put(array) for name, array in values.items()})
    tables = codes.modules(cfg, [number])
    step = Equations(images, poses, tables, room_for([space]), sigma, cfg, workspace)
    step.run()
    return step.read(np.array([gain]), [space])[0]


def solved(equations, cfg, *, workspace):
    """Modules of one code."""
    (estimate,) = solve_modules([equations], cfg, workspace=workspace)
    return estimate
