"""What an operation is, written down once: its arguments, their shapes, what is refused, and its adjoint.

The table (`evqr_kernels.operations`) has one `Operation` for each.  Backends find their launchers by it, the
checked functions, PyTorch's and JAX's check and allocate by it, and so do the tests and the measurements.

A size of an array is a number, a letter, or an expression in letters, settings and ``tile``, as in
``("B", "Y", "2 * radius + 1")``.  A letter is one size throughout a call: that of the first array that has
it.  ``tile`` is how much of a thing one thread takes together; it depends on the device, and the backend
tells it.
"""

from __future__ import annotations

import enum
import functools
import math
import operator
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import CodeType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.config import SplatConfig

Extent = int | str
Shape = tuple[int, ...]
Sizes = Mapping[str, Any]
"""Values of letters and settings, and of ``tile``."""

Arrays = Mapping[str, Any]
"""Arrays by the names of the arguments."""


class Written(enum.Enum):
    """What becomes of what an output held before."""

    OVERWRITTEN = "overwritten"
    ACCUMULATED = "added to: zero it first"
    IN_PART = "overwritten where something is computed, and left as it is elsewhere"
    IN_PLACE = "where the operation begins"


@dataclass(frozen=True, kw_only=True)
class Argument:
    """An argument of a launcher.

    Attributes
    ----------
    name : str
        As in the launchers, and in the checked function.
    """

    name: str


@dataclass(frozen=True, kw_only=True)
class Array(Argument):
    """An array.

    Attributes
    ----------
    shape : tuple
        Sizes.
    integer : bool
        Whether it is of integers; otherwise it has the call's float dtype.
    integers : type
        Of which.
    """

    shape: tuple[Extent, ...]
    integer: bool = False
    integers: type[np.integer[Any]] = np.int32

    def dtype(self, floats: DTypeLike) -> np.dtype[Any]:
        """Give the dtype in a call whose floats are ``floats``."""
        return np.dtype(self.integers if self.integer else floats)


@dataclass(frozen=True, kw_only=True)
class Input(Array):
    """An array that is read.

    Attributes
    ----------
    index : str or None
        It holds indices of so many things.
    ascending : bool
        It is a ``window_ptr``, which cuts E events into B windows.
    ranges : str or None
        It cuts windows out of so many things: the first of each, and the one behind its last.
    most : tuple of size
        What the entries of a row may be at most, and not below 0; empty for any.
    choices : tuple of int
        What its last size may be; empty for any.
    default : float, tuple of float or size, or None
        What stands for it where a caller gives none: a value, or a row of them; None if it must be given.
        How many rows, if nothing else tells: one.
    single : bool
        Whether a caller who has one of it may leave out its first axis.
    check : callable or None
        Raises ValueError unless its contents are right; called where the host can read them.
    made : callable or None
        Makes it of the other arguments of the checked function, which then does not have it.
    """

    index: str | None = None
    ascending: bool = False
    ranges: str | None = None
    most: tuple[Extent, ...] = ()
    choices: tuple[int, ...] = ()
    default: float | tuple[float | str, ...] | None = None
    single: bool = False
    check: Callable[[NDArray[Any]], None] | None = None
    made: Callable[[Sizes, np.dtype[Any]], Any] | None = None

    def row(self, sizes: Sizes) -> list[float]:
        """Give what stands for each of its rows where a caller gives none; a letter without value is 0."""
        default = self.default if isinstance(self.default, tuple) else (self.default or 0.0,)
        known = defaultdict(int, sizes)
        return [size_of(value, known) if isinstance(value, str) else value for value in default]


@dataclass(frozen=True, kw_only=True)
class Output(Array):
    """An array that is written.

    Attributes
    ----------
    written : Written
        What becomes of what it held.
    start : str or None
        Of one in place: the argument of the checked function that it begins with, and leaves as it is.
    returned : bool
        Whether the checked function gives it.
    """

    written: Written = Written.OVERWRITTEN
    start: str | None = None
    returned: bool = True


@dataclass(frozen=True, kw_only=True)
class Scratch(Array):
    """An array of partial results; what it holds before and after means nothing."""


@dataclass(frozen=True, kw_only=True)
class Setting(Argument):
    """A number, or a frozen configuration.

    Attributes
    ----------
    least : float or None
        The least that it may be.
    default : object or None
        What None stands for.
    letters : tuple of str
        Sizes that it gives; of more than one, in this order.
    """

    least: float | None = None
    default: Any = None
    letters: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Variant:
    """What an operation's kernels are built for, where it is suitable.

    Attributes
    ----------
    tile : int
        How much one thread takes together: neighbours in memory, events or samples.
    threads : int
        So many share the events of a window.
    rows : int
        So many rows of it.
    lanes : int
        Threads that do one thing together, a window or a pose, and wait for each other: a block of a GPU.
    device : str or None
        Kind of device that it is for: "cpu", "cuda", "vulkan", "metal"; None for any.
    architecture : int
        Least architecture of such a device: 90 for compute capability 9.0.
    width : int
        Least width that it is for.
    backend : str or None
        Backend that it is for; None for any.
    """

    tile: int = 1
    threads: int = 1
    rows: int = 1
    lanes: int = 1
    device: str | None = None
    architecture: int = 0
    width: int = 0
    backend: str | None = None

    def suits(self, backend: str, device: str, architecture: int, width: int) -> bool:
        """Whether it is for this backend, kind of device, architecture and width."""
        return (
            self.backend in (None, backend)
            and self.device in (None, device)
            and self.architecture <= architecture
            and self.width <= width
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Operation:
    """An operation.

    Attributes
    ----------
    name : str
        Of the launchers and of the checked function.
    file : str
        Module of each backend's package that has the launcher.
    arguments : tuple of Argument
        Of the launchers, in order: inputs and settings, then scratch and outputs; configurations may follow.
    parameters : tuple of Setting
        What the checked function has beside them.
    variants : tuple of Variant
        What its kernels are built for: the first that suits is taken.
    adjoint : str or None
        The operation that is its adjoint, whose outputs tell what in: ``adj_x_out`` is that of ``x``.
    passes_on : tuple of str
        Inputs that are just added: their adjoint is that of the output.
    check : callable or None
        Raises ValueError unless shapes and settings fit each other.
    check_values : callable or None
        Raises ValueError unless contents fit each other; called where the host can read them.
    floats : tuple
        Float dtypes that it computes in.
    """

    name: str
    file: str
    arguments: tuple[Argument, ...]
    parameters: tuple[Setting, ...] = ()
    variants: tuple[Variant, ...] = (Variant(),)
    adjoint: str | None = None
    passes_on: tuple[str, ...] = ()
    check: Callable[[Arrays, Sizes], None] | None = None
    check_values: Callable[[Arrays, Sizes], None] | None = None
    floats: tuple[type[np.floating[Any]], ...] = (np.float32, np.float64)

    @functools.cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Arrays that are read."""
        return tuple(a for a in self.arguments if isinstance(a, Input))

    @functools.cached_property
    def looked_at(self) -> tuple[Input, ...]:
        """Inputs with contents that cannot be just anything."""
        return tuple(a for a in self.inputs if a.ascending or a.index or a.ranges or a.most or a.check)

    @functools.cached_property
    def outputs(self) -> tuple[Output, ...]:
        """Arrays that are written."""
        return tuple(a for a in self.arguments if isinstance(a, Output))

    @functools.cached_property
    def scratch(self) -> tuple[Scratch, ...]:
        """Arrays of partial results."""
        return tuple(a for a in self.arguments if isinstance(a, Scratch))

    @functools.cached_property
    def settings(self) -> tuple[Setting, ...]:
        """Settings of the launchers, and what the checked function has beside them."""
        return (*(a for a in self.arguments if isinstance(a, Setting)), *self.parameters)

    @functools.cached_property
    def accumulates(self) -> bool:
        """Whether threads add to one output, in no certain order on a GPU."""
        return any(output.written is Written.ACCUMULATED for output in self.outputs)

    def variant(self, backend: str, device: str, architecture: int = 0, width: int = 1 << 30) -> Variant:
        """Give the variant for a backend, a kind of device, an architecture and a width."""
        for variant in self.variants:
            if variant.suits(backend, device, architecture, width):
                return variant
        raise ValueError(f"{self.name} has no variant for {backend} on {device} and a width of {width}")

    def bind(self, shapes: Mapping[str, Shape], settings: Sizes) -> dict[str, Any]:
        """Give values of letters and settings, from shapes that fit; `check_call` sees to it that they do."""
        sizes: dict[str, Any] = {}
        for setting in self.settings:
            value = settings.get(setting.name, setting.default)
            if value is not None:
                sizes[setting.name] = value
                sizes.update(letters_of(setting, value))
        for array in (a for a in self.arguments if isinstance(a, (Input, Output))):
            name = checked_name(array)
            for extent, size in zip(array.shape, shapes.get(name, ()), strict=False):
                if isinstance(extent, str):
                    sizes.setdefault(extent, size)
            if isinstance(array, Input) and array.ascending and name in shapes:
                sizes["B"] = shapes[name][0] - 1
        return sizes


@dataclass(frozen=True)
class Buffer:
    """An array that a launcher writes: what it is, and how large in one call.

    Attributes
    ----------
    array : Output or Scratch
        What the table has.
    shape : tuple of int
        Its shape.
    dtype : dtype
        Its dtype.
    """

    array: Output | Scratch
    shape: Shape
    dtype: np.dtype[Any]


def buffers_behind(operation: Operation, given: Sequence[Any], settings: Sizes, tile: int) -> list[Buffer]:
    """Give what a launcher writes, from its first arguments.

    Parameters
    ----------
    operation : Operation
        What is called.
    given : sequence
        Values of the first arguments, all inputs among them: arrays and settings.
    settings : mapping
        Settings that are not among them, and sizes that they do not tell.
    tile : int
        The backend's.
    """
    named = dict(zip(operation.arguments, given, strict=False))
    shapes = {checked_name(a): v.shape for a, v in named.items() if isinstance(a, Array)}
    known = {a.name: v for a, v in named.items() if isinstance(a, Setting)} | dict(settings)
    sizes = {**operation.bind(shapes, known), "tile": tile}
    floats = next((v.dtype for a, v in named.items() if isinstance(a, Array) and not a.integer), np.float32)
    rest = [a for a in operation.arguments[len(given) :] if isinstance(a, (Output, Scratch))]
    return [Buffer(array, shape_of(array, sizes), array.dtype(floats)) for array in rest]


def letters_of(setting: Setting, value: Any) -> Iterator[tuple[str, int]]:
    """Give the sizes that a setting stands for.

    Raises
    ------
    TypeError
        If they are no whole numbers.
    ValueError
        If there are not as many as there should be.
    """
    if not setting.letters:
        return
    several = len(setting.letters) > 1
    wanted = f"({', '.join(setting.letters)}), whole numbers" if several else "a whole number"
    try:
        sizes = [operator.index(size) for size in (value if several else (value,))]
    except TypeError:
        raise TypeError(f"{setting.name} must be {wanted}, got {value!r}") from None
    if len(sizes) != len(setting.letters):
        raise ValueError(f"{setting.name} must be {wanted}, got {value!r}")
    yield from zip(setting.letters, sizes, strict=True)


def checked_name(argument: Argument) -> str:
    """Give what the checked function calls an argument."""
    return (argument.start if isinstance(argument, Output) else None) or argument.name


def shape_of(array: Array, sizes: Sizes) -> Shape:
    """Give an array's shape; KeyError names a letter that has no value."""
    return tuple(size_of(extent, sizes) for extent in array.shape)


def size_of(extent: Extent, sizes: Sizes) -> int:
    """Give the value of a size.

    Raises
    ------
    KeyError
        If a letter in it has no value.
    """
    if isinstance(extent, int):
        return extent
    if extent in sizes:
        return sizes[extent]
    code = _compiled(extent)
    return eval(code, _FUNCTIONS, {name: sizes[name] for name in code.co_names if name not in _FUNCTIONS})


@functools.cache
def _compiled(extent: str) -> CodeType:
    """Compile an expression; they are the table's own, and never a caller's."""
    return compile(extent, extent, "eval")


def _up(count: int, tile: int) -> int:
    return -(-count // tile) * tile


def _parts(count: int, tile: int) -> int:
    """So many parts of at most ``tile``, but at least one."""
    return max(1, -(-count // tile))


_FUNCTIONS: dict[str, Any] = {
    "__builtins__": {}, "ceil": math.ceil, "max": max, "min": min, "up": _up, "parts": _parts
}  # fmt: skip
"""What an expression may call: ``up(n, tile)`` is the next multiple, ``parts(n, tile)`` how many tiles."""


# Short names, so that an operation reads as its signature.


def floats(name: str, *shape: Extent, **more: Any) -> Input:
    """Declare an input of floats."""
    return Input(name=name, shape=shape, **more)


def ints(name: str, *shape: Extent, **more: Any) -> Input:
    """Declare an input of int32."""
    return Input(name=name, shape=shape, integer=True, **more)


def scratch(name: str, *shape: Extent, integer: bool = False) -> Scratch:
    """Declare partial results."""
    return Scratch(name=name, shape=shape, integer=integer)


def overwritten(name: str, *shape: Extent, **more: Any) -> Output:
    """Declare an output that is overwritten."""
    return Output(name=name, shape=shape, **more)


def accumulated(name: str, *shape: Extent, integer: bool = False) -> Output:
    """Declare an output that is added to."""
    return Output(name=name, shape=shape, written=Written.ACCUMULATED, integer=integer)


def in_part(name: str, *shape: Extent, integer: bool = False) -> Output:
    """Declare an output that is overwritten in part."""
    return Output(name=name, shape=shape, written=Written.IN_PART, integer=integer)


def in_place(name: str, *shape: Extent, start: str, returned: bool = True) -> Output:
    """Declare an output that the operation begins with."""
    return Output(name=name, shape=shape, written=Written.IN_PLACE, start=start, returned=returned)


def setting(name: str, least: float | None = None, **more: Any) -> Setting:
    """Declare a setting."""
    return Setting(name=name, least=least, **more)


def size(name: str, *letters: str, least: float | None = None) -> Setting:
    """Declare a setting that gives sizes: its own letter, if no others are named."""
    return Setting(name=name, least=least, letters=letters or (name,))


IMAGE = size("shape", "Y", "X")
"""Rows and columns of an image."""

SPLAT = setting("cfg", default=SplatConfig())
"""Shape of a splat."""
