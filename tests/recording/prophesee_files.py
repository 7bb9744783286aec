"""Files of Prophesee's encodings, made word by word from the layouts that the vendor publishes."""

from __future__ import annotations

import numpy as np

from evqr.events.array import EventArray

HEADER = b"% date 2026-01-02 03:04:05\n% geometry 64x48\n% evt VERSION\n% end\n"

TIME_HIGH = {"2.0": 0x8, "2.1": 0x8, "4.0": 0xE}
EVENT = {"2.0": (0x0, 0x1), "4.0": (0xA, 0xB)}
VECTOR = {"2.1": (0x0, 0x1), "4.0": (0xC, 0xD)}


def _high(version: str, time_us: int) -> list[int]:
    word = TIME_HIGH[version] << 28 | (time_us >> 6) & 0x0FFFFFFF
    return [0, word] if version == "2.1" else [word]


def words_of(events: EventArray, version: str, *, vectors: bool = False) -> list[int]:
    """32-bit words in order, the lower half of a 64-bit word first; rows of one time as vectors."""
    words: list[int] = []
    high = None
    i = 0
    columns = [column.tolist() for column in (events.t, events.x, events.y, events.p)]
    while i < len(events):
        t, x, y, p = (column[i] for column in columns)
        if high != t >> 6:
            high = t >> 6
            words += _high(version, t)
        place = (t & 0x3F) << 22 | x << 11 | y
        mask, n = 1, 1
        while vectors and version in VECTOR and i + n < len(events):
            same = (columns[0][i + n], columns[2][i + n], columns[3][i + n]) == (t, y, p)
            dx = columns[1][i + n] - x
            if not same or not mask.bit_length() <= dx < 32:
                break
            mask |= 1 << dx
            n += 1
        i += n
        on = int(p > 0)
        if version == "2.1":
            words += [mask, VECTOR[version][on] << 28 | place]
        elif n > 1:
            words += [VECTOR[version][on] << 28 | place, mask]
        else:
            words += [EVENT[version][on] << 28 | place]
    return words


def raw(events: EventArray, version: str, *, header: bytes = HEADER, vectors: bool = False) -> bytes:
    """A RAW file of EVT2, EVT2.1 or EVT4."""
    words = np.array(words_of(events, version, vectors=vectors), "<u4")
    return header.replace(b"VERSION", version.encode()) + words.tobytes()


def dat(events: EventArray, *, version: int = 2, kind: int = 0x0C, length: int = 8) -> bytes:
    """A DAT file."""
    x_bits, y_bits = {1: (9, 8), 2: (14, 14)}.get(version, (14, 14))
    place = events.x.astype(np.uint32) | events.y.astype(np.uint32) << x_bits
    place |= (events.p > 0).astype(np.uint32) << (x_bits + y_bits)
    records = np.stack([(events.t & 0xFFFFFFFF).astype("<u4"), place.astype("<u4")], axis=1)
    header = f"% Data file containing CD events\n% Version {version}\n% Width 64\n% Height 48\n"
    return header.encode() + bytes([kind, length]) + records.tobytes()
