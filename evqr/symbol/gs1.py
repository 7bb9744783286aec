"""Elements of GS1 messages, parsed by biip (extra ``gs1``)."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from evqr.values import Value
from evqr_kernels.extras import install_command

SEPARATOR = "\x1d"
"""Ends an element of no fixed length; FNC1 in the symbol."""

NOT_INSTALLED = "the elements of GS1 codes are not told apart: that needs the package biip"


@dataclass(frozen=True, kw_only=True)
class Gs1Element(Value):
    """One element string of a GS1 message.

    Attributes
    ----------
    ai : str
        Application identifier, 2 to 4 digits.
    title : str
        What GS1 calls it: GTIN, BATCH/LOT, ...
    value : str
        Its data.
    """

    ai: str
    title: str
    value: str

    def __str__(self) -> str:
        return f"({self.ai}) {self.title} {self.value}"


@functools.lru_cache(maxsize=256)
def elements_of(message: str) -> tuple[tuple[Gs1Element, ...], str]:
    """Split a GS1 message into its elements; the first time loads biip, which takes a tenth of a second.

    Parameters
    ----------
    message : str
        Element strings, with `SEPARATOR` behind those of no fixed length.

    Returns
    -------
    elements : tuple of Gs1Element
        In order; empty where they cannot be told.
    why_not : str
        Why they cannot, in words; "" where they can.
    """
    try:
        from biip import ParseConfig, ParseError
        from biip.gs1_messages import GS1Message
    except ImportError:
        return (), f"{NOT_INSTALLED}: {install_command('gs1')}"
    # dates that are none are the printer's business: the element is told as it is
    config = ParseConfig(gs1_element_strings_verify_date=False, separator_chars=(SEPARATOR,))
    try:
        parsed = GS1Message.parse(message, config=config)
    except (ParseError, ValueError, ArithmeticError) as error:
        return (), f"the content is marked as GS1, but its elements cannot be told apart: {error}"
    elements = (
        Gs1Element(ai=each.ai.ai, title=each.ai.data_title, value=each.value)
        for each in parsed.element_strings
    )
    return tuple(elements), ""
