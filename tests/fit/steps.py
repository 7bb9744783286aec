"""Single steps of the solver, which runs them as parts of larger ones, for one window."""

from types import SimpleNamespace

import numpy as np

from evqr.config import AlignConfig
from evqr.events.batch import EventBatch
from evqr.fit.image import Sharpen, depositing
from evqr.fit.modules import Equations, solve_modules
from evqr.fit.tables import Codes, room_for


def deposit(window, motion, region, *, workspace):
    """Events on a region's cells."""
    step, fresh = depositing(EventBatch.of([window]), [motion], [region], workspace=workspace)
    if fresh:
        step.run()
    return step


def sharpen(deposited, motion, region, lags_px, *, workspace):
    """Images (N, height, width) for some pairs of lags [px]."""
    step = Sharpen(deposited, AlignConfig().blur_cells, workspace, each=len(lags_px))
    step.write([motion], [region], [lags_px])
    step.run()
    return step.images


def normal_equations(images, pose, gain, space, sigma, cfg, *, workspace):
    """Stage two's equations for an image, a pose (3, 3) in its pixels and a gain (2,)."""
    codes = Codes.of(workspace)
    number = codes.number(space)
    shapes = {"pose": (1, 9), "gain": (1, 2), "number": (1,)}
    mirrors = {
        name: workspace.mirror(shape, np.int32 if name == "number" else np.float32)
        for name, shape in shapes.items()
    }
    for name, values in {"pose": pose.reshape(1, 9), "gain": gain, "number": number}.items():
        mirrors[name].write(values)
    poses = SimpleNamespace(**{name: mirror.device for name, mirror in mirrors.items()})
    tables = codes.modules(cfg, [number])
    step = Equations(images, poses, tables, room_for([space]), sigma, cfg, workspace)
    step.run()
    return step.read(np.array([gain]), [space])[0]


def solved(equations, cfg, *, workspace):
    """Modules of one code."""
    (estimate,) = solve_modules([equations], cfg, workspace=workspace)
    return estimate
