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
    from evqr.config import (
        AlignConfig,
        DecodeConfig,
        EdgeConfig,
        FinderConfig,
        FinderPass,
        JobConfig,
        LagConfig,
        LineConfig,
        ModulesConfig,
        MotionConfig,
        ReadConfig,
        SchedulerConfig,
        TrackConfig,
        TriggerConfig,
        Vote,
    )
    from evqr.errors import BackendError, EvqrError, MissingExtra, RecordingError, StreamChoice, UsageError
    from evqr.events.array import EventArray
    from evqr.events.batch import EventBatch
    from evqr.events.buffer import EventBuffer
    from evqr.events.packed import PackedEvents
    from evqr.events.window import Window
    from evqr.fit.detection import Detection, NotFound, Target
    from evqr.fit.modules import CodeEstimate, Fused, NormalEquations
    from evqr.grade import Grade, GradedPart
    from evqr.line.aio import AsyncReader
    from evqr.line.group import ReaderGroup
    from evqr.line.reader import Reader
    from evqr.line.records import (
        ClockRecord,
        GapRecord,
        LineRecord,
        OverloadRecord,
        PartRecord,
        ReadRecord,
    )
    from evqr.many import read_many
    from evqr.motion import Motion
    from evqr.offline import read_codes, read_windows
    from evqr.output.picture import draw_reading
    from evqr.reason import Reason
    from evqr.recording import (
        EventCounts,
        Recording,
        RecordingInfo,
        RecordingOptions,
        TimeUnit,
        convert_recording,
        open_recording,
        save_recording,
        summarise,
    )
    from evqr.results import CodeReading, ReadResult, ReadStatus, WindowCode, WindowReading
    from evqr.search.motion_estimate import MotionEstimate, QuietSpells
    from evqr.seen import Candidate, Nearest, Statistics
    from evqr.solver import Solver
    from evqr.symbol.gs1 import Gs1Element
    from evqr.symbol.messages import Message, join_messages
    from evqr.symbol.payload import CharsetSource, ContentType, Payload, StructuredAppend
    from evqr.symbol.space import Anchor, CodeSpace, Landmark
    from evqr.symbology import Symbology

    __version__: str

__all__ = [
    "AlignConfig",
    "Anchor",
    "AsyncReader",
    "BackendError",
    "Candidate",
    "CharsetSource",
    "ClockRecord",
    "CodeEstimate",
    "CodeReading",
    "CodeSpace",
    "ContentType",
    "DecodeConfig",
    "Detection",
    "EdgeConfig",
    "EventArray",
    "EventBatch",
    "EventBuffer",
    "EventCounts",
    "EvqrError",
    "FinderConfig",
    "FinderPass",
    "Fused",
    "GapRecord",
    "Grade",
    "GradedPart",
    "Gs1Element",
    "JobConfig",
    "LagConfig",
    "Landmark",
    "LineConfig",
    "LineRecord",
    "Message",
    "MissingExtra",
    "ModulesConfig",
    "Motion",
    "MotionConfig",
    "MotionEstimate",
    "Nearest",
    "NormalEquations",
    "NotFound",
    "OverloadRecord",
    "PackedEvents",
    "PartRecord",
    "Payload",
    "QuietSpells",
    "ReadConfig",
    "ReadRecord",
    "ReadResult",
    "ReadStatus",
    "Reader",
    "ReaderGroup",
    "Reason",
    "Recording",
    "RecordingError",
    "RecordingInfo",
    "RecordingOptions",
    "SchedulerConfig",
    "Solver",
    "Statistics",
    "StreamChoice",
    "StructuredAppend",
    "Symbology",
    "Target",
    "TimeUnit",
    "TrackConfig",
    "TriggerConfig",
    "UsageError",
    "Vote",
    "Window",
    "WindowCode",
    "WindowReading",
    "convert_recording",
    "draw_reading",
    "join_messages",
    "open_recording",
    "read_codes",
    "read_many",
    "read_windows",
    "save_recording",
    "simulate",
    "summarise",
]

_HOME = {
    "evqr.config": (
        "AlignConfig",
        "DecodeConfig",
        "EdgeConfig",
        "FinderConfig",
        "FinderPass",
        "JobConfig",
        "LagConfig",
        "LineConfig",
        "ModulesConfig",
        "MotionConfig",
        "ReadConfig",
        "SchedulerConfig",
        "TrackConfig",
        "TriggerConfig",
        "Vote",
    ),
    "evqr.errors": (
        "BackendError",
        "EvqrError",
        "MissingExtra",
        "RecordingError",
        "StreamChoice",
        "UsageError",
    ),
    "evqr.events.array": ("EventArray",),
    "evqr.events.batch": ("EventBatch",),
    "evqr.events.buffer": ("EventBuffer",),
    "evqr.events.packed": ("PackedEvents",),
    "evqr.events.window": ("Window",),
    "evqr.fit.detection": (
        "Detection",
        "NotFound",
        "Target",
    ),
    "evqr.fit.modules": (
        "CodeEstimate",
        "Fused",
        "NormalEquations",
    ),
    "evqr.grade": ("Grade", "GradedPart"),
    "evqr.line.aio": ("AsyncReader",),
    "evqr.line.group": ("ReaderGroup",),
    "evqr.line.reader": ("Reader",),
    "evqr.line.records": (
        "ClockRecord",
        "GapRecord",
        "LineRecord",
        "OverloadRecord",
        "PartRecord",
        "ReadRecord",
    ),
    "evqr.many": ("read_many",),
    "evqr.motion": ("Motion",),
    "evqr.offline": (
        "read_codes",
        "read_windows",
    ),
    "evqr.output.picture": ("draw_reading",),
    "evqr.reason": ("Reason",),
    "evqr.recording": (
        "EventCounts",
        "Recording",
        "RecordingInfo",
        "RecordingOptions",
        "TimeUnit",
        "convert_recording",
        "open_recording",
        "save_recording",
        "summarise",
    ),
    "evqr.results": ("CodeReading", "ReadResult", "ReadStatus", "WindowCode", "WindowReading"),
    "evqr.search.motion_estimate": ("MotionEstimate", "QuietSpells"),
    "evqr.seen": ("Candidate", "Nearest", "Statistics"),
    "evqr.solver": ("Solver",),
    "evqr.symbol.gs1": ("Gs1Element",),
    "evqr.symbol.messages": (
        "Message",
        "join_messages",
    ),
    "evqr.symbol.payload": (
        "CharsetSource",
        "ContentType",
        "Payload",
        "StructuredAppend",
    ),
    "evqr.symbol.space": (
        "Anchor",
        "CodeSpace",
        "Landmark",
    ),
    "evqr.symbology": ("Symbology",),
}
_HOME_OF = {name: module for module, names in _HOME.items() for name in names}


def _value(name: str) -> Any:
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


if not TYPE_CHECKING:
    __getattr__ = _value  # a type checker would take it that there is every name


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
