"""From what a source gives to a reader, each trigger before the events of its time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from evqr.errors import EvqrError, UsageError
from evqr.line.gates import Trigger
from evqr.line.reader import Reader
from evqr.line.records import LineRecord
from evqr.live.named import is_live, live_source
from evqr.live.pieces import Events, Interrupted, Piece, Sensor, TimePasses, TriggerSeen
from evqr.live.playing import Playing
from evqr.live.source import LiveSource
from evqr.recording import open_recording

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from evqr.recording import RecordingOptions

_LOG = logging.getLogger(__name__)


@contextmanager
def opened_source(
    where: str,
    *,
    speed: float | None = None,
    repeat: bool = False,
    in_stream: bool = False,
    **opening: Unpack[RecordingOptions],
) -> Iterator[LiveSource]:
    """Open a live source, or a recording that is played; what was odd about a recording is logged at its end.

    Parameters
    ----------
    where : str
        As of `live_source`, or a path, which goes before it.
    speed, repeat : float, bool
        Of a recording, as of `Playing`.
    in_stream : bool
        The triggers that are in a recording are wanted.
    **opening : as for `open_recording`
        Of a recording.

    Yields
    ------
    source : LiveSource
        To feed a reader with.

    Raises
    ------
    EvqrError
        It cannot be opened.
    """
    if is_live(where) and (speed is not None or repeat):
        option = "repeat=" if speed is None else "speed="
        raise UsageError(f"{where}: {option} is for recordings: a live source comes as it does")
    source = live_source(where)
    if source is not None:
        yield source
        return
    with open_recording(where, **opening) as recording:
        yield Playing(recording, where, speed=speed, repeat=repeat, triggers=in_stream)
        for text in recording.notes:
            _LOG.warning("%s: %s", where, text)


def feed(
    source: LiveSource,
    make: Callable[[tuple[int, int]], Reader],
    triggers: Sequence[Trigger] = (),
    *,
    in_stream: bool = False,
    seen: Callable[[Piece], None] = lambda piece: None,
) -> Iterator[LineRecord]:
    """Feed a reader until the source ends or is stopped.

    Parameters
    ----------
    source : LiveSource
        Of events.
    make : callable
        Makes the reader, once the size of the sensor is known.
    triggers : sequence of Trigger
        In order of time.
    in_stream : bool
        Take the triggers of the source as well.
    seen : callable
        Is given each piece before the reader is.

    Yields
    ------
    record : LineRecord
        As soon as it is certain; the last ones also where the source turns out to be wrong.

    Raises
    ------
    EvqrError
        The source cannot be read.
    """
    reader: Reader | None = None
    waiting = iter(triggers)
    following = next(waiting, None)

    def give(reader: Reader, until_us: int | None) -> None:
        nonlocal following
        while following is not None and (until_us is None or following.t_us <= until_us):
            reader.trigger(following.t_us, following.kind.value, following.index, following.ticks)
            following = next(waiting, None)

    try:
        for piece in source.pieces():
            seen(piece)
            if isinstance(piece, Sensor):
                reader = reader or make((piece.width, piece.height))
            elif reader is None:
                continue
            elif isinstance(piece, Interrupted):
                yield from reader.interrupt(piece.reason)
            elif isinstance(piece, Events):
                if len(piece.columns.t):
                    give(reader, int(piece.columns.t.max()))
                    yield from reader.push(piece.columns)
            elif isinstance(piece, TimePasses):
                give(reader, piece.t_us)
                yield from reader.advance(piece.t_us)
            elif isinstance(piece, TriggerSeen) and in_stream:
                reader.trigger(piece.t_us, piece.kind, piece.index, piece.ticks)
    except EvqrError:
        if reader is not None:  # what was read before what is wrong is told
            yield from reader.close()
        raise
    if reader is not None:
        give(reader, None)
        yield from reader.close()
