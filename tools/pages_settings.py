"""The page of all settings, from their dataclasses and their documentation."""

from __future__ import annotations

import re
import typing
from dataclasses import fields
from enum import Enum
from types import NoneType
from typing import Annotated, Any

from evqr import config
from evqr.config.settings import Range, Settings, kinds
from evqr.symbology import Symbology

INTRODUCTION = """\
# Settings

All hang under `ReadConfig`, which `read_codes`, `read_windows`, `read_many`, `Reader` and `Solver` take as
`config`, but for `TriggerConfig` and `JobConfig`, which `Reader` takes as `triggers` and `jobs`:

```python
import evqr

config = evqr.ReadConfig(window_us=500, align=evqr.AlignConfig(min_score=0.6))
config = evqr.ReadConfig.from_dict({"window_us": 500, "align": {"min_score": 0.6}})  # the same
```

They are frozen, and a value out of range or of the wrong type is refused with a message that says what is
allowed. `to_dict` gives plain values, for JSON or YAML.

The text of each ends with where its default comes from: *measured* names where; *chosen* means that nobody
measured that number by itself. All chosen ones together were checked with `python perf/acceptance.py` (random
scenes that must be read, and scenes without a code that must give no text). """


def settings_page() -> str:
    """Write the page."""
    classes = [getattr(config, name) for name in config.__all__ if name not in ("Settings", "Vote")]
    classes.sort(key=lambda each: each is not config.ReadConfig)  # the one that holds the others comes first
    return "\n".join([INTRODUCTION, *(_section(each) for each in classes), _enums()])


def _enums() -> str:
    lines: list[str] = []
    for kind in (config.Vote, Symbology):
        lines += [
            f"## {kind.__name__}",
            "",
            (kind.__doc__ or "").strip(),
            "",
            "| value | what |",
            "|---|---|",
        ]
        texts = _strings_after_members(kind)
        lines += [*(f'| `"{each.value}"` | {texts[each.name]} |' for each in kind), ""]
    return "\n".join(lines[:-1])


def _strings_after_members(enum: type[Enum]) -> dict[str, str]:
    """Text below each member of an enum, which Python does not keep."""
    import ast
    import inspect
    import textwrap

    (node,) = ast.parse(textwrap.dedent(inspect.getsource(enum))).body
    assert isinstance(node, ast.ClassDef)
    found, name = {}, ""
    for each in node.body:
        if isinstance(each, ast.Assign):
            name = ast.unparse(each.targets[0])
        elif isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant) and name:
            found[name] = " ".join(str(each.value.value).split())
    return found


def _section(settings: type[Settings]) -> str:
    summary, *rest = (settings.__doc__ or "").split("Attributes\n")
    told = _descriptions(rest[0])
    lines = [f"## {settings.__name__}", "", " ".join(summary.split()), ""]
    lines += ["| setting | default | allowed | what |", "|---|---|---|---|"]
    allowed, below = kinds(settings), []
    for field, default in zip(fields(settings), settings().to_dict().values(), strict=True):
        kind, text = told[field.name]
        unit = re.search(r"\[[^\]]+\]", kind)
        name = f"`{field.name}`" + (f" {unit[0]}" if unit else "")
        lines.append(
            f"| {name} | {_default(default, allowed[field.name])} | {_kind(allowed[field.name])} | {text} |"
        )
        if _is_several_settings(default):
            below += _several(field.name, default)
    return "\n".join([*lines, *below, ""])


def _is_several_settings(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, dict) for each in value)


def _several(name: str, values: list[dict[str, Any]]) -> list[str]:
    """Write what several settings of one kind are by default, a column each."""
    lines = ["", f"`{name}` by default, in their order:", ""]
    lines += [f"| setting |{'|'.join(f' {number + 1} ' for number in range(len(values)))}|"]
    lines += ["|---" * (len(values) + 1) + "|"]
    return lines + [f"| `{key}` | {' | '.join(f'`{each[key]!r}`' for each in values)} |" for key in values[0]]


def _descriptions(text: str) -> dict[str, tuple[str, str]]:
    """Kind and text of each field, from the section of a docstring."""
    found = {}
    for block in re.split(r"^ {4}(?=\w)", text, flags=re.MULTILINE)[1:]:
        head, _, body = block.partition("\n")
        names, _, kind = head.partition(" : ")
        for name in names.split(", "):
            found[name] = kind, " ".join(body.split()).replace("``", "`").replace("|", "\\|")
    return found


def _default(value: Any, kind: Any) -> str:
    if isinstance(kind, type) and issubclass(kind, Settings):
        return f"[`{kind.__name__}()`](#{kind.__name__.lower()})"
    return f"{len(value)}, told below" if _is_several_settings(value) else f"`{value!r}`"


def _kind(kind: Any) -> str:
    """Say in words what a setting takes."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        limits = [str(each) for each in parts[1:] if isinstance(each, Range) and str(each)]
        order = (
            ["ascending"] if any(getattr(each, "__name__", "") == "Ascending" for each in parts[1:]) else []
        )
        return ", ".join([_kind(parts[0]), *limits, *order])
    if origin is tuple:
        inner = [_kind(each) for each in parts if each is not Ellipsis]
        return (
            f"any number of ({inner[0]})"
            if Ellipsis in parts
            else f"{len(inner)} of ({', '.join(dict.fromkeys(inner))})"
        )
    if parts:
        return " or ".join(_kind(each) for each in parts)
    if kind is NoneType:
        return "None"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return f"a [{kind.__name__}](#{kind.__name__.lower()})"
    return {"int": "whole number", "float": "number", "str": "text", "bool": "True or False"}.get(
        kind.__name__, f"`{kind.__name__}`"
    )
