"""Streams cut into chunks, and read."""

import itertools

import numpy as np

from evqr.solver import Solver
from evqr.stream.scheduler import StreamScheduler


def cut_every(events, us):
    """The events in chunks of so many microseconds; some are empty."""
    edges = np.arange(events.t[0], events.t[-1] + us, us)
    bounds = [*np.searchsorted(events.t, edges).tolist(), len(events)]
    return [events.cut(a, b) for a, b in itertools.pairwise(bounds)]


def cut_anywhere(events, count, seed):
    """The events in so many chunks, of any number of events each."""
    cuts = np.sort(np.random.default_rng(seed).integers(0, len(events) + 1, count - 1)).tolist()
    return [events.cut(a, b) for a, b in zip([0, *cuts], [*cuts, len(events)], strict=True)]


def records_of(chunks, solver=None, **options):
    """Push chunks, step after each, close."""
    scheduler = StreamScheduler([solver or Solver()], chunks[0].width, chunks[0].height, **options)
    records = []
    for chunk in chunks:
        scheduler.push(chunk)
        records += scheduler.step()
    return records + scheduler.close(), scheduler.statistics
