"""What tests of the later stages start from: the image around a code, at its true pose and motion."""

from dataclasses import dataclass

import numpy as np
import pytest
from scenes import at, corners, middle_us, motion_at, window_of
from steps import deposit, sharpen

from evqr.config import AlignConfig
from evqr.events.window import Window
from evqr.fit.region import Region, region_around
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.symbol import qr
from evqr.symbol.space import CodeSpace
from evqr.workspace import Images, Workspace
from evqr_kernels.registry import get_backend


@dataclass(frozen=True, eq=False, kw_only=True)
class Seen:
    """A code in the middle of a simulated recording.

    Attributes
    ----------
    space, size               of the code
    modules : (r, r)          truth, -1 dark, +1 light
    pose : (3, 3)             truth, code coordinates to px
    motion                    truth
    window                    of events, all of them
    region, image             around the code; the image is on the device
    """

    space: CodeSpace
    modules: np.ndarray
    pose: np.ndarray
    motion: Motion
    module_px: float
    region: Region
    window: Window
    image: Images

    @property
    def size(self) -> int:
        return len(self.modules)

    @property
    def in_cells(self) -> np.ndarray:
        """The true pose in cells of the image, as the stages take it."""
        return self.region.from_px @ self.pose

    def modules_off(self, in_cells: np.ndarray) -> float:
        """How far the worst corner of a pose in cells is from the truth [modules]."""
        pose = np.linalg.inv(self.region.from_px) @ in_cells
        return float(np.abs(corners(pose, self.size) - corners(self.pose, self.size)).max()) / self.module_px


@pytest.fixture(scope="session")
def workspace():
    """One for all tests: its buffers are made once."""
    backend = get_backend("warp")
    backend.load("cpu", LAUNCHED)
    return Workspace(backend, "cpu")


@pytest.fixture(scope="session")
def see(workspace):
    """Make what there is to see of a simulation, optionally at another time than its middle."""

    def seen(made, *, middle=None, travel_px=2.0, name="truth"):
        cfg = AlignConfig()
        truth = made.truth[name]
        time = middle_us(made) if middle is None else middle
        pose, motion = at(truth, "H", time), motion_at(truth, time)
        space = qr.space(truth["version"])
        window = window_of(made, travel_px, middle=time)
        region = region_around(pose, space, cfg, margin_px=4.0)
        deposited = deposit(window, motion, region, workspace=workspace)
        image = sharpen(deposited, motion, region, [(0.0, 0.0)], workspace=workspace)
        return Seen(
            space=space,
            modules=1.0 - 2.0 * truth["modules"],
            pose=pose,
            motion=motion,
            module_px=made.scene.codes[0].module_px,
            region=region,
            window=window,
            # a copy: two that are seen may be used side by side
            image=Images(workspace.put(workspace.get(image.device).copy())),
        )

    return seen
