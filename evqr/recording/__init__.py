"""Open, check, stream and save event recordings.

`open_recording` recognises the format by its content, never by the name.  Data flow: a `source.Source` of one
format family gives raw columns, `columns` checks and converts them, `ordering` puts them in order of time,
`stream.Recording` hands them out.
"""

from .declared import TimeUnit
from .faults import EventCounts
from .opening import open_recording
from .options import RecordingOptions
from .stream import Recording
from .summary import RecordingInfo, summarise
from .writing import convert_recording, save_recording

__all__ = [
    "EventCounts",
    "Recording",
    "RecordingInfo",
    "RecordingOptions",
    "TimeUnit",
    "convert_recording",
    "open_recording",
    "save_recording",
    "summarise",
]
