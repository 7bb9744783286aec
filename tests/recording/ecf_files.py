"""Prophesee's ECF compression, written from the layout: all runs, or places packed."""

from __future__ import annotations

import struct
from itertools import groupby
from pathlib import Path

import h5py
import numpy as np

from evqr.events.array import EventArray

DTYPE = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
MODES = {"runs": 0, "x and p packed": 1, "all packed": 2}


def _runs(values, bits: int, code: str) -> bytes:
    out, full = b"", (1 << bits) - 1
    for value, same in groupby(values):
        n = len(list(same))
        out += struct.pack(code, value << bits | min(n, full)) + (struct.pack("<H", n) if n >= full else b"")
    return out


def _times(t: list[int]) -> bytes:
    out, now = struct.pack("<Q", t[0]), t[0]
    for value, same in groupby(t):
        n, step = len(list(same)), value - now
        now = value
        if step >= 15:
            while step:
                out += bytes([0xF0 | step & 15])
                step >>= 4
        out += bytes([step << 4 | min(n, 15)]) + (struct.pack("<H", n) if n >= 15 else b"")
    return out


def _masked(x: list[int]) -> bytes:
    out, i = b"", 0
    while i < len(x):
        first, mask = x[i], 0
        i += 1
        while i < len(x) and 0 < x[i] - first <= 5 and not mask & ((1 << (6 - x[i] + first)) - 1):
            mask |= 1 << (5 - x[i] + first)
            i += 1
        out += struct.pack("<H", first << 5 | mask)
    return out


def _packed(values: list[int], bits: int, code: str) -> bytes:
    """Four values of so many bits in three words of two thirds more."""
    values = values + [0] * (-len(values) % 4)
    word = bits * 4 // 3
    out = b""
    for a, b, c, d in zip(*(iter(values),) * 4, strict=True):
        share = word - bits
        words = a << share | b & (1 << share) - 1, (b >> share) << 2 * share | c & (1 << 2 * share) - 1
        out += struct.pack(code * 3, *words, (c >> 2 * share) << bits | d)
    return out


def encode(events: EventArray, mode: int) -> bytes:
    """One chunk."""
    t, x, y, p = (column.tolist() for column in (events.t, events.x, events.y, (events.p > 0).astype(int)))
    out = struct.pack("<I", len(events) << 2 | mode) + _times(t)
    if mode == 2:
        return out + _packed([b << 12 | a << 1 | c for a, b, c in zip(x, y, p, strict=True)], 24, "I")
    out += _runs(y, 5, "<H")
    if mode == 1:
        return out + _packed([a << 1 | c for a, c in zip(x, p, strict=True)], 12, "H")
    return out + _masked(x) + _runs(p, 7, "<B")


def write_ecf(path: Path, events: EventArray, mode: int, chunk: int) -> None:
    """A file as the vendor's tools write it."""
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = f"{events.width}x{events.height}"
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk((chunk,))
        creation.set_filter(0x8ECF, h5py.h5z.FLAG_OPTIONAL)
        space = h5py.h5s.create_simple((len(events),))
        group = file.create_group("CD")
        dataset = h5py.h5d.create(group.id, b"events", h5py.h5t.py_create(DTYPE), space, creation)
        for i in range(0, len(events), chunk):
            dataset.write_direct_chunk((i,), encode(events.cut(i, i + chunk), mode))
