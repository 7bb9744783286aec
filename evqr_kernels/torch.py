"""The operations as differentiable PyTorch functions, on the caller's device and stream.

    image = evqr_kernels.torch.splat_events(x, y, t, weight, window_ptr, motion, shape=(Y, X))
    (-image.var()).backward()           # motion.grad: the adjoint by hand

Shapes, dtypes, units, cost and determinism are those of the functions of the same names in `evqr_kernels`;
here is what differs for all of them.

Tensors are not copied: Warp's kernels read and write their memory, on the CPU or an NVIDIA GPU, in PyTorch's
current stream, and nothing waits for them.  All tensors of a call are on one device.  Results are new tensors
there, never accumulated into; scratch is made there too.

Each is a custom operator, `torch.ops.evqr_kernels.splat_events`, so that `torch.compile` takes it as it is,
``fullgraph=True`` too, and so is its adjoint.  `torch.func` knows them: ``grad``, ``vjp``, ``jacrev``, and
``vmap``, which calls one after the other.

Saved for the backward pass are the inputs alone, as PyTorch saves them: not copied, and not to be changed in
place until then.  It makes adjoints in all inputs that an operation is differentiable in, wanted or not.
Adjoints are not differentiable once more: a second backward pass through one raises RuntimeError.

What a call needs beside its tensors is kept for the next one with the same shapes, dtypes and settings; the
first takes a millisecond more.

They raise TypeError and ValueError as those functions do, also for a tensor that is not contiguous, is on
another device than the first, or requires a gradient that the operation does not have.  Of tensors on a GPU
they look at no values, for that would wait for the device: where windows, indices or extents are wrong there,
results are wrong too, but nothing outside the tensors is read or written.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from evqr_kernels.call import check_values
from evqr_kernels.config import SplatConfig
from evqr_kernels.differentiable import Front, Rule, Shape
from evqr_kernels.operation import Setting, letters_of
from evqr_kernels.registry import get_backend
from evqr_kernels.warp_backend.rebinding import Rebindable, place

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
Kind = tuple[Shape, torch.dtype, torch.device, bool]
"""Shape, dtype, device, and whether it is contiguous."""

_DTYPES = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32}
_PLACES = {torch.float32: wp.float32, torch.float64: wp.float64, torch.int32: wp.int32}

_library = torch.library.Library("evqr_kernels", "DEF")


def _function(op: str) -> Callable[..., Tensor]:
    """Make the function of an operation."""
    front, rule = Front(op, "Tensor"), Rule(op, ())
    compute = _operators(rule)
    inputs = [(array.name, array.default is not None) for array in rule.operation.inputs]
    constant = [name for name in rule.inputs if name not in (*rule.varied, *rule.added)]
    has = f"one in {', '.join(rule.varied)}" if rule.differentiable else "none"

    def function(*args: Any, **kwargs: Any) -> Tensor:
        values = front.values(args, kwargs)
        for name, optional in inputs:
            value = values[name]
            if not (isinstance(value, torch.Tensor) or (optional and value is None)):
                raise TypeError(f"{name} must be a torch.Tensor, got {type(value).__name__}")
        for name in constant:
            if values[name] is not None and values[name].requires_grad:
                raise ValueError(f"{name} must not require a gradient: {op} has {has}")
        settings = [number for s in rule.operation.settings for number in _numbers(s, values[s.name])]
        return compute(*[values[name] for name, _ in inputs], *settings)

    return front.dress(function)


def _numbers(setting: Setting, value: Any) -> Sequence[Any]:
    """Give a setting as operators take it: numbers and strings."""
    value = setting.default if value is None else value
    if isinstance(value, SplatConfig):
        return [getattr(value, field) for field in _FIELDS]
    if not setting.letters:
        return [value]
    whole = value if isinstance(value, (tuple, list)) else (value,)
    if len(whole) != len(setting.letters) or not all(type(number) is int for number in whole):
        whole = [size for _, size in letters_of(setting, value)]
    return whole


_FIELDS = {field.name: type(field.default).__name__ for field in dataclasses.fields(SplatConfig)}


def _settings(rule: Rule, numbers: Sequence[Any]) -> tuple[tuple[str, Any], ...]:
    """Undo `_numbers`."""
    left = iter(numbers)

    def value(setting: Setting) -> Any:
        if isinstance(setting.default, SplatConfig):
            return SplatConfig(**{name: next(left) for name in _FIELDS})
        several = tuple(next(left) for _ in setting.letters or (setting.name,))
        return several if len(setting.letters) > 1 else next(iter(several))

    return tuple((setting.name, value(setting)) for setting in rule.operation.settings)


def _schema(rule: Rule) -> str:
    """Declare the arguments of an operation's operators."""
    said = [f"Tensor{'?' if a.default is not None else ''} {a.name}" for a in rule.operation.inputs]
    for setting in rule.operation.settings:
        if isinstance(setting.default, SplatConfig):
            said += [f"{kind} {setting.name}_{name}" for name, kind in _FIELDS.items()]
        elif setting.letters:
            several = len(setting.letters) > 1
            said += [f"SymInt {setting.name}{f'_{n.lower()}' if several else ''}" for n in setting.letters]
        else:
            said.append(f"float {setting.name}")
    return ", ".join(said)


def _operators(rule: Rule) -> Callable[..., Tensor]:
    """Register the operators of an operation and its adjoint; give the function that is differentiable."""
    op, count = rule.op, len(rule.inputs)
    _library.define(f"{op}({_schema(rule)}) -> Tensor", tags=_TAGS)

    def forward(*values: Any) -> Tensor:
        tensors = values[:count]
        plan = _plan(op, False, values[count:], tuple(map(_kind, tensors)))
        (out,) = plan(tensors)
        return out

    def shape_only(*values: Any) -> Tensor:
        tensors = values[:count]
        sized = Rule(op, _settings(rule, values[count:]))
        floats = next(tensor for tensor in tensors if tensor is not None and tensor.is_floating_point())
        dtype = torch.int32 if rule.counts else floats.dtype
        return _empty(sized.output(_shapes(rule, tensors)), dtype, floats.device)

    _library.impl(op, forward, "CPU")
    _library.impl(op, forward, "CUDA")
    torch.library.register_fake(f"evqr_kernels::{op}", shape_only, lib=_library)
    operator = getattr(torch.ops.evqr_kernels, op).default
    if not rule.differentiable:
        torch.library.register_vmap(f"evqr_kernels::{op}", _one_by_one(operator), lib=_library)
        return operator

    adjoint_of = _adjoint_operator(rule)
    # where each input's gradient is: plain numbers, which `torch.compile` can follow
    places = {name: k for k, name in enumerate(rule.varied)}
    places |= dict.fromkeys(rule.added, len(places))
    of_inputs = tuple(places.get(name, -1) for name in rule.inputs)
    varied = tuple(k for k, place in enumerate(of_inputs) if place >= 0)

    class Function(torch.autograd.Function):
        @staticmethod
        def forward(*values: Any) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
            return operator(*values)

        @staticmethod
        def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
            ctx.save_for_backward(*inputs[:count])
            ctx.settings = inputs[count:]

        @staticmethod
        def backward(ctx: Any, adj: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
            # of a sum, say, it is one number seen many times over
            adj = adj.contiguous()
            found = (*adjoint_of(adj, *ctx.saved_tensors, *ctx.settings), adj)
            return *[found[k] if k >= 0 else None for k in of_inputs], *[None for _ in ctx.settings]

        @staticmethod
        def vmap(info: Any, in_dims: tuple[Any, ...], *values: Any) -> tuple[Tensor, int]:
            return _one_by_one(compute)(info, in_dims, *values)

    def compute(*values: Any) -> Tensor:
        return Function.apply(*values) if _is_followed(values, varied) else operator(*values)

    _quick(Function)
    torch.library.register_vmap(f"evqr_kernels::{op}", _one_by_one(compute), lib=_library)
    return compute


def _adjoint_operator(rule: Rule) -> Callable[..., Sequence[Tensor]]:
    """Register the operator of an adjoint; give the function that says that it is not differentiable."""
    op, count = rule.adjoint_operation.name, 1 + len(rule.inputs)
    _library.define(f"{op}(Tensor adj, {_schema(rule)}) -> Tensor[]", tags=_TAGS)

    def adjoint(*values: Any) -> list[Tensor]:
        tensors = (*values[1:count], values[0])
        return _plan(rule.op, True, values[count:], tuple(map(_kind, tensors)))(tensors)

    def shape_only(adj: Tensor, *values: Any) -> list[Tensor]:
        shapes = _shapes(rule, values)
        return [_empty(shapes[name], adj.dtype, adj.device) for name in rule.varied]

    _library.impl(op, adjoint, "CPU")
    _library.impl(op, adjoint, "CUDA")
    torch.library.register_fake(f"evqr_kernels::{op}", shape_only, lib=_library)
    operator = getattr(torch.ops.evqr_kernels, op).default

    class Adjoint(torch.autograd.Function):
        @staticmethod
        def forward(*values: Any) -> tuple[Tensor, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
            return tuple(operator(*values))

        @staticmethod
        def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
            pass

        @staticmethod
        def backward(ctx: Any, *adjoints: Tensor) -> Any:
            raise RuntimeError(
                f"{op} has no adjoint of its own: {rule.op} is differentiable once; difference its gradient, "
                "or detach it"
            )

        @staticmethod
        def vmap(info: Any, in_dims: tuple[Any, ...], *values: Any) -> tuple[Any, Any]:
            return _one_by_one(compute)(info, in_dims, *values)

    def compute(*values: Any) -> Sequence[Tensor]:
        # what is compiled has no second backward pass
        followed = not torch.compiler.is_compiling() and _is_followed(values, range(count))
        return Adjoint.apply(*values) if followed else operator(*values)

    _quick(Adjoint)
    torch.library.register_vmap(f"evqr_kernels::{op}", _one_by_one(compute), lib=_library)
    return compute


def _is_followed(values: Sequence[Any], varied: Iterable[int]) -> bool:
    """Whether someone wants to know what is computed; to tell them takes ten microseconds."""
    if torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active():
        return True
    return torch.is_grad_enabled() and any(values[k] is not None and values[k].requires_grad for k in varied)


_ANY = inspect.Signature([inspect.Parameter("values", inspect.Parameter.VAR_POSITIONAL)])


def _quick(function: Any) -> None:
    """Spare PyTorch to work out at each call what a function takes."""
    function.forward.__signature__ = _ANY


_TAGS = (torch.Tag.needs_exact_strides,)


def _one_by_one(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function for a batch of calls of one for a call."""

    def batch(info: Any, in_dims: tuple[Any, ...], *values: Any) -> Any:
        results = [
            function(*(
                value if dim is None else value.select(dim, k).contiguous()
                for value, dim in zip(values, in_dims, strict=True)
            ))
            for k in range(info.batch_size)
        ]  # fmt: skip
        if isinstance(results[0], Tensor):
            return torch.stack(results), 0
        return tuple(torch.stack(column) for column in zip(*results, strict=True)), (0,) * len(results[0])

    return batch


def _kind(tensor: Tensor | None) -> Kind | None:
    if tensor is None:
        return None
    return tensor.shape, tensor.dtype, tensor.device, tensor.is_contiguous()


class _Plan:
    """What a call takes beside its tensors, the same for all with these shapes, dtypes and settings.

    Attributes
    ----------
    defaults : dict
        Tensors that stand for what is not given, by position.
    """

    def __init__(self, rule: Rule, kinds: dict[str, Kind], given: set[str], *, adjoint: bool) -> None:
        self._rule, self._given, self._adjoint = rule, given, adjoint
        shapes = {name: shape for name, (shape, *_) in kinds.items() if name in rule.inputs}
        _, _, self._device, _ = kinds[rule.inputs[0]]
        backend, place_of = get_backend("warp"), _place(self._device)
        self._sizes = rule.sizes(shapes, backend.tile(rule.op, place_of))
        floats = next(dtype for _, dtype, *_ in kinds.values() if dtype.is_floating_point)
        if adjoint:
            scratch = rule.adjoint_scratch(shapes, backend.tile(rule.adjoint_operation.name, place_of))
            results = [shapes[name] for name in rule.varied]
        else:
            scratch, results = rule.forward_scratch(shapes, self._sizes["tile"]), [rule.output(shapes)]
        self._inputs = [(shape, dtype) for shape, dtype, *_ in kinds.values()]
        self._scratch = [(shape, floats) for shape in scratch]
        dtype = torch.int32 if rule.counts and not adjoint else floats
        self._results = [(shape, dtype) for shape in results]
        self.defaults = {
            k: torch.tensor(
                array.row(self._sizes), dtype=kinds[array.name][1], device=self._device
            ).expand(shapes[array.name]).contiguous()
            for k, array in enumerate(rule.operation.inputs)
            if array.name not in given
        }  # fmt: skip
        self._free: list[Rebindable] = []

    def __call__(self, tensors: Sequence[Tensor | None]) -> list[Tensor]:
        """Check what tensors hold, if the host can read them; compute."""
        complete = [self.defaults[k] if t is None else t for k, t in enumerate(tensors)]
        if self._device.type == "cpu" and not self._adjoint:
            check_values(self._rule.operation, _OnHost(self._rule.inputs, complete, self._given), self._sizes)
        scratch = [_empty(*like, self._device) for like in self._scratch]
        results = [_empty(*like, self._device) for like in self._results]
        addresses = [tensor.data_ptr() for tensor in (*complete, *scratch, *results)]
        # one that no thread uses
        launch = self._free.pop() if self._free else Rebindable(self._launch)
        if self._device.type == "cpu":
            launch(addresses)
        else:  # where PyTorch does
            with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self._device))):
                launch(addresses)
        self._free.append(launch)
        return results

    def _launch(self) -> None:
        device = wp.get_device(_place(self._device))
        arrays = (*self._inputs, *self._scratch, *self._results)
        places = iter(place(k, shape, _PLACES[dtype], device) for k, (shape, dtype) in enumerate(arrays))
        inputs, partial, results = (
            list(itertools.islice(places, len(part))) for part in (self._inputs, self._scratch, self._results)
        )
        if self._adjoint:
            *given, adj = inputs
            self._rule.adjoint(get_backend("warp"), given, adj, partial, results)
        else:
            self._rule.forward(get_backend("warp"), inputs, partial, *results)


class _OnHost(dict[str, Any]):
    """Tensors as NumPy's arrays, made when they are looked at; None of those that were not given."""

    def __init__(self, names: Sequence[str], tensors: Sequence[Any], given: set[str]) -> None:
        super().__init__()
        self._tensors, self._given = dict(zip(names, tensors, strict=True)), given

    def __missing__(self, name: str) -> Any:
        made = self._tensors[name].detach().numpy() if name in self._given else None
        self[name] = made
        return made

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self._tensors else default


@functools.lru_cache(maxsize=256)
def _plan(op: str, adjoint: bool, numbers: tuple[Any, ...], kinds: tuple[Kind | None, ...]) -> _Plan:
    """Check the tensors of a call, and settings, by what is known of them; make its plan."""
    rule = Rule(op, _settings(Rule(op, ()), numbers))
    named = dict(zip((*rule.inputs, "adj")[: len(kinds)], kinds, strict=True))
    known = {name: kind for name, kind in named.items() if kind is not None}
    _, floats, device, _ = known[rule.inputs[0]]
    for name, (_, dtype, where, contiguous) in known.items():
        if dtype not in _DTYPES:
            remedy = "" if dtype.is_floating_point else f": give {name}.int()"
            raise TypeError(f"{name} must be float32, float64 or int32, got {dtype}{remedy}")
        if where != device:
            raise ValueError(f"{name} must be on {device} like the tensors before it, got {where}")
        if not contiguous:
            raise ValueError(f"{name} must be contiguous, it is not copied: call {name}.contiguous()")
    sizes = rule.operation.bind({name: tuple(kind[0]) for name, kind in known.items()}, dict(rule.settings))
    complete = {
        array.name: known.get(array.name)
        # 0 where no other input tells a size: the check says what is wrong with that
        or (
            tuple(sizes.get(n, 0) if isinstance(n, str) else n for n in array.shape),
            torch.int32 if array.integer else floats,
            device,
            True,
        )
        for array in rule.operation.inputs
    }
    rule.check(
        {name: tuple(shape) for name, (shape, *_) in complete.items()},
        {name: _DTYPES[dtype] for name, (_, dtype, *_) in complete.items()},
    )
    if adjoint:
        complete["adj"] = known["adj"]
    return _Plan(rule, complete, set(known), adjoint=adjoint)


def _shapes(rule: Rule, tensors: Sequence[Tensor | None]) -> dict[str, Shape]:
    named = zip(rule.inputs, tensors, strict=False)
    return {name: tuple(tensor.shape) for name, tensor in named if tensor is not None}


def _empty(shape: Shape, dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.empty(shape, dtype=dtype, device=device)


def _place(device: torch.device) -> str:
    """Give Warp's name of a device."""
    return "cpu" if device.type == "cpu" else str(wp.device_from_torch(device))


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
