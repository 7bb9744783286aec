"""Kinds of symbols."""

from __future__ import annotations

from enum import Enum


class Symbology(str, Enum):
    """Kinds of symbols, by zxing-cpp's names, in any case, with or without "Code" at their end."""

    QR_CODE = "QRCode"
    """ISO/IEC 18004"""
    MICRO_QR_CODE = "MicroQRCode"
    """ISO/IEC 18004"""
    RMQR_CODE = "RMQRCode"
    """ISO/IEC 23941"""
    DATA_MATRIX = "DataMatrix"
    """ISO/IEC 16022, and ISO/IEC 21471"""
    AZTEC = "Aztec"
    """ISO/IEC 24778"""

    def __str__(self) -> str:
        return self.value

    @classmethod
    def _missing_(cls, value: object) -> Symbology | None:
        wanted = _plain(value) if isinstance(value, str) else ""
        return next((symbology for symbology in cls if _plain(symbology.value) == wanted), None)

    @classmethod
    def parse(cls, name: str) -> Symbology:
        """Return the symbology of a name, in any case; ``Code`` at its end may be left out.

        Parameters
        ----------
        name : str
            As ``QRCode``, ``microqr``, ``data_matrix``.

        Returns
        -------
        Symbology
            That is called so.

        Raises
        ------
        ValueError
            There is none.
        """
        try:
            return cls(name)
        except ValueError:
            raise ValueError(f"symbology must be one of {', '.join(cls)}, got {name!r}") from None


BY_THREE_PATTERNS = frozenset({Symbology.QR_CODE, Symbology.MICRO_QR_CODE})
"""Kinds found by three finder patterns, and those whose search costs next to nothing beside that."""


def _plain(name: str) -> str:
    return "".join(filter(str.isalnum, name.lower())).removesuffix("code")
