"""The image of a window's events, transported by their motion: what the paper's section 3.3 calls E."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.workspace import Workspace
from evqr_kernels.config import SplatConfig


def event_image(
    window: Window,
    motion: NDArray[np.float64],
    *,
    epsilon_px: float,
    workspace: Workspace,
    weight: float = 1.0,
) -> NDArray[np.float32]:
    """Splat the events of a window, transported to its middle.

    Parameters
    ----------
    window : Window
        Events of one window.
    motion : (2,) float64 [px per window]
        Displacement that is undone.
    epsilon_px : float [px]
        Standard deviation of an event's splat.
    workspace : Workspace
        Whose buffers are used.
    weight : float
        Of an event.

    Returns
    -------
    image : (Y, X) float32
        A buffer of the workspace that the next call fills again.
    """
    image = workspace.buffer("image of events", (1, window.height, window.width))
    workspace.get(image).fill(0.0)
    workspace.backend.splat_events(
        workspace.put(window.x),
        workspace.put(window.y),
        workspace.put(window.t / np.float32(window.seconds)),
        workspace.put(np.float32(weight) * window.p),
        workspace.put(np.array([0, len(window)], np.int32)),
        workspace.put(motion[None].astype(np.float32)),
        workspace.put(np.zeros((1, 2), np.float32)),
        workspace.put(np.array([[0.0, 0.0, 1.0]], np.float32)),
        image,
        SplatConfig(epsilon_px=epsilon_px),
    )
    workspace.backend.synchronize(workspace.device)
    return workspace.get(image)[0]
