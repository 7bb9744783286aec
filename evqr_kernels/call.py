"""A call of an operation by the table: its arguments checked, its arrays made, its launcher run.

No values are looked at unless the host can read them: of a tensor on a GPU there is a shape, and nothing else
for free.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import Array, KernelBackend
from evqr_kernels.checks import ArrayChecks, check_apart, check_counts, check_size
from evqr_kernels.errors import OperationRefused
from evqr_kernels.interop import host_view
from evqr_kernels.operation import (
    Input,
    Operation,
    Output,
    Scratch,
    Setting,
    Sizes,
    checked_name,
    letters_of,
    shape_of,
    size_of,
)
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.registry import get_backend, require_device

P = ParamSpec("P")
R = TypeVar("R")


def checked(declaration: Callable[P, R]) -> Callable[P, R]:
    """Make the checked function of an operation from its signature and documentation."""
    operation, signature = OPERATIONS[declaration.__name__], inspect.signature(declaration)

    @functools.wraps(declaration)
    def function(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        given = {name: host_view(name, value) for name, value in bound.arguments.items()}
        for array in operation.inputs:
            value = given.get(array.name)
            if array.single and isinstance(value, np.ndarray) and value.ndim == len(array.shape) - 1:
                given[array.name] = value[None]
        results = _run(operation, given, given.pop("backend"), given.pop("device"))
        return cast(R, results[0] if len(results) == 1 else tuple(results))

    return function


def check_call(
    operation: Operation, given: Mapping[str, Any], out: Any = None, *, values: bool = False
) -> tuple[dict[str, Any], np.dtype[Any]]:
    """Check the arguments of a call against each other.

    Parameters
    ----------
    operation : Operation
        What is called.
    given : mapping
        Arrays and settings by name; NumPy's, or what has a shape and dtype like theirs.
    out : array or None
        What is to be the operation's output.
    values : bool
        Whether to look at the contents of the arrays.

    Returns
    -------
    sizes : dict
        Values of letters and settings.
    floats : dtype
        That of the call's floats.

    Raises
    ------
    TypeError
        If what must be an array is none, or is of the wrong dtype, or a size is not given.
    ValueError
        If a shape, setting or content is out of range.
    """
    checks = ArrayChecks()
    for setting in operation.settings:
        value = given.get(setting.name)
        checks.sizes[setting.name] = setting.default if value is None else value
        if setting.least is not None and value is not None:
            checks.at_least(setting.name, value, setting.least)
    arrays = [a for a in operation.arguments if isinstance(a, (Input, Output)) and checked_name(a) in given]
    absent: list[Input] = []
    # those whose sizes follow from others' after these
    for array in sorted(arrays, key=lambda array: not _is_plain(array)):
        value = given[checked_name(array)]
        if value is None and isinstance(array, Input) and array.default is not None:
            absent.append(array)
            continue
        if isinstance(array, Input) and array.choices:
            checks.parameters(array.name, value, array.choices, array.shape[-1])
        elif isinstance(array, Input) and array.ascending:
            checks.windows(value)
        else:
            shape = [_known(extent, checks.sizes) for extent in array.shape]
            if array.integer:
                checks.ints(checked_name(array), value, *shape, dtype=array.integers)
            else:
                checks.floats(checked_name(array), value, *shape)
    for letter in (letter for array in absent for letter in _letters(array)):
        checks.sizes.setdefault(letter, 1)
    (output, *others) = operation.outputs
    if out is not None and not others:
        (checks.ints if output.integer else checks.floats)("out", out, *output.shape)
    for setting in operation.settings:
        for letter in setting.letters:
            if given.get(setting.name) is None and letter not in checks.sizes:
                raise TypeError(f"{setting.name} of the image must be given when there is no out")
        if given.get(setting.name) is not None and out is None:
            checks.sizes.update(letters_of(setting, given[setting.name]))
    if operation.check:
        operation.check(given, checks.sizes)
    for array in operation.inputs:
        if array.index and given.get(array.name) is not None:
            checks.choice(array.name, given[array.name], checks.sizes[array.index])
    if values:
        check_values(operation, given, checks.sizes)
    return checks.sizes, checks.dtype or np.dtype(np.float32)


def check_values(operation: Operation, given: Mapping[str, Any], sizes: Sizes) -> None:
    """Check what arrays hold, whose shapes fit.

    Parameters
    ----------
    operation : Operation
        What is called.
    given : mapping
        Arrays by name; None where a default stands.
    sizes : mapping
        Values of letters and settings.

    Raises
    ------
    ValueError
        If something in them is out of range.
    """
    checks = ArrayChecks(sizes)
    for array in operation.looked_at:
        value = given[array.name]
        if value is None:
            continue
        if array.ascending:
            checks.window_values(value)
        if array.index:
            checks.index(array.name, value, sizes[array.index])
        if array.ranges:
            checks.ranges(array.name, value, sizes[array.ranges])
        if array.most:
            checks.at_most(array.name, value, [size_of(n, sizes) for n in array.most])
        if array.check:
            array.check(value)
    if operation.check_values:
        operation.check_values(given, sizes)


def _is_plain(array: Input | Output) -> bool:
    ascending = isinstance(array, Input) and array.ascending
    return ascending or all(isinstance(extent, int) or extent.isidentifier() for extent in array.shape)


def _known(extent: int | str, sizes: Sizes) -> int | str:
    """Give the value of an expression, if its letters have one; a letter is for the checks to bind."""
    if isinstance(extent, int) or extent.isidentifier() or extent in sizes:
        return extent
    try:
        return size_of(extent, sizes)
    except KeyError:
        return extent


def default_of(array: Input, sizes: Sizes, floats: DTypeLike) -> NDArray[Any]:
    """Make what stands for an input that is not given."""
    made = np.empty(shape_of(array, sizes), array.dtype(floats))
    made[...] = array.row(sizes)
    return made


def make_scratch(
    backend: KernelBackend, device: str, op: str, floats: DTypeLike = np.float32, **sizes: Any
) -> list[Array]:
    """Make the arrays of partial results that an operation takes.

    Parameters
    ----------
    backend : KernelBackend
        Whose method is to be called.
    device : str
        Where.
    op : str
        Name of the operation.
    floats : dtype
        That of the call's floats.
    **sizes : int or float
        Values of the letters and settings that its scratch depends on.

    Returns
    -------
    arrays : list of array
        In the order of the operation's arguments; their contents are undefined.

    Raises
    ------
    ValueError
        If there is no such operation, or an array would have more elements than can be addressed.
    TypeError
        If a size is missing.
    """
    if op not in OPERATIONS:
        raise ValueError(f"op must be the name of an operation, got {op!r}")
    known = {**sizes, "tile": backend.tile(op, device)}
    made = []
    for array in OPERATIONS[op].scratch:
        try:
            shape = shape_of(array, known)
        except KeyError as error:
            raise TypeError(f"{error.args[0]} must be given: {array.name} of {op} depends on it") from None
        check_size("scratch", shape)
        made.append(backend.empty(shape, array.dtype(floats), device))
    return made


def run_operation(backend: KernelBackend, operation: Operation, values: Mapping[str, Any]) -> None:
    """Run a launcher with arrays of the backend and settings, by name."""
    given = [(argument, values[argument.name]) for argument in operation.arguments]
    last = max(k for k, (argument, _) in enumerate(given) if not isinstance(argument, Setting))
    positional = [value for _, value in given[: last + 1]]
    named = {argument.name: value for argument, value in given[last + 1 :]}
    getattr(backend, operation.name)(*positional, **named)


def _run(operation: Operation, given: dict[str, Any], name: str, device: str | None) -> list[NDArray[Any]]:
    """Check, choose the backend, move arrays there, launch, and bring the results back."""
    out = given.pop("out", None)
    sizes, floats = check_call(operation, given, out, values=True)
    backend = get_backend(name)
    device = device or backend.devices()[0]
    require_device(backend, device)
    refusal = backend.supports(operation.name, floats, device)
    if refusal:
        raise OperationRefused(f"{backend.name} refuses {operation.name}: {refusal}")
    sizes["tile"] = backend.tile(operation.name, device)
    values: dict[str, Any] = {}
    returned: list[tuple[NDArray[Any], Any]] = []
    for argument in operation.arguments:
        value = given.get(argument.name)
        if isinstance(argument, Input):
            if argument.made:
                value = argument.made(given, floats)
            elif value is None:
                value = default_of(argument, sizes, floats)
            value = backend.from_host(value, device)
        elif isinstance(argument, Setting):
            value = sizes[argument.name]
        elif isinstance(argument, Scratch):
            shape = shape_of(argument, sizes)
            check_size("scratch", shape)
            value = backend.empty(shape, argument.dtype(floats), device)
        elif isinstance(argument, Output):
            host = _host_output(argument, given, out, sizes, floats)
            value = backend.from_host(host, device)
            if argument.returned:
                returned.append((host, value))
        values[argument.name] = value
    run_operation(backend, operation, values)
    backend.synchronize(device)
    results = [_brought_back(backend, host, there) for host, there in returned]
    if operation.accumulates and "window_ptr" in given:
        check_counts(given["window_ptr"], results)
    return results


def _host_output(
    output: Output, given: Mapping[str, Any], out: Any, sizes: Sizes, floats: DTypeLike
) -> NDArray[Any]:
    """Give the host's array of a result: ``out``, a copy of where it starts, or zeros."""
    shape = shape_of(output, sizes)
    check_size("result", shape)
    if output.start:
        return given[output.start].copy()
    if out is None:
        return np.zeros(shape, output.dtype(floats))
    if not out.flags.writeable:
        raise ValueError("out must be writable, it gets the result: give a copy of it, or no out")
    check_apart("out", out, given)
    return out


def _brought_back(backend: KernelBackend, host: NDArray[Any], there: Array) -> NDArray[Any]:
    back = backend.to_host(there)
    if not np.may_share_memory(host, back):
        np.copyto(host, back)
    return host


FEW = {"B": 1, "N": 1, "K": 5, "M": 1}
"""Sizes that are not many where none is given: windows, poses, taps of a filter, codes."""


def example(backend: KernelBackend, device: str, op: str, given: Mapping[str, Any]) -> Callable[[], None]:
    """Give a call of an operation on arrays of some size, to see what it launches; they hold nothing.

    Parameters
    ----------
    backend : KernelBackend
        Whose arrays.
    device : str
        Where they are.
    op : str
        Name of the operation.
    given : mapping
        Sizes and settings that matter; others are chosen.
    """
    if op not in OPERATIONS:
        raise ValueError(f"op must be the name of an operation, got {op!r}")
    operation = OPERATIONS[op]
    sizes: dict[str, Any] = {"tile": backend.tile(op, device)}
    for setting in operation.settings:
        value = given.get(setting.name, setting.default)
        sizes[setting.name] = 1 if value is None else value
    for array in _arrays(operation):
        for letter in _letters(array):
            sizes.setdefault(letter, given.get(letter, FEW.get(letter, 32)))
        if isinstance(array, Input) and array.choices:
            sizes[str(array.shape[-1])] = given.get(str(array.shape[-1]), array.choices[0])
    values = dict(sizes)
    for array in _arrays(operation):
        values[array.name] = backend.empty(shape_of(array, sizes), array.dtype(np.float32), device)
    return lambda: run_operation(backend, operation, values)


def _arrays(operation: Operation) -> list[Input | Output | Scratch]:
    return [a for a in operation.arguments if isinstance(a, (Input, Output, Scratch))]


def _letters(array: Input | Output | Scratch) -> Iterable[str]:
    """Names in the sizes of an array."""
    for extent in array.shape:
        if isinstance(extent, str):
            names = compile(extent, extent, "eval").co_names
            yield from (name for name in names if name.isupper() or name == "most")
