"""Prophesee EVT2, EVT2.1 and EVT4, decoded here: words of fixed length, many at a time with NumPy.

No package reads all three in bounded memory: eventcv takes whole files of EVT2 and finds the data by a rule
of its own, evlib reads EVT2.1 into memory, nothing on PyPI reads EVT4.  The layouts are those of openeb's
``evt2_event_types.h``, ``evt21_event_types.h`` and ``evt4_event_types.h``.

A word of 32 bits holds, from the highest bits down, its type (4), the low bits of the time (6), x (11) and y
(11).  A word of type TIME_HIGH holds the next 28 bits of the time instead, for all words up to the next
such.  A vector stands for up to 32 events of one row at once: x is that of the first, and 32 bits say which
of x, x + 1, ... fired.  In EVT2.1 they make the lower half of a 64-bit word (the upper one on older systems),
in EVT4 the word after.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .declared import DeclaredSensor, DeclaredUnit, Unclear
from .faults import Faults
from .source import RawChunks, RawColumns, Source

TIME_LOW_BITS, TIME_HIGH_BITS = 6, 28
TIME_LOOP_US = 1 << (TIME_LOW_BITS + TIME_HIGH_BITS)  # 4.8 hours
VECTOR = np.dtype("<u4")
EVENTS_A_VECTOR = 8  # more than scenes have on average; memory is bounded by the 32 there can be


class Words(NamedTuple):
    """How one encoding uses its words.

    Attributes
    ----------
    name : str
        The encoding.
    parts : int
        32-bit parts of a word: 2 where a word holds its vector.
    key : int
        Which part holds type, time and place.
    off, on, off_vector, on_vector, time_high : int
        Types; -1 for what the encoding does not have.
    others : frozenset of int
        Types that are no events: triggers, monitoring, continued words, padding.
    """

    name: str
    parts: int
    key: int
    off: int
    on: int
    off_vector: int
    on_vector: int
    time_high: int
    others: frozenset[int]

    @property
    def bytes(self) -> int:
        """Length of a word."""
        return 4 * self.parts


EVT2 = Words("EVT2", 1, 0, 0x0, 0x1, -1, -1, 0x8, frozenset((0xA, 0xD, 0xE, 0xF)))
EVT21 = Words("EVT2.1", 2, 1, -1, -1, 0x0, 0x1, 0x8, frozenset((0xA, 0xE, 0xF)))
EVT21_LEGACY = EVT21._replace(key=0)
EVT4 = Words("EVT4", 1, 0, 0xA, 0xB, 0xC, 0xD, 0xE, frozenset((0x6, 0x7, 0x9, 0xF)))


class WordDecoder:
    """Decodes a stream of words as the bytes come, whole words at a time.

    Parameters
    ----------
    words : Words
        The encoding.
    faults : Faults
        Is told of words that are none of the encoding's.
    """

    def __init__(self, words: Words, faults: Faults) -> None:
        self._words = words
        self._faults = faults
        self._decoded = 0
        self._time_us: int | None = None  # by the last TIME_HIGH, with loops
        self._opened = np.empty(
            0, np.uint32
        )  # EVT4: the word before its vector, at the end of the last bytes

    def feed(self, data: bytes) -> RawColumns:
        """Return the events of some whole words."""
        words = self._words
        parts = np.frombuffer(data, VECTOR).reshape(-1, words.parts)
        key = np.concatenate([self._opened, parts[:, words.key]])
        vectors = parts[:, 1 - words.key] if words.parts == 2 else None
        first = self._decoded - len(self._opened)
        self._decoded += len(parts)
        kind = (key >> 28).astype(np.int8)
        if vectors is None and words.off_vector >= 0:
            vectors, kind = self._vectors_after(key, kind)
            key = key[: len(kind)]
        time_us = self._times(key, kind)

        single = (kind == words.off) | (kind == words.on)
        vector = (kind == words.off_vector) | (kind == words.on_vector)
        known = single | vector | (kind == words.time_high) | np.isin(kind, (*words.others, _VECTOR_WORD))
        if not np.all(known):
            at = int(np.argmin(known))
            count = len(known) - int(np.count_nonzero(known))
            self._faults.met += count
            problem = f"word {first + at:,} is of type {kind[at]:#x}, which {words.name} does not have"
            self._faults.leave_out(count, problem, "copy the file again")
        timeless = int(np.count_nonzero((single | vector) & (time_us < 0)))
        if timeless:
            self._faults.note(
                f"{timeless:,} words before the first time in the file are left out: their time is unknown"
            )
        event = np.flatnonzero((single | vector) & (time_us >= 0))
        key, kind, time_us = key[event], kind[event], time_us[event]
        t = time_us + ((key >> 22) & 0x3F)
        x = ((key >> 11) & 0x7FF).astype(np.uint16)
        y = (key & 0x7FF).astype(np.uint16)
        p = ((kind == words.on) | (kind == words.on_vector)).astype(np.uint8)
        if vectors is None:
            return RawColumns(t, x, y, p)
        fired = vectors[event]
        fired = np.where(single[event], VECTOR.type(1), fired)
        word, bit = np.nonzero(
            np.unpackbits(fired.astype(VECTOR).view(np.uint8).reshape(-1, 4), axis=1, bitorder="little")
        )
        return RawColumns(t[word], x[word] + bit.astype(np.uint16), y[word], p[word])

    @property
    def opened(self) -> bool:
        """Whether the last word's vector has not come yet."""
        return len(self._opened) > 0

    def _times(self, key: NDArray[np.uint32], kind: NDArray[np.int8]) -> NDArray[np.int64]:
        """Time of each word [us] but its low bits; negative before the first TIME_HIGH of all."""
        high = np.flatnonzero(kind == self._words.time_high)
        stamps = (key[high] & 0x0FFFFFFF).astype(np.int64) << TIME_LOW_BITS
        before = stamps[:1] if self._time_us is None else np.array([self._time_us])
        steps = np.diff(np.concatenate([before % TIME_LOOP_US, stamps]))
        loops = np.cumsum(steps < -(TIME_LOOP_US // 2)) * TIME_LOOP_US
        if len(stamps):
            stamps = stamps + loops + (before[0] - before[0] % TIME_LOOP_US)
        times = np.concatenate([[-1 if self._time_us is None else self._time_us], stamps])
        if len(stamps):
            self._time_us = int(stamps[-1])
        return times[np.cumsum(kind == self._words.time_high)]

    def _vectors_after(
        self, key: NDArray[np.uint32], kind: NDArray[np.int8]
    ) -> tuple[NDArray[np.uint32], NDArray[np.int8]]:
        """Tell vectors, which may look like any word, from words.

        Returns the next word of each, and the kinds.  In a row of words that look as if a vector followed,
        every other one is that vector.
        """
        words = self._words
        is_vector = (kind == words.off_vector) | (kind == words.on_vector)
        place = np.arange(len(kind))
        start = np.maximum.accumulate(
            np.where(is_vector & ~np.concatenate([[False], is_vector[:-1]]), place, 0)
        )
        opens = is_vector & ((place - start) % 2 == 0)
        kind = kind.copy()
        kind[1:][opens[:-1]] = _VECTOR_WORD
        last = len(kind) - 1 if len(kind) and opens[-1] else len(kind)
        self._opened = key[last:]
        following = np.concatenate([key[1:], np.zeros(1, np.uint32)]) if len(key) else key
        return following[:last], kind[:last]


_VECTOR_WORD = 16  # no type of four bits


class WordSource(Source):
    """A RAW file in one of these encodings."""

    def __init__(
        self,
        path: str,
        words: Words,
        start: int,
        sensor: DeclaredSensor | Unclear | None,
        notes: tuple[str, ...] = (),
    ) -> None:
        unit = DeclaredUnit("us", "the format is in us")
        super().__init__(path, f"Prophesee {words.name}", sensor=sensor, unit=unit, notes=notes)
        self._words = words
        self._start = start

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Decode a word an event; a vector may hold more."""
        decoder = WordDecoder(self._words, faults)
        rest = (os.path.getsize(self.name) - self._start) % self._words.bytes
        with open(self.name, "rb") as file:
            file.seek(self._start)
            words = chunk_events if self._words.off_vector < 0 else max(1, chunk_events // EVENTS_A_VECTOR)
            while data := file.read(words * self._words.bytes):
                raw = decoder.feed(data[: len(data) - len(data) % self._words.bytes])
                for first in range(0, len(raw.t), chunk_events):
                    yield RawColumns(*(column[first : first + chunk_events] for column in raw))
        if rest or decoder.opened:
            rest += decoder.opened * self._words.bytes
            faults.cut(f"{rest} byte{'s' * (rest != 1)} after the last whole word of {self._words.bytes}")
