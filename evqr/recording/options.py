"""What the user says about a recording, which goes before what the file says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypedDict

from ..errors import UsageError
from .declared import PER_SECOND, TimeUnit, parse_size

if TYPE_CHECKING:
    from .columns import Columns

DEFAULT_CHUNK_EVENTS = 1 << 20


class RecordingOptions(TypedDict, total=False):
    """Keywords of `open_recording`, which all that opens recordings takes and hands on.

    Attributes
    ----------
    sensor : (int, int) or str [px]
        Width and height, or a text such as "640x480"; where the source does not tell, or tells wrong.
    time_unit : "s", "ms", "us" or "ns"
        Unit of the stored times, where neither source nor numbers tell, or tell wrong.
    stream : str
        Which of several event streams: an HDF5 group, a topic of a bag, a stream of AEDAT4, an array of npz.
    columns : str or sequence of str
        What the columns of a table are, in their order, such as "t,x,y,p"; "-" for one that is not read.
    strict : bool
        Refuse a recording at the first event that is wrong, instead of leaving a few out.
    start_us, end_us : int [us]
        Read events with ``start_us <= t < end_us`` only, in the recording's own time.
    """

    sensor: tuple[int, int] | str | None
    time_unit: TimeUnit | None
    stream: str | None
    columns: str | Sequence[str] | None
    strict: bool
    start_us: int | None
    end_us: int | None


@dataclass(frozen=True, kw_only=True)
class Asked:
    """`RecordingOptions`, checked.

    Attributes
    ----------
    sensor : (int, int) [px], optional
        Width and height.
    time_unit : "s", "ms", "us" or "ns", optional
        Unit of the stored times.
    stream : str, optional
        Which of several event streams.
    columns : Columns, optional
        What the columns of a table are.
    strict : bool
        Whether the first event that is wrong is refused.
    start_us, end_us : int [us], optional
        Events with ``start_us <= t < end_us`` only.
    chunk_events : int
        About so many events a chunk.
    """

    sensor: tuple[int, int] | None = None
    time_unit: TimeUnit | None = None
    stream: str | None = None
    columns: Columns | None = None
    strict: bool = False
    start_us: int | None = None
    end_us: int | None = None
    chunk_events: int = field(default=DEFAULT_CHUNK_EVENTS)

    def __post_init__(self) -> None:
        if self.time_unit is not None and self.time_unit not in PER_SECOND:
            raise UsageError(f"time_unit {self.time_unit!r} is unknown; pass one of {', '.join(PER_SECOND)}")
        for name in ("start_us", "end_us"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, Integral)):
                raise TypeError(f"{name} must be a whole number or None, got {value!r}")
        if self.chunk_events < 1:
            raise ValueError(f"chunk_events must be at least 1, got {self.chunk_events}")
        if self.start_us is not None and self.end_us is not None and self.end_us <= self.start_us:
            raise UsageError(f"nothing lies from {self.start_us} us to {self.end_us} us; end after the start")


def checked(*, sensor: Any = None, columns: str | Sequence[str] | None = None, **others: Any) -> Asked:
    """Check what was asked for; raises `UsageError` for what makes no sense."""
    from .columns import parse_columns

    size = None
    if sensor is not None:
        size = parse_size(sensor)
        if size is None:
            raise UsageError(f"sensor {sensor!r} is no size; pass (640, 480) or '640x480'")
    return Asked(sensor=size, columns=None if columns is None else parse_columns(columns), **others)


def check_names(call: str, opening: Mapping[str, Any]) -> None:
    """Refuse keywords that `open_recording` does not take, in the name of the call that was made.

    Parameters
    ----------
    call : str
        Name of the function.
    opening : mapping
        Its keywords that are handed on.

    Raises
    ------
    TypeError
        One of them is unknown; for a setting, with where it goes.
    """
    from ..config import ReadConfig

    for name in opening:
        if name == "chunk_events" or name in RecordingOptions.__annotations__:
            continue
        setting = f"; pass config=ReadConfig({name}=...)" if name in ReadConfig.__dataclass_fields__ else ""
        raise TypeError(f"{call}() got an unexpected keyword argument {name!r}{setting}")
