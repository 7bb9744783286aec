"""Whether a part's codes are what its job expects."""

from __future__ import annotations

import re
from collections.abc import Sequence

from evqr.config import JobConfig
from evqr.results import CodeReading


class Rule:
    """What the codes of one product are.

    Parameters
    ----------
    cfg : JobConfig
        What is expected.
    """

    def __init__(self, cfg: JobConfig) -> None:
        self._cfg = cfg
        self._pattern = None if cfg.pattern is None else re.compile(cfg.pattern)

    def mismatch(self, readings: Sequence[CodeReading]) -> str:
        """Tell what is not as expected.

        Parameters
        ----------
        readings : sequence of CodeReading
            All codes of a part.

        Returns
        -------
        mismatch : str
            In words; "" where all is as expected.
        """
        cfg = self._cfg
        if cfg.codes is not None and len(readings) != cfg.codes:
            return f"{len(readings)} of {cfg.codes} codes were read"
        for reading in readings:
            if cfg.symbology is not None and reading.symbology != cfg.symbology:
                return f"{reading.symbology}, where {cfg.symbology} is expected"
            if cfg.text is not None and reading.text != cfg.text:
                return f"{reading.text!r}, where {cfg.text!r} is expected"
            if self._pattern is not None and not self._pattern.fullmatch(reading.text):
                return f"{reading.text!r} does not match {cfg.pattern!r}"
        return ""
