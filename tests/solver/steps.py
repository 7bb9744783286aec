"""Single steps of the solver, which runs them as parts of larger ones."""

from evqr.fit.image import Sharpen, depositing
from evqr.fit.modules import Equations


def deposit(window, velocity, region, *, workspace):
    """Events on a region's cells (1, 2, height, width)."""
    step = depositing(window, velocity, region, workspace=workspace)
    step.run()
    return step.cells


def sharpen(cells, velocity, region, lags_px, *, workspace):
    """Images (N, height, width) for some pairs of lags [px]."""
    step = Sharpen(cells, len(lags_px), workspace)
    step.write(velocity, region, lags_px)
    step.run()
    return step.images


def normal_equations(image, pose, gain, version, sigma, cfg, *, workspace):
    """Stage two's equations for an image on the device, a pose (3, 3) in its pixels and a gain (2,)."""
    at, gains = workspace.mirror((1, 9)), workspace.mirror((1, 2))
    at.write(pose.reshape(1, 9))
    gains.write(gain)
    step = Equations(image, at.device, gains.device, version, sigma, cfg, workspace)
    step.run()
    return step.read(gain)
