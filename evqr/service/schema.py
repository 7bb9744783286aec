"""Settings as a JSON schema, for editors that complete and check files of them."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, Union

from evqr.config import JobConfig
from evqr.config.settings import Range, Settings, kinds
from evqr.service.settings import ServiceSettings

PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}


def json_schema() -> dict[str, Any]:
    """Give the schema of a service's file.

    Returns
    -------
    schema : dict
        JSON Schema, draft 2020-12.
    """
    schema = _of_settings(ServiceSettings)
    schema["properties"]["jobs"] = {"type": "object", "additionalProperties": _of_settings(JobConfig)}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "evqr watch",
        "required": ["source"],
        **schema,
    }


def _of_settings(settings: type[Settings]) -> dict[str, Any]:
    properties: Mapping[str, Any] = {name: _of(kind) for name, kind in kinds(settings).items()}
    return {"type": "object", "additionalProperties": False, "properties": dict(properties)}


def _of(kind: Any) -> dict[str, Any]:
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        found = _of(parts[0])
        for limit in parts[1:]:
            if isinstance(limit, Range):
                ends = {
                    "minimum": limit.least, "exclusiveMinimum": limit.above,
                    "maximum": limit.most, "exclusiveMaximum": limit.below,
                }  # fmt: skip
                found |= {name: end for name, end in ends.items() if end is not None}
        return found
    if origin in (Union, UnionType):
        # TOML has no word for None: such a setting is left out
        several = [_of(part) for part in parts if part is not NoneType]
        return several[0] if len(several) == 1 else {"anyOf": several}
    if origin is tuple:
        if parts[1:] == (...,):
            return {"type": "array", "items": _of(parts[0])}
        return {"type": "array", "prefixItems": [_of(part) for part in parts], "minItems": len(parts),
                "maxItems": len(parts)}  # fmt: skip
    if issubclass(kind, Enum):
        return {"enum": [member.value for member in kind]}
    if issubclass(kind, Settings):
        return _of_settings(kind)
    return {"type": PLAIN[kind]}
