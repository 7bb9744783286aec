"""The operations as differentiable PyTorch functions, on the caller's device and stream.

    image = evqr_kernels.torch.splat_events(x, y, t, weight, window_ptr, motion, shape=(Y, X))
    (-image.var()).backward()           # motion.grad: the adjoint by hand

Shapes, dtypes, units, cost and determinism are those of the functions of the same names in `evqr_kernels`;
here is what differs for all of them.

Tensors are not copied: Warp's kernels read and write their memory, on the CPU or an NVIDIA GPU, in PyTorch's
current stream, and nothing waits for them.  All tensors of a call are on one device.  Results are new tensors
there, never accumulated into; scratch is made there too.

Saved for the backward pass are the inputs alone, as PyTorch saves them: not copied, and not to be changed in
place until then.  It makes adjoints in all inputs that an operation is differentiable in, wanted or not.
Adjoints are not differentiable once more.

They raise TypeError and ValueError as those functions do, also for a tensor that is not contiguous, is on
another device than the first, or requires a gradient that the operation does not have.  But they look at no
values of tensors (that would wait for the device): windows, indices and frames must be right.
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
    """Scatter transported events as splats: `evqr_kernels.splat_events`.

    Parameters
    ----------
    x, y, t, weight, window_ptr, motion, lag, frame, cfg
        As there.
    shape : (int, int)
        (Y, X) of the image.

    Returns
    -------
    image : (B, Y, X) float [weight]
        A new one.  Differentiable in ``weight`` and ``motion``; the direction
        of lags counts as fixed.

    Notes
    -----
    The backward pass is `evqr_kernels.splat_events_adjoint`.
    """
    lag = _rows((0.0, 0.0), motion) if lag is None else lag
    frame = _rows((0.0, 0.0, 1.0), motion) if frame is None else frame
    rule = differentiable.splat_events(shape, cfg or SplatConfig())
    return _apply(rule, x, y, t, weight, window_ptr, motion, lag, frame)


def deposit_events(
    x: Tensor, y: Tensor, t: Tensor, weight: Tensor, window_ptr: Tensor, motion: Tensor, *,
    shape: tuple[int, int], frame: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Share transported events among four cells each: `evqr_kernels.deposit_events`.

    Parameters
    ----------
    x, y, t, weight, window_ptr, motion, frame
        As there.
    shape : (int, int)
        (Y, X) of the images.

    Returns
    -------
    deposit : (B, 2, Y, X) float [weight]
        A new one.  Differentiable in ``weight``.

    Notes
    -----
    The backward pass is `evqr_kernels.deposit_events_adjoint`.
    """
    frame = _rows((0.0, 0.0, 1.0), motion) if frame is None else frame
    return _apply(differentiable.deposit_events(shape), x, y, t, weight, window_ptr, motion, frame)


def lag_operator(
    deposit: Tensor, deposit_idx: Tensor, direction: Tensor, lag: Tensor, taps: Tensor
) -> Tensor:
    """Blur deposits and undo pixels that lag: `evqr_kernels.lag_operator`.

    Parameters
    ----------
    deposit, deposit_idx, direction, lag, taps
        As there.

    Returns
    -------
    image : (N, Y, X) float [weight]
        A new one.  Differentiable in ``deposit``.

    Notes
    -----
    The backward pass is `evqr_kernels.lag_operator_adjoint`.
    """
    return _apply(differentiable.lag_operator(), deposit, deposit_idx, direction, lag, taps)


def render_code(
    grid: Tensor, to_grid: Tensor, outside: Tensor, *, shape: tuple[int, int], sigma: float = 0.0
) -> Tensor:
    """Image of a grid of modules: `evqr_kernels.render_code`.

    Parameters
    ----------
    grid, to_grid, outside, sigma
        As there.
    shape : (int, int)
        (Y, X) of the image.

    Returns
    -------
    image : (B, Y, X) float [of grid]
        A new one.  Differentiable in ``grid`` and ``to_grid``.

    Notes
    -----
    The backward pass is `evqr_kernels.render_code_adjoint`.
    """
    return _apply(differentiable.render_code(shape, sigma), grid, to_grid, outside)


def brightness_residual(luminance: Tensor, events_image: Tensor, motion: Tensor) -> Tensor:
    """Slope of the luminance along the motion, plus the events: `evqr_kernels.brightness_residual`.

    Parameters
    ----------
    luminance, events_image, motion
        As there.

    Returns
    -------
    residual : (B, Y, X) float [of luminance]
        A new one.  Differentiable in ``luminance``, ``events_image`` and ``motion``.

    Notes
    -----
    The backward pass is `evqr_kernels.brightness_residual_adjoint` in luminance and motion; events images get
    the residual's adjoint as it is.
    """
    return _apply(differentiable.brightness_residual(), luminance, events_image, motion)


def brightness_cost(
    luminance: Tensor, events_image: Tensor, motion: Tensor, *, mask: Tensor | None = None
) -> Tensor:
    """Half the weighted sum of squared residuals: `evqr_kernels.brightness_cost`.

    Parameters
    ----------
    luminance, events_image, motion, mask
        As there; weights of the mask below 0 are not looked for.

    Returns
    -------
    cost : (B,) float [luminance^2]
        A new one.  Differentiable in ``luminance``, ``events_image`` and ``motion``; a mask is held.

    Notes
    -----
    The backward pass is `evqr_kernels.brightness_cost_adjoint`.
    """
    mask = torch.ones_like(luminance) if mask is None else mask
    return _apply(differentiable.brightness_cost(), luminance, events_image, motion, mask)


def sample_moments(
    image: Tensor, image_idx: Tensor, pose: Tensor, points: Tensor, table: Tensor, *,
    active: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Moments of images seen through poses: `evqr_kernels.sample_moments`.

    Parameters
    ----------
    image, image_idx, pose, points, table, active
        As there.

    Returns
    -------
    moments : (N, C + 1) float [weight x table, weight^2]
        New ones.  Differentiable in ``image``.

    Notes
    -----
    The backward pass is `evqr_kernels.sample_moments_adjoint`.
    """
    if active is None:
        active = torch.ones_like(_tensor("image_idx", image_idx))
    return _apply(differentiable.sample_moments(), image, image_idx, pose, active, points, table)


def _tensor(name: str, value: Any) -> Tensor:
    if not isinstance(value, torch.Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(value).__name__}")
    return value


def _rows(row: Sequence[float], motion: Tensor) -> Tensor:
    """Repeat a row for each window that there is a motion of."""
    return _tensor("motion", motion).new_tensor(row).repeat(*motion.shape[:1], 1)


def _apply(rule: Rule, *tensors: Tensor) -> Tensor:
    """Check tensors against a rule, and apply it."""
    named = dict(zip(rule.inputs, tensors, strict=True))
    device = _tensor(rule.inputs[0], tensors[0]).device
    for name, tensor in named.items():
        _tensor(name, tensor)
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
        # of a sum, say, it is one number seen many times over
        adj = adj.contiguous()
        sizes = _shapes(rule, tensors)
        adjoints = [_empty(sizes[name], tensors) for name in rule.varied]
        scratch = [_empty(shape, tensors) for shape in rule.adjoint_scratch(sizes)]
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
