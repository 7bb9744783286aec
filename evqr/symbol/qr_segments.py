"""The segments of data of the QR family (ISO/IEC 18004, 7.4; 23941, 7.4): what zxing-cpp does not pass on.

That is structured append, and which bytes are of which mode.  Bit lengths come from segno's tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from evqr.symbol import rmqr_tables
from evqr.symbol.payload import StructuredAppend
from evqr.symbol.space import Version

FNC1_FIRST = 0b0101
FNC1_SECOND = 0b1001

_RMQR_MODES: Mapping[int, int] = MappingProxyType(
    {1: 0b0001, 2: 0b0010, 3: 0b0100, 4: 0b1000, 5: FNC1_FIRST, 6: FNC1_SECOND, 7: 0b0111}
)
"""Modes of QR codes by the numbers that they have in rMQR codes."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Bytes of the content that are of one kind.

    Attributes
    ----------
    length : int
        How many.
    charset : str, optional
        Character set of their mode; None for bytes of any.
    """

    length: int
    charset: str | None


@dataclass(frozen=True, kw_only=True)
class Segments:
    """What the segments of a symbol tell.

    Attributes
    ----------
    structured_append : StructuredAppend, optional
        None where the symbol stands alone.
    runs : tuple of Run
        The content, in order; neighbours are of different kinds.
    """

    structured_append: StructuredAppend | None = None
    runs: tuple[Run, ...] = ()


class _Bits:
    """Bits, taken from the front."""

    def __init__(self, data: bytes) -> None:
        self._value = int.from_bytes(data, "big")
        self.left = 8 * len(data)

    def ahead(self, count: int) -> int:
        return (self._value >> (self.left - count)) & ((1 << count) - 1)

    def take(self, count: int) -> int:
        if count > self.left:
            raise ValueError("the data ends within a segment")
        value = self.ahead(count)
        self.left -= count
        return value


def segments_of(data: bytes, version: Version) -> Segments:
    """Go through the segments of a symbol.

    Parameters
    ----------
    data : bytes
        Its data codewords.
    version : int or str
        Its size.

    Returns
    -------
    Segments
        As far as they are well formed.
    """
    append: StructuredAppend | None = None
    runs: list[Run] = []
    try:
        for found in _walk(_Bits(data), version):
            if isinstance(found, StructuredAppend):
                append = found if found.index < found.count else None
            elif runs and runs[-1].charset == found.charset:
                runs[-1] = Run(length=runs[-1].length + found.length, charset=found.charset)
            elif found.length:
                runs.append(found)
    except ValueError:
        pass
    return Segments(structured_append=append, runs=tuple(runs))


def _walk(bits: _Bits, version: Version) -> Iterator[StructuredAppend | Run]:
    """Yield what each segment is."""
    from segno import consts, encoder

    if isinstance(version, int):
        modes, mode_bits, end_bits, sizes = None, 4, 4, encoder.version_range(version)
    elif version in rmqr_tables.SIZES:
        modes, mode_bits, end_bits, sizes = _RMQR_MODES, 3, 3, None
    else:
        micro = int(version[1:])
        modes = {short: mode for mode, short in consts.MODE_TO_MICRO_MODE_MAPPING.items()}
        mode_bits, end_bits, sizes = micro - 1, 2 * micro + 1, consts.MICRO_VERSION_MAPPING[version]
    if sizes is None:
        count_bits = rmqr_tables.count_bits(version)
    else:
        lengths = consts.CHAR_COUNT_INDICATOR_LENGTH
        count_bits = {mode: bits[sizes] for mode, bits in lengths.items() if sizes in bits}
    fnc1 = False
    while bits.ahead(min(bits.left, end_bits)):
        mode = bits.take(mode_bits)
        mode = mode if modes is None else modes.get(mode, -1)
        if mode == FNC1_FIRST:
            fnc1 = True
        elif mode == FNC1_SECOND:
            fnc1 = True
            yield Run(length=2 if bits.take(8) < 100 else 1, charset="ascii")  # the application indicator
        elif mode == consts.MODE_STRUCTURED_APPEND:
            index, last, parity = bits.take(4), bits.take(4), bits.take(8)
            yield StructuredAppend(index=index, count=last + 1, parity=parity)
        elif mode == consts.MODE_ECI:
            bits.take(8 if not bits.ahead(1) else 16 if bits.ahead(2) == 0b10 else 24)
        else:
            if mode == consts.MODE_HANZI:
                bits.take(4)  # which set of characters
            if mode not in count_bits:
                raise ValueError(f"there is no mode {mode}")
            count = bits.take(count_bits[mode])
            yield _run(bits, mode, count, fnc1)


def _run(bits: _Bits, mode: int, count: int, fnc1: bool) -> Run:
    from segno import consts

    if mode == consts.MODE_NUMERIC:
        bits.take(count // 3 * 10 + (0, 4, 7)[count % 3])
    elif mode == consts.MODE_ALPHANUMERIC and not fnc1:
        bits.take(count // 2 * 11 + count % 2 * 6)
    elif mode == consts.MODE_ALPHANUMERIC:  # where "%%" is one "%", the 38th character
        values = [value for _ in range(count // 2) for value in divmod(bits.take(11), 45)]
        values += [bits.take(6) for _ in range(count % 2)]
        count = len(bytes(values).replace(b"\x26\x26", b"\x26"))
    elif mode == consts.MODE_BYTE:
        bits.take(8 * count)
        return Run(length=count, charset=None)
    else:
        bits.take(13 * count)
        return Run(length=2 * count, charset="shift_jis" if mode == consts.MODE_KANJI else "gb18030")
    return Run(length=count, charset="ascii")
