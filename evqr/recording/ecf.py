"""Prophesee's ECF compression of HDF5 (filter 0x8ECF), decoded here.

No package on PyPI that was tried decodes all its forms.

A chunk holds up to 65 535 events: their number and how places are stored (32 bits), then all times, all y,
all x, all polarities, each in runs of equal values.

times       64 bits for the first; then bytes of a step (upper half) and the length of a run (lower half; 15:
            it is in the next 16 bits).  A step of 15 is none: the lower half is four bits of a longer one
y           16 bits: y (11) and the length of a run (5; 31: it is in the next 16 bits)
x           16 bits: x (11), and which of the next five columns fired too (5, the nearest first)
polarities  8 bits: polarity (1) and the length of a run (7; 127: it is in the next 16 bits)

Where runs are short, x and polarity (12 bits) or y, x and polarity (23 bits in 24) of four events are packed
into three words instead.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

ECF_FILTER = 0x8ECF
MAX_EVENTS = 0xFFFF

EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])


def read_ecf(dataset: Any, first: int, last: int) -> NDArray[Any]:
    """Read events ``first`` to ``last - 1`` of a data set of events that is compressed so.

    Raises
    ------
    ValueError
        For a chunk that is damaged.
    """
    step = dataset.chunks[0]
    last = min(last, dataset.shape[0])
    parts = [np.empty(0, EVENT)]
    for start in range(first // step * step, last, step):
        mask, data = dataset.id.read_direct_chunk((start,))
        if mask:  # stored as it is
            raw: Any = np.frombuffer(data, dataset.dtype)
            events = np.empty(len(raw), EVENT)
            for name in EVENT.names or ():
                events[name] = raw[name]
        else:
            events = decode(data)
        parts.append(events[max(first - start, 0) : last - start])
    events = np.concatenate(parts)
    if len(events) != last - first:
        raise ValueError(f"chunks hold {len(events)} of {last - first} events")
    return events


def decode(data: bytes) -> NDArray[Any]:
    """Decode one chunk; raises ValueError for one that is damaged."""
    head = int.from_bytes(data[:4], "little")
    count, y_packed, x_packed = head >> 2, head >> 1 & 1, head & 1
    if len(data) < 4 or count > MAX_EVENTS:
        raise ValueError(f"a chunk of {count} events")
    events = np.empty(count, EVENT)
    events["t"], at = _times(data, 4, count)
    if y_packed:
        words, at = _take(data, at, -(-count // 4) * 3, 4)
        a, b, c = words.reshape(-1, 3).T
        packed = np.stack([a >> 8, a & 0xFF | b >> 16 << 8, b & 0xFFFF | c >> 24 << 16, c & 0xFFFFFF], axis=1)
        place = packed.ravel()[:count]
        events["y"], events["x"], events["p"] = place >> 12 & 0x7FF, place >> 1 & 0x7FF, place & 1
        return events
    events["y"], at = _runs(data, at, count, 2, 5)
    if x_packed:
        words, at = _take(data, at, -(-count // 4) * 3, 2)
        a, b, c = words.reshape(-1, 3).T
        packed = np.stack([a >> 4, a & 0xF | b >> 8 << 4, b & 0xFF | c >> 12 << 8, c & 0xFFF], axis=1)
        place = packed.ravel()[:count]
        events["x"], events["p"] = place >> 1, place & 1
        return events
    events["x"], at = _masked(data, at, count)
    events["p"], _ = _runs(data, at, count, 1, 7)
    return events


def _take(data: bytes, at: int, count: int, size: int) -> tuple[NDArray[np.uint32], int]:
    """Take so many words of so many bytes; return them and what follows."""
    end = at + count * size
    if end > len(data):
        raise ValueError("a chunk is cut short")
    return np.frombuffer(data[at:end], f"<u{size}").astype(np.uint32), end


def _times(data: bytes, at: int, count: int) -> tuple[NDArray[np.int64], int]:
    now = int.from_bytes(data[at : at + 8], "little")
    at += 8
    times: list[int] = []
    lengths: list[int] = []
    done = longer = bits = 0
    try:
        while done < count:
            step, length = data[at] >> 4, data[at] & 0xF
            at += 1
            if step == 0xF:
                longer |= length << bits
                bits += 4
                continue
            if length == 0xF:
                length = data[at] | data[at + 1] << 8
                at += 2
            now += longer + step
            longer = bits = 0
            times.append(now)
            lengths.append(length)
            done += length
        return np.repeat(np.array(times, np.int64), lengths)[:count], at
    except (IndexError, OverflowError) as error:
        raise ValueError("the times of a chunk are cut short") from error


def _runs(data: bytes, at: int, count: int, size: int, bits: int) -> tuple[NDArray[np.uint32], int]:
    """Values and the lengths of their runs, in words of ``size`` bytes with ``bits`` bits for the length."""
    values: list[int] = []
    lengths: list[int] = []
    full, done = (1 << bits) - 1, 0
    while done < count:
        word = int.from_bytes(data[at : at + size], "little")
        at += size
        length = word & full
        if length == full:
            length = int.from_bytes(data[at : at + 2], "little")
            at += 2
        if at > len(data):
            raise ValueError("a chunk is cut short")
        values.append(word >> bits)
        lengths.append(length)
        done += length
        if not length:
            raise ValueError("a run of no events")
    return np.repeat(np.array(values, np.uint32), lengths)[:count], at


def _masked(data: bytes, at: int, count: int) -> tuple[NDArray[Any], int]:
    words = np.frombuffer(data[at : at + 2 * min(count, (len(data) - at) // 2)], "<u2").astype(np.uint32)
    fired = np.ones((len(words), 6), bool)
    fired[:, 1:] = words[:, None] >> np.arange(4, -1, -1) & 1
    ends = np.cumsum(fired.sum(axis=1))
    used = int(np.searchsorted(ends, count)) + 1
    if count and (not len(ends) or ends[-1] < count):
        raise ValueError("a chunk is cut short")
    word, column = np.nonzero(fired[: used if count else 0])
    return ((words[word] >> 5) + column.astype(np.uint32))[:count], at + 2 * (used if count else 0)
