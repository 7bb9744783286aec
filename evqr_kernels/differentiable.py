"""What a framework with automatic differentiation must know of an operation: shapes, and its two directions.

`evqr_kernels.torch` and `evqr_kernels.jax` make functions of operations of the table, differentiable where
those have an adjoint.  A rule allocates nothing: the framework makes all buffers, arrays of its own kind, and
hands over views of them in the order of the operation's arguments.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels import ops
from evqr_kernels.backend import Array
from evqr_kernels.call import check_call, run_operation
from evqr_kernels.checks import check_size
from evqr_kernels.operation import Input, Operation, Output, Scratch, Shape, Written, shape_of
from evqr_kernels.operations import OPERATIONS

Shapes = Mapping[str, Shape]
Arrays = Sequence[Array]
A = TypeVar("A", bound=Any)
Backend = Any  # a KernelBackend


@dataclass(frozen=True)
class Rule:
    """An operation with its settings; those with the same settings are equal.

    Attributes
    ----------
    op : str
        Name of the operation.
    settings : tuple of (str, object)
        Settings and sizes that are not those of inputs, by name.
    """

    op: str
    settings: tuple[tuple[str, Any], ...]

    @property
    def operation(self) -> Operation:
        """The operation."""
        return OPERATIONS[self.op]

    @property
    def differentiable(self) -> bool:
        """Whether it has an adjoint."""
        return self.operation.adjoint is not None

    @property
    def adjoint_operation(self) -> Operation:
        """Its adjoint."""
        assert self.operation.adjoint is not None
        return OPERATIONS[self.operation.adjoint]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(array.name for array in self.operation.inputs)

    @property
    def indices(self) -> tuple[str, ...]:
        """Inputs that are int32."""
        return tuple(array.name for array in self.operation.inputs if array.integer)

    @property
    def varied(self) -> tuple[str, ...]:
        """Inputs that the adjoint is in, in its order."""
        if not self.differentiable:
            return ()
        return tuple(adjoint_of(output) for output in self.adjoint_operation.outputs)

    @property
    def added(self) -> tuple[str, ...]:
        """Inputs that are just added: their adjoint is that of the output."""
        return self.operation.passes_on

    def check(self, shapes: Shapes, dtypes: Mapping[str, DTypeLike]) -> None:
        """Raise TypeError or ValueError unless the inputs fit.  Looks at no values."""
        # of the same shapes and dtypes, in four bytes each
        likes = {name: np.broadcast_to(np.zeros((), dtypes[name]), shapes[name]) for name in self.inputs}
        self._check(likes, shapes, values=False)

    def check_host(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Raise TypeError or ValueError unless the inputs, in the host's memory, fit: shapes and values."""
        self._check(arrays, {name: array.shape for name, array in arrays.items()}, values=True)

    def _check(self, arrays: Mapping[str, NDArray[Any]], shapes: Shapes, *, values: bool) -> None:
        check_call(self.operation, {**arrays, **dict(self.settings)}, values=values)
        made = [
            self.output(shapes),
            *self.forward_scratch(shapes, self.operation.variant("warp", "cpu").tile),
        ]
        if self.differentiable:
            made += self.adjoint_scratch(shapes, self.adjoint_operation.variant("warp", "cpu").tile)
        for shape in made:
            check_size(self.op, shape)

    def sizes(self, shapes: Shapes, tile: int) -> dict[str, Any]:
        """Give values of letters and settings."""
        return {**self.operation.bind(shapes, dict(self.settings)), "tile": tile}

    def output(self, shapes: Shapes) -> Shape:
        """Give the shape of the output, from those of the inputs."""
        (output,) = self.operation.outputs
        return shape_of(output, self.sizes(shapes, 1))

    @property
    def counts(self) -> bool:
        """Whether the output is of integers."""
        return self.operation.outputs[0].integer

    def forward_scratch(self, shapes: Shapes, tile: int) -> list[Shape]:
        """Give the shapes of partial results; ``tile`` is the backend's for the operation."""
        return [shape_of(array, self.sizes(shapes, tile)) for array in self.operation.scratch]

    def adjoint_scratch(self, shapes: Shapes, tile: int) -> list[Shape]:
        """Give the shapes of the adjoint's partial results; ``tile`` is the backend's for the adjoint."""
        return [shape_of(array, self.sizes(shapes, tile)) for array in self.adjoint_operation.scratch]

    def forward(self, backend: Backend, given: Arrays, scratch: Arrays, out: Array) -> None:
        """Compute the output, which is overwritten."""
        self._run(backend, self.operation, dict(zip(self.inputs, given, strict=True)), scratch, [out])

    def adjoint(self, backend: Backend, given: Arrays, adj: Array, scratch: Arrays, adjoints: Arrays) -> None:
        """Compute the adjoints of ``varied`` from that of the output; they are overwritten."""
        (output,) = self.operation.outputs
        arrays = dict(zip(self.inputs, given, strict=True))
        arrays[f"adj_{output.name.removesuffix('_out')}"] = adj
        self._run(backend, self.adjoint_operation, arrays, scratch, adjoints)

    def _run(
        self, backend: Backend, operation: Operation, arrays: dict[str, Array], scratch: Arrays, outs: Arrays
    ) -> None:
        partial, written, values = iter(scratch), iter(outs), {**arrays, **dict(self.settings)}
        for argument in operation.arguments:
            if isinstance(argument, Scratch):
                values[argument.name] = next(partial)
            elif isinstance(argument, Output):
                values[argument.name] = out = next(written)
                if argument.written is not Written.OVERWRITTEN:
                    backend.clear(out)
        run_operation(backend, operation, values)


def adjoint_of(output: Output) -> str:
    """Give the input that an adjoint's output is of."""
    return output.name.removeprefix("adj_").removesuffix("_out")


class Front:
    """The differentiable function of an operation: its arguments, and what is said of it.

    Parameters
    ----------
    op : str
        Name of the operation.
    array : str
        What the framework calls its arrays, for the signature.
    """

    def __init__(self, op: str, array: str) -> None:
        self.operation = OPERATIONS[op]
        parameters = inspect.signature(getattr(ops, op)).parameters.values()
        kept = [p for p in parameters if p.name not in ("out", "backend", "device")]
        arrays = {a.name for a in self.operation.inputs}
        sizes = {s.name for s in self.operation.parameters if s.letters}
        self.signature = inspect.Signature(
            [
                p.replace(
                    annotation=p.annotation.replace("Floats", array).replace("Ints", array)
                    if p.name in arrays
                    else p.annotation.removesuffix(" | None" * (p.name in sizes)),
                    default=p.empty if p.name in sizes else p.default,
                )
                for p in kept
            ],
            return_annotation=array,
        )
        parameters = self.signature.parameters.values()
        self._defaults = {p.name: None if p.default is p.empty else p.default for p in parameters}
        self._required = tuple(p.name for p in parameters if p.default is p.empty)
        self._positional = sum(p.kind is not p.KEYWORD_ONLY for p in parameters)

    def values(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
        """Give what the function was called with, and defaults, by name; TypeError if it does not fit."""
        given = {**dict(zip(self._defaults, args, strict=False)), **kwargs}
        fits = len(given) == len(args) + len(kwargs) and len(args) <= self._positional
        if not (
            fits and all(n in given for n in self._required) and all(n in self._defaults for n in kwargs)
        ):
            self.signature.bind(*args, **kwargs)
        return {**self._defaults, **given}

    def bound(
        self,
        args: tuple[Any, ...],
        kwargs: dict[str, Any],
        require: Callable[[str, Any], A],
        default: Callable[[Input, list[float], Shape, A], A],
    ) -> tuple[Rule, list[A]]:
        """Give the rule of a call and its arrays.

        Parameters
        ----------
        args, kwargs : tuple, dict
            What the function was called with.
        require : callable
            Raises TypeError unless what has a name is an array.
        default : callable
            Makes what stands for an input that is not given, of a row and a shape, like an array of floats.
        """
        values = self.values(args, kwargs)
        settings = []
        for setting in self.operation.settings:
            value = values[setting.name]
            value = setting.default if value is None else value
            settings.append((setting.name, tuple(value) if isinstance(value, list) else value))
        rule = Rule(self.operation.name, tuple(settings))
        given = {
            array.name: require(array.name, values[array.name])
            for array in self.operation.inputs
            if values[array.name] is not None or array.default is None
        }
        sizes = self.operation.bind({n: tuple(a.shape) for n, a in given.items()}, dict(settings))
        like = next(given[array.name] for array in self.operation.inputs if not array.integer)
        for array in self.operation.inputs:
            if array.name not in given:
                # 0 where no other input tells a size: the check says what is wrong with that
                shape = tuple(sizes.get(n, 0) if isinstance(n, str) else n for n in array.shape)
                given[array.name] = default(array, array.row(sizes), shape, like)
        return rule, [given[name] for name in rule.inputs]

    def dress(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Give a function the name, signature and documentation of this one."""
        function.__name__ = function.__qualname__ = self.operation.name
        function.__signature__ = self.signature  # pyright: ignore[reportFunctionMemberAccess]
        function.__doc__ = self.documentation
        return function

    @property
    def documentation(self) -> str:
        """What is said of it: the rest is said of the checked function."""
        op, original = self.operation.name, inspect.getdoc(getattr(ops, self.operation.name)) or ""
        as_there = ", ".join(name for name in self.signature.parameters if name != "shape")
        shape = (
            "shape : (int, int)\n    (Y, X) of the image.\n" if "shape" in self.signature.parameters else ""
        )
        (result,) = re.findall(r"^Returns\n-+\n(.*)", original, re.MULTILINE)
        rule = Rule(op, ())
        varied = [f"``{name}``" for name in rule.inputs if name in (*rule.varied, *rule.added)]
        said = "Not differentiable."
        if varied:
            said = f"Differentiable in {' and '.join(filter(None, (', '.join(varied[:-1]), varied[-1])))}."
        notes = (
            f"The backward pass is `evqr_kernels.{self.operation.adjoint}`."
            if varied
            else "It has no adjoint."
        )
        return f"""{original.partition(".")[0]}: `evqr_kernels.{op}`.

Parameters
----------
{as_there}
    As there.
{shape}
Returns
-------
{result}
    A new one.  {said}

Notes
-----
{notes}
"""
