"""Write Prophesee RAW (EVT3) and AEDAT4.

EVT3 is encoded here: eventcv, which writes it too, says nothing of the time where there are no events, so
that readers lose turns of the clock, which has 24 bits.  AEDAT4 packets are eventcv's (extra ``formats``),
which writes a file of one packet for each chunk; here the packets are joined.
"""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

import numpy as np

from evqr.events.array import EventArray

from ..errors import UsageError
from .extras import required
from .writers import Truth, Writer

EVT3_SIDE = 1 << 11
EVT3_TURN_US = 1 << 24
ADDRESS_Y, ADDRESS_X, TIME_LOW, TIME_HIGH = 0x0 << 12, 0x2 << 12, 0x6 << 12, 0x8 << 12

AEDAT4_MAGIC = b"#!AER-DAT4.0\r\n"
TABLE_POSITION_SLOT = 6  # of dataTablePosition in the vtable of the IOHeader, a FlatBuffer
PACKET_EVENTS = 1 << 16


class Evt3Writer(Writer):
    """Words of 16 bits: high and low bits of the time and y, each when it changes; x with the polarity."""

    def __init__(self, path: Path, width: int, height: int) -> None:
        super().__init__(path, width, height)
        if max(width, height) > EVT3_SIDE:
            raise UsageError(f"EVT3 has room for {EVT3_SIDE}x{EVT3_SIDE} pixels, not for {width}x{height}")
        self._file = open(path, "wb")
        size = f"% format EVT3;height={height};width={width}\n% geometry {width}x{height}\n"
        self._file.write(f"% evt 3.0\n{size}% end\n".encode())
        self._start_us: int | None = None
        self._high = self._low = self._y = -1

    def write(self, events: EventArray) -> None:
        """Append events."""
        if self._start_us is None:
            self._start_us = int(events.t[0]) // EVT3_TURN_US * EVT3_TURN_US
            if self._start_us:
                self.notes.append(
                    f"EVT3 has no room for such times: they are put {self._start_us:,} us earlier"
                )
        t = events.t - self._start_us
        high, low, y = t >> 12, t & 0xFFF, events.y.astype(np.int64)
        steps = np.diff(high, prepend=self._high)
        turns = np.diff(high >> 12, prepend=max(self._high, 0) >> 12)
        words = 2 * turns + (steps > 0)
        new_low = (np.diff(low, prepend=self._low) != 0) | (steps > 0)
        new_y = np.diff(y, prepend=self._y) != 0
        self._high, self._low, self._y = int(high[-1]), int(low[-1]), int(y[-1])

        ends = np.cumsum(words + new_low + new_y + 1)
        out = np.empty(int(ends[-1]), np.uint16)
        out[ends - 1] = ADDRESS_X | (events.p > 0).astype(np.int64) << 11 | events.x
        out[(ends - 2)[new_y]] = ADDRESS_Y | y[new_y]
        out[(ends - 2 - new_y)[new_low]] = TIME_LOW | low[new_low]
        at = ends - 2 - new_y - new_low
        out[at[steps > 0]] = TIME_HIGH | high[steps > 0] & 0xFFF
        # Readers count turns of the clock where it goes from its last step to its first.
        for i in np.flatnonzero(turns):
            out[at[i] - 2 * turns[i] : at[i]] = [TIME_HIGH | 0xFFF, TIME_HIGH] * int(turns[i])
        self._file.write(out.astype("<u2").tobytes())

    def finish(self, truth: Truth) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Aedat4Writer(Writer):
    """Packets as eventcv writes them, one after the other, without the table that may follow."""

    def __init__(self, path: Path, width: int, height: int) -> None:
        super().__init__(path, width, height)
        self._eventcv = required("eventcv", str(path), "writing AEDAT4")
        self._folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-")
        self._file = open(path, "wb")

    def write(self, events: EventArray) -> None:
        """Append events."""
        for i in range(0, len(events), PACKET_EVENTS):
            self._write_packets(events.cut(i, i + PACKET_EVENTS))

    def _write_packets(self, events: EventArray) -> None:
        table = np.stack([events.x, events.y, events.t, events.p > 0], axis=1).astype(np.int64)
        size = self.width, self.height
        piece = Path(self._folder.name) / "piece.aedat4"
        stream = self._eventcv.from_numpy(table, sensor_size=size, time_unit="us")
        self._eventcv.save(stream, str(piece))
        data = bytearray(piece.read_bytes())
        (length,) = struct.unpack_from("<I", data, len(AEDAT4_MAGIC))
        start = len(AEDAT4_MAGIC) + 4 + length
        slot = _table_position_slot(data)
        (end,) = struct.unpack_from("<q", data, slot) if slot else (len(data),)
        if self._file.tell() == 0:
            if slot:
                struct.pack_into("<q", data, slot, -1)
            self._file.write(data[:start])
        self._file.write(data[start : end if 0 < end <= len(data) else len(data)])

    def finish(self, truth: Truth) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file, and remove the last piece."""
        self._file.close()
        self._folder.cleanup()


def _table_position_slot(head: bytes | bytearray) -> int:
    """Where in the IOHeader the position of the table of packets stands; 0 if nowhere."""
    base = len(AEDAT4_MAGIC) + 4  # after the length of the IOHeader
    table = base + struct.unpack_from("<I", head, base)[0]
    vtable = table - struct.unpack_from("<i", head, table)[0]
    (field,) = struct.unpack_from("<H", head, vtable + TABLE_POSITION_SLOT)
    return table + field if field else 0
