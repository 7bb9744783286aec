"""Make the data set: one HDF5 file a scene, a manifest, a card, checksums."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from evqr.errors import RecordingError
from evqr.paper.dataset.card import CARD, card_of
from evqr.paper.dataset.frames import render_frames
from evqr.paper.dataset.manifest import Entry, save_manifest, write_atomically
from evqr.paper.dataset.scenes import LEVEL, VERSION, SceneSpec
from evqr.recording.writing import save_recording
from evqr.simulate import simulate_scene
from evqr.simulate.printed import make_symbol

SUMS = "SHA256SUMS"

MAKER = 1
"""Raised when a scene made from the same specification would be another one."""


def make_dataset(
    folder: Path,
    specs: Iterable[SceneSpec],
    *,
    executor: Executor | None = None,
    progress: Callable[[str], object] | None = None,
) -> list[Entry]:
    """Make the scenes that are not there yet, then manifest, card and checksums.

    A scene's file appears when it is whole, so a run that was interrupted goes on where it was.

    Parameters
    ----------
    folder : Path
        Where the recordings and the manifest go.
    specs : iterable of SceneSpec
        What is to be made.
    executor : Executor, optional
        Any `concurrent.futures.Executor`; None: in this thread.
    progress : callable, optional
        Called with the name of each scene that is done.

    Raises
    ------
    RecordingError
        A file cannot be written.
    UsageError
        A text does not fit its code.
    """
    specs = list(specs)
    for spec in specs:  # before an hour of work is done
        make_symbol(*spec.scene.codes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        make = partial(make_scene, folder)
        for spec, _ in zip(
            specs, map(make, specs) if executor is None else executor.map(make, specs), strict=True
        ):
            if progress is not None:
                progress(spec.name)
        entries = [entry_of(spec) for spec in specs]
        save_manifest(folder, entries)
        write_atomically(folder / CARD, card_of(specs))
        names = [*(entry.recording for entry in entries), CARD, "manifest.json"]
        sums = "".join(f"{_sha256(folder / name)}  {name}\n" for name in names)
        write_atomically(folder / SUMS, sums)
    except OSError as error:
        raise RecordingError(
            f"{folder}: cannot be written ({error.strerror or error}); choose another place"
        ) from error
    return entries


def make_scene(folder: Path, spec: SceneSpec) -> None:
    """Make one scene's file, unless it is there and made from the same."""
    import h5py

    path = folder / entry_of(spec).recording
    made_from = json.dumps({"maker": MAKER, **asdict(spec)}, sort_keys=True)
    if path.exists():
        with contextlib.suppress(OSError), h5py.File(path) as file:  # a damaged one is made anew
            if file.attrs.get("made_from") == made_from:
                return
    made = simulate_scene(spec.scene, spec.kind.sensor, threads=1)
    t_us, frames = render_frames(spec.scene, spec.kind.camera)
    part = path.with_name(f".{path.name}.{os.getpid()}.h5")
    save_recording(part, made.events, truth=made.truth)
    with h5py.File(part, "a") as file:
        file.attrs["made_from"] = made_from
        group = file.create_group("frames")
        group.create_dataset("t", data=t_us)
        group.create_dataset("image", data=frames, chunks=(1, *frames.shape[1:]), compression="gzip")
        group.attrs["exposure_us"] = spec.kind.camera.exposure_us
    os.replace(part, path)


def entry_of(spec: SceneSpec) -> Entry:
    """Return what the manifest says of a scene."""
    return Entry(
        name=spec.name,
        scene=spec.kind.name,
        angle=spec.angle,
        recording=f"{spec.name}.h5",
        text=spec.text,
        version=VERSION,
        level=LEVEL,
        window_us=spec.kind.window_us,
        start_us=0,
        end_us=spec.windows * spec.kind.window_us,
    )


def _sha256(path: Path) -> str:
    digest: Any = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
