"""Modules smaller than the usual ones, which are searched for where nothing else is read."""

from __future__ import annotations

from dataclasses import replace

from evqr.config import ReadConfig
from evqr.symbology import Symbology


def smaller(cfg: ReadConfig) -> ReadConfig | None:
    """Give the settings of a search for smaller modules.

    It is for QR codes alone: symbols with fewer patterns are soon found in noise there.

    Parameters
    ----------
    cfg : ReadConfig
        Settings of the usual search.

    Returns
    -------
    config : ReadConfig or None
        None where there is nothing to search for.
    """
    usual, count = cfg.finder, cfg.finder.smaller_sizes
    if not count or Symbology.QR_CODE not in cfg.symbologies:
        return None
    finder = replace(
        usual,
        smallest_module_px=usual.smallest_module_px / usual.scale_ratio**count,
        largest_module_px=usual.smallest_module_px / usual.scale_ratio,
        # the pass that takes but what stands out
        passes=(replace(usual.passes[0], least_module_px=0.0),),
        single_patterns=0,
        smaller_sizes=0,
    )
    return replace(cfg, finder=finder, symbologies=(Symbology.QR_CODE,))
