"""What an exact symbol says: modes, ECI, kanji and the rest are zxing-cpp's to interpret."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.clock import one_time
from evqr.symbol.payload import CharsetSource, ContentType, Payload
from evqr.symbol.qr_segments import Run, Segments
from evqr.symbology import Symbology

BYTES = "iso8859-1"
"""How bytes that are no text are shown: each as the character of its number."""

BINARY_ECI = 899

CHARSETS: Mapping[int, str] = MappingProxyType(
    {
        **dict.fromkeys((0, 2), "cp437"),
        **dict.fromkeys((1, 3), "iso8859-1"),
        **{eci: f"iso8859-{eci - 2}" for eci in (*range(4, 14), *range(15, 19))},
        20: "shift_jis",
        **{21: "cp1250", 22: "cp1251", 23: "cp1252", 24: "cp1256"},
        **{25: "utf-16-be", 26: "utf-8", 33: "utf-16-le", 34: "utf-32-be", 35: "utf-32-le"},
        **{27: "ascii", 28: "big5", 29: "gb2312", 30: "euc-kr", 31: "gbk", 32: "gb18030", 170: "ascii"},
        BINARY_ECI: BYTES,
    }
)
"""Python's codecs by ECI designator (AIM ITS/04-023), and bytes that are no text."""

GUESSES = ("ascii", "utf-8", "cp932", "iso8859-1")
"""What zxing-cpp guesses among."""

_TYPES: Mapping[str, ContentType] = MappingProxyType(
    {
        "Text": ContentType.TEXT,
        "Binary": ContentType.BINARY,
        "Mixed": ContentType.MIXED,
        "GS1": ContentType.GS1,
        "ISO15434": ContentType.ISO15434,
        "UnknownECI": ContentType.UNKNOWN_ECI,
    }
)


def content_of(
    modules: NDArray[np.int8],
    symbology: Symbology,
    *,
    charset: str | None = None,
    segments: Segments | None = None,
) -> Payload | None:
    """Return what a symbol says.

    Parameters
    ----------
    modules : (V, U) int8
        -1 dark, +1 light, without an error: zxing-cpp corrects errors up to the last check codeword, and so
        reads one chance grid in two million of QR version 1-L.
    symbology : Symbology
        Kind of the symbol.
    charset : str, optional
        Character set of bytes of which the symbol does not name it. Default: guessed by zxing-cpp.
    segments : Segments, optional
        What the symbology's own decoder knows of the content. Default: nothing.

    Returns
    -------
    Payload, or None
        None where it is empty or malformed.
    """
    zxingcpp = _zxing()
    # In the ECI protocol (ISO/IEC 15424) the bytes come with the designators, which nothing else tells.
    barcode = _read(modules, symbology, zxingcpp.TextMode.HexECI)
    if barcode is None or not barcode.valid or not barcode.bytes:
        return None
    data, identifier = barcode.bytes, barcode.symbology_identifier
    content_type = _TYPES[barcode.content_type.name]
    transmitted = bytes.fromhex(barcode.text)
    warnings: list[str] = []
    segments = segments or Segments()
    runs = segments.runs
    if sum(run.length for run in runs) != len(data):
        runs = (Run(length=len(data), charset=None),)
    by_mode = all(run.charset for run in runs)
    eci: tuple[int, ...] = ()
    if not transmitted.startswith(identifier.encode()):  # another identifier says that designators follow
        blocks = _eci_blocks(transmitted[len(identifier) :])
        eci = tuple(dict.fromkeys(number for number, _ in blocks))
        text = "".join(part.decode(CHARSETS.get(number, BYTES), "replace") for number, part in blocks)
        name, source = _one_of(CHARSETS.get(number) for number in eci), CharsetSource.ECI
        if not CHARSETS.keys() >= set(eci):
            content_type, name = ContentType.UNKNOWN_ECI, None
    elif charset is not None and not by_mode:
        text, source = _decoded(data, runs, charset), CharsetSource.ASSUMED
        name = _one_of(run.charset or charset for run in runs)
        if content_type is ContentType.BINARY and text.replace("\n", "").isprintable():
            content_type = ContentType.TEXT
    else:
        text = data.decode("ascii") if data.isascii() else _read(modules, symbology).text
        name = next((name for name in GUESSES if data.decode(name, "replace") == text), None)
        source = CharsetSource.GUESSED
        if by_mode:
            name, source = _one_of(run.charset for run in runs), CharsetSource.MODE
    if "\ufffd" in text:
        warnings.append(f"some of the bytes are not of the character set {name or 'that is named'}")
    return Payload(
        text=text,
        data=data,
        symbology_identifier=identifier,
        content_type=content_type,
        eci=eci,
        charset=name,
        charset_source=source,
        structured_append=segments.structured_append,
        warnings=tuple(warnings),
    )


@functools.cache
@one_time()
def _zxing() -> Any:
    """Load the library that reads what symbols say."""
    import zxingcpp

    return zxingcpp


def _read(modules: NDArray[np.int8], symbology: Symbology, text_mode: Any = None) -> Any:
    zxingcpp = _zxing()
    return zxingcpp.read_barcode(
        ~modules.view(np.uint8),  # 0 and 254
        formats=_formats(symbology),
        text_mode=text_mode or zxingcpp.TextMode.Plain,
        is_pure=True,
        try_rotate=False,
        try_invert=False,
        try_downscale=False,
    )


def _eci_blocks(protocol: bytes) -> list[tuple[int, bytes]]:
    r"""Split what is sent in the ECI protocol: ``\nnnnnn`` is a designator, a doubled backslash is one."""
    found = re.findall(rb"\\(\d{6})((?:[^\\]|\\\\)*)", protocol, re.DOTALL)
    return [(int(number), part.replace(rb"\\", b"\\")) for number, part in found]


def _decoded(data: bytes, runs: Iterable[Run], charset: str) -> str:
    parts, start = [], 0
    for run in runs:
        parts.append(data[start : start + run.length].decode(run.charset or charset, "replace"))
        start += run.length
    return "".join(parts)


def _one_of(names: Iterable[str | None]) -> str | None:
    """Return the only name; ASCII beside another one, which it is a part of, does not count."""
    found = set(names)
    if len(found) > 1:
        found.discard("ascii")
    return found.pop() if len(found) == 1 else None


@functools.cache
def _formats(symbology: Symbology) -> Any:
    return _zxing().barcode_formats_from_str(symbology.value)
