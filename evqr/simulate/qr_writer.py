"""QR codes that say more than characters: FNC1, any ECI, a part of a message.  segno writes the rest.

Segments, padding, masks and modules are segno's; only the header before the segments is written here.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Sequence

import segno
from segno import consts, encoder

from evqr.symbol.content import CHARSETS
from evqr.symbol.gs1 import SEPARATOR
from evqr.symbol.payload import StructuredAppend
from evqr.symbol.qr_segments import FNC1_FIRST, FNC1_SECOND

FIXED_LENGTH = re.compile(r"0[0-4]|1[1-9]|20|3[1-6]|41")
"""How application identifiers begin whose elements need no separator (GS1 General Specifications, 7.8.5)."""

PADS = (0b11101100, 0b00010001)


def gs1_message(text: str) -> str:
    """Return a GS1 message as a symbol holds it.

    Parameters
    ----------
    text : str
        Application identifiers in brackets, as ``(01)09506000134352(10)LOT 42``, or a message without them
        with separators in it.

    Returns
    -------
    message : str
        With a separator behind each element of no fixed length but the last.
    """
    if not text.startswith("("):
        return text
    elements = re.findall(r"\((\d{2,4})\)([^(]*)", text)
    ended = (ai + value + ("" if FIXED_LENGTH.match(ai) else SEPARATOR) for ai, value in elements)
    return "".join(ended).removesuffix(SEPARATOR)


def charset_of(charset: str | None, eci: int | None) -> str | None:
    """Return the character set of bytes to be written; None: segno's choice by the text."""
    return charset or (None if eci is None else CHARSETS.get(eci, "utf-8"))


def parity_of(texts: Sequence[str], charset: str | None) -> int:
    """Return the parity of a message of which these are the parts (ISO/IEC 18004, 8.3)."""
    data = b"".join(encoder.data_to_bytes(text, charset)[0] for text in texts)
    return functools.reduce(operator.xor, data, 0)


def write_qr(
    text: str,
    *,
    version: int | None,
    level: str,
    mask: int | None,
    gs1: bool,
    eci: int | None,
    charset: str | None,
    append: StructuredAppend | None,
    application: str | None = None,
) -> segno.QRCode:
    """Encode a text with what is to be said beside it.

    Parameters
    ----------
    text : str
        The characters; with separators, for GS1.
    version, level, mask : as of `segno.make`
        Of the symbol.
    gs1 : bool
        FNC1 in first position.
    eci : int, optional
        ECI designator.
    charset : str, optional
        Of the bytes; default: that of the ECI, or segno's choice.
    append : StructuredAppend, optional
        Which part of a message it is.
    application : str, optional
        Application indicator, two digits or a letter: FNC1 in second position.

    Returns
    -------
    segno.QRCode
        With its matrix, version, level and mask.

    Raises
    ------
    DataOverflowError
        It does not fit.
    ValueError
        The character set does not have the text's characters.
    """
    header = encoder.Buffer()
    if append is not None:
        for value, bits in ((consts.MODE_STRUCTURED_APPEND, 4), (append.index, 4), (append.count - 1, 4)):
            header.append_bits(value, bits)
        header.append_bits(append.parity, 8)
    if eci is not None:
        header.append_bits(consts.MODE_ECI, 4)
        for most, prefix, prefix_bits, bits in (
            (127, 0, 1, 7),
            (16383, 0b10, 2, 14),
            (999_999, 0b110, 3, 21),
        ):
            if eci <= most:
                header.append_bits(prefix, prefix_bits)
                header.append_bits(eci, bits)
                break
    if gs1:
        header.append_bits(FNC1_FIRST, 4)
    if application is not None:
        header.append_bits(FNC1_SECOND, 4)
        header.append_bits(int(application) if application.isdecimal() else ord(application) + 100, 8)
    segments = _segments(text, charset_of(charset, eci), gs1 or application is not None)
    error = consts.ERROR_MAPPING[level]
    for size in range(1, 41) if version is None else [version]:
        capacity = consts.SYMBOL_CAPACITY[size][error]
        if len(header) + segments.bit_length_with_overhead(size, eci=False) <= capacity:
            return _symbol(header, segments, size, error, mask)
    raise segno.DataOverflowError("the data does not fit")


def _segments(text: str, charset: str | None, fnc1: bool) -> encoder.Segments:
    if fnc1:  # in the alphanumeric mode "%" is the separator and "%%" is "%"
        escaped = text.replace("%", "%%").replace(SEPARATOR, "%")
        if encoder.is_alphanumeric(escaped.encode()) and not text.isdecimal():
            return encoder.prepare_data(escaped, consts.MODE_ALPHANUMERIC, None)
    in_bytes = charset is not None and not text.isascii()
    return encoder.prepare_data(text, consts.MODE_BYTE if in_bytes else None, charset)


def _symbol(
    header: encoder.Buffer, segments: encoder.Segments, version: int, error: int, mask: int | None
) -> segno.QRCode:
    """Draw a symbol, as `segno.encoder.encode` does."""
    bits = encoder.Buffer(header.getbits())
    for segment in segments:
        encoder.write_segment(bits, segment, None, encoder.version_range(version))
    capacity = consts.SYMBOL_CAPACITY[version][error]
    bits.extend([0] * min(4, capacity - len(bits)))  # terminator
    bits.extend([0] * (-len(bits) % 8))
    for k in range((capacity - len(bits)) // 8):
        bits.append_bits(PADS[k % 2], 8)
    size = encoder.calc_matrix_size(version)
    matrix = encoder.make_matrix(size, size)
    encoder.add_finder_patterns(matrix, size, size)
    encoder.add_alignment_patterns(matrix, size, size)
    encoder.add_codewords(matrix, encoder.make_final_message(version, error, bits), version)
    mask, matrix = encoder.find_and_apply_best_mask(matrix, size, size, mask)
    encoder.add_format_info(matrix, version, error, mask)
    encoder.add_version_info(matrix, version)
    code = encoder.Code(matrix, version, error, mask, segments)
    return segno.QRCode(code)  # pyright: ignore[reportCallIssue] (missing in segno's stubs)
