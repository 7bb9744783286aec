"""Windows searched side by side: what is found in each does not depend on the others, to the bit."""

import functools

import numpy as np
import pytest
from scenes import windows_of_many_kinds

from evqr.config import ReadConfig
from evqr.events.batch import EventBatch
from evqr.fit.detection import NotFound
from evqr.search.busy import busy_region
from evqr.solver import Solver


@functools.cache
def alone(backend: str, which: int):
    """What is found in a window that is searched alone."""
    windows, motions = windows_of_many_kinds()
    return Solver(backend=backend).find(EventBatch.of([windows[which]]), [motions[which]])[0]


def test_windows_are_of_many_sizes():
    sizes = {busy_region(window, ReadConfig().finder)[3:] for window in windows_of_many_kinds()[0]}
    assert len(sizes) >= 5
    found = [alone("warp", k) for k in range(len(windows_of_many_kinds()[0]))]
    assert sum(isinstance(each, NotFound) for each in found) == 4
    assert {each[0].space.version for each in found if not isinstance(each, NotFound)} == {1, 5}
    assert {bool(each[0].gain[0] > 0) for each in found if not isinstance(each, NotFound)} == {False, True}


@pytest.mark.parametrize(
    ("backend", "which"),
    [("warp", [4, 0]), ("warp", 16), ("warp", 128), ("numpy", [2, 3])],
    ids=["2", "16", "128", "2 on NumPy"],
)
def test_a_batch_finds_what_each_window_shows_alone(backend, which):
    windows, motions = windows_of_many_kinds()
    if isinstance(which, int):
        which = (np.random.default_rng(which).permutation(which) % len(windows)).tolist()
    batch = EventBatch.of([windows[k] for k in which])
    together = Solver(backend=backend).find(batch, [motions[k] for k in which])
    for k, found in zip(which, together, strict=True):
        assert found == alone(backend, k)
