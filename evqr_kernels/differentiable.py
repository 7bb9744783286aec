"""What a framework with automatic differentiation must know of an operation: shapes, and its two directions.

`evqr_kernels.torch` and `evqr_kernels.jax` make differentiable functions of these rules.  A rule allocates
nothing: the framework makes all buffers, arrays of its own kind, and hands over views of them in the order of
the operation's arguments.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from evqr_kernels import arguments
from evqr_kernels.backend import Array
from evqr_kernels.checks import ArrayChecks, check_size
from evqr_kernels.config import SplatConfig
from evqr_kernels.launch import chunks_of, chunks_of_samples

Shape = tuple[int, ...]
Shapes = Mapping[str, Shape]
Arrays = Sequence[Array]
Backend = Any  # a KernelBackend, whose arguments a type checker cannot count when they are unpacked


def _nothing(sizes: Shapes) -> list[Shape]:
    return []


@dataclass(frozen=True, kw_only=True, eq=False)
class Rule:
    """An operation with its settings; the same settings give the same rule.

    Attributes
    ----------
    op               name of the operation
    inputs           names of the inputs, in order
    require          (checks, inputs): raises unless their dtypes and shapes, and the settings, fit
    indices          inputs that are int32
    varied           inputs that it has an adjoint in
    added            an input that is just added: its adjoint is that of the output
    output           shape of the output, from those of the inputs
    forward_scratch  shapes of partial results
    adjoint_scratch  shapes of the adjoint's partial results
    forward          (backend, inputs, scratch, output): overwrites the output
    adjoint          (backend, inputs, adjoint of the output, scratch, adjoints of ``varied``): overwrites
    """

    op: str
    inputs: tuple[str, ...]
    require: Callable[..., None]
    indices: tuple[str, ...] = ()
    varied: tuple[str, ...]
    added: str | None = None
    output: Callable[[Shapes], Shape]
    forward_scratch: Callable[[Shapes], list[Shape]] = _nothing
    adjoint_scratch: Callable[[Shapes], list[Shape]] = _nothing
    forward: Callable[[Backend, Arrays, Arrays, Array], None]
    adjoint: Callable[[Backend, Arrays, Array, Arrays, Arrays], None]

    def check(self, shapes: Shapes, dtypes: Mapping[str, DTypeLike]) -> np.dtype[Any]:
        """Raise TypeError or ValueError unless the inputs fit; give their dtype.  Looks at no values."""
        checks = ArrayChecks()
        # of the same shapes and dtypes, in four bytes each
        likes = (np.broadcast_to(np.zeros((), dtypes[name]), shapes[name]) for name in self.inputs)
        self.require(checks, *likes)
        for shape in (self.output(shapes), *self.forward_scratch(shapes), *self.adjoint_scratch(shapes)):
            check_size(self.op, shape)
        return checks.dtype or np.dtype(np.float32)


EVENTS = ("x", "y", "t", "weight", "window_ptr")


@functools.lru_cache(maxsize=128)
def splat_events(shape: tuple[int, int], cfg: SplatConfig) -> Rule:
    """Give the rule of `evqr_kernels.splat_events`: in weight and motion."""

    def forward(backend: Backend, given: Arrays, scratch: Arrays, out: Array) -> None:
        backend.clear(out)
        backend.splat_events(*given, out, cfg)

    return Rule(
        op="splat_events",
        inputs=(*EVENTS, "motion", "lag", "frame"),
        require=arguments.splat_events,
        indices=("window_ptr",),
        varied=("weight", "motion"),
        output=lambda sizes: (sizes["motion"][0], *shape),
        adjoint_scratch=lambda sizes: [
            (sizes["motion"][0], chunks_of(sizes["x"][0], sizes["motion"][0]), sizes["motion"][1])
        ],
        forward=forward,
        adjoint=lambda backend, given, adj, scratch, adjoints: backend.splat_events_adjoint(
            *given, adj, *scratch, *adjoints, cfg
        ),
    )


@functools.lru_cache(maxsize=128)
def deposit_events(shape: tuple[int, int]) -> Rule:
    """Give the rule of `evqr_kernels.deposit_events`: in the weight."""

    def forward(backend: Backend, given: Arrays, scratch: Arrays, out: Array) -> None:
        backend.clear(out)
        backend.deposit_events(*given, out)

    return Rule(
        op="deposit_events",
        inputs=(*EVENTS, "motion", "frame"),
        require=arguments.deposit_events,
        indices=("window_ptr",),
        varied=("weight",),
        output=lambda sizes: (sizes["motion"][0], 2, *shape),
        forward=forward,
        adjoint=lambda backend, given, adj, scratch, adjoints: backend.deposit_events_adjoint(
            *given, adj, *adjoints
        ),
    )


@functools.cache
def lag_operator() -> Rule:
    """Give the rule of `evqr_kernels.lag_operator`: in the deposit."""

    def shape(sizes: Shapes) -> Shape:
        return sizes["lag"][0], *sizes["deposit"][2:]

    def rows(sizes: Shapes) -> list[Shape]:
        return [(sizes["lag"][0], *sizes["deposit"][1:])]

    return Rule(
        op="lag_operator",
        inputs=("deposit", "deposit_idx", "direction", "lag", "taps"),
        require=arguments.lag_operator,
        indices=("deposit_idx",),
        varied=("deposit",),
        output=shape,
        forward_scratch=rows,
        adjoint_scratch=rows,
        forward=lambda backend, given, scratch, out: backend.lag_operator(*given, *scratch, out),
        adjoint=lambda backend, given, adj, scratch, adjoints: backend.lag_operator_adjoint(
            *given[1:], adj, *scratch, *adjoints
        ),
    )


@functools.lru_cache(maxsize=128)
def render_code(shape: tuple[int, int], sigma: float) -> Rule:
    """Give the rule of `evqr_kernels.render_code`: in grid and map."""
    return Rule(
        op="render_code",
        inputs=("grid", "to_grid", "outside"),
        require=functools.partial(arguments.render_code, sigma=sigma),
        varied=("grid", "to_grid"),
        output=lambda sizes: (sizes["grid"][0], *shape),
        adjoint_scratch=lambda sizes: [(sizes["grid"][0], shape[0], sizes["to_grid"][1])],
        forward=lambda backend, given, scratch, out: backend.render_code(*given, sigma, out),
        adjoint=lambda backend, given, adj, scratch, adjoints: backend.render_code_adjoint(
            *given, sigma, adj, *scratch, *adjoints
        ),
    )


@functools.cache
def brightness_residual() -> Rule:
    """Give the rule of `evqr_kernels.brightness_residual`: in all its inputs."""
    return Rule(
        op="brightness_residual",
        inputs=("luminance", "events_image", "motion"),
        require=arguments.brightness_residual,
        varied=("luminance", "motion"),
        added="events_image",
        output=lambda sizes: sizes["luminance"],
        adjoint_scratch=lambda sizes: [(*sizes["luminance"][:2], 2)],
        forward=lambda backend, given, scratch, out: backend.brightness_residual(*given, out),
        adjoint=lambda backend, given, adj, scratch, adjoints: backend.brightness_residual_adjoint(
            given[0], given[2], adj, *scratch, *adjoints
        ),
    )


@functools.cache
def brightness_cost() -> Rule:
    """Give the rule of `evqr_kernels.brightness_cost`: in all its inputs but the mask."""

    def adjoint(backend: Backend, given: Arrays, adj: Array, scratch: Arrays, adjoints: Arrays) -> None:
        backend.brightness_cost_adjoint(*given, adj, *scratch, *adjoints)

    return Rule(
        op="brightness_cost",
        inputs=("luminance", "events_image", "motion", "mask"),
        require=arguments.brightness_cost,
        varied=("luminance", "events_image", "motion"),
        output=lambda sizes: sizes["luminance"][:1],
        forward_scratch=lambda sizes: [sizes["luminance"][:2]],
        adjoint_scratch=lambda sizes: [(*sizes["luminance"][:2], 2)],
        forward=lambda backend, given, scratch, out: backend.brightness_cost(*given, *scratch, out),
        adjoint=adjoint,
    )


@functools.cache
def sample_moments() -> Rule:
    """Give the rule of `evqr_kernels.sample_moments`: in the image."""

    def forward(backend: Backend, given: Arrays, scratch: Arrays, out: Array) -> None:
        backend.clear(out)  # what is not active is left as it is
        backend.sample_moments(*given, *scratch, out)

    def adjoint(backend: Backend, given: Arrays, adj: Array, scratch: Arrays, adjoints: Arrays) -> None:
        backend.clear(adjoints[0])
        backend.sample_moments_adjoint(*given, adj, *adjoints)

    def shape(sizes: Shapes) -> Shape:
        return sizes["pose"][0], sizes["table"][1] + 1

    return Rule(
        op="sample_moments",
        inputs=("image", "image_idx", "pose", "active", "points", "table"),
        require=arguments.sample_moments,
        indices=("image_idx", "active"),
        varied=("image",),
        output=shape,
        forward_scratch=lambda sizes: [
            (sizes["pose"][0], chunks_of_samples(sizes["points"][0]), shape(sizes)[1])
        ],
        forward=forward,
        adjoint=adjoint,
    )
