"""Writers of recordings, a chunk at a time: HDF5 in the layout ``events/{t,x,y,p}``, npz and text."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np

from evqr.events.array import EventArray

CHUNK_EVENTS = 1 << 16
COLUMNS = {
    "t": np.dtype(np.int64),
    "x": np.dtype(np.uint16),
    "y": np.dtype(np.uint16),
    "p": np.dtype(np.int8),
}

Truth = Mapping[str, Mapping[str, Any]]


class Writer(ABC):
    """Writes one file of one format.

    Parameters
    ----------
    path : Path
        The file; it is made anew.
    width, height : int [px]
        Sensor size.

    Attributes
    ----------
    notes : list of str
        What the format could not keep, each in one line.
    keeps_truth : bool
        Whether the format has a place for the truth of simulated codes.
    """

    keeps_truth: ClassVar[bool] = False

    def __init__(self, path: Path, width: int, height: int) -> None:
        self.path, self.width, self.height = path, width, height
        self.notes: list[str] = []

    @abstractmethod
    def write(self, events: EventArray) -> None:
        """Append events, which follow on those before in time."""

    @abstractmethod
    def finish(self, truth: Truth) -> None:
        """Write what stands at the end, and close the file."""

    def close(self) -> None:  # noqa: B027  (most writers hold nothing open)
        """Release files; harmless when called twice."""


class Hdf5Writer(Writer):
    """``events/{t,x,y,p}``, compressed, which grow."""

    keeps_truth = True

    def __init__(self, path: Path, width: int, height: int) -> None:
        import h5py

        super().__init__(path, width, height)
        self._file = h5py.File(path, "w")
        self._file.attrs["width"], self._file.attrs["height"] = width, height
        self._group = self._file.create_group("events")

    def write(self, events: EventArray) -> None:
        """Append events."""
        for name, values in _columns(events).items():
            if name not in self._group:
                self._create(name, min(CHUNK_EVENTS, max(len(events), 1)))
            dataset: Any = self._group[name]
            before = len(dataset)
            dataset.resize(before + len(values), axis=0)
            dataset[before:] = values

    def _create(self, name: str, chunk: int) -> None:
        self._group.create_dataset(
            name, (0,), COLUMNS[name], maxshape=(None,), chunks=(chunk,), compression="gzip", shuffle=True
        )

    def finish(self, truth: Truth) -> None:
        """Write the unit and the truth."""
        for name in COLUMNS:
            if name not in self._group:
                self._create(name, 1)
        self._group["t"].attrs["unit"] = "us"
        for code, fields in truth.items():
            group = self._file.create_group(code)
            for name, value in fields.items():
                if np.ndim(value) == 0:
                    group.attrs[name] = value
                else:
                    group.create_dataset(name, data=np.asarray(value))
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class NpzWriter(Writer):
    """Columns in an .npz file, gathered in files of their own: an array tells its length first."""

    keeps_truth = True

    def __init__(self, path: Path, width: int, height: int) -> None:
        super().__init__(path, width, height)
        self._columns: dict[str, IO[bytes]] = {
            name: tempfile.TemporaryFile(dir=path.parent, prefix=f".{path.name}-") for name in COLUMNS
        }
        self._count = 0

    def write(self, events: EventArray) -> None:
        """Append events."""
        for name, values in _columns(events).items():
            self._columns[name].write(np.ascontiguousarray(values).data)
        self._count += len(events)

    def finish(self, truth: Truth) -> None:
        """Put the columns into the archive."""
        others = {"width": self.width, "height": self.height, "time_unit": "us"}
        others |= {
            f"{code}/{name}": value for code, fields in truth.items() for name, value in fields.items()
        }
        with zipfile.ZipFile(self.path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, file in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    header = {
                        "descr": np.lib.format.dtype_to_descr(COLUMNS[name]),
                        "fortran_order": False,
                        "shape": (self._count,),
                    }
                    np.lib.format.write_array_header_1_0(member, header)
                    file.seek(0)
                    shutil.copyfileobj(file, member, 1 << 20)
            for name, value in others.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(value), allow_pickle=False)
        self.close()

    def close(self) -> None:
        """Remove the gathered columns."""
        for file in self._columns.values():
            file.close()


class TextWriter(Writer):
    """A line an event, ``t x y p`` in us, with the sensor, the unit and the columns in comments before."""

    separator = " "

    def __init__(self, path: Path, width: int, height: int) -> None:
        super().__init__(path, width, height)
        self._file = open(path, "w", encoding="ascii", newline="\n")
        self._file.write(f"# geometry: {width}x{height}\n# time unit: us\n")
        self._file.write(f"# {self.separator.join(COLUMNS)}\n")

    def write(self, events: EventArray) -> None:
        """Append lines."""
        rows = np.stack([values.astype(np.int64) for values in _columns(events).values()], axis=1)
        np.savetxt(self._file, rows, "%d", self.separator)

    def finish(self, truth: Truth) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class CsvWriter(TextWriter):
    """The same with commas."""

    separator = ","


def _columns(events: EventArray) -> dict[str, np.ndarray]:
    # The int8 {0, 1} of the development recordings, which most readers take.
    return {"t": events.t, "x": events.x, "y": events.y, "p": (events.p > 0).astype(np.int8)}
