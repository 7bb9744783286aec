"""Some of the damaged bytes that `perf/fuzz.py` gives for long to what a line takes from outside."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("evt3", reason="extra 'formats' is not installed")


@pytest.fixture(scope="module")
def fuzz():
    sys.path.insert(0, str(Path(__file__).parents[2] / "perf"))
    try:
        import fuzz
    finally:
        del sys.path[0]
    return fuzz


@pytest.mark.parametrize(
    ("name", "cases"), [("evt3", 60), ("packed", 60), ("reader", 6), ("triggers", 60), ("settings", 40)]
)
def test_damaged_bytes_are_taken_or_refused_in_one_line(name, cases, fuzz):
    @settings(deadline=None, max_examples=cases)
    @given(st.integers(0, 1 << 32))
    def try_some(number):
        assert fuzz.try_case(name, number) in ("taken", "refused")

    try_some()


def test_what_is_refused_in_several_lines_would_be_seen(fuzz, monkeypatch):
    def take(data, rng):
        raise fuzz.EvqrError("one\ntwo")

    monkeypatch.setitem(fuzz.TARGETS, "evt3", fuzz.Target(lambda: [b"good"], take))
    with pytest.raises(AssertionError, match="not one line"):
        fuzz.try_case("evt3", 3)
