"""Matched filters for finder patterns: ``-(grad of the pattern) . m / |m|`` at eight angles.

They are what the events of a finder pattern add up to under a motion m.  Only the direction of m matters.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from evqr.config import FinderConfig
from evqr.fit.model import profiles

ANGLES = 8
"""Templates, over a right angle: a finder pattern looks alike turned by one."""

TERMS = 5
"""Templates that the others are mixed from: all but 0.7 % of their energy."""


@functools.cache
def _template_gradients(cells_a_module: float, half: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the gradient of a finder pattern in the image, (2, n, n, ANGLES), and its disc (n, n)."""
    steps = np.arange(-half, half + 1) / cells_a_module
    x, y = np.meshgrid(steps, steps)
    disc = (x * x + y * y <= min(5.2, half / cells_a_module + 0.3) ** 2).astype(np.float64)
    sigma = 0.8 / cells_a_module * 0.8
    gradients = np.empty((2, *x.shape, ANGLES))
    for a in range(ANGLES):
        cos, sin = math.cos(a * math.pi / 2 / ANGLES), math.sin(a * math.pi / 2 / ANGLES)
        u, v = cos * x + sin * y, -sin * x + cos * y
        along_u, along_v = np.zeros_like(u), np.zeros_like(u)
        for size, sign in ((7, -1.0), (5, 1.0), (3, -1.0)):
            # a square of `size` modules is a module's profile, stretched
            fu, du, _ = profiles((u + size / 2) / size, sigma / size)
            fv, dv, _ = profiles((v + size / 2) / size, sigma / size)
            along_u += sign * du / size * fv
            along_v += sign * fu * dv / size
        gradients[0, :, :, a] = (cos * along_u - sin * along_v) * disc
        gradients[1, :, :, a] = (sin * along_u + cos * along_v) * disc
    return gradients, disc


@functools.cache
def spans(cfg: FinderConfig) -> NDArray[np.int32]:
    """Give the first row of the disc in each column of a template, and the one behind its last, (n, 2)."""
    _, disc = _template_gradients(cfg.cells_a_module, cfg.half)
    return np.array([(c.argmax(), len(c) - c[::-1].argmax()) for c in disc.T > 0.0], np.int32)


@functools.lru_cache(maxsize=361)
def bank_along(degrees: int, cfg: FinderConfig) -> tuple[NDArray[np.float64], ...]:
    """Give the templates for a direction of motion as a basis (n, n, TERMS) and a mixture (ANGLES, TERMS)."""
    gradients, _ = _template_gradients(cfg.cells_a_module, cfg.half)
    along = np.deg2rad(degrees)
    bank = -(np.cos(along) * gradients[0] + np.sin(along) * gradients[1])
    bank /= np.sqrt(np.square(bank).sum(axis=(0, 1)))
    flat = bank.reshape(-1, ANGLES)
    terms = np.einsum("na,ta->tn", flat, _waves())
    for t, term in enumerate(terms):  # cells are squares: they are only nearly orthogonal as they are
        before = terms[:t]
        term -= np.einsum("sn,s->n", before, np.einsum("sn,n->s", before, term))
        term /= math.sqrt(np.square(term).sum())
    return terms.T.reshape(*bank.shape[:2], TERMS), np.einsum("na,tn->at", flat, terms)


@functools.cache
def _waves() -> NDArray[np.float64]:
    """Give the waves over the templates' angles that make up most of them, (TERMS, ANGLES).

    A finder pattern is a sum of terms that vary as cos 4 n a with the angle a, the less the higher n is.  To
    turn it by an eighth of a right angle is to turn each by n / 8 of its period: so the templates are mixed
    from few terms, those of n = 0, 1 and 2, and different ones are orthogonal.
    """
    turns = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    return np.stack([np.ones(ANGLES), *(wave(n * turns) for n in (1, 2) for wave in (np.cos, np.sin))])
