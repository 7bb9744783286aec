"""Hypotheses of all windows scored at once, by what all symbols of their size show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig
from evqr.search.models import Models, models
from evqr.search.pyramid import Places, Pyramid
from evqr.workspace import Images, Step, Workspace

LEAST_ROOM = 64
"""Room for hypotheses grows from this in powers of two, so that what was recorded for it is used again."""


class Score(Step):
    """Scores so many poses, on some images."""

    def __init__(
        self, images: Images, room: int, known: Models, cfg: AlignConfig, workspace: Workspace
    ) -> None:
        super().__init__(workspace)
        staging = self._staging
        self._images, self._ridge = images.device, cfg.ridge
        self._window, self._size = (staging.input((room,), np.int32) for _ in range(2))
        self._part = staging.input((room, 3), np.int32)
        self._pose, self._score = staging.input((room, 9)), staging.output((room, 3))
        self._nothing = len(known.ptr) - 1
        self._ptr = workspace.table((known.name, "ptr"), known.ptr)
        self._points = workspace.table((known.name, "points"), known.points)

    def write(self, places: Places, size: NDArray[np.intp], pose: NDArray[np.float64]) -> None:
        """Say which poses [cells] of which sizes, and where they are; other rows are of nothing."""
        count = len(size)
        self._window.host[:count], self._part.host[:count] = places.image_idx, places.image_part
        self._size.host[:count], self._size.host[count:] = size, self._nothing
        self._pose.host[:count] = pose.reshape(-1, 9)

    def launch(self) -> None:
        """Launch the kernel."""
        self._backend.score_poses(
            self._images, self._window.device, self._part.device, self._pose.device, self._size.device,
            self._ptr, self._points, self._ridge, self._score.device,
        )  # fmt: skip

    def read(self) -> NDArray[np.float32]:
        """Wait for the device and give the scores (room, 3), until the next ones."""
        return self._score.read()


def score(
    pyramid: Pyramid,
    window: NDArray[np.intp],
    size: NDArray[np.intp],
    pose: NDArray[np.float64],
    cfg: AlignConfig,
    *,
    workspace: Workspace,
    known: Models | None = None,
) -> NDArray[np.float32]:
    """Score hypotheses by their finder patterns and timing alone, as they are.

    Parameters
    ----------
    pyramid : Pyramid
        Of the windows.
    window : (N,) intp
        Which of them each is in.
    size : (N,) intp
        Which of `evqr.search.models.sizes` each is of, or which of the models.
    pose : (N, 3, 3) float64
        Code coordinates to px, affine.
    cfg : AlignConfig
        Settings.
    workspace : Workspace
        Buffers.
    known : Models
        Default: those of the sizes.

    Returns
    -------
    scores : (N, 2) float32
        Correlation with the finder patterns, and with the timing patterns, for one gain.
    """
    room = max(LEAST_ROOM, 1 << (len(size) - 1).bit_length())
    which = known or models()
    step = pyramid.images.once(
        ("score", room, which.name, cfg.ridge), lambda: Score(pyramid.images, room, which, cfg, workspace)
    )
    places = pyramid.places(window, pose, cfg.cells_a_module)
    step.write(places, size, places.in_cells(pose))
    step.run()
    return step.read()[: len(size), 1:].copy()
