"""Frozen dataclasses with arrays in them, as values: they compare, hash, pickle and print by what they hold.

This is also the one way from a result to JSON: `plain` says what becomes of arrays, enums, bytes and numbers.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
import math
from collections.abc import Hashable, Mapping
from enum import Enum
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

V = TypeVar("V", bound="Value")

LONGEST_TEXT = 60
"""Characters of a field that a short description shows."""


def read_only(values: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Give an array that cannot be written to: a copy, unless it is one already.

    Parameters
    ----------
    values : array-like
        What it holds.
    dtype : numpy dtype
        Of the array.

    Returns
    -------
    array : numpy array
        Contiguous and read-only; owns its numbers.
    """
    if (
        isinstance(values, np.ndarray)
        and values.dtype == dtype
        and values.base is None
        and not values.flags.writeable
        and values.flags.c_contiguous
    ):
        return values
    array = np.array(values, dtype, order="C")
    array.flags.writeable = False
    return array


class FrozenDict(dict):
    """A dict that refuses to change, so that it can be hashed and shared."""

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError("this dict is part of a result and cannot be changed: make a dict() of it")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = _refuse
    setdefault = update = _refuse  # pyright: ignore[reportAssignmentType]

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenDict, (dict(self),)


class Value:
    """Base of frozen dataclasses (``eq=False``) whose fields may be arrays and dicts, which are frozen too.

    Two are equal when they are of one class and all fields with ``compare`` are equal; equal ones have the
    same hash.  Fields without ``repr`` are left out of descriptions and of `to_dict`, those without
    ``compare`` of descriptions.
    """

    def __post_init__(self) -> None:
        for name in _may_change(type(self)):
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, read_only(value, value.dtype))
            elif isinstance(value, dict) and not isinstance(value, FrozenDict):
                object.__setattr__(self, name, FrozenDict(value))

    @classmethod
    def trusted(cls: type[V], **fields: Any) -> V:
        """Make one of what needs no check: arrays are read-only already and will not change.

        Parameters
        ----------
        **fields : any
            All of them.

        Returns
        -------
        value : Value
            As the constructor makes it, at a fraction of the cost.
        """
        made = object.__new__(cls)
        made.__dict__.update(fields)
        return made

    def altered(self: V, **fields: Any) -> V:
        """Make the same with other fields, likewise unchecked; what is cached must not depend on them.

        Parameters
        ----------
        **fields : any
            Those that differ.

        Returns
        -------
        value : Value
            With what is cached of this one.
        """
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__)
        made.__dict__.update(fields)
        return made

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self is other or all(
            _same(getattr(self, name), getattr(other, name)) for name in _compared(self)
        )

    def __hash__(self) -> int:
        return hash((type(self), *(_hashable(getattr(self, name)) for name in _compared(self))))

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False  # arrays come out of a pickle writable
        self.__dict__.update(state)

    def __str__(self) -> str:
        compared = _compared(self)
        shown = ((name, _short(getattr(self, name))) for name in _shown(self) if name in compared)
        return f"{type(self).__name__}({', '.join(f'{name}={text}' for name, text in shown)})"

    def to_dict(self) -> dict[str, Any]:
        """Return what it holds as plain values, as JSON has them.

        Returns
        -------
        record : dict
            Lists for arrays, values for enums, dicts for values in it.
        """
        return {name: plain(getattr(self, name)) for name in _shown(self)}

    def to_json(self) -> str:
        """Return `to_dict` as one line of JSON.

        Returns
        -------
        line : str
            In ASCII, so that any terminal and any pipe carries it.
        """
        return json_line(self.to_dict())


def plain(value: Any, digits: int | None = None) -> Any:
    """Return a value as JSON has it.

    Parameters
    ----------
    value : any
        Array, enum, bytes (as base64), dataclass, number, text, or mapping and sequence of them.
    digits : int, optional
        Floats are rounded to so many after the point.

    Returns
    -------
    plain : dict, list, str, int, float, bool or None
        What is not finite is None: JSON has no word for it.
    """
    if isinstance(value, Value):
        return value.to_dict()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: plain(getattr(value, name)) for name in _shown(value)}
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, (np.generic, np.ndarray)):
        return plain(value.tolist(), digits)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(each, digits) for key, each in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(each, digits) for each in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else round(value, digits)
    return value


def json_line(record: Mapping[str, Any]) -> str:
    """Write one JSON object on one line, in ASCII.

    Parameters
    ----------
    record : mapping of str to any
        What `plain` takes, by key.

    Returns
    -------
    line : str
        Without the end of the line.

    Raises
    ------
    TypeError
        A value is of a type that has no place in JSON.
    """
    return json.dumps(plain(record), allow_nan=False)


NEVER_CHANGE = ("int", "float", "bool", "str", "bytes")
"""Types, as annotations have them, of fields that need not be looked at: there are many a window."""


@functools.cache
def _may_change(kind: type) -> tuple[str, ...]:
    """Return the fields that an array or a dict could be in."""
    never = {*NEVER_CHANGE, *(f"{name} | None" for name in NEVER_CHANGE)}
    return tuple(field.name for field in dataclasses.fields(kind) if field.type not in never)


def _compared(value: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(value) if field.compare]


def _shown(value: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(value) if field.repr]


def _same(one: Any, other: Any) -> bool:
    if not isinstance(one, np.ndarray) or not isinstance(other, np.ndarray):
        return type(one) is type(other) and bool(one == other)
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")


def _hashable(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        # by numbers, not bytes: 0 and -0 are equal; and NaN, which has a hash for each, counts as one
        return value.shape, *(None if each != each else each for each in value.ravel().tolist())
    return value


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size > 6:
        return f"{value.dtype} {value.shape}"
    if isinstance(value, np.ndarray):
        text = str(value.tolist())
    else:
        text = str(value) if dataclasses.is_dataclass(value) else repr(plain(value))
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."
