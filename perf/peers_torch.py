"""The same computations as a user of PyTorch writes them, one thread, with derivatives by autograd.

torch is imported when a peer is prepared: it need not be installed.  Arrays become tensors before that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from problems import Problem

Run = Callable[[], list[Any]]


def _tensors(*arrays: Any) -> list[Any]:
    import torch

    torch.set_num_threads(1)
    return [torch.from_numpy(array.copy()).to(torch.get_default_device()) for array in arrays]


def _window_of_events(window_ptr: np.ndarray) -> Any:
    (window,) = _tensors(np.repeat(np.arange(len(window_ptr) - 1), np.diff(window_ptr)))
    return window


def bin_events(problem: Problem) -> Run:
    x, y, weight = _tensors(*problem.inputs[:3])
    window = _window_of_events(problem.inputs[3])
    (image,) = _tensors(*problem.outputs)

    def run() -> list[Any]:
        row, column = (y + 0.5).floor().long(), (x + 0.5).floor().long()
        inside = (row >= 0) & (column >= 0) & (row < image.shape[1]) & (column < image.shape[2])
        row, column = row.clamp(0, image.shape[1] - 1), column.clamp(0, image.shape[2] - 1)
        image.index_put_((window, row, column), weight * inside, accumulate=True)
        return [image]

    return run


def _taps(offset: Any, cfg: Any) -> tuple[Any, Any]:
    """Profile and slope at the taps around events, (E, taps) each."""
    import torch

    r = torch.arange(-cfg.reach, cfg.reach + 1, dtype=offset.dtype) - offset[:, None]
    q = (1 - r * r / cfg.radius_px**2).clamp(min=0)
    gauss = cfg.norm * torch.exp(-0.5 * r * r / cfg.epsilon_px**2)
    return gauss * q * q, -r * gauss * q * (q / cfg.epsilon_px**2 + 4 / cfg.radius_px**2)


def _splat(events: list[Any], window: Any, motion: Any, lag: Any, frame: Any, image: Any, cfg: Any) -> tuple:
    """Flat indices and shares of all taps of all events, (E taps taps,) each."""
    import torch

    x, y, t, weight = events
    height, width = image.shape[1:]
    velocity, corner = motion[window], frame[window]
    cx = (x - t * velocity[:, 0] - corner[:, 0] + 0.5) / corner[:, 2] - 0.5
    cy = (y - t * velocity[:, 1] - corner[:, 1] + 0.5) / corner[:, 2] - 0.5
    column, row = (cx.detach() + 0.5).floor(), (cy.detach() + 0.5).floor()
    (gx, sx), (gy, sy) = _taps(cx - column, cfg), _taps(cy - row, cfg)

    heading = torch.nn.functional.normalize(motion.detach(), dim=1)[window]
    lag_px = torch.where(weight > 0, lag[window, 0], lag[window, 1])[:, None] * heading
    along = weight[:, None] * (gx - lag_px[:, :1] * sx)
    across = -weight[:, None] * lag_px[:, 1:] * gx
    shares = gy[:, :, None] * along[:, None] + sy[:, :, None] * across[:, None]

    steps = torch.arange(-cfg.reach, cfg.reach + 1)
    rows, columns = row.long()[:, None] + steps, column.long()[:, None] + steps
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None]
    flat = (window[:, None] * height + rows.clamp(0, height - 1))[:, :, None] * width
    flat = flat + columns.clamp(0, width - 1)[:, None]
    return flat.reshape(-1), (shares * inside).reshape(-1)


def _splat_arguments(problem: Problem) -> tuple[list[Any], Any, Any, Any, Any, Any]:
    x, y, t, weight, window_ptr, motion, lag, frame = problem.inputs[:8]
    *events, motion, lag, frame = _tensors(x, y, t, weight, motion, lag, frame)
    return events, _window_of_events(window_ptr), motion, lag, frame, problem.tail[0]


def splat_index_put(problem: Problem) -> Run:
    *arguments, cfg = _splat_arguments(problem)
    (image,) = _tensors(*problem.outputs)

    def run() -> list[Any]:
        flat, shares = _splat(*arguments, image, cfg)
        image.view(-1).index_put_((flat,), shares, accumulate=True)
        return [image]

    return run


def splat_scatter_add(problem: Problem) -> Run:
    *arguments, cfg = _splat_arguments(problem)
    (image,) = _tensors(*problem.outputs)

    def run() -> list[Any]:
        image.view(-1).scatter_add_(0, *_splat(*arguments, image, cfg))
        return [image]

    return run


def splat_adjoint(problem: Problem) -> Run:
    """Give the time of the backward pass alone, the graph being there."""
    import torch

    events, window, motion, lag, frame, cfg = _splat_arguments(problem)
    (adj_image,) = _tensors(problem.inputs[8])
    varied = events[3], motion, events[0], events[1]
    for tensor in varied:
        tensor.requires_grad_()
    flat, shares = _splat(events, window, motion, lag, frame, adj_image, cfg)
    image = torch.zeros(adj_image.numel(), dtype=shares.dtype).scatter_add(0, flat, shares)

    def run() -> list[Any]:
        return list(torch.autograd.grad(image, varied, adj_image.view(-1), retain_graph=True))

    return run


def _render(grid: Any, to_grid: Any, outside: Any, height: int, width: int) -> Any:
    import torch

    y, x = torch.arange(height, dtype=grid.dtype)[:, None], torch.arange(width, dtype=grid.dtype)
    w = to_grid[:, :, None, None]
    u, v = w[:, 0] * x + (w[:, 1] * y + w[:, 2]), w[:, 3] * x + (w[:, 4] * y + w[:, 5])
    places = torch.stack([2 * u / (grid.shape[2] - 1) - 1, 2 * v / (grid.shape[1] - 1) - 1], dim=-1)
    beyond = outside[:, None, None]
    # beyond the grid it takes nodes to be 0
    seen = torch.nn.functional.grid_sample((grid - beyond)[:, None], places, align_corners=True)
    return seen[:, 0] + beyond


def render_code(problem: Problem) -> Run:
    arguments = _tensors(*problem.inputs[:3])
    _, height, width = problem.outputs[0].shape
    return lambda: [_render(*arguments, height, width)]


def render_adjoint(problem: Problem) -> Run:
    """Give the time of the backward pass alone, the graph being there."""
    import torch

    grid, to_grid, outside, adj_image = _tensors(*problem.inputs[:3], problem.inputs[4])
    varied = grid.requires_grad_(), to_grid.requires_grad_()
    image = _render(grid, to_grid, outside, *adj_image.shape[1:])
    return lambda: list(torch.autograd.grad(image, varied, adj_image, retain_graph=True))


def _slope(image: Any, axis: int) -> Any:
    """Central difference; beyond the border lies the border's own pixel again."""
    import torch

    first, last = image.narrow(axis, 0, 1), image.narrow(axis, -1, 1)
    padded = torch.cat([first, image, last], axis)
    size = image.shape[axis]
    return 0.5 * (padded.narrow(axis, 2, size) - padded.narrow(axis, 0, size))


def cost(problem: Problem) -> Run:
    """Give the time of forward and backward pass, as each step of an optimiser has them."""
    import torch

    from evqr_kernels import SplatConfig

    x, y, t, weight, window_ptr, motion, lag, frame, grid, to_grid, outside, _, displacement = problem.inputs
    *events, motion, lag, frame = _tensors(x, y, t, weight, motion, lag, frame)
    grid, to_grid, outside, displacement, image = _tensors(
        grid, to_grid, outside, displacement, problem.outputs[0]
    )
    window, cfg = _window_of_events(window_ptr), SplatConfig()
    varied = [t.requires_grad_() for t in (events[3], motion, grid, to_grid, displacement)]

    def run() -> list[Any]:
        flat, shares = _splat(events, window, motion, lag, frame, image, cfg)
        splatted = torch.zeros(image.numel(), dtype=shares.dtype).scatter_add_(0, flat, shares)
        luminance = _render(grid, to_grid, outside, *image.shape[1:])
        m = displacement[:, :, None, None]
        residual = (
            m[:, 0] * _slope(luminance, 2) + m[:, 1] * _slope(luminance, 1) + splatted.view(image.shape)
        )
        return list(torch.autograd.grad(0.5 * (residual * residual).sum(), varied))

    return run
