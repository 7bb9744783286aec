"""What an exact symbol says: modes, ECI, kanji and the rest are zxing-cpp's to interpret."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.symbol.space import Symbology


def content_of(modules: NDArray[np.int8], symbology: Symbology) -> tuple[str, bytes] | None:
    """Return what a symbol says.

    Parameters
    ----------
    modules : (V, U) int8
        -1 dark, +1 light, without an error: zxing-cpp corrects errors up to the last check codeword, and so
        reads one chance grid in two million of QR version 1-L.
    symbology : Symbology
        Kind of the symbol.

    Returns
    -------
    (str, bytes), or None
        The payload, as text and as bytes; None where it is empty or malformed.
    """
    import zxingcpp

    barcode = zxingcpp.read_barcode(
        ~modules.view(np.uint8),  # 0 and 254
        formats=_formats(symbology),
        text_mode=zxingcpp.TextMode.Plain,
        is_pure=True,
        try_rotate=False,
        try_invert=False,
        try_downscale=False,
    )
    if barcode is None or not barcode.valid or not barcode.bytes:
        return None
    return barcode.text, barcode.bytes


@functools.cache
def _formats(symbology: Symbology) -> Any:
    import zxingcpp

    return zxingcpp.barcode_formats_from_str(symbology.value)
