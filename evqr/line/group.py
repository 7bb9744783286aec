"""Readers of many cameras: a process a camera where CPUs compute, one for all of them where a GPU does."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Literal

from evqr.config import JobConfig, ReadConfig, TriggerConfig
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.lanes import Beside, Call, Done, Lane, Making, Together
from evqr.line.ledger import Ledger
from evqr.line.parts import Parts, parts_for
from evqr.line.reader import sensor_size, whole_us
from evqr.line.records import LineRecord
from evqr.recording import TimeUnit
from evqr.seen import Statistics

_LOG = logging.getLogger(__name__)


class ReaderGroup:
    """Reads the streams of many cameras; a context manager.

    Each camera has the records that a `Reader` of its own would give, in that order, under its name.  Calls
    hand things on and do not wait for what comes of them: each gives the records of all cameras that have
    become certain since the last.  Where the process of a camera ends, a `GapRecord` says so, each of its
    triggers that has no part yet becomes a NO READ with the reason WORKER_LOST, and another process goes on.

    Parameters
    ----------
    cameras : mapping of str to (int, int) or str [px]
        Names, and sizes of the sensors, as of `Reader`.
    config : ReadConfig, optional
        What to do; default `ReadConfig()`.
    triggers : TriggerConfig, optional
        As of `Reader`, of all cameras.
    mode : "auto", "processes" or "together"
        A process a camera, begun afresh (so a script needs ``if __name__ == "__main__":``), or all cameras in
        this one, in batches of what is due of them. "auto": together on a device, processes on CPUs.
    room : int
        Calls of a camera (all of them together, in one process) that may wait; then who calls waits.
    jobs, backend, device, time_unit, line : as of `Reader`
        The same for all cameras.
    sequence : mapping of str to int
        Numbers of the first records, by camera, where they are not 0.

    Raises
    ------
    UsageError
        The size of a sensor is none.
    BackendError
        The backend or the device is not there.
    ValueError
        There is no camera, or no such mode.
    """

    def __init__(
        self,
        cameras: Mapping[str, tuple[int, int] | str],
        config: ReadConfig | None = None,
        triggers: TriggerConfig | None = None,
        *,
        mode: Literal["auto", "processes", "together"] = "auto",
        room: int = 64,
        jobs: Mapping[str, JobConfig] | None = None,
        backend: str = "auto",
        device: str = "cpu",
        time_unit: TimeUnit = "us",
        line: str = "",
        sequence: Mapping[str, int] | None = None,
    ) -> None:
        if not cameras:
            raise ValueError("cameras must name one at least")
        if mode not in ("auto", "processes", "together"):
            raise ValueError(f"mode must be 'auto', 'processes' or 'together', got {mode!r}")
        if mode == "auto":
            mode = "processes" if device == "cpu" else "together"
        config = ReadConfig.of(config)
        makings = [
            Making(
                sensor_size(sensor, time_unit), config, triggers, jobs, backend, device, time_unit, line, name
            )
            for name, sensor in cameras.items()
        ]  # fmt: skip
        first = sequence or {}
        self._jobs = dict(jobs or {})
        self._ledgers = {name: Ledger(line, name, first.get(name, 0), self._jobs) for name in cameras}
        self._checks: Parts = parts_for(triggers, config, makings[0].size)
        self._changed = threading.Condition()  # of all below, and of the ledgers
        self._statistics = dict.fromkeys(cameras, Statistics())
        self._before = dict.fromkeys(cameras, Statistics())
        self._records: deque[LineRecord] = deque()
        self._errors: deque[Exception] = deque()
        self._closed = False
        with ExitStack() as begun:
            if mode == "together":
                lane = Lane(Together(makings), room, self._take)
                self._lanes = dict.fromkeys(cameras, lane)
                return
            workers = [Beside(making) for making in makings]
            for worker in workers:
                begun.callback(worker.close)
            for worker in workers:  # the first compiles what is not compiled yet
                worker.begin()
            begun.pop_all()
            self._lanes = {
                name: Lane(worker, room, self._take) for name, worker in zip(cameras, workers, strict=True)
            }

    # ---- what comes in

    def push(self, camera: str, events: Any) -> list[LineRecord]:
        """Hand on the next events of a camera.

        Parameters
        ----------
        camera : str
            Its name.
        events : as for `Reader.push`
            The same; not to be changed until the group is closed.

        Returns
        -------
        records : list of LineRecord
            What has become certain by now, of all cameras.

        Raises
        ------
        RecordingError, TypeError
            An earlier push was refused for that; records stay for the next call.
        ValueError
            There is no such camera, or the group is closed.
        """
        self._put(camera, "push", events)
        return self.poll()

    def advance(self, camera: str, t_us: int) -> list[LineRecord]:
        """Let time of a camera pass.

        Parameters
        ----------
        camera : str
            Its name.
        t_us : int [us]
            As of `Reader.advance`.

        Returns
        -------
        records : list of LineRecord
            As of `push`.
        """
        self._put(camera, "advance", whole_us(t_us))
        return self.poll()

    def interrupt(self, camera: str, reason: str = "") -> list[LineRecord]:
        """Say that the source of a camera was lost, and may come back.

        Parameters
        ----------
        camera : str
            Its name.
        reason : str
            Why, in words.

        Returns
        -------
        records : list of LineRecord
            As of `push`.
        """
        self._put(camera, "interrupt", reason)
        return self.poll()

    def trigger(
        self,
        camera: str,
        t_us: int,
        kind: Literal["pulse", "start", "end", "ticks"] = "pulse",
        index: int | None = None,
        ticks: float | None = None,
    ) -> None:
        """Take a trigger of a camera.  May be called from any thread.

        Parameters
        ----------
        camera : str
            Its name.
        t_us : int [us]
            When, by the clock of the camera's events.
        kind, index, ticks : as of `Reader.trigger`
            The same.

        Raises
        ------
        ValueError
            There are no triggers, no such camera or kind, or the group is closed.
        UsageError
            Ticks are missing.
        TypeError
            A time that is no whole number.
        """
        trigger = Trigger(whole_us(t_us), TriggerKind(kind), index, ticks)
        self._checks.check(trigger)
        lane = self._lane(camera)
        with self._changed:
            trigger = self._ledgers[camera].numbered(trigger)
        lane.put(_call(camera, "trigger", trigger))

    def use(self, camera: str, job: str) -> None:
        """Change what is expected of a camera's parts from now on.

        Parameters
        ----------
        camera : str
            Its name.
        job : str
            As of `Reader.use`.

        Raises
        ------
        ValueError
            There is no such camera or job, or the group is closed.
        """
        if job and job not in self._jobs:
            raise ValueError(f"job must be one of {', '.join(self._jobs) or 'none'}, got {job!r}")
        self._put(camera, "use", job)

    # ---- what comes out

    def poll(self, timeout_s: float = 0.0) -> list[LineRecord]:
        """Give what has become certain by now.

        Parameters
        ----------
        timeout_s : float [s]
            Most time to wait for it, where there is nothing yet.

        Returns
        -------
        records : list of LineRecord
            Of all cameras, those of each in order.

        Raises
        ------
        RecordingError, TypeError
            As of `push`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._records or self._errors, timeout_s)
            if self._errors:
                raise self._errors.popleft()
            records = list(self._records)
            self._records.clear()
        return records

    @property
    def statistics(self) -> dict[str, Statistics]:
        """What has been done so far, by camera, also by processes that have ended."""
        with self._changed:
            return {
                camera: Statistics(**{key: count + self._before[camera][key] for key, count in now.items()})
                for camera, now in self._statistics.items()
            }

    def close(self) -> list[LineRecord]:
        """Take all streams as ended, and wait until all of them are read.

        Returns
        -------
        records : list of LineRecord
            The last ones.

        Raises
        ------
        RecordingError, TypeError
            As of `push`; the next call gives the records.
        """
        if not self._closed:
            for camera in self._lanes:
                self._put(camera, "close", None)
            self._closed = True
            for lane in dict.fromkeys(self._lanes.values()):
                lane.close()
        return self.poll()

    def __enter__(self) -> ReaderGroup:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ---- on the lanes

    def _lane(self, camera: str) -> Lane:
        if self._closed:
            raise ValueError("the group is closed")
        if camera not in self._lanes:
            raise ValueError(f"camera must be one of {', '.join(self._lanes)}, got {camera!r}")
        return self._lanes[camera]

    def _put(self, camera: str, name: str, given: Any) -> None:
        self._lane(camera).put(_call(camera, name, given))

    def _take(self, done: Done) -> None:
        """Take what came of a call; on the thread of its lane."""
        camera, name, given, _ = done.call
        with self._changed:
            ledger = self._ledgers[camera]
            if done.error is not None:
                self._errors.append(done.error)
            elif name == "trigger":
                ledger.owe(given)
            elif name == "use":
                ledger.job = given
            if done.lost:
                _LOG.error("%s: its process has ended: %s", camera, done.lost)
                self._records.extend(ledger.lost(done.lost))
                done_before = self._statistics[camera]
                self._statistics[camera] = Statistics()
                self._before[camera] = Statistics(
                    **{key: count + self._before[camera][key] for key, count in done_before.items()}
                )
            else:
                self._statistics[camera] = done.statistics
                self._records.extend(ledger.take(done.records, done.known_us))
            self._changed.notify_all()


def _call(camera: str, name: str, given: Any) -> Call:
    return Call(camera, name, given, (time.monotonic(), time.time()))
