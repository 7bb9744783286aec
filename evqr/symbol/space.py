"""What is known of a QR code before it is read: where its modules are, and which of them are fixed.

The version alone fixes the function patterns (finders, separators, timing, alignment, the dark module,
version information).  They anchor the pose, and they need not be estimated.  All of it comes from segno, so
that the tables of ISO/IEC 18004 are not repeated here.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_VERSION = 1
MAX_VERSION = 40


@dataclass(frozen=True, eq=False, kw_only=True)
class CodeSpace:
    """The modules of one version, by what they carry.  Every module is in exactly one of the three masks.

    Attributes
    ----------
    version                1 to 40
    size                   r = 17 + 4 version, modules a side
    known : (r, r) bool    function patterns: fixed by the version
    values : (r, r) int8   -1 dark, +1 light where known, 0 elsewhere
    format : (r, r) bool   format information, two copies of 15 bits: level and mask
    data : (r, r) bool     codewords, and the few remainder bits behind the last
    """

    version: int
    size: int
    known: NDArray[np.bool_]
    values: NDArray[np.int8]
    format: NDArray[np.bool_]
    data: NDArray[np.bool_]


def size_of(version: int) -> int:
    """Return the modules a side of a version.

    Raises
    ------
    ValueError   not a version from 1 to 40
    """
    if not MIN_VERSION <= version <= MAX_VERSION:
        raise ValueError(f"version must be {MIN_VERSION} to {MAX_VERSION}, got {version}")
    return 17 + 4 * version


def version_of(size: int) -> int:
    """Return the version with so many modules a side.

    Raises
    ------
    ValueError   not a size that a version has: 21, 25, ... 177
    """
    version, rest = divmod(size - 17, 4)
    if rest or not MIN_VERSION <= version <= MAX_VERSION:
        raise ValueError(
            f"size must be {size_of(MIN_VERSION)}, {size_of(MIN_VERSION + 1)}, ... {size_of(MAX_VERSION)} "
            f"(17 + 4 version), got {size}"
        )
    return version


@functools.cache
def code_space(version: int) -> CodeSpace:
    """Return the code space of a version, with read-only arrays.

    Raises
    ------
    ValueError   not a version from 1 to 40
    """
    import segno  # here: it takes 60 ms to import
    from segno import consts

    size = size_of(version)
    symbol = segno.make("0", version=version, error="L", mask=0, boost_error=False, micro=False)
    kind = np.array(list(symbol.matrix_iter(border=0, verbose=True)))
    # segno (1.6) counts the data module left of the upper right format bits as one of them.
    kind[8, size - 9] = consts.TYPE_DATA_LIGHT

    is_format = np.isin(kind, [consts.TYPE_FORMAT_LIGHT, consts.TYPE_FORMAT_DARK])
    is_data = np.isin(kind, [consts.TYPE_DATA_LIGHT, consts.TYPE_DATA_DARK])
    known = ~(is_format | is_data)
    values = np.where(np.array(symbol.matrix, dtype=bool), -1, 1) * known
    return CodeSpace(
        version=version,
        size=size,
        known=read_only(known),
        values=read_only(values.astype(np.int8)),
        format=read_only(is_format),
        data=read_only(is_data),
    )


def read_only(array: NDArray) -> NDArray:
    """Return the array, closed for writing: it is shared by all who ask."""
    array.flags.writeable = False
    return array
