"""Reed-Solomon codes over GF(2^m): errors and erasures.

A word is a polynomial, its first symbol the highest power; X_i = 2^(n - 1 - i) is the place of symbol i.  It
is valid when all its syndromes are zero,

    S_k = sum_i word_i X_i^(first_root + k),   k = 0 ... n_check - 1.

Decoding is the textbook's (Blahut, "Algebraic codes for data transmission", chapters 6 and 7): erasures are
taken out of the syndromes, Berlekamp-Massey finds the shortest recurrence in what is left, its roots are the
places of the errors, and Forney's formula gives the values.

What calls share is never written to, what a call writes to is its own: threads need no lock.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Symbols = NDArray[np.unsignedinteger]
"""A word or a part of one: uint8 up to GF(256), uint16 above."""

_FURTHER = 3
"""Check symbols behind those of a code that are looked for."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GaloisField:
    """GF(2^m): the powers of 2 and their logarithms.

    Zero's logarithm is so large that its sum with any logarithm is the index of a zero: the product of any
    two numbers is ``power[log[a] + log[b]]``.

    Attributes
    ----------
    order : int
        2^m - 1, the count of numbers that are not zero; 2^order = 1.
    power : (4 order + 1,) uint8 or uint16
        Powers of 2 up to 2^(2 order - 1), then zeros.
    log : (order + 1,) int64
        Logarithm of each number, below ``order``; 2 ``order`` for zero.
    powers, logs : list of int
        The same for Python, which reads numbers from lists faster.
    """

    order: int
    power: Symbols
    log: NDArray[np.int64]
    powers: list[int]
    logs: list[int]


@functools.cache
def galois_field(polynomial: int) -> GaloisField:
    """Return the field of a primitive polynomial.

    Parameters
    ----------
    polynomial : int
        Bit k is the coefficient of x^k; of degree 2 to 16.

    Returns
    -------
    GaloisField
        Its tables, read-only and shared.

    Raises
    ------
    ValueError
        The degree is out of range or the polynomial is not primitive.
    """
    m = polynomial.bit_length() - 1
    if not 2 <= m <= 16:
        raise ValueError(f"polynomial must have a degree of 2 to 16, got {polynomial:#x}")
    order = (1 << m) - 1
    powers = [1]
    while len(powers) < order:
        double = powers[-1] << 1
        powers.append(double ^ polynomial if double > order else double)
    if set(powers) != set(range(1, order + 1)):
        raise ValueError(f"polynomial must be primitive, got {polynomial:#x}")
    power = np.zeros(4 * order + 1, np.uint8 if m <= 8 else np.uint16)
    power[: 2 * order] = powers * 2
    log = np.full(order + 1, 2 * order, np.int64)
    log[powers] = np.arange(order)
    power.flags.writeable = log.flags.writeable = False
    return GaloisField(order=order, power=power, log=log, powers=power.tolist(), logs=log.tolist())


@dataclass(frozen=True, kw_only=True)
class ReedSolomon:
    """A Reed-Solomon code; its words may have any length up to that of the field.

    Attributes
    ----------
    polynomial : int
        Primitive polynomial of the field, as of ``galois_field``.
    n_check : int
        Check symbols of a word, at least 1.
    first_root : int
        The generator's roots are 2^first_root and the ``n_check - 1`` powers behind it; default 0.

    Raises
    ------
    ValueError
        No such field, or a number out of range.
    """

    polynomial: int
    n_check: int
    first_root: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.n_check < self.field.order:
            raise ValueError(f"n_check must be 1 to {self.field.order - 1}, got {self.n_check}")
        if not 0 <= self.first_root < self.field.order:
            raise ValueError(f"first_root must be 0 to {self.field.order - 1}, got {self.first_root}")

    @property
    def width(self) -> int:
        """Bits of a symbol, m."""
        return self.polynomial.bit_length() - 1

    @property
    def field(self) -> GaloisField:
        """The field of its symbols."""
        return galois_field(self.polynomial)

    def encode(self, data: Symbols) -> Symbols:
        """Append the check symbols.

        Parameters
        ----------
        data : (k,) uint8 or uint16
            Data symbols.

        Returns
        -------
        (k + n_check,) uint8 or uint16
            The valid word that begins with them.

        Raises
        ------
        ValueError
            The word would be longer than the field allows.
        """
        # The check symbols are data that were lost, and there are as many as can be lost.
        word = np.concatenate([data, np.zeros(self.n_check, data.dtype)])
        return self._with_values(word, self.syndromes(word), range(len(data), len(word)))

    def syndromes(self, word: Symbols) -> Symbols:
        """Compute the syndromes, of one word or of many at once.

        Parameters
        ----------
        word : (..., n) uint8 or uint16
            Data and check symbols.

        Returns
        -------
        (..., n_check) uint8 or uint16
            All zero for a valid word.

        Raises
        ------
        ValueError
            The word is longer than the field allows, or not longer than its check symbols.
        """
        field, exponents = self.field, _exponents(self, word.shape[-1])
        logs = field.log.take(word)[..., None, :]
        return np.bitwise_xor.reduce(field.power.take(logs + exponents), axis=-1)

    def further_roots(self, word: Symbols) -> int:
        """Tell how many further check symbols a valid word has, 0 to 3: it is one of a larger code then.

        Parameters
        ----------
        word : (n,) uint8 or uint16
            A valid word.

        Returns
        -------
        count : int
            Syndromes that are zero, one after another, behind those of this code.
        """
        if len(word) <= _FURTHER:
            return 0
        further = _further(self).syndromes(word).tolist()
        return next((k for k, each in enumerate(further) if each), _FURTHER)

    def correct(
        self, word: Symbols, erased: Sequence[int] = (), *, syndromes: Symbols | None = None
    ) -> Symbols | None:
        """Find the valid word within reach: 2 errors + erasures <= check symbols.

        Parameters
        ----------
        word : (n,) uint8 or uint16
            Data and check symbols as received; what stands at erased places does not matter.
        erased : sequence of int
            Indices of symbols that are not to be trusted, each once.
        syndromes : (n_check,) uint8 or uint16
            Of the word, where they are known already: they are the same for any erasures.

        Returns
        -------
        (n,) uint8 or uint16, or None
            The valid word; None when there is none within reach.

        Raises
        ------
        ValueError
            As of ``syndromes``.
        """
        if syndromes is None:
            syndromes = self.syndromes(word)
        if not syndromes.any():
            return word
        if len(erased) > self.n_check:
            return None
        field, n = self.field, len(word)
        logs, powers = field.logs, field.powers
        rest: list[int] = syndromes.tolist()
        for i in erased:  # S_(k + 1) - X_i S_k holds nothing of symbol i
            place = n - 1 - i
            rest = [powers[logs[a] + place] ^ b for a, b in pairwise(rest)]
        locator = _shortest_recurrence(field, rest)
        if 2 * (len(locator) - 1) > len(rest):
            return None
        errors = _roots(self, locator, n)
        if len(errors) < len(locator) - 1 or not set(errors).isdisjoint(erased):
            return None
        return self._with_values(word, syndromes, [*erased, *errors])

    def _with_values(self, word: Symbols, syndromes: Symbols, wrong: Sequence[int]) -> Symbols:
        """Return the valid word that differs from the word at the given places only (Forney)."""
        field = self.field
        places = len(word) - 1 - np.array(wrong, dtype=np.int64)
        # the product of 1 + X_i x, and its product with S(x) up to the highest power of the evaluator
        locator = functools.reduce(functools.partial(_times_root, field), places.tolist(), [1])
        evaluator = _product(field, locator, syndromes.tolist(), len(places))
        # X^-first_root (X^(t - 1) evaluator(1 / X)) / product over the others of X + X_other
        powers_of_x = np.outer(places, np.arange(len(places) - 1, -1, -1)) % field.order
        values = np.bitwise_xor.reduce(
            field.power.take(field.log.take(np.array(evaluator)) + powers_of_x), axis=1
        )
        x = field.power.take(places)
        apart = field.log.take(x[:, None] ^ x)
        np.fill_diagonal(apart, 0)
        divisor = (apart.sum(axis=1) + self.first_root * places) % field.order
        corrected = word.copy()
        corrected[list(wrong)] ^= field.power.take(field.log.take(values) + (-divisor) % field.order)
        return corrected


@functools.lru_cache(maxsize=256)
def _further(code: ReedSolomon) -> ReedSolomon:
    """Return the code of the roots behind those of another."""
    first = (code.first_root + code.n_check) % code.field.order
    return ReedSolomon(polynomial=code.polynomial, n_check=_FURTHER, first_root=first)


@functools.lru_cache(maxsize=64)
def _exponents(code: ReedSolomon, n: int) -> NDArray[np.int64]:
    """Return the logarithm of X_i^(first_root + k), (n_check, n) int64."""
    if not code.n_check < n <= code.field.order:
        raise ValueError(f"a word must have {code.n_check + 1} to {code.field.order} symbols, got {n}")
    exponents = np.outer(code.first_root + np.arange(code.n_check), np.arange(n)[::-1]) % code.field.order
    exponents.flags.writeable = False
    return exponents


def _shortest_recurrence(field: GaloisField, sequence: list[int]) -> list[int]:
    """Return 1, c_1, ... c_L with sequence_k = sum_j c_j sequence_(k - j), L the least (Massey 1969)."""
    powers, logs, order = field.powers, field.logs, field.order
    log_sequence = [logs[value] for value in sequence]
    current, earlier = [1], [1]
    length, shift, log_earlier = 0, 1, 0
    for k, value in enumerate(sequence):
        discrepancy = value
        for j in range(1, min(length, len(current) - 1) + 1):
            discrepancy ^= powers[logs[current[j]] + log_sequence[k - j]]
        if not discrepancy:
            shift += 1
            continue
        factor = (logs[discrepancy] - log_earlier) % order
        better = current + [0] * (len(earlier) + shift - len(current))
        for j, c in enumerate(earlier, shift):
            better[j] ^= powers[logs[c] + factor]
        if 2 * length <= k:
            length = k + 1 - length
            earlier, log_earlier, shift = current, logs[discrepancy], 1
        else:
            shift += 1
        current = better
    return current[: length + 1] + [0] * (length + 1 - len(current))


def _roots(code: ReedSolomon, locator: list[int], n: int) -> list[int]:
    """Return the indices i at whose places X_i the locator, a product of 1 + X_i x, has a factor."""
    field, degree = code.field, len(locator) - 1
    if not degree:
        return []
    # x^L locator(1 / x), a product of x + X_i, times x^first_root, which is not zero
    backwards = field.log.take(np.array(locator[::-1]))
    values = field.power.take(backwards[:, None] + _exponents(code, n)[: degree + 1])
    return np.flatnonzero(np.bitwise_xor.reduce(values, axis=0) == 0).tolist()


def _times_root(field: GaloisField, polynomial: list[int], place: int) -> list[int]:
    """Return the polynomial, lowest power first, times 1 + 2^place x."""
    powers, logs = field.powers, field.logs
    return [a ^ powers[logs[b] + place] for a, b in zip([*polynomial, 0], [0, *polynomial], strict=True)]


def _product(field: GaloisField, a: list[int], b: list[int], n: int) -> list[int]:
    """Return the first n coefficients of a product, lowest power first."""
    powers = field.powers
    logs_a, logs_b = ([field.logs[value] for value in factor] for factor in (a, b))
    product = [0] * n
    for i, log_a in enumerate(logs_a):
        for j in range(i, n):
            product[j] ^= powers[log_a + logs_b[j - i]]
    return product
