"""The symbols to be printed, from segno and from zxing-cpp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import segno
from numpy.typing import NDArray

from evqr.errors import UsageError
from evqr.simulate.config import WITH_LEVELS, CodePlacement
from evqr.simulate.qr_writer import charset_of, parity_of, write_qr
from evqr.symbol.payload import StructuredAppend
from evqr.symbol.space import CodeSpace
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.symbology import Symbology


@dataclass(frozen=True, kw_only=True, eq=False)
class PrintedSymbol:
    """A code and where it is printed.

    Attributes
    ----------
    placement : CodePlacement
        Text, place and print.
    space : CodeSpace
        Kind and size of the symbol.
    ec_level : str, optional
        Level of error correction; None where there are none.
    mask : int, optional
        Number of the mask; None where there are none.
    modules : (V, U) uint8
        1 dark; of the symbol, not of an inverted print.
    """

    placement: CodePlacement
    space: CodeSpace
    ec_level: str | None
    mask: int | None
    modules: NDArray[np.uint8]


def parts_of_a_message(placements: Sequence[CodePlacement]) -> list[CodePlacement]:
    """Make codes the parts of one message (structured append), in order; raise UsageError for one alone."""
    if not 2 <= len(placements) <= 16:
        raise UsageError(
            f"simulate: a message has 2 to 16 parts, got {len(placements)}; give a text for each"
        )
    charset = charset_of(placements[0].charset, placements[0].eci)
    parity = parity_of([placement.text for placement in placements], charset)
    count = len(placements)
    return [
        replace(placement, append=StructuredAppend(index=index, count=count, parity=parity))
        for index, placement in enumerate(placements)
    ]


def make_symbol(placement: CodePlacement) -> PrintedSymbol:
    """Encode a placement's text; raise UsageError where the version cannot hold it."""
    by_segno = placement.symbology in (Symbology.QR_CODE, Symbology.MICRO_QR_CODE)
    return _by_segno(placement) if by_segno else _by_zxing(placement)


def _by_segno(p: CodePlacement) -> PrintedSymbol:
    symbology = Symbology(p.symbology)
    micro = symbology is Symbology.MICRO_QR_CODE
    level = None if p.version == "M1" else p.ec  # which has none
    try:
        more = p.gs1 or p.append is not None or p.application is not None
        if more or (not micro and (p.eci is not None or p.charset is not None)):
            code = write_qr(
                p.text,
                version=None if p.version is None else int(p.version),
                level=p.ec,
                mask=p.mask,
                gs1=p.gs1,
                eci=p.eci,
                charset=p.charset,
                append=p.append,
                application=p.application,
            )
        else:
            code = segno.make(
                p.text,
                version=p.version,
                error=level,
                mask=p.mask,
                micro=micro,
                boost_error=False,
                encoding=p.charset,
                mode="byte" if p.charset is not None and not p.text.isascii() else None,
            )
    except segno.DataOverflowError:
        raise _too_long(p) from None
    except ValueError as error:  # a level or a kind of text that a Micro QR code's version has not
        raise UsageError(f"simulate: {symbology} cannot say {p.text!r}: {error}") from None
    return PrintedSymbol(
        placement=p,
        space=space_of(symbology, code.version if micro else int(code.version)),
        ec_level=code.error,
        mask=int(code.mask),
        modules=np.array(code.matrix, np.uint8),
    )


def _by_zxing(p: CodePlacement) -> PrintedSymbol:
    import zxingcpp

    symbology = Symbology(p.symbology)
    versions = list(SYMBOLS[symbology].sizes)
    options: dict[str, Any] = {} if p.version is None else {"version": 1 + versions.index(p.version)}
    if symbology in WITH_LEVELS:
        options["ec_level"] = p.ec
    kind = zxingcpp.barcode_format_from_str(symbology.value)
    try:
        barcode = zxingcpp.create_barcode(p.text, kind, **options)
    except ValueError as error:
        if "too long" in str(error):
            raise _too_long(p) from None
        raise UsageError(f"simulate: {symbology} cannot say {p.text!r}: {error}") from None
    image = np.array(barcode.to_image(scale=1, add_quiet_zones=False))
    signs = np.where(image < 128, -1, 1)
    as_large = (version for version, shape in SYMBOLS[symbology].sizes.items() if shape == image.shape)
    spaces = (space_of(symbology, version) for version in as_large)
    space = next(each for each in spaces if (signs == each.values)[each.known].all())
    return PrintedSymbol(
        placement=p,
        space=space,
        ec_level=p.ec if symbology in WITH_LEVELS else None,
        mask=None,
        modules=(signs < 0).astype(np.uint8),
    )


def _too_long(p: CodePlacement) -> UsageError:
    asked = "any version" if p.version is None else f"version {p.version}"
    level = f" at level {p.ec}" if p.symbology in WITH_LEVELS else ""
    return UsageError(
        f"simulate: the text of {len(p.text)} characters does not fit {asked}{level}; take a higher version, "
        "a lower level or a shorter text"
    )
