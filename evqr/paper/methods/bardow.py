"""Row 2 of the paper's table: optical flow and intensity at once, from a sliding window of K slices.

Bardow, Davison, Leutenegger, "Simultaneous Optical Flow and Intensity Estimation from an Event Camera" (CVPR
2016) minimise over the logarithmic luminance L and the flow u of every pixel in every slice

    lambda_1 |grad u| + lambda_2 |du/dt| + lambda_3 |grad L| + lambda_4 |grad L . u + dL/dt|
        + lambda_5 h(L - L at the last event) + sum over events |L - L at the event before - theta rho|

where h is zero up to the threshold: a pixel that is silent has changed by less.  The optical-flow term is
linearised, and the cost is minimised by the preconditioned primal-dual method of Pock and Chambolle (2011).
The paper runs it with its authors' weights and K = 128 slices of the length of its own windows.  The weights
here are from memory of that text and not checked against it: no public code was found that repeats them.

Where it is made to end on a CPU, and what the texts leave open:

- slices hold ``reduction`` x ``reduction`` pixels, and only the part of the view where events are;
- each window starts from nothing (L = 0, u = 0); the flow term is linearised anew every few iterations;
- several events of a pixel in one slice count as one step of their sum;
- the image is that of the middle slice, which has events on either side;
- it has converged where a step is smaller than ``tolerance`` of the luminance it has reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.paper.methods.method import Outcome, Watch
from evqr_kernels.registry import get_backend

BUSY_SHARE = 0.01
"""Share of the events that may lie outside of the part of the view on either side."""


@dataclass(frozen=True, kw_only=True)
class BardowConfig:
    """Settings.

    Attributes
    ----------
    slices : int
        K.
    weights : (float, float, float, float, float)
        lambda_1 to lambda_5, see above.
    threshold : float [log units]
        Theta, of an event.
    reduction : int
        Pixels a side that make one.
    relinearise : int
        Iterations between two linearisations of the flow term.
    tolerance : float
        Step of L, relative to L, below which it has converged.
    max_iterations : int
        At most so many.
    """

    slices: int = 128
    weights: tuple[float, float, float, float, float] = (0.02, 0.05, 0.02, 0.2, 0.1)
    threshold: float = 0.2
    reduction: int = 2
    relinearise: int = 5
    tolerance: float = 0.03
    max_iterations: int = 60


class Bardow:
    """Luminance and flow from many windows (Bardow et al., CVPR 2016); the code is found in the image.

    Parameters
    ----------
    cfg : BardowConfig, optional
        Settings.
    reduction : int, optional
        In place of the configuration's [px].
    iterations : int, optional
        In place of the configuration's ``max_iterations``.
    device : str
        Of Warp: "cpu", "cuda:0", ...
    """

    takes: Literal["events"] = "events"
    matched = True

    def __init__(
        self,
        cfg: BardowConfig | None = None,
        *,
        reduction: int | None = None,
        iterations: int | None = None,
        device: str = "cpu",
    ) -> None:
        cfg = cfg or BardowConfig()
        cfg = cfg if reduction is None else replace(cfg, reduction=reduction)
        self.cfg = cfg if iterations is None else replace(cfg, max_iterations=iterations)
        self.windows = self.cfg.slices
        self._device = device

    def read(self, seen: Window, watch: Watch) -> Outcome:
        """Iterate until it has converged, then on for as long as the watch wants to see more."""
        cfg = self.cfg
        volume = Volume(seen, cfg, self._device)
        final: NDArray[np.float32] | None = None
        for iteration in range(1, cfg.max_iterations + 1):
            if (iteration - 1) % cfg.relinearise == 0:
                volume.relinearise()
            change = volume.iterate()
            image = volume.image()
            if final is None and change < cfg.tolerance:
                final = image
            enough = watch(iteration, image, final is not None)
            if final is not None and enough:
                break
        image = volume.image() if final is None else final
        return Outcome(image=image, converged=final is not None, windows=self.windows)


class Volume:
    """All slices of one window, on a device.

    Attributes
    ----------
    luminance : (Y, X, K) float32
        Its logarithm.
    flow_x, flow_y : (Y, X, K) float32 [px per slice]
        Optical flow, column and row.
    """

    def __init__(self, window: Window, cfg: BardowConfig, device: str) -> None:
        get_backend("warp")  # it starts Warp, in silence
        import warp as wp

        self._cfg, self._device, self._window = cfg, device, window
        step = cfg.reduction
        self._x, width = _busy(window.x, window.width, step)
        self._y, height = _busy(window.y, window.height, step)
        x, y = (window.x.astype(np.intp) - self._x) // step, (window.y.astype(np.intp) - self._y) // step
        k = ((window.t / window.seconds + 0.5) * cfg.slices).astype(np.intp).clip(0, cfg.slices - 1)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        shape = (height, width, cfg.slices)
        address = np.ravel_multi_index((y[inside], x[inside], k[inside]), shape)
        size = int(np.prod(shape))
        # a bin of several pixels sees the mean of their steps
        total = np.bincount(address, weights=window.p[inside], minlength=size) / step**2
        count = np.bincount(address, minlength=size)

        def put(array: NDArray[Any], dtype: Any) -> Any:
            return wp.array(array.reshape(shape), dtype=dtype, device=device)

        self._events = put(total.astype(np.float32), wp.float32)
        self._seen = put((count > 0).astype(np.uint8), wp.uint8)
        fields = [wp.zeros(shape, dtype=wp.float32, device=device) for _ in range(9)]
        self.luminance, self.flow_x, self.flow_y = fields[:3]
        self._ahead, self._linear = fields[3:6], fields[6:]
        self._dual = wp.zeros((10, *shape), dtype=wp.float32, device=device)
        self._weights = wp.array(cfg.weights, dtype=wp.float32, device=device)
        self._previous = self._middle()

    def relinearise(self) -> None:
        """Linearise the flow term at what has been reached."""
        import warp as wp

        for linear, field in zip(self._linear, (self.luminance, self.flow_x, self.flow_y), strict=True):
            wp.copy(linear, field)

    def iterate(self) -> float:
        """Iterate once; give the step of the middle slice, relative to it."""
        import warp as wp

        from evqr.paper.methods import bardow_kernel

        shape = self.luminance.shape[:2]
        duals = [*self._ahead, *self._linear, self._events, self._seen, self._weights, self._cfg.threshold]
        wp.launch(bardow_kernel.raise_duals, shape, [*duals, self._dual], device=self._device)
        primals = [self.luminance, self.flow_x, self.flow_y, *self._ahead]
        wp.launch(
            bardow_kernel.lower_primals,
            shape,
            [self._dual, *self._linear, self._seen, *primals],
            device=self._device,
        )
        middle = self._middle()
        change = float(np.linalg.norm(middle - self._previous)) / max(float(np.linalg.norm(middle)), 1e-12)
        self._previous = middle
        return change

    def _middle(self) -> NDArray[np.float32]:
        middle = np.asarray(self.luminance.numpy()[:, :, self._cfg.slices // 2], np.float32)
        return middle.copy()

    def image(self) -> NDArray[np.float32]:
        """Luminance (height, width) of the middle slice, 0 outside the part of the view that is busy."""
        step = self._cfg.reduction
        image = np.zeros((self._window.height, self._window.width), np.float32)
        fine = self._previous.repeat(step, axis=0).repeat(step, axis=1)
        part = image[self._y :, self._x :][: fine.shape[0], : fine.shape[1]]
        part[:] = fine[: part.shape[0], : part.shape[1]]
        return image


def _busy(place: NDArray[np.float32], extent: int, step: int) -> tuple[int, int]:
    """First pixel of the part where most events are, and its number of bins."""
    low, high = np.quantile(place, (BUSY_SHARE, 1.0 - BUSY_SHARE)) if len(place) else (0.0, 0.0)
    first = max(0, int(low) // step * step - 4 * step)
    last = min(extent, int(high) + 4 * step)
    return first, max(1, -(-(last - first) // step))
