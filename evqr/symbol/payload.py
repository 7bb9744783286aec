"""What a symbol says: its characters, and what it tells beside them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from evqr.symbol.gs1 import Gs1Element, elements_of
from evqr.values import Value


class ContentType(str, Enum):
    """What kind of content a symbol holds, as zxing-cpp classifies it."""

    TEXT = "text"
    BINARY = "binary"
    """bytes that are no text"""
    MIXED = "mixed"
    """text and bytes, one behind the other"""
    GS1 = "gs1"
    """element strings of GS1, marked by FNC1 in first position"""
    ISO15434 = "iso15434"
    """a message of ISO/IEC 15434, which begins with ``[)>``"""
    UNKNOWN_ECI = "unknown_eci"
    """a part is in a character set, or a coding, by an ECI designator that evqr does not know"""

    def __str__(self) -> str:
        return self.value


class CharsetSource(str, Enum):
    """From where the character set of a text is known."""

    ECI = "eci"
    """the symbol names it, by an ECI designator"""
    MODE = "mode"
    """the modes of the symbol hold one character set only: digits, letters of the alphanumeric mode, kanji"""
    ASSUMED = "assumed"
    """the symbol does not name it; `DecodeConfig.charset` does"""
    GUESSED = "guessed"
    """the symbol does not name it, and zxing-cpp guessed it from the bytes: UTF-8, Shift JIS or ISO 8859-1"""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, kw_only=True)
class StructuredAppend(Value):
    """That a symbol is a part of a message.

    Attributes
    ----------
    index : int
        Which part it is, 0 for the first.
    count : int
        Parts that the message has, at most 16 in QR codes.
    parity : int
        What all parts of a message have in common: in QR codes the exclusive or of all bytes of the message,
        elsewhere the number that the symbology identifies a message by.
    """

    index: int
    count: int
    parity: int

    def __str__(self) -> str:
        return f"part {self.index + 1} of {self.count}, parity {self.parity}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Payload(Value):
    """What a symbol says.

    Attributes
    ----------
    text : str
        The content as text. A separator of GS1 is the character 0x1d. Bytes that are no text, and those in an
        unknown ECI, are each the character of its number (ISO 8859-1).
    data : bytes
        The content, without ECI designators.
    symbology_identifier : str
        Of ISO/IEC 15424: ]Q1 a QR code, ]Q3 one with FNC1 in first position (GS1), ]Q5 in second (the text
        begins with the application indicator then). ]Q2, ]Q4 and ]Q6, which say that designators are sent
        with the bytes, are never given: `data` is without them.
    content_type : ContentType
        Kind of content.
    eci : tuple of int
        ECI designators, in order; empty where the symbol has none.
    charset : str or None
        Character set of the text, by Python's name; None where there are several, or none.
    charset_source : CharsetSource
        From where it is known.
    structured_append : StructuredAppend or None
        Which part of which message the symbol is; None where it stands alone.
    warnings : tuple of str
        What was odd about the content, in words.
    """

    text: str
    data: bytes
    symbology_identifier: str = ""
    content_type: ContentType = ContentType.TEXT
    eci: tuple[int, ...] = ()
    charset: str | None = None
    charset_source: CharsetSource = CharsetSource.GUESSED
    structured_append: StructuredAppend | None = None
    warnings: tuple[str, ...] = ()

    @property
    def gs1(self) -> tuple[Gs1Element, ...]:
        """Elements of a GS1 message, parsed when asked for; empty for other content, and with `gs1_error`."""
        return elements_of(self.text)[0] if self.content_type is ContentType.GS1 else ()

    @property
    def gs1_error(self) -> str:
        """Why a GS1 message has no elements, in words; "" where it has, and for other content."""
        return elements_of(self.text)[1] if self.content_type is ContentType.GS1 else ""

    def same_content(self, other: Payload) -> bool:
        """Whether another symbol says the same, byte by byte and in the same sense.

        Parameters
        ----------
        other : Payload
            Of the other one.

        Returns
        -------
        same : bool
            Texts do not count: they depend on the character set that was assumed.
        """
        return (
            self.data == other.data
            and self.symbology_identifier == other.symbology_identifier
            and self.eci == other.eci
            and self.structured_append == other.structured_append
        )
