"""Small recordings of the vendor formats, written by eventcv."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evqr.events.array import EventArray

# name: (suffix and format that eventcv wants, what evqr calls it, the package that decodes it, if any)
FORMATS: dict[str, tuple[str, str | None, str, str | None]] = {
    "evt2": (".raw", "evt2", "Prophesee EVT2", None),
    "evt3": (".raw", "evt3", "Prophesee EVT3", "evt3"),
    "dat": (".dat", None, "Prophesee DAT", None),
    "aedat4": (".aedat4", None, "AEDAT4", "aedat"),
    "bag": (".bag", None, "ROS bag dvs_msgs/EventArray on /davis/left/events", "rosbags"),
}


def write(kind: str, path: Path, events: EventArray) -> None:
    import eventcv

    suffix, encoding, _, _ = FORMATS[kind]
    table = np.stack([events.x, events.y, events.t, events.p > 0], axis=1).astype(np.int64)
    stream = eventcv.from_numpy(table, sensor_size=(events.width, events.height), time_unit="us")
    written = path.with_name(f"written{suffix}")
    eventcv.save(stream, str(written), format=encoding)
    written.replace(path)
