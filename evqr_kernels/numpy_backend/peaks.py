"""Peaks over a pyramid and triples of them; the definitions are in ``warp_backend/peaks.py``."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from evqr_kernels.numpy_backend.levels import parts_of_levels


def local_maxima(response, angle, rows, extent, levels, origin, least, turn, maxima_out) -> None:
    """Find the local maxima of all levels, the strongest of each row; overwrites."""
    maxima_out[:] = 0
    for b, k, part in parts_of_levels(rows, extent):
        here = response[b][part]
        if min(here.shape) < 3:
            continue
        cell, size = levels[k]
        top, strength = part[0].start, np.abs(here)
        around = sliding_window_view(here, (3, 3))
        inner = here[1:-1, 1:-1]
        extreme = np.where(inner > 0.0, inner >= around.max(axis=(2, 3)), inner <= around.min(axis=(2, 3)))
        high = extreme & (strength[1:-1, 1:-1] > least)
        for y in np.flatnonzero(high.any(axis=1)) + 1:
            x = np.flatnonzero(high[y - 1]) + 1
            best = np.sort(np.argsort(-strength[y, x], kind="stable")[: maxima_out.shape[2]])
            for place, column in enumerate(x[best]):
                sign = np.sign(here[y, column])
                across = _vertex(*(sign * here[y, column - 1 : column + 2]))
                down = _vertex(*(sign * here[y - 1 : y + 2, column]))
                maxima_out[b, top + y, place] = (
                    here[y, column],
                    origin[b, 0] + (column + across + 0.5) * cell,
                    origin[b, 1] + (y + down + 0.5) * cell,
                    size,
                    angle[b, top + y, column] * turn,
                )


def _vertex(before: float, here: float, after: float) -> float:
    return float(np.clip(0.5 * (after - before) / max(2.0 * here - before - after, 1e-9), -0.5, 0.5))


def merge_maxima(maxima, apart, log_ratio, strength_out, index_out, peaks_out) -> None:
    """Keep the strongest maxima, one a place and size; overwrites."""
    peaks_out[:] = 0
    for found, peaks in zip(maxima, peaks_out, strict=True):
        left = found[found[:, 0] != 0]
        for place in range(len(peaks)):
            if not len(left):
                break
            best = left[np.abs(left[:, 0]).argmax()]
            peaks[place] = best
            same = np.hypot(left[:, 1] - best[1], left[:, 2] - best[2]) < apart * best[3]
            same &= np.abs(np.log(left[:, 3] / best[3])) < log_ratio
            same &= left[:, 0] * best[0] > 0
            left = left[~same]


def match_corners(peaks, tolerances, ends_out, legs_out, triples_out) -> None:
    """Find triples of peaks that make the corners of a code; overwrites."""
    triples_out[:] = 0
    leg_tolerance, size_tolerance, angle_tolerance, fewest, most = tolerances
    for table, triples in zip(peaks, triples_out, strict=True):
        table = table[table[:, 0] != 0]
        strength, log_size = np.abs(table[:, 0]), np.log(table[:, 3])
        for i, corner in enumerate(table):
            to = table[:, 1:3] - corner[1:3]
            direction = np.arctan2(to[:, 1], to[:, 0])
            log_leg = np.log(np.maximum(np.hypot(to[:, 0], to[:, 1]), 1e-9))
            good = (np.arange(len(table)) != i) & (table[:, 0] * corner[0] > 0)
            good &= _off(direction - corner[4], math.pi / 2) < angle_tolerance
            good &= _off(direction - table[:, 4], math.pi / 2) < angle_tolerance
            good &= np.abs(log_size - log_size[i]) < 2 * size_tolerance
            good &= log_leg > np.minimum(log_size, log_size[i]) + fewest - 2 * size_tolerance
            found = []
            for j in np.flatnonzero(good):
                for k in np.flatnonzero(good):
                    across = _off(direction[k] - direction[j] - math.pi / 2, 2 * math.pi)
                    modules = (log_leg[j] + log_leg[k]) / 2 - (log_size[i] + log_size[j] + log_size[k]) / 3
                    if (
                        across < angle_tolerance
                        and abs(log_leg[j] - log_leg[k]) < leg_tolerance
                        and fewest - size_tolerance < modules < most + size_tolerance
                    ):
                        found.append((strength[i] + strength[j] + strength[k], j, k, modules))
            found.sort(key=lambda triple: -triple[0])
            for place, triple in enumerate(found[: triples.shape[1]]):
                triples[i, place] = triple


def _off(angle, period):
    """Distance of angles from the nearest multiple of a period."""
    return np.abs(angle - period * np.round(angle / period))
