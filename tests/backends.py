"""Backends as parameters of tests; one that cannot be here is skipped, with the reason."""

import importlib.util

import pytest

COMPARED = ("warp", "taichi")
"""Backends other than the specification."""


def needs(name):
    """Marks that skip a test of a backend that cannot be here."""
    if name == "taichi" and not any(map(importlib.util.find_spec, ("taichi", "quadrants"))):
        return [pytest.mark.skip(reason="neither taichi nor quadrants is installed")]
    return []


BACKENDS = tuple(pytest.param(name, marks=needs(name)) for name in ("numpy", *COMPARED))
"""All of them, as parameters of a test."""
