"""Settings of the decoder."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Annotated

from evqr.config.settings import CharacterSet, Count, Range, Settings, Share


@dataclass(frozen=True, kw_only=True)
class DecodeConfig(Settings):
    """How hard to try, and how sure to be.

    Attributes
    ----------
    min_confidence : float
        A reading below is refused. Chosen: one wrong text in a thousand grids that might have been one.
    wrong_grids : float
        Grids without a code tried for each one with a code, the prior of the confidence. Chosen.
    format_candidates : int
        Most words of format information to try. Chosen.
    format_margin : float
        Their correlation may be this much below the best one's, 0 to 2. Chosen.
    format_floor : float
        Correlation below which format information is unreadable, 0 to 1, where 1 is perfect. Chosen.
    quick_tries : int
        Tries a block with effort "quick", spread evenly over those of "full". Chosen.
    min_check : int [codewords]
        Check codewords that erasures must leave. Chosen.
    charset : str, optional
        Character set of bytes of which the symbol does not name it, as utf-8 or shift_jis. Default: guessed.
    """

    min_confidence: Annotated[float, Range(above=0.0, below=1.0)] = 0.999
    wrong_grids: Annotated[float, Range(least=1.0)] = 1e6
    format_candidates: Annotated[int, Range(least=1, most=32)] = 3
    format_margin: Annotated[float, Range(least=0.0, most=2.0)] = 0.2
    format_floor: Share = 0.25
    quick_tries: Count = 4
    min_check: Count = 2
    charset: CharacterSet | None = None

    @property
    def log_chance_limit(self) -> float:
        """Natural logarithm of the largest expected number of chance contents of a reading."""
        return math.log((1.0 / self.min_confidence - 1.0) / self.wrong_grids)

    def among(self, grids: int) -> DecodeConfig:
        """Give the settings for one of several grids that are tried in place of one.

        Parameters
        ----------
        grids : int
            How many are.

        Returns
        -------
        config : DecodeConfig
            That asks of each for so many times less chance, so that all together may have that of one.
        """
        return _among(self, grids)


@functools.lru_cache(maxsize=64)
def _among(config: DecodeConfig, grids: int) -> DecodeConfig:
    return replace(config, wrong_grids=grids * config.wrong_grids) if grids > 1 else config
