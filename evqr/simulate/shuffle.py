"""A negative control: the same events with nothing left to see in them."""

from __future__ import annotations

import numpy as np

from evqr.events.array import EventArray


def shuffled(events: EventArray, seed: int = 0) -> EventArray:
    """Move every pixel's events to another pixel, by a random permutation of the sensor.

    Each pixel keeps its own series of times and polarities, so rates, noise and hot pixels stay as they are;
    edges and their motion are gone.

    Parameters
    ----------
    events : EventArray
        Of any sensor.
    seed : int
        Of the permutation.

    Returns
    -------
    events : EventArray
        As many, in the same order of time.
    """
    target = np.random.default_rng(seed).permutation(events.width * events.height)
    where = target[events.y.astype(np.int64) * events.width + events.x]
    return EventArray(
        t=events.t,
        x=(where % events.width).astype(np.uint16),
        y=(where // events.width).astype(np.uint16),
        p=events.p,
        width=events.width,
        height=events.height,
    )
