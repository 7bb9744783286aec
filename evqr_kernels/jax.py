"""The operations as differentiable JAX functions, inside `jax.jit` and outside, on the caller's device.

    loss = lambda motion: -evqr_kernels.jax.splat_events(x, y, t, weight, ptr, motion, shape=(Y, X)).var()
    jax.grad(loss)(motion)              # the adjoint by hand

Shapes, dtypes, units, cost and determinism are those of the functions of the same names in `evqr_kernels`,
float64 where JAX is told so; here is what differs for all of them.

Arrays are not copied: XLA hands their memory to Warp's kernels, on the CPU or an NVIDIA GPU, in its own
stream.  Results and scratch are XLA's, new ones; nothing is accumulated into an argument.  ``shape``, ``cfg``
and ``sigma`` are constants when a function is traced.

Saved for the backward pass are the inputs alone.  It makes adjoints in all inputs that an operation is
differentiable in; other inputs get a gradient of zero.  Adjoints are not differentiable once more; `jax.vmap`
calls one after the other.

They raise TypeError and ValueError as those functions do.  But they look at no values of arrays: windows,
indices and frames must be right.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
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

_DTYPES = {"float32": wp.float32, "float64": wp.float64, "int32": wp.int32}
Ranks = tuple[int, ...]


def splat_events(
    x: jax.Array, y: jax.Array, t: jax.Array, weight: jax.Array, window_ptr: jax.Array, motion: jax.Array, *,
    shape: tuple[int, int], lag: jax.Array | None = None, frame: jax.Array | None = None,
    cfg: SplatConfig | None = None,
) -> jax.Array:  # fmt: skip
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
    x: jax.Array, y: jax.Array, t: jax.Array, weight: jax.Array, window_ptr: jax.Array, motion: jax.Array, *,
    shape: tuple[int, int], frame: jax.Array | None = None,
) -> jax.Array:  # fmt: skip
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
    deposit: jax.Array, deposit_idx: jax.Array, direction: jax.Array, lag: jax.Array, taps: jax.Array
) -> jax.Array:
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
    grid: jax.Array, to_grid: jax.Array, outside: jax.Array, *, shape: tuple[int, int], sigma: float = 0.0
) -> jax.Array:
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


def brightness_residual(luminance: jax.Array, events_image: jax.Array, motion: jax.Array) -> jax.Array:
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
    luminance: jax.Array, events_image: jax.Array, motion: jax.Array, *, mask: jax.Array | None = None
) -> jax.Array:
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
    mask = jnp.ones_like(luminance) if mask is None else mask
    return _apply(differentiable.brightness_cost(), luminance, events_image, motion, mask)


def sample_moments(
    image: jax.Array, image_idx: jax.Array, pose: jax.Array, points: jax.Array, table: jax.Array, *,
    active: jax.Array | None = None,
) -> jax.Array:  # fmt: skip
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
        active = jnp.ones_like(_array("image_idx", image_idx))
    return _apply(differentiable.sample_moments(), image, image_idx, pose, active, points, table)


def _array(name: str, value: Any) -> jax.Array:
    if not isinstance(value, jax.Array):
        raise TypeError(f"{name} must be a jax.Array, got {type(value).__name__}")
    return value


def _rows(row: Sequence[float], motion: jax.Array) -> jax.Array:
    """Repeat a row for each window that there is a motion of."""
    return jnp.tile(jnp.array(row, _array("motion", motion).dtype), (*motion.shape[:1], 1))


def _apply(rule: Rule, *arrays: jax.Array) -> jax.Array:
    """Check arrays against a rule, and apply it."""
    for name, array in zip(rule.inputs, arrays, strict=True):
        _array(name, array)
    dtypes = {name: array.dtype for name, array in zip(rule.inputs, arrays, strict=True)}
    rule.check(_shapes(rule, arrays), dtypes)
    return _differentiable(rule, *arrays)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _differentiable(rule: Rule, *arrays: jax.Array) -> jax.Array:
    sizes = _shapes(rule, arrays)
    scratch = rule.forward_scratch(sizes)
    ranks = _ranks([*sizes.values()]), len(rule.output(sizes)), _ranks(scratch)
    call = _forward(rule, str(_floats(arrays).dtype), *ranks)
    return call(arrays, [rule.output(sizes), *scratch])[0]


def _with_inputs(rule: Rule, *arrays: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    return _differentiable(rule, *arrays), arrays


def _adjoints(rule: Rule, arrays: tuple[jax.Array, ...], adj: jax.Array) -> tuple[Any, ...]:
    sizes = _shapes(rule, arrays)
    outputs = [sizes[name] for name in rule.varied]
    scratch = rule.adjoint_scratch(sizes)
    ranks = _ranks([*sizes.values()]), adj.ndim, _ranks(outputs), _ranks(scratch)
    call = _adjoint(rule, str(adj.dtype), *ranks)
    results = call((*arrays, adj), [*outputs, *scratch])
    found: dict[str | None, Any] = dict(zip(rule.varied, results, strict=False))
    found[rule.added] = adj

    def of(name: str, array: jax.Array) -> Any:
        if name in rule.indices:
            return np.zeros(array.shape, jax.dtypes.float0)
        return found[name] if name in found else jnp.zeros_like(array)

    return tuple(of(name, array) for name, array in zip(rule.inputs, arrays, strict=True))


_differentiable.defvjp(_with_inputs, _adjoints)


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
        rule.forward(backend, given, results[1:], results[0])

    return _Call(
        run, _kinds(rule, dtype, input_ranks), [_kind(dtype, r) for r in (output_rank, *scratch_ranks)]
    )


@functools.cache
def _adjoint(
    rule: Rule, dtype: str, input_ranks: Ranks, adj_rank: int, varied_ranks: Ranks, scratch_ranks: Ranks
) -> _Call:
    backend, varied = get_backend("warp"), len(varied_ranks)

    def run(given: Sequence[Any], results: Sequence[Any]) -> None:
        rule.adjoint(backend, given[:-1], given[-1], results[varied:], results[:varied])

    inputs = [*_kinds(rule, dtype, input_ranks), _kind(dtype, adj_rank)]
    return _Call(run, inputs, [_kind(dtype, r) for r in (*varied_ranks, *scratch_ranks)])


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
