"""What of an HDF5 file is there: files that are being written, and files that were cut short.

HDF5 gives zeros for what was never written, and refuses a file that is shorter than its header says as a
whole.  A cut file is opened as if zeros followed; the places of all stored pieces are known, so those that
reach behind its true end are left out.
"""

from __future__ import annotations

import io
import os
from typing import Any, NamedTuple

import h5py

from .source import explained


class Opened(NamedTuple):
    """An open file.

    Attributes
    ----------
    file : h5py.File
        To read from.
    end : int or None
        Bytes that are there of a file that was cut short; None for a whole one.
    notes : tuple of str
        What was odd about it.
    """

    file: h5py.File
    end: int | None = None
    notes: tuple[str, ...] = ()


def open_file(path: str) -> Opened:
    """Open a file, also one that is being written in the way that lets others read (SWMR), or was cut short.

    Raises
    ------
    RecordingError
        It is no HDF5 file, in use, or so damaged that nothing in it can be found.
    """
    with explained(path, "HDF5 file"):
        try:
            return Opened(h5py.File(path, "r"))
        except OSError as error:
            if "h5clear" in str(error):
                try:
                    file = h5py.File(path, "r", swmr=True)
                except OSError:
                    raise error from None
                return Opened(
                    file, notes=("the file is marked as being written (SWMR); what is in it now is read",)
                )
            if "truncated file" not in str(error):
                raise
            try:
                # not the name, but a file-like object: HDF5 asks that how long it is
                return Opened(h5py.File(_Padded(path), "r"), os.path.getsize(path))
            except Exception:
                raise error from None


class _Padded(io.RawIOBase):
    """A file with zeros behind its end, without an end that HDF5 could miss."""

    def __init__(self, path: str) -> None:
        self._file = open(path, "rb", buffering=0)
        self._at = 0

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: 1 << 60}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        self._file.seek(self._at)
        count = self._file.readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        self._at += len(view)
        return len(view)

    def close(self) -> None:
        self._file.close()
        super().close()


def rows_stored(dataset: h5py.Dataset, along: int, declared: int, end: int | None) -> int:
    """Count the events from the first on whose storage is there.

    Parameters
    ----------
    dataset : h5py.Dataset
        Whose.
    along : int
        Axis along which events follow one another.
    declared : int
        Events that it should have.
    end : int or None
        Bytes of the file that are there; None: all.
    """
    layout = dataset.id.get_create_plist().get_layout()
    if dataset.is_virtual or declared == 0 or layout == h5py.h5d.COMPACT:
        return declared
    if dataset.chunks:
        return min(_chunked_rows(dataset, dataset.chunks, along, declared, end), declared)
    stored = dataset.id.get_storage_size()
    if end is not None and (start := dataset.id.get_offset()) is not None:
        stored = min(stored, max(end - start, 0))
    whole = int(dataset.size or 0) * dataset.dtype.itemsize
    if along == 0:
        return min(stored * declared // whole, declared)
    return declared if stored >= whole else 0


def _chunked_rows(
    dataset: h5py.Dataset, chunks: tuple[int, ...], along: int, declared: int, end: int | None
) -> int:
    step, across = chunks[along], 1
    if dataset.ndim == 2:
        across = -(-dataset.shape[1 - along] // chunks[1 - along])
    count = dataset.id.get_num_chunks()
    if end is None and count * step >= declared * across:
        return declared
    starts: dict[int, int] = {}
    for i in range(count):
        chunk = dataset.id.get_chunk_info(i)
        if end is None or chunk.byte_offset + chunk.size <= end:
            start = chunk.chunk_offset[along]
            starts[start] = starts.get(start, 0) + 1
    done = 0
    while starts.get(done) == across:
        done += step
    return done
