"""The truth of a simulation, in the layout in which recordings store it."""

from __future__ import annotations

from typing import Any

import numpy as np

from evqr.simulate.config import SceneConfig
from evqr.simulate.geometry import Motion, code_corners, code_to_object, transform
from evqr.simulate.printed import PrintedSymbol

#: Time between two poses [us].
POSE_PERIOD_US = 250


def truth_of(scene: SceneConfig, motion: Motion, symbols: list[PrintedSymbol]) -> dict[str, dict[str, Any]]:
    """Return what is true of each code: group name ("truth", "truth2", ...) to its fields.

    Fields: payload, symbology, version, rows, cols, ec_level ("" without levels), mask (-1 without masks);
    modules (V, U) uint8, 1 = dark; t_us (K,) int64; H (K, 3, 3), which maps (column, row, 1) in modules from
    the outer corner of the top-left module to px; velocity (K, 2) of the code's centre [px/s]; in_view (K,)
    bool, all of the code (without its quiet zone) on the sensor.
    """
    t_us = np.unique(np.append(np.arange(0, motion.duration_us, POSE_PERIOD_US), motion.duration_us)).astype(
        np.int64
    )
    groups = {}
    for index, symbol in enumerate(symbols):
        to_object = code_to_object(symbol, scene.direction)
        pose = motion.object_to_image(t_us) @ to_object
        pose /= pose[:, 2:, 2:]
        space = symbol.space
        centre = np.array([[space.columns, space.rows]]) / 2
        # One microsecond to each side: exact to rounding for a path this smooth.
        before, after = (transform(motion.object_to_image(t_us + d) @ to_object, centre) for d in (-1.0, 1.0))
        corners = transform(pose[:, None], code_corners(symbol))
        inside = (corners >= -0.5) & (corners <= np.array([scene.width, scene.height]) - 0.5)
        groups["truth" if index == 0 else f"truth{index + 1}"] = {
            "payload": (symbol.placement.application or "") + symbol.placement.text,
            "symbology": space.symbology.value,
            "version": space.version,
            "rows": space.rows,
            "cols": space.columns,
            "ec_level": "" if symbol.ec_level is None else symbol.ec_level,
            "mask": -1 if symbol.mask is None else symbol.mask,
            "modules": symbol.modules,
            "t_us": t_us,
            "H": pose,
            "velocity": (after - before) / 2e-6,
            "in_view": inside.all(axis=(1, 2)),
        }
    return groups
