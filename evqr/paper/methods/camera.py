"""Row 1 of the paper's table, "Image": a frame camera on the same scene, and an ordinary decoder."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evqr.paper.methods.method import Outcome, Watch


class Camera:
    """One frame as it is (Nagata et al. 2020, section 4.3): section 4.4's matching and zxing-cpp read it."""

    takes: Literal["frame"] = "frame"
    windows = 1
    matched = True

    def read(self, seen: NDArray[np.uint8], watch: Watch) -> Outcome:
        """Give the frame back."""
        image: NDArray[Any] = seen.astype(np.float32)
        watch(1, image, True)
        return Outcome(image=image)
