"""The methods by name, in the order of the table; each is imported when it is made."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from evqr.paper.methods.method import Method


@dataclass(frozen=True, kw_only=True)
class Row:
    """How a method is called in the table, and how it is made.

    Attributes
    ----------
    title : str
        What tables call it.
    target : str
        "module:class".
    options : mapping of str to Any
        Of the class.
    quick : mapping of str to Any
        Options more, where a try is enough.
    given_version : bool
        Whether the class is given the version of the code, too.
    revision : int
        Raised when the method gives other results: its older cells are then computed again.
    by_name : bool
        Whether it is run only where it is asked for by its name.
    """

    title: str
    target: str
    options: Mapping[str, Any] = field(default_factory=dict)
    quick: Mapping[str, Any] = field(default_factory=dict)
    given_version: bool = False
    revision: int = 0
    by_name: bool = False


METHODS: Mapping[str, Row] = MappingProxyType(
    {
        "image": Row(title="Image", target="evqr.paper.methods.camera:Camera"),
        "bardow": Row(
            title="Bardow et al.", target="evqr.paper.methods.bardow:Bardow", quick={"iterations": 12}
        ),
        # what half the resolution costs; 4 GB of memory, and some minutes a trial
        "bardow_full": Row(
            title="Bardow et al., full resolution",
            target="evqr.paper.methods.bardow:Bardow",
            options={"reduction": 1},
            quick={"iterations": 12},
            by_name=True,
        ),
        "without_qr": Row(title="w/o QR", target="evqr.paper.methods.without_qr:WithoutQr"),
        "descent": Row(
            title="Ours (the paper's)",
            target="evqr.paper.methods.descent:Descent",
            given_version=True,
            revision=1,
        ),
        "evqr": Row(title="evqr, each window alone", target="evqr.paper.methods.evqr:Own"),
        "evqr_fused": Row(
            title="evqr, windows fused", target="evqr.paper.methods.evqr:Own", options={"windows": 8}
        ),
        "evqr_no_lag": Row(
            title="evqr, no lag operator", target="evqr.paper.methods.evqr:Own", options={"lag": False}
        ),
        "evqr_fused_no_lag": Row(
            title="evqr, fused, no lag operator",
            target="evqr.paper.methods.evqr:Own",
            options={"windows": 8, "lag": False},
        ),
        "integrate": Row(title="integration + zxing-cpp", target="evqr.paper.methods.integrate:Integrate"),
        "decay": Row(title="decaying sum + zxing-cpp", target="evqr.paper.methods.decay:Decay"),
    }
)


def make_method(name: str, version: int, *, quick: bool = False) -> Method:
    """Make a method for codes of a version; quick: one that gives up earlier, if it takes long."""
    row = METHODS[name]
    module, _, attribute = row.target.partition(":")
    known = {"version": version} if row.given_version else {}
    more = row.quick if quick else {}
    return getattr(importlib.import_module(module), attribute)(**row.options, **known, **more)
