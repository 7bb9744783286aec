"""The table of symbols: what can be read, one line a symbology.

To add one, write its file, and its line here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import DecodeConfig
from evqr.symbol import aztec, data_matrix, micro_qr, qr, rmqr
from evqr.symbol.decoded import Decoded, DecodeFailure, Effort
from evqr.symbol.qr_decode import valid_words
from evqr.symbol.space import Anchor, CodeSpace, Timing, Version
from evqr.symbology import Symbology


def _none(q: NDArray[np.float64], space: CodeSpace) -> NDArray[np.bool_]:
    return np.zeros(len(q), np.bool_)


Shown = tuple[CodeSpace, NDArray[np.float64]]
"""A code space, and a map (3, 3) of its code coordinates to those of the grid that tells it."""


@dataclass(frozen=True, kw_only=True)
class Symbol:
    """A symbology that can be read.

    Attributes
    ----------
    sizes : mapping of version to (int, int) [modules]
        Rows and columns of every version, in the standard's order; known without loading anything.
    anchors : callable
        Gives what the search looks for in a version, as its code space does, without loading anything.
    timing : callable
        Gives the timing patterns of a version, as its code space has them, likewise.
    space : callable
        Gives the code space of a version.
    decode : callable
        Gives what a grid says, of the grid (V, U) float64, its space, the configuration and the effort; as
        `evqr.symbol.decode.decode_grid`, but in one orientation and unchecked.
    mirror : callable
        Gives the grid of the mirror image of a square symbol, which the known modules do not tell from it;
        its own inverse. Default: the transpose.
    valid : callable
        Tells of grids (B, V, U) float64 of a space, all at once, whose codewords (B,) bool have no error as
        they are: those are decoded in no time. Default: of none.
    heads : mapping of str to tuple of str
        What several versions begin with, by a name that ``anchors``, ``timing`` and ``space`` take too, and
        which they are. Default: none.
    cores : mapping of str to str
        What is known of several versions before that is read, by a name that ``anchors`` and ``space`` take
        too, with the smallest version. Default: none.
    shown : callable, optional
        Gives what the grid of a core says that it is the core of; None where that is unreadable. Default:
        sizes and directions are told by known modules.
    """

    sizes: Mapping[Any, tuple[int, int]]
    anchors: Callable[[Any], tuple[Anchor, ...]]
    timing: Callable[[Any], tuple[Timing, ...]]
    space: Callable[[Any], CodeSpace]
    decode: Callable[[NDArray[np.float64], CodeSpace, DecodeConfig, Effort], Decoded | DecodeFailure]
    mirror: Callable[[NDArray], NDArray] = np.transpose
    valid: Callable[[NDArray[np.float64], CodeSpace], NDArray[np.bool_]] = _none
    heads: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    cores: Mapping[str, str] = field(default_factory=dict)
    shown: Callable[[NDArray[np.float64], CodeSpace], Shown | None] | None = None


SYMBOLS: Mapping[Symbology, Symbol] = MappingProxyType(
    {
        Symbology.QR_CODE: Symbol(
            sizes=qr.SIZES,
            anchors=qr.anchors,
            timing=qr.timing,
            space=qr.space,
            decode=qr.decode,
            valid=valid_words,
        ),
        Symbology.MICRO_QR_CODE: Symbol(
            sizes=micro_qr.SIZES,
            anchors=micro_qr.anchors,
            timing=micro_qr.timing,
            space=micro_qr.space,
            decode=micro_qr.decode,
            valid=valid_words,
        ),
        Symbology.RMQR_CODE: Symbol(
            sizes=rmqr.SIZES,
            anchors=rmqr.anchors,
            timing=rmqr.timing,
            space=rmqr.space,
            decode=rmqr.decode,
            valid=valid_words,
            heads=rmqr.HEADS,
        ),
        Symbology.DATA_MATRIX: Symbol(
            sizes=data_matrix.SIZES,
            anchors=data_matrix.anchors,
            timing=data_matrix.timing,
            space=data_matrix.space,
            decode=data_matrix.decode,
            mirror=data_matrix.mirror,
        ),
        Symbology.AZTEC: Symbol(
            sizes=aztec.SIZES,
            anchors=aztec.anchors,
            timing=aztec.timing,
            space=aztec.space,
            decode=aztec.decode,
            shown=aztec.shown,
            cores=aztec.CORES,
        ),
    }
)


def space_of(symbology: Symbology, version: Version) -> CodeSpace:
    """Return a code space.

    Parameters
    ----------
    symbology : Symbology
        One that can be read.
    version : int or str
        One that it has.

    Returns
    -------
    CodeSpace
        Shared by all who ask.

    Raises
    ------
    ValueError
        It cannot be read, or has no such version.
    """
    if symbology not in SYMBOLS:
        raise ValueError(f"symbology must be one of {', '.join(SYMBOLS)}, got {symbology}")
    return SYMBOLS[symbology].space(version)
