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
another device than the first, or requires a gradient that the operation does not have.  Of tensors on a GPU
they look at no values, for that would wait for the device: where windows, indices or extents are wrong there,
results are wrong too, but nothing outside the tensors is read or written.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from evqr_kernels.differentiable import Front, Rule, Shape
from evqr_kernels.operation import Input
from evqr_kernels.registry import get_backend

__all__ = [
    "brightness_cost",
    "brightness_residual",
    "deposit_events",
    "event_histogram",
    "lag_operator",
    "render_code",
    "sample_moments",
    "splat_events",
    "time_surface",
    "voxel_grid",
]

Tensor = torch.Tensor

_DTYPES = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32}


def _tensor(name: str, value: Any) -> Tensor:
    if not isinstance(value, torch.Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(value).__name__}")
    return value


def _default(array: Input, row: list[float], shape: Shape, like: Tensor) -> Tensor:
    """Make what stands for an input that is not given."""
    dtype = torch.int32 if array.integer else like.dtype
    return torch.tensor(row, dtype=dtype, device=like.device).expand(shape).contiguous()


def _function(op: str) -> Callable[..., Tensor]:
    """Make the differentiable function of an operation."""
    front = Front(op, "Tensor")

    def function(*args: Any, **kwargs: Any) -> Tensor:
        rule, arrays = front.bound(args, kwargs, _tensor, _default)
        return _apply(rule, *arrays)

    return front.dress(function)


def _apply(rule: Rule, *tensors: Tensor) -> Tensor:
    """Check tensors against a rule, and apply it."""
    named = dict(zip(rule.inputs, tensors, strict=True))
    device = _tensor(rule.inputs[0], tensors[0]).device
    for name, tensor in named.items():
        _tensor(name, tensor)
        if tensor.dtype not in _DTYPES:
            remedy = "" if tensor.is_floating_point() else f": give {name}.int()"
            raise TypeError(f"{name} must be float32, float64 or int32, got {tensor.dtype}{remedy}")
        if tensor.device != device:
            raise ValueError(f"{name} must be on {device} like the tensors before it, got {tensor.device}")
        if not tensor.is_contiguous():
            raise ValueError(f"{name} must be contiguous, it is not copied: call {name}.contiguous()")
        if tensor.requires_grad and name not in (*rule.varied, *rule.added):
            has = f"one in {', '.join(rule.varied)}" if rule.differentiable else "none"
            raise ValueError(f"{name} must not require a gradient: {rule.op} has {has}")
    if device.type == "cpu":
        rule.check_host({name: tensor.detach().numpy() for name, tensor in named.items()})
    else:
        rule.check(_shapes(rule, tensors), {name: _DTYPES[tensor.dtype] for name, tensor in named.items()})
    return _Function.apply(rule, *tensors) if rule.differentiable else _computed(rule, tensors)


def _computed(rule: Rule, tensors: Sequence[Tensor]) -> Tensor:
    sizes = _shapes(rule, tensors)
    out = _empty(rule.output(sizes), tensors, integer=rule.counts)
    tile = get_backend("warp").tile(rule.op, _place(out))
    scratch = [_empty(shape, tensors) for shape in rule.forward_scratch(sizes, tile)]
    with _stream(out.device):
        rule.forward(get_backend("warp"), _views(tensors), _views(scratch), _view(out))
    return out


class _Function(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rule: Rule, *tensors: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        out = _computed(rule, tensors)
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
        tile = get_backend("warp").tile(rule.adjoint_operation.name, _place(adj))
        scratch = [_empty(shape, tensors) for shape in rule.adjoint_scratch(sizes, tile)]
        with _stream(adj.device):
            rule.adjoint(get_backend("warp"), _views(tensors), _view(adj), _views(scratch), _views(adjoints))
        result = dict(zip(rule.varied, adjoints, strict=True)) | dict.fromkeys(rule.added, adj)
        return None, *(result.get(name) for name in rule.inputs)


def _shapes(rule: Rule, tensors: Sequence[Tensor]) -> dict[str, Shape]:
    return {name: tuple(tensor.shape) for name, tensor in zip(rule.inputs, tensors, strict=True)}


def _empty(shape: Shape, like: Sequence[Tensor], *, integer: bool = False) -> Tensor:
    floats = next(tensor for tensor in like if tensor.is_floating_point())
    return floats.new_empty(shape, dtype=torch.int32 if integer else None)


def _view(tensor: Tensor) -> wp.array:
    """Give the same memory as a Warp array."""
    return wp.from_torch(tensor.detach())


def _views(tensors: Sequence[Tensor]) -> list[wp.array]:
    return [_view(tensor) for tensor in tensors]


def _place(tensor: Tensor) -> str:
    """Give Warp's name of a tensor's device."""
    return "cpu" if tensor.device.type == "cpu" else str(wp.device_from_torch(tensor.device))


@contextlib.contextmanager
def _stream(device: torch.device):
    """Launch where PyTorch does: its current stream of the device."""
    get_backend("warp")  # initialises Warp
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device))):
        yield


brightness_cost = _function("brightness_cost")
brightness_residual = _function("brightness_residual")
deposit_events = _function("deposit_events")
event_histogram = _function("event_histogram")
lag_operator = _function("lag_operator")
render_code = _function("render_code")
sample_moments = _function("sample_moments")
splat_events = _function("splat_events")
time_surface = _function("time_surface")
voxel_grid = _function("voxel_grid")
