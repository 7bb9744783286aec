"""The operations as differentiable JAX functions, inside `jax.jit` and outside, on the caller's device.

    loss = lambda motion: -evqr_kernels.jax.splat_events(x, y, t, weight, ptr, motion, shape=(Y, X)).var()
    jax.grad(loss)(motion)              # the adjoint by hand

Shapes, dtypes, units, cost and determinism are those of the functions of the same names in `evqr_kernels`,
float64 where JAX is told so; here is what differs for all of them.

Arrays are not copied: XLA hands their memory to Warp's kernels, on the CPU or an NVIDIA GPU, in its own
stream.  Results and scratch are XLA's, new ones; nothing is accumulated into an argument.  ``shape``, ``cfg``
and ``sigma`` are constants when a function is traced.

Saved for the backward pass are the inputs alone.  It makes adjoints in all inputs that an operation is
differentiable in; other inputs get a gradient of zero.  Adjoints are not differentiable once more, TypeError
says so; `jax.vmap` calls one after the other.

They raise TypeError and ValueError as those functions do.  Values of arrays are looked at on the CPU: a
function that was traced raises such a line when it runs, as an error of JAX.  On a GPU nobody looks: where
windows, indices or extents are wrong, results are wrong too, but nothing outside the arrays is read or
written.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp
from jax.core import Tracer

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

_DTYPES = {"float32": wp.float32, "float64": wp.float64, "int32": wp.int32}
Ranks = tuple[int, ...]


def _array(name: str, value: Any) -> jax.Array:
    if not isinstance(value, jax.Array):
        raise TypeError(f"{name} must be a jax.Array, got {type(value).__name__}")
    return value


def _default(array: Input, row: list[float], shape: Shape, like: jax.Array) -> jax.Array:
    """Make what stands for an input that is not given."""
    return jnp.broadcast_to(jnp.array(row, jnp.int32 if array.integer else like.dtype), shape)


def _function(op: str) -> Callable[..., jax.Array]:
    """Make the differentiable function of an operation."""
    front = Front(op, "jax.Array")

    def function(*args: Any, **kwargs: Any) -> jax.Array:
        rule, arrays = front.bound(args, kwargs, _array, _default)
        return _apply(rule, *arrays)

    return front.dress(function)


def _apply(rule: Rule, *arrays: jax.Array) -> jax.Array:
    """Check arrays against a rule, and apply it."""
    for name, array in zip(rule.inputs, arrays, strict=True):
        _array(name, array)
    dtypes = {name: array.dtype for name, array in zip(rule.inputs, arrays, strict=True)}
    rule.check(_shapes(rule, arrays), dtypes)
    if not any(isinstance(array, Tracer) for array in arrays) and _on_cpu():
        rule.check_host({name: np.asarray(a) for name, a in zip(rule.inputs, arrays, strict=True)})
    return _differentiable(rule, *arrays) if rule.differentiable else _computed(rule, *arrays)


def _computed(rule: Rule, *arrays: jax.Array) -> jax.Array:
    sizes = _shapes(rule, arrays)
    scratch = rule.forward_scratch(sizes, _tile(rule.op))
    ranks = _ranks([*sizes.values()]), len(rule.output(sizes)), _ranks(scratch)
    call = _forward(rule, str(_floats(arrays).dtype), *ranks)
    return call(arrays, [rule.output(sizes), *scratch])[0]


_differentiable = jax.custom_vjp(_computed, nondiff_argnums=(0,))


def _with_inputs(rule: Rule, *arrays: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    return _differentiable(rule, *arrays), arrays


def _adjoints(rule: Rule, arrays: tuple[jax.Array, ...], adj: jax.Array) -> tuple[Any, ...]:
    sizes = _shapes(rule, arrays)
    outputs = [sizes[name] for name in rule.varied]
    scratch = rule.adjoint_scratch(sizes, _tile(rule.adjoint_operation.name))
    ranks = _ranks([*sizes.values()]), adj.ndim, _ranks(outputs), _ranks(scratch)
    call = _adjoint(rule, str(adj.dtype), *ranks)
    results: Any = _once(call, (*outputs, *scratch), rule.op, *arrays, adj)
    found = dict(zip(rule.varied, results, strict=False)) | dict.fromkeys(rule.added, adj)

    def of(name: str, array: jax.Array) -> Any:
        if name in rule.indices:
            return np.zeros(array.shape, jax.dtypes.float0)
        return found[name] if name in found else jnp.zeros_like(array)

    return tuple(of(name, array) for name, array in zip(rule.inputs, arrays, strict=True))


_differentiable.defvjp(_with_inputs, _adjoints)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2))
def _once(call: _Call, shapes: tuple[Shape, ...], op: str, *arrays: jax.Array) -> Sequence[jax.Array]:
    """Compute adjoints, which are not differentiable once more."""
    return call(arrays, shapes)


def _no_second(call: _Call, shapes: tuple[Shape, ...], op: str, *arrays: jax.Array) -> Any:
    raise TypeError(
        f"{op}_adjoint has no adjoint of its own: {op} is differentiable once; difference its gradient, or "
        "stop it by jax.lax.stop_gradient"
    )


_once.defvjp(_no_second, _no_second)


class _Call:
    """A function on Warp arrays that JAX can call: inputs, then outputs, each of a known number of axes."""

    def __init__(self, run: Any, inputs: list[wp.array], outputs: list[wp.array]) -> None:
        names = [f"input_{k}" for k in range(len(inputs))] + [f"output_{k}" for k in range(len(outputs))]
        kinds = [*inputs, *outputs]

        # Warp reads what a function takes from its signature
        def function(*given: wp.array) -> None:
            run(given[: len(inputs)], given[len(inputs) :])

        positional = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = [
            inspect.Parameter(name, positional, annotation=kind)
            for name, kind in zip(names, kinds, strict=True)
        ]
        function.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
        function.__annotations__ = dict(zip(names, kinds, strict=True))
        self._names = names[len(inputs) :]
        self._function = wp.jax_callable(
            function,
            num_outputs=len(outputs),
            # kernels are compiled when they are first launched, which a capture does not allow
            graph_mode=wp.JaxCallableGraphMode.NONE,
            vmap_method="sequential",
        )

    def __call__(self, arrays: Sequence[jax.Array], shapes: Sequence[Shape]) -> Sequence[jax.Array]:
        return self._function(*arrays, output_dims=dict(zip(self._names, shapes, strict=True)))


@functools.cache
def _forward(rule: Rule, dtype: str, input_ranks: Ranks, output_rank: int, scratch_ranks: Ranks) -> _Call:
    backend = get_backend("warp")

    def run(given: Sequence[Any], results: Sequence[Any]) -> None:
        if results[0].device.is_cpu:
            rule.check_host({name: array.numpy() for name, array in zip(rule.inputs, given, strict=True)})
        rule.forward(backend, given, results[1:], results[0])

    out = _kind("int32" if rule.counts else dtype, output_rank)
    return _Call(run, _kinds(rule, dtype, input_ranks), [out, *(_kind(dtype, r) for r in scratch_ranks)])


@functools.cache
def _adjoint(
    rule: Rule, dtype: str, input_ranks: Ranks, adj_rank: int, varied_ranks: Ranks, scratch_ranks: Ranks
) -> _Call:
    backend, varied = get_backend("warp"), len(varied_ranks)

    def run(given: Sequence[Any], results: Sequence[Any]) -> None:
        rule.adjoint(backend, given[:-1], given[-1], results[varied:], results[:varied])

    inputs = [*_kinds(rule, dtype, input_ranks), _kind(dtype, adj_rank)]
    return _Call(run, inputs, [_kind(dtype, r) for r in (*varied_ranks, *scratch_ranks)])


def _tile(op: str) -> int:
    """Give the backend's tile where JAX computes: it tells no device while it traces."""
    return get_backend("warp").tile(op, "cpu" if _on_cpu() else "cuda:0")


def _on_cpu() -> bool:
    return jax.default_backend() == "cpu"


def _kinds(rule: Rule, dtype: str, ranks: Ranks) -> list[wp.array]:
    return [
        _kind("int32" if name in rule.indices else dtype, rank)
        for name, rank in zip(rule.inputs, ranks, strict=True)
    ]


def _kind(dtype: str, rank: int) -> wp.array:
    return wp.array(dtype=_DTYPES[dtype], ndim=rank)


def _ranks(shapes: Sequence[Shape]) -> Ranks:
    return tuple(len(shape) for shape in shapes)


def _shapes(rule: Rule, arrays: Sequence[jax.Array]) -> dict[str, Shape]:
    return {name: tuple(array.shape) for name, array in zip(rule.inputs, arrays, strict=True)}


def _floats(arrays: Sequence[jax.Array]) -> jax.Array:
    return next(array for array in arrays if array.dtype.kind == "f")


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
