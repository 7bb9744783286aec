"""Some parts of the line that `perf/soak.py` lets pass for long: each is accounted for."""

import sys
from pathlib import Path

import pytest

PERF = Path(__file__).parents[2] / "perf"


@pytest.fixture
def soak(monkeypatch):
    monkeypatch.syspath_prepend(str(PERF))
    monkeypatch.delitem(sys.modules, "soak", raising=False)
    from soak import soak

    return soak


def test_each_part_is_accounted_for_and_stamps_of_any_size_are_taken(soak):
    rows, wrong = soak(40, 4)
    assert not any(wrong.values()), wrong
    given = {name: rows[-1][name] for name in ("parts", "no_reads", "gaps", "resets")}
    assert given == {"parts": 40, "no_reads": 8, "gaps": 11, "resets": 2}
    times = [row["event_time_us"] for row in rows]
    assert times[0] - 61_500 < 1 << 31 < times[0] and max(times) > 1 << 32
    assert len({(row["descriptors"], row["threads"]) for row in rows}) == 1
