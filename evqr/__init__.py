"""Read 2-D codes from event cameras.

>>> import evqr
>>> for reading in evqr.read_codes("recording.h5").readings:
...     print(reading.text)

Importing the package loads no backend, no decoder and no file library: each name below is imported when it
is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evqr import simulate
    from evqr.config import ReadConfig, Vote
    from evqr.errors import EvqrError, MissingExtra, RecordingError, UsageError
    from evqr.events.array import EventArray
    from evqr.many import read_many
    from evqr.offline import read_codes, read_windows
    from evqr.output.picture import draw_reading
    from evqr.recording import Recording, RecordingInfo, open_recording, save_recording, summarise
    from evqr.results import CodeReading, ReadResult, ReadStatus, WindowReading
    from evqr.solver import Solver

__all__ = [
    "CodeReading",
    "EventArray",
    "EvqrError",
    "MissingExtra",
    "ReadConfig",
    "ReadResult",
    "ReadStatus",
    "Recording",
    "RecordingError",
    "RecordingInfo",
    "Solver",
    "UsageError",
    "Vote",
    "WindowReading",
    "draw_reading",
    "open_recording",
    "read_codes",
    "read_many",
    "read_windows",
    "save_recording",
    "simulate",
    "summarise",
]

_HOME = {
    "evqr.config": ("ReadConfig", "Vote"),
    "evqr.errors": ("EvqrError", "MissingExtra", "RecordingError", "UsageError"),
    "evqr.many": ("read_many",),
    "evqr.output.picture": ("draw_reading",),
    "evqr.offline": ("read_codes", "read_windows"),
    "evqr.recording": ("Recording", "RecordingInfo", "open_recording", "save_recording", "summarise"),
    "evqr.solver": ("Solver",),
    "evqr.events.array": ("EventArray",),
    "evqr.results": ("CodeReading", "ReadResult", "ReadStatus", "WindowReading"),
}
_HOME_OF = {name: module for module, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("evqr")
    if name == "simulate":
        return importlib.import_module("evqr.simulate")
    if name not in _HOME_OF:
        raise AttributeError(f"module 'evqr' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
