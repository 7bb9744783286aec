"""A folder of recordings and what is true of them: ``manifest.json``, written by `make` or by hand.

    {"scenes": [{"name": "belt-1", "scene": "belt", "angle": 30, "recording": "belt-1.raw",
                 "text": "LOT 42", "version": 2, "level": "H", "window_us": 250}]}

Each scene needs these fields.  Optional ones: ``mask`` (0 to 7) of the printed symbol, or its ``modules``
(rows of 0 and 1, 1 dark), where it was not printed by segno, whose choice is taken otherwise; ``start_us``
and ``end_us``, event times between which the whole code is in view; ``sensor`` ([width, height]) and
``time_unit`` where the recording does not tell them.  Frames of a camera are optional too: ``frames/image``
(N, Y, X) uint8 and ``frames/t`` (N,) [us] in the recording, if that is HDF5.
"""

from __future__ import annotations

import functools
import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.errors import UsageError
from evqr.events.array import EventArray
from evqr.events.window import Window, make_window
from evqr.paper.dataset.truth import Truth
from evqr.recording import open_recording
from evqr.symbol import qr

if TYPE_CHECKING:
    from evqr.recording import TimeUnit
    from evqr.symbol.qr_codewords import ErrorLevel

MANIFEST = "manifest.json"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One recording of a manifest.

    Attributes
    ----------
    name : str
        Of the recording, unique.
    scene : str
        Of the table: recordings of one scene at several angles make one block.
    angle : float [deg]
        Of the code against the direction of travel.
    recording : str
        File, relative to the manifest.
    text : str
        That the code says.
    version : int
        Of the symbol, 1 to 40.
    level : "L", "M", "Q" or "H"
        Error correction of the symbol.
    window_us : int [us]
        Length of a window.
    mask : int, optional
        Of the symbol; None: as segno chooses.
    modules : tuple of str, optional
        Of the symbol, rows of "0" and "1", 1 dark; None: segno's.
    start_us, end_us : int [us], optional
        Event times between which windows are taken; None: the first and the last.
    sensor : (int, int), optional
        (width, height) where the recording does not tell.
    time_unit : TimeUnit, optional
        Of the recording where it does not tell.
    """

    name: str
    scene: str
    angle: float
    recording: str
    text: str
    version: int
    level: ErrorLevel
    window_us: int
    mask: int | None = None
    modules: tuple[str, ...] | None = None
    start_us: int | None = None
    end_us: int | None = None
    sensor: tuple[int, int] | None = None
    time_unit: TimeUnit | None = None

    @functools.cached_property
    def _truth(self) -> Truth:
        import segno

        space = qr.space(self.version)
        if self.modules is not None:
            dark = np.array([[mark == "1" for mark in row] for row in self.modules])
        else:
            code = segno.make(
                self.text,
                version=self.version,
                error=self.level,
                mask=self.mask,
                micro=False,
                boost_error=False,
            )
            dark = np.array(code.matrix, bool)
        return Truth(text=self.text, modules=np.where(dark, -1, 1).astype(np.int8), known=space.known)

    def truth(self) -> Truth:
        """Return what is true of the code."""
        return self._truth


@dataclass(frozen=True, eq=False)
class Sequence:
    """A recording, ready for methods.

    Attributes
    ----------
    entry : Entry
        Its line in the manifest.
    truth : Truth
        What the code says.
    events : EventArray
        All of them.
    frames : (N, Y, X) uint8
        Of a camera; N is 0 without one.
    frame_t_us : (N,) int64 [us]
        Middles of their exposures.
    pose_t_us : (K,) int64 [us]
        Times of the true poses; K is 0 where they are not known.
    poses : (K, 3, 3) float64
        Code coordinates to px.
    """

    entry: Entry
    truth: Truth
    events: EventArray
    frames: NDArray[np.uint8]
    frame_t_us: NDArray[np.int64]
    pose_t_us: NDArray[np.int64]
    poses: NDArray[np.float64]

    @property
    def start_us(self) -> int:
        """Start of the first window [us]."""
        if self.entry.start_us is not None:
            return self.entry.start_us
        return int(self.events.t[0]) if len(self.events) else 0

    @property
    def windows(self) -> int:
        """How many windows follow one another."""
        end = self.entry.end_us
        if end is None:
            end = int(self.events.t[-1]) + 1 if len(self.events) else 0
        # the last window may end in silence: a few microseconds without an event make no window less
        return int((end - self.start_us) / self.entry.window_us + 0.5)

    def window(self, index: int, length: float = 1.0) -> Window:
        """Cut ``length`` windows out as one, from the ``index``-th on."""
        start = self.start_us + index * self.entry.window_us
        return make_window(self.events, start, start + round(length * self.entry.window_us))

    def pose_at(self, time_us: float) -> NDArray[np.float64] | None:
        """Give the true pose (3, 3) at a time, None where none is known."""
        if not len(self.poses):
            return None
        nearest = np.abs(self.pose_t_us - time_us).argmin()
        ahead = np.eye(3)
        ahead[:2, 2] = self.velocity * (time_us - self.pose_t_us[nearest])
        return ahead @ (self.poses[nearest] / self.poses[nearest, 2, 2])

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Mean velocity of the code's centre by its true poses (2,), 0 where none are known [px/us]."""
        if len(self.poses) < 2:
            return np.zeros(2)
        half = len(self.truth.modules) / 2.0
        ends = self.poses[[0, -1]] @ np.array([half, half, 1.0])
        began, ended = ends[:, :2] / ends[:, 2:]
        return (ended - began) / float(self.pose_t_us[-1] - self.pose_t_us[0])


def load_manifest(folder: Path) -> list[Entry]:
    """Read the manifest of a folder.

    Raises
    ------
    UsageError
        There is none, or it does not say what it must.
    """
    path = folder / MANIFEST
    try:
        scenes = json.loads(path.read_text(encoding="utf-8"))["scenes"]
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be read ({error.strerror}); make it with evqr dataset make"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{path}: is no manifest: it must be JSON with a list of scenes ({error})"
        ) from error
    entries = [_entry(path, scene) for scene in scenes]
    names = [entry.name for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"{path}: scene {name!r} is there twice; give each a name of its own")
    return entries


def _entry(path: Path, scene: dict[str, Any]) -> Entry:
    unknown = sorted(set(scene) - {field.name for field in fields(Entry)})
    where = f"{path}: scene {scene.get('name', '?')!r}"
    if unknown:
        raise UsageError(
            f"{where} has the unknown field {unknown[0]!r}; see the documentation of the manifest"
        )
    for field in ("modules", "sensor"):
        if scene.get(field) is not None:
            scene = {**scene, field: tuple(scene[field])}
    try:
        entry = Entry(**scene)
        size = qr.size_of(entry.version)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{where} is not complete: {error}") from error
    if entry.modules is not None and [len(row) for row in entry.modules] != [size] * size:
        raise UsageError(f"{where}: modules must be {size} rows of {size} marks for version {entry.version}")
    return entry


def save_manifest(folder: Path, entries: list[Entry]) -> None:
    """Write the manifest of a folder."""
    scenes = [
        {name: value for name, value in asdict(entry).items() if value is not None} for entry in entries
    ]
    write_atomically(folder / MANIFEST, json.dumps({"scenes": scenes}, indent=1) + "\n")


def write_atomically(path: Path, text: str) -> None:
    """Write a text file that is either whole or not there."""
    part = path.with_name(f".{path.name}.{os.getpid()}")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def load_sequence(folder: Path, entry: Entry) -> Sequence:
    """Read the events and frames of one recording into memory.

    Raises
    ------
    RecordingError
        The recording cannot be read.
    """
    path = folder / entry.recording
    with open_recording(path, sensor=entry.sensor, time_unit=entry.time_unit) as recording:
        chunks = list(recording.chunks())
        width, height = recording.width, recording.height
    empty = EventArray(
        np.empty(0, np.int64),
        np.empty(0, np.uint16),
        np.empty(0, np.uint16),
        np.empty(0, np.int8),
        width,
        height,
    )
    t, x, y, p = (np.concatenate([getattr(part, name) for part in [empty, *chunks]]) for name in "txyp")
    events = EventArray(t, x, y, p, width, height)
    return Sequence(entry, entry.truth(), events, *_frames_and_poses(path, events))


def _frames_and_poses(
    path: Path, events: EventArray
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Read what only recordings in HDF5 hold, and not all of them: frames and poses with their times."""
    import h5py

    frames = np.empty((0, events.height, events.width), np.uint8)
    frame_t_us, pose_t_us, poses = np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3, 3))
    if path.is_file() and h5py.is_hdf5(path):
        with h5py.File(path) as file:
            if "frames/image" in file:
                frames = np.asarray(file["frames/image"], np.uint8)
                frame_t_us = np.asarray(file["frames/t"], np.int64)
            if "truth/H" in file:
                pose_t_us, poses = (
                    np.asarray(file["truth/t_us"], np.int64),
                    np.asarray(file["truth/H"], np.float64),
                )
    return frames, frame_t_us, pose_t_us, poses
