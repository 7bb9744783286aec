"""A reader of a stream that has no end: events in as they come, records out as soon as they are certain."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from types import TracebackType
from typing import Any, Literal

from evqr.config import JobConfig, ReadConfig, TriggerConfig
from evqr.errors import UsageError
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.records import LineRecord
from evqr.line.scheduler import LineScheduler
from evqr.recording import TimeUnit
from evqr.recording.options import checked
from evqr.seen import Statistics
from evqr.solver import Solver
from evqr.work import Working, answer


class Reader:
    """Reads a stream of events that comes bit by bit; a context manager.

    Leaving its block closes it, too, but gives no records: call `close` for the last ones.  Calls are those
    of one thread, but for `trigger`, which any may call.

    Parameters
    ----------
    sensor : (int, int) or str [px]
        Width and height of the sensor, or a text such as "640x480".
    config : ReadConfig, optional
        What to do; default `ReadConfig()`.
    triggers : TriggerConfig, optional
        Of which times triggers ask: there is one part a trigger then. Default: there are none, and each code
        that passes is a part.
    jobs : mapping of str to JobConfig, optional
        What is expected of products, by name; `use` chooses one. That with the name "" is in use at first.
    backend : str
        "auto", "warp", "taichi", "numpy", or a registered name.
    device : str
        "cpu", "cuda:0", ...
    time_unit : "s", "ms", "us" or "ns"
        Of the times of events that do not say it themselves.
    line, camera : str
        Names that records carry.
    sequence : int
        Number of the first record: one more than the last one's before a restart.

    Raises
    ------
    UsageError
        The size of the sensor is none.
    BackendError
        The backend or the device is not there.
    """

    def __init__(
        self,
        sensor: tuple[int, int] | str,
        config: ReadConfig | None = None,
        triggers: TriggerConfig | None = None,
        *,
        jobs: Mapping[str, JobConfig] | None = None,
        backend: str = "auto",
        device: str = "cpu",
        time_unit: TimeUnit = "us",
        line: str = "",
        camera: str = "",
        sequence: int = 0,
    ) -> None:
        self._solver = Solver(config, backend=backend, device=device)
        self._line = LineScheduler(
            self._solver, sensor_size(sensor, time_unit), triggers, jobs=jobs, time_unit=time_unit, line=line,
            camera=camera, sequence=sequence,
        )  # fmt: skip
        self._closed = False

    def push(self, events: Any) -> list[LineRecord]:
        """Take the next events.

        Parameters
        ----------
        events : EventArray, array, tuple, list, dict, DataFrame or PackedEvents
            What `open_recording` takes of events in memory, or eight bytes an event; any number, also none.
            Events that are wrong, or later than is sorted, are left out, and a `GapRecord` counts them.

        Returns
        -------
        records : list of LineRecord
            What has become certain, in order.

        Raises
        ------
        RecordingError, TypeError
            These are no events, or not those of this sensor.
        ValueError
            The reader is closed.
        """
        return self._done(self._open.pushing(events))

    def advance(self, t_us: int) -> list[LineRecord]:
        """Let time pass: all events before a time were pushed, though none may have come since long.

        Parameters
        ----------
        t_us : int [us]
            By the clock of the events.

        Returns
        -------
        records : list of LineRecord
            What has become certain by that, in order.

        Raises
        ------
        ValueError
            The reader is closed.
        """
        return self._done(self._open.advancing(whole_us(t_us)))

    def interrupt(self, reason: str = "") -> list[LineRecord]:
        """Say that the source was lost, and may come back.

        Parameters
        ----------
        reason : str
            Why, in words.

        Returns
        -------
        records : list of LineRecord
            A `GapRecord`.

        Raises
        ------
        ValueError
            The reader is closed.
        """
        return self._open.interrupt(reason)

    def trigger(
        self,
        t_us: int,
        kind: Literal["pulse", "start", "end", "ticks"] = "pulse",
        index: int | None = None,
        ticks: float | None = None,
    ) -> None:
        """Take a trigger; the next call gives what becomes certain by it.  May be called from any thread.

        Parameters
        ----------
        t_us : int [us]
            When, by the clock of the events; before its events come, or as much later as the settings allow.
        kind : "pulse", "start", "end" or "ticks"
            A part passes; its gate opens, or closes; or nothing but where the encoder is.
        index : int, optional
            Of the part, which its record has as ``trigger``. Default: pulses and starts are counted, and an
            end closes the gate that was opened last.
        ticks : float, optional
            Where the encoder is.

        Raises
        ------
        ValueError
            The reader has no triggers, or is closed, or there is no such kind.
        UsageError
            Ticks are missing, or too many triggers wait.
        TypeError
            A time that is no whole number.
        """
        self._open.trigger(Trigger(whole_us(t_us), TriggerKind(kind), index, ticks))

    def use(self, job: str) -> None:
        """Change what is expected, for the triggers, or without any the codes, that come from now on.

        Parameters
        ----------
        job : str
            One of ``jobs``; "" is there always.

        Raises
        ------
        ValueError
            There is no such job.
        """
        self._line.use(job)

    def close(self) -> list[LineRecord]:
        """Take the stream as ended: all parts that are left are told.

        Returns
        -------
        records : list of LineRecord
            The last ones; none when it was closed before.
        """
        if self._closed:
            return []
        self._closed = True
        return self._done(self._line.closing())

    def __enter__(self) -> Reader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def hot_pixels(self) -> list[tuple[int, int]]:
        """Column and row of the pixels whose events are left out, since they fire all the time [px]."""
        return self._line.hot_pixels

    @property
    def statistics(self) -> Statistics:
        """What has been done so far, over all clocks of the source."""
        return self._line.statistics

    @property
    def _open(self) -> LineScheduler:
        if self._closed:
            raise ValueError("the reader is closed")
        return self._line

    def _done(self, working: Working[list[LineRecord]]) -> list[LineRecord]:
        return answer(working, self._solver)


def sensor_size(sensor: tuple[int, int] | str, time_unit: TimeUnit) -> tuple[int, int]:
    """Give the size of a sensor [px], and refuse what is none, or no unit of time."""
    size = checked(sensor=sensor, time_unit=time_unit).sensor
    if size is None:
        raise UsageError("the size of the sensor is needed; pass (640, 480) or '640x480'")
    return size


def whole_us(t_us: int) -> int:
    """Give a time that is a whole number [us]."""
    if isinstance(t_us, bool) or not isinstance(t_us, Integral):
        raise TypeError(f"t_us must be a whole number of microseconds, got {t_us!r}")
    return int(t_us)
