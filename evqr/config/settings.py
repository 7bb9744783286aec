"""What all settings share: frozen, keyword-only, and checked against what their annotations allow.

A field says what it takes in its annotation, ``Annotated[float, Range(above=0.0)]``, so that the check, the
message and the type are one line.
"""

from __future__ import annotations

import difflib
import functools
import math
import numbers
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union

_S = TypeVar("_S", bound="Settings")


@dataclass(frozen=True, kw_only=True)
class Range:
    """Numbers that a setting takes; the finite ones, where no end is given.

    Attributes
    ----------
    least, most : float, optional
        Ends that are allowed themselves.
    above, below : float, optional
        Ends that are not.
    """

    least: float | None = None
    above: float | None = None
    most: float | None = None
    below: float | None = None

    def __contains__(self, value: float) -> bool:
        return (
            math.isfinite(value)
            and (self.least is None or value >= self.least)
            and (self.above is None or value > self.above)
            and (self.most is None or value <= self.most)
            and (self.below is None or value < self.below)
        )

    def __str__(self) -> str:
        ends = (
            ("at least", self.least),
            ("above", self.above),
            ("at most", self.most),
            ("below", self.below),
        )
        return " and ".join(f"{word} {end:.15g}" for word, end in ends if end is not None)


class Ascending:
    """Marks a tuple of numbers none of which may be smaller than the one before it."""


class NotEmpty:
    """Marks a tuple of at least one."""


class KnownCharset:
    """Marks the name of a character set that Python knows."""


Count = Annotated[int, Range(least=1)]
Positive = Annotated[float, Range(above=0.0)]
NotNegative = Annotated[float, Range(least=0.0)]
CharacterSet = Annotated[str, KnownCharset]
Share = Annotated[float, Range(least=0.0, most=1.0)]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of all settings.

    Raises
    ------
    TypeError
        A value is of the wrong type.
    ValueError
        A value is not among those allowed.
    """

    def __post_init__(self) -> None:
        for name, kind in kinds(type(self)).items():
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, _converted(value, kind))
            except (TypeError, ValueError) as error:
                # of settings within settings, the message is there already
                said = f"{name}: {error}" if error.args else f"{name} must be {_allowed(kind)}, got {value!r}"
                raise type(error)(said) from None

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values that JSON and TOML can hold; `from_dict` reads them.

        Returns
        -------
        settings : dict
            Key by field; enums are their values, tuples are lists, settings in settings are dicts.
        """
        return {field.name: _plain(getattr(self, field.name)) for field in fields(self)}

    def changed(self) -> dict[str, Any]:
        """Return what is not the default, as JSON has it.

        Returns
        -------
        changed : dict
            Such that ``from_dict`` of it is equal.
        """
        mine, default = self.to_dict(), type(self)().to_dict()
        changed = {name: value for name, value in mine.items() if value != default[name]}
        for name in changed:
            value = getattr(self, name)
            if isinstance(value, Settings):
                changed[name] = value.changed()
        return changed

    @classmethod
    def from_dict(cls: type[_S], values: Mapping[str, Any]) -> _S:
        """Make settings from what `to_dict` returned, or from a part of it: the rest are defaults.

        Parameters
        ----------
        values : mapping
            Value by field.

        Returns
        -------
        settings : Settings
            Of the class that this is called on.

        Raises
        ------
        TypeError
            A value is of the wrong type.
        ValueError
            There is no such setting, or a value is not among those allowed.
        """
        known = [field.name for field in fields(cls)]
        for name in values:
            if name not in known:
                close = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(known)}"
                raise ValueError(f"{cls.__name__} has no setting {name!r}: {hint}")
        return cls(**values)


@functools.cache
def kinds(settings: type[Settings]) -> dict[str, Any]:
    """Return the annotation of each field, with what `Annotated` adds.

    Parameters
    ----------
    settings : type of Settings
        Any of the classes.

    Returns
    -------
    kinds : dict
        Annotation by name of field.
    """
    hints = typing.get_type_hints(settings, include_extras=True)
    return {field.name: hints[field.name] for field in fields(settings)}


def _converted(value: Any, kind: Any) -> Any:
    """Return the value as the type that is asked for; raise TypeError or ValueError where it is not that."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        value = _converted(value, parts[0])
        for limit in parts[1:]:
            if isinstance(limit, Range) and value not in limit:
                raise ValueError
            if limit is Ascending and list(value) != sorted(value):
                raise ValueError
            if limit is NotEmpty and not value:
                raise ValueError
            if limit is KnownCharset and not _is_charset(value):
                raise ValueError
        return value
    if origin in (Union, UnionType):
        errors = []
        for part in parts:
            try:
                return _converted(value, part)
            except (TypeError, ValueError) as error:
                errors.append(error)
        raise next((error for error in errors if isinstance(error, ValueError)), errors[0])
    if origin is tuple:
        return _converted_tuple(value, parts)
    if kind is NoneType and value is None:
        return None
    if (kind is bool and isinstance(value, bool)) or (kind is str and isinstance(value, str)):
        return value
    if kind is int and isinstance(value, numbers.Integral) and not isinstance(value, bool):
        return int(value)
    if kind is float and isinstance(value, numbers.Real) and not isinstance(value, bool):
        return float(value)
    if isinstance(kind, type) and issubclass(kind, Enum) and isinstance(value, (str, kind)):
        try:
            return kind(value)
        except ValueError:
            raise ValueError from None  # what is allowed is said in one place
    if isinstance(kind, type) and issubclass(kind, Settings):
        if isinstance(value, Mapping):
            return kind.from_dict(value)
        if isinstance(value, kind):
            return value
    raise TypeError


def _is_charset(name: str) -> bool:
    try:
        return bool("a".encode(name))
    except (LookupError, ValueError):  # unknown, or a codec that is no character set
        return False


def _converted_tuple(value: Any, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise TypeError
    if parts[1:] == (...,):
        parts = (parts[0],) * len(value)
    if len(value) != len(parts):
        raise ValueError
    return tuple(_converted(one, part) for one, part in zip(value, parts, strict=True))


def _allowed(kind: Any) -> str:
    """Say in words what a setting takes."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        limits = [str(limit) for limit in parts[1:] if isinstance(limit, Range)]
        limits += ["as utf-8 or shift_jis" for limit in parts[1:] if limit is KnownCharset]
        limits += ["at least one" for limit in parts[1:] if limit is NotEmpty]
        limits += ["none smaller than the one before" for limit in parts[1:] if limit is Ascending]
        return ", ".join([_allowed(parts[0]), *limits])
    if origin in (Union, UnionType):
        return ", or ".join(_allowed(part) for part in parts)
    if origin is tuple:
        return _allowed_tuple(parts)
    if issubclass(kind, Enum):
        return "one of " + ", ".join(repr(member.value) for member in kind)
    if issubclass(kind, Settings):
        return f"a {kind.__name__}"
    names = {NoneType: "None", bool: "True or False", int: "a whole number", float: "a number", str: "a name"}
    return names[kind]


def _allowed_tuple(parts: tuple[Any, ...]) -> str:
    if parts[1:] == (...,):
        return f"a tuple, each {_allowed(parts[0])}"
    each = [_allowed(part) for part in parts]
    if len(set(each)) == 1:
        return f"a tuple of {len(each)}, each {each[0]}"
    return f"a tuple of {len(each)}: " + "; ".join(each)


def _plain(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.to_dict()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return value
