"""The operations as differentiable PyTorch functions, on the caller's device and stream.

    image = evqr_kernels.torch.splat_events(x, y, t, weight, window_ptr, motion, shape=(Y, X))
    (-image.var()).backward()           # motion.grad: the adjoint by hand

Tensors are not copied: kernels read and write their memory, on the CPU or a GPU, in PyTorch's current stream.
One that is not contiguous is refused rather than copied.  Shapes and units are those of the functions of the
same names in `evqr_kernels`; float32 or float64, indices int32.  They raise TypeError and ValueError as those
do, but look at no values (that would wait for the device): windows and indices must be right.

Adjoints are not differentiable once more.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from evqr_kernels import differentiable
from evqr_kernels.backend import get_backend
from evqr_kernels.config import SplatConfig
from evqr_kernels.differentiable import Rule, Shape

__all__ = [
    "brightness_cost",
    "brightness_residual",
    "deposit_events",
    "lag_operator",
    "render_code",
    "sample_moments",
    "splat_events",
]

Tensor = torch.Tensor

_DTYPES = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32}


def splat_events(
    x: Tensor, y: Tensor, t: Tensor, weight: Tensor, window_ptr: Tensor, motion: Tensor, *,
    shape: tuple[int, int], lag: Tensor | None = None, frame: Tensor | None = None,
    cfg: SplatConfig | None = None,
) -> Tensor:  # fmt: skip
    """Scatter transported events as splats (B, Y, X); differentiable in weight and motion."""
    batch = len(motion)
    lag = motion.new_zeros((batch, 2)) if lag is None else lag
    rule = differentiable.splat_events(shape, cfg or SplatConfig())
    return _apply(rule, x, y, t, weight, window_ptr, motion, lag, _frame(frame, motion))


def deposit_events(
    x: Tensor, y: Tensor, t: Tensor, weight: Tensor, window_ptr: Tensor, motion: Tensor, *,
    shape: tuple[int, int], frame: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Share transported events among four cells each (B, 2, Y, X); differentiable in the weight."""
    rule = differentiable.deposit_events(shape)
    return _apply(rule, x, y, t, weight, window_ptr, motion, _frame(frame, motion))


def lag_operator(
    deposit: Tensor, deposit_idx: Tensor, direction: Tensor, lag: Tensor, taps: Tensor
) -> Tensor:
    """Blur deposits and undo pixels that lag (N, Y, X); differentiable in the deposit."""
    return _apply(differentiable.lag_operator(), deposit, deposit_idx, direction, lag, taps)


def render_code(
    grid: Tensor, to_grid: Tensor, outside: Tensor, *, shape: tuple[int, int], sigma: float = 0.0
) -> Tensor:
    """Image of a grid of modules (B, Y, X); differentiable in grid and map."""
    return _apply(differentiable.render_code(shape, sigma), grid, to_grid, outside)


def brightness_residual(luminance: Tensor, events_image: Tensor, motion: Tensor) -> Tensor:
    """Slope of the luminance along the motion, plus the events (B, Y, X); differentiable in all three."""
    return _apply(differentiable.brightness_residual(), luminance, events_image, motion)


def brightness_cost(
    luminance: Tensor, events_image: Tensor, motion: Tensor, *, mask: Tensor | None = None
) -> Tensor:
    """Half the sum of squared residuals, weighted by a mask (B,); differentiable in all but the mask."""
    mask = torch.ones_like(luminance) if mask is None else mask
    return _apply(differentiable.brightness_cost(), luminance, events_image, motion, mask)


def sample_moments(
    image: Tensor, image_idx: Tensor, pose: Tensor, points: Tensor, table: Tensor, *,
    active: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Moments of images seen through poses (N, C + 1); differentiable in the image."""
    active = torch.ones_like(image_idx) if active is None else active
    return _apply(differentiable.sample_moments(), image, image_idx, pose, active, points, table)


def _frame(frame: Tensor | None, motion: Tensor) -> Tensor:
    return motion.new_tensor([0.0, 0.0, 1.0]).repeat(len(motion), 1) if frame is None else frame


def _apply(rule: Rule, *tensors: Tensor) -> Tensor:
    """Check tensors against a rule, and apply it."""
    named = dict(zip(rule.inputs, tensors, strict=True))
    device = tensors[0].device
    for name, tensor in named.items():
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f"{name} must be a torch.Tensor, got {type(tensor).__name__}")
        if tensor.dtype not in _DTYPES:
            raise TypeError(f"{name} must be float32, float64 or int32, got {tensor.dtype}")
        if tensor.device != device:
            raise ValueError(f"{name} must be on {device} like the tensors before it, got {tensor.device}")
        if not tensor.is_contiguous():
            raise ValueError(f"{name} must be contiguous, it is not copied: call {name}.contiguous()")
        if tensor.requires_grad and name not in (*rule.varied, rule.added):
            raise ValueError(
                f"{name} must not require a gradient: {rule.op} has one in {', '.join(rule.varied)}"
            )
    rule.check(_shapes(rule, tensors), {name: _DTYPES[tensor.dtype] for name, tensor in named.items()})
    return _Function.apply(rule, *tensors)


class _Function(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rule: Rule, *tensors: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        sizes = _shapes(rule, tensors)
        out = _empty(rule.output(sizes), tensors)
        scratch = [_empty(shape, tensors) for shape in rule.forward_scratch(sizes)]
        with _stream(out.device):
            rule.forward(get_backend("warp"), _views(tensors), _views(scratch), _view(out))
        ctx.rule = rule
        ctx.save_for_backward(*tensors)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, adj: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        rule, tensors = ctx.rule, ctx.saved_tensors
        named = dict(zip(rule.inputs, tensors, strict=True))
        # of a sum, say, it is one number seen many times over
        adj = adj.contiguous()
        adjoints = [torch.empty_like(named[name]) for name in rule.varied]
        scratch = [_empty(shape, tensors) for shape in rule.adjoint_scratch(_shapes(rule, tensors))]
        with _stream(adj.device):
            rule.adjoint(get_backend("warp"), _views(tensors), _view(adj), _views(scratch), _views(adjoints))
        result: dict[str | None, Tensor] = dict(zip(rule.varied, adjoints, strict=True))
        result[rule.added] = adj
        return None, *(result.get(name) for name in rule.inputs)


def _shapes(rule: Rule, tensors: Sequence[Tensor]) -> dict[str, Shape]:
    return {name: tuple(tensor.shape) for name, tensor in zip(rule.inputs, tensors, strict=True)}


def _empty(shape: Shape, like: Sequence[Tensor]) -> Tensor:
    floats = next(tensor for tensor in like if tensor.is_floating_point())
    return floats.new_empty(shape)


def _view(tensor: Tensor) -> wp.array:
    """Give the same memory as a Warp array."""
    return wp.from_torch(tensor.detach())


def _views(tensors: Sequence[Tensor]) -> list[wp.array]:
    return [_view(tensor) for tensor in tensors]


@contextlib.contextmanager
def _stream(device: torch.device):
    """Launch where PyTorch does: its current stream of the device."""
    get_backend("warp")  # initialises Warp
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device))):
        yield
