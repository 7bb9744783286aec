"""Prophesee DAT, versions 1 and 2, decoded here: records of eight bytes, each an event.

eventcv takes a DAT file as a whole, whatever type of events its header tells.  The layout is that of openeb's
``dat_tools``: after the header lines a byte for the type of the events and one for their length; then for
each 32 bits of time [us] and 32 bits that hold x, y and the polarity.
"""

from __future__ import annotations

import os

import numpy as np

from ..errors import RecordingError
from .declared import DeclaredSensor, DeclaredUnit, Unclear
from .faults import Faults
from .source import RawChunks, RawColumns, Source

TYPE_BYTES = 2
RECORD = np.dtype([("t", "<u4"), ("place", "<u4")])
TIME_LOOP_US = 1 << 32  # 72 minutes

CD_TYPES = (0x00, 0x0C)
OTHER_TYPES = {0x0E: "external triggers", 0x0D: "IMU samples", 0x05: "grey levels", 0x0B: "grey levels"}

BITS = {1: (9, 8), 2: (14, 14)}  # of x and of y, by version; the polarity is the next bit


class DatSource(Source):
    """A DAT file of CD events."""

    def __init__(
        self, path: str, header_bytes: int, version: int, sensor: DeclaredSensor | Unclear | None
    ) -> None:
        if version not in BITS:
            raise RecordingError(
                f"{path}: DAT version {version} is not known (1 and 2 are); export it as version 2"
            )
        with open(path, "rb") as file:
            file.seek(header_bytes)
            type_and_length = file.read(TYPE_BYTES)
        if len(type_and_length) < TYPE_BYTES:
            raise RecordingError(f"{path}: truncated: nothing after the header; copy the file again")
        kind, length = type_and_length
        if kind not in CD_TYPES or length != RECORD.itemsize:
            what = OTHER_TYPES.get(kind, "events of an unknown type")
            raise RecordingError(
                f"{path}: no event stream in this file: DAT event type {kind} ({what}) of {length} bytes, and"
                " CD events are read: type 0 or 12 of 8 bytes; export the CD events"
            )
        self._start = header_bytes + TYPE_BYTES
        self._bits = BITS[version]
        super().__init__(
            path,
            "Prophesee DAT" if version == 2 else f"Prophesee DAT version {version}",
            sensor=sensor,
            n_events=(os.path.getsize(path) - self._start) // RECORD.itemsize,
            unit=DeclaredUnit("us", "the format is in us"),
        )

    def raw_chunks(self, chunk_events: int, faults: Faults) -> RawChunks:
        """Take ``chunk_events`` records at a time."""
        x_bits, y_bits = self._bits
        rest = (os.path.getsize(self.name) - self._start) % RECORD.itemsize
        before: int | None = None
        loops = 0
        with open(self.name, "rb") as file:
            file.seek(self._start)
            while data := file.read(chunk_events * RECORD.itemsize):
                records = np.frombuffer(data[: len(data) - len(data) % RECORD.itemsize], RECORD)
                if not len(records):
                    break
                t, place = records["t"].astype(np.int64), records["place"]
                # The clock has 32 bits: a step back by more than half of that is its next turn, and one
                # forward by as much an event that came late from the turn before.
                steps = np.diff(t, prepend=t[0] if before is None else before)
                turn = (steps < -TIME_LOOP_US // 2).astype(np.int64) - (steps > TIME_LOOP_US // 2)
                turns = loops + np.cumsum(turn)
                before, loops = int(t[-1]), int(turns[-1])
                yield RawColumns(
                    t + turns * TIME_LOOP_US,
                    (place & ((1 << x_bits) - 1)).astype(np.uint16),
                    ((place >> x_bits) & ((1 << y_bits) - 1)).astype(np.uint16),
                    ((place >> (x_bits + y_bits)) & 1).astype(np.uint8),
                )
        if rest:
            faults.cut(f"{rest} byte{'s' * (rest != 1)} after the last whole record of {RECORD.itemsize}")
