"""Write recordings: which writer a name asks for, from memory or from another recording, in bounded memory.

A file takes its place when it is complete: one that was there before stays as it was until then.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evqr.events.array import EventArray

from ..errors import EvqrError, RecordingError, UsageError
from .opening import open_recording
from .options import RecordingOptions
from .stream import Recording
from .vendor_writers import Aedat4Writer, Evt3Writer
from .writers import CsvWriter, Hdf5Writer, NpzWriter, TextWriter, Truth, Writer

if TYPE_CHECKING:
    from typing_extensions import Unpack

Progress = Callable[[int, int | None], None]


def writer_of(path: str | os.PathLike[str], *, truth: bool = False) -> type[Writer]:
    """Return what writes a recording of this name, with its truth if there is one to keep.

    Raises
    ------
    UsageError
        For a suffix that is not written, or of a format without a place for the truth.
    """
    writers: dict[str, type[Writer]] = {
        **dict.fromkeys((".h5", ".hdf5"), Hdf5Writer),
        ".npz": NpzWriter,
        ".raw": Evt3Writer,
        ".aedat4": Aedat4Writer,
        ".txt": TextWriter,
        ".csv": CsvWriter,
    }
    if truth:
        writers = {suffix: writer for suffix, writer in writers.items() if writer.keeps_truth}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        with_truth = " with their truth" if truth else ""
        raise UsageError(
            f"{path}: recordings are written{with_truth} as {', '.join(writers)}; end the name in one of them"
        )
    return writers[suffix]


def save_recording(
    path: str | os.PathLike[str],
    events: Any,
    *,
    truth: Truth | None = None,
    **opening: Unpack[RecordingOptions],
) -> None:
    """Write events, so that `open_recording` gives them back exactly.

    Parameters
    ----------
    path : path
        .h5 or .hdf5 (``events/{t,x,y,p}``, p as {0, 1}, attributes width and height), .npz (the same names),
        .txt or .csv (a line an event), .raw (Prophesee EVT3), .aedat4 (needs the extra ``formats``).
    events : EventArray, or what `open_recording` takes
        What to write.
    truth : mapping
        What is true of each code, as `evqr.simulate` tells it: name of a group ("truth", "truth2", ...) to
        its fields.  Scalars become attributes of the group, arrays its datasets; in .npz all become arrays
        ``GROUP/NAME``.  Other formats have no place for it.
    **opening : as for `open_recording`
        Such as ``sensor`` and ``time_unit``, for events that do not say.

    Raises
    ------
    RecordingError
        When the file cannot be written.
    UsageError
        For another suffix, or a truth that the format has no place for.
    TypeError
        ``events`` are none.
    """
    if not isinstance(events, EventArray):
        with open_recording(events, **opening) as recording:
            events = recording.read()
    with _new_file(Path(path), writer_of(path, truth=bool(truth)), events.width, events.height) as writer:
        if len(events):
            writer.write(events)
        writer.finish(truth or {})


def convert_recording(
    recording: Any,
    path: str | os.PathLike[str],
    *,
    progress: Progress | None = None,
    **opening: Unpack[RecordingOptions],
) -> tuple[str, ...]:
    """Write all events of a recording to a file, a chunk at a time.

    Parameters
    ----------
    recording : Recording, path or arrays
        As `open_recording` gives it, or what it takes.
    path : path
        What to write; the suffix names the format, as for `save_recording`.
    progress : callable
        Called with the event time done and the whole duration, None while unknown [us].
    **opening : as for `open_recording`
        Such as ``sensor`` and ``time_unit``, for what is not open yet.

    Returns
    -------
    tuple of str
        What the format could not keep, each in one line.

    Raises
    ------
    RecordingError, MissingExtra, UsageError
        Where `open_recording` and streaming do; the file cannot be written, or its suffix names no format.
    TypeError
        It is nothing that can be opened, or is open already and there is something to open it with.
    """
    if not isinstance(recording, Recording):
        with open_recording(recording, **opening) as opened:
            return convert_recording(opened, path, progress=progress)
    if opening:
        raise TypeError(f"a Recording is open already: pass {', '.join(opening)} to open_recording")
    with _new_file(Path(path), writer_of(path), recording.width, recording.height) as writer:
        for chunk in recording.chunks():
            writer.write(chunk)
            if progress is not None and recording.t_first_us is not None:
                last = recording.t_last_us
                total = None if last is None else last - recording.t_first_us
                progress(int(chunk.t[-1]) - recording.t_first_us, total)
        writer.finish({})
    return tuple(writer.notes)


@contextmanager
def _new_file(path: Path, writer: type[Writer], width: int, height: int) -> Iterator[Writer]:
    """Give a writer of a file beside the one that is wanted, which takes its place when all is written."""
    part = path.with_name(f".{path.name}.part")
    opened: Writer | None = None
    try:
        opened = writer(part, width, height)
        yield opened
        os.replace(part, path)
    except EvqrError:
        raise
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be written ({error.strerror or error}); choose another place"
        ) from error
    finally:
        if opened is not None:
            opened.close()
        part.unlink(missing_ok=True)
