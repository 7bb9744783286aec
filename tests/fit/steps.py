"""Single steps of the solver, which runs them as parts of larger ones."""

from evqr.config import AlignConfig
from evqr.events.batch import EventBatch
from evqr.fit.image import Sharpen, depositing
from evqr.fit.modules import Equations


def deposit(window, motion, region, *, workspace):
    """Events on a region's cells."""
    step, fresh = depositing(EventBatch.of([window]), [motion], [region], workspace=workspace)
    if fresh:
        step.run()
    return step


def sharpen(cells, motion, region, lags_px, *, workspace):
    """Images (N, height, width) for some pairs of lags [px]."""
    step = Sharpen(cells, len(lags_px), AlignConfig().blur_cells, workspace)
    step.write(motion, region, lags_px)
    step.run()
    return step.images


def normal_equations(images, pose, gain, space, sigma, cfg, *, workspace):
    """Stage two's equations for an image, a pose (3, 3) in its pixels and a gain (2,)."""
    at, gains = workspace.mirror((1, 9)), workspace.mirror((1, 2))
    at.write(pose.reshape(1, 9))
    gains.write(gain)
    step = Equations(images, at.device, gains.device, space, sigma, cfg, workspace)
    step.run()
    return step.read(gain)
