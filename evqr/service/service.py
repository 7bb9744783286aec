"""The service: from a source to sinks, recorder and page, until it is told to stop."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evqr.clock import utc_text
from evqr.config import JobConfig
from evqr.errors import EvqrError, UsageError
from evqr.events.array import EventArray
from evqr.line.reader import Reader
from evqr.line.records import LineRecord, PartRecord, ReadRecord
from evqr.live.pieces import Events, Idle, Interrupted, Piece, Sensor
from evqr.live.playing import Playing
from evqr.live.source import LiveSource
from evqr.page.state import LineState
from evqr.results import module_rows
from evqr.service.feeding import feed, opened_source
from evqr.service.sequence import SequenceFile
from evqr.service.settings import Keep, OutletSettings, ServiceSettings, TriggerSource
from evqr.service.systemd import Notifier
from evqr.sinks.database import Database
from evqr.sinks.flight_recorder import FlightRecorder
from evqr.sinks.json_lines import JsonLines
from evqr.sinks.line_format import LineFormat
from evqr.sinks.mqtt import Mqtt
from evqr.sinks.opcua import OpcUa
from evqr.sinks.outlet import Outlet
from evqr.sinks.sink import Sink
from evqr.sinks.tcp import TcpServer
from evqr.sinks.webhook import Webhook

_LOG = logging.getLogger(__name__)

AROUND_US = 2_000
"""Events that a flight recorder keeps before and after a part [us]."""


class Service:
    """Reads a line, and sends its records where the settings say.

    Parameters
    ----------
    settings : ServiceSettings
        All of it.
    jobs : mapping of str to JobConfig
        Products, by name.
    out : callable, optional
        Is given each record as plain values, beside the sinks.

    Attributes
    ----------
    state : LineState
        What the page tells.
    """

    def __init__(
        self,
        settings: ServiceSettings,
        jobs: Mapping[str, JobConfig] | None = None,
        *,
        out: Callable[[Mapping[str, Any]], None] = lambda record: None,
    ) -> None:
        self._settings, self._jobs, self._out = settings, dict(jobs or {}), out
        self.state = LineState(settings.line)
        self._source: LiveSource | None = None
        self._stopped = False
        self._outlets: list[tuple[str, Outlet]] = []
        self._recorder: FlightRecorder | None = None
        self._sequence: SequenceFile | None = None
        self._reader: Reader | None = None
        self._job = settings.job
        self.state.uses(self._job, tuple(self._jobs))
        self._size = 0, 0
        self._recent: deque[bool] = deque(maxlen=settings.watch.alarm_parts)
        self._alarm = False
        self._systemd = Notifier()
        self._heartbeat_at = self._watchdog_at = 0.0

    def stop(self) -> None:
        """End soon, with all parts told and all records delivered; any thread, or a signal, may say so."""
        self._stopped = True
        if self._source is not None:
            self._source.stop()

    def use(self, job: str) -> None:
        """Change what is expected of parts, from now on; any thread may say so.

        Parameters
        ----------
        job : str
            One of the jobs; "" expects nothing.

        Raises
        ------
        ValueError
            There is no such job.
        """
        if job and job not in self._jobs:
            raise ValueError(f"job must be one of {', '.join(self._jobs) or 'none'}, got {job!r}")
        self._job = job
        if self._reader is not None:
            self._reader.use(job)
        self.state.uses(job, tuple(self._jobs))
        _LOG.info("the job is %r", job)

    def run(self) -> bool:
        """Read until the source ends or is stopped.

        Returns
        -------
        read : bool
            Whether anything was read.

        Raises
        ------
        EvqrError
            A setting cannot be used, or the source cannot be read.
        """
        read = False
        with ExitStack() as stack:
            for name, outlet in self._opened(stack):
                self._outlets.append((name, outlet))
            self.state.watch_sinks(lambda: [(name, outlet.status) for name, outlet in self._outlets])
            self._open_recorder(stack)
            self._open_page(stack)
            self._open_sequence(stack)
            self._check_itself()
            settings = self._settings.source
            in_stream = self._settings.triggers is TriggerSource.STREAM
            source = self._source = stack.enter_context(
                opened_source(
                    settings.where,
                    speed=settings.speed,
                    repeat=settings.repeat,
                    in_stream=in_stream,
                    sensor=settings.sensor,
                )
            )
            if self._stopped:
                source.stop()
            self._systemd.tell("READY=1")
            _LOG.info("reading %s", source.name)
            for record in feed(source, self._make, in_stream=in_stream, seen=self._seen):
                read = read or isinstance(record, ReadRecord)
                self._take(record)
            self._systemd.tell("STOPPING=1")
            _LOG.info("%s has ended", source.name)
        return read

    # ---- what is opened

    def _opened(self, stack: ExitStack) -> Iterator[tuple[str, Outlet]]:
        for sink, settings in sinks_of(self._settings):
            outlet = Outlet(
                sink, room=settings.room, spool=settings.spool, spool_bytes=settings.spool_bytes,
                when_full=settings.when_full, at_once=isinstance(sink, TcpServer),
            )  # fmt: skip
            stack.callback(outlet.close)
            yield sink.name, outlet

    def _open_recorder(self, stack: ExitStack) -> None:
        settings = self._settings.recorder
        if settings.folder is not None:
            self._recorder = FlightRecorder(
                settings.folder, seconds=settings.seconds, quota_bytes=settings.quota_bytes
            )
            stack.callback(self._recorder.close)

    def _open_page(self, stack: ExitStack) -> None:
        settings, folder = self._settings.page, self._settings.recorder.folder
        if settings.enabled:
            from evqr.page.serve import PageServer

            page = stack.enter_context(
                PageServer(
                    self.state, settings.host, settings.port, token=settings.token,
                    no_reads=None if folder is None else Path(folder), use=self.use,
                )
            )  # fmt: skip
            _LOG.info("the page is at %s", page.url)

    def _open_sequence(self, stack: ExitStack) -> None:
        path = self._settings.watch.sequence_file
        if path is not None:
            self._sequence = SequenceFile(path)
            stack.callback(self._sequence.close)

    def _make(self, size: tuple[int, int]) -> Reader:
        settings, read = self._settings, self._settings.read
        if isinstance(self._source, Playing) and settings.source.speed is None:
            # it comes as fast as it is read, and so is always far ahead
            read = replace(read, line=replace(read.line, behind_us=None))
        self._size = size
        self._reader = Reader(
            size, read, None if settings.triggers is TriggerSource.NONE else settings.trigger,
            jobs=self._jobs, backend=settings.backend, device=settings.device, line=settings.line,
            camera=settings.camera, sequence=0 if self._sequence is None else self._sequence.next,
        )  # fmt: skip
        self._reader.use(self._job)
        return self._reader

    def _check_itself(self) -> None:
        """Read the part that can be read; where that fails, say so for as long as this runs."""
        path = self._settings.watch.self_check
        if path is None:
            return
        from evqr.offline import read_codes

        settings = self._settings
        try:
            result = read_codes(path, config=settings.read, backend=settings.backend, device=settings.device)
            problem = "" if result.readings else f"the self-check read nothing from {path}: {result.reason}"
        except EvqrError as error:
            problem = f"the self-check failed: {error}"
        if problem:
            _LOG.error("%s", problem)
            self.state.problem("self-check", problem)

    # ---- what comes and goes

    def _seen(self, piece: Piece) -> None:
        """Let recorder and page see what the source gives, and do what is due."""
        if isinstance(piece, Sensor):
            self.state.connected(self._settings.source.where)
        elif isinstance(piece, Interrupted):
            _LOG.warning("%s: %s; trying again", self._settings.source.where, piece.reason)
            self.state.connected(self._settings.source.where, piece.reason)
        elif isinstance(piece, Events):
            columns = piece.columns
            p = np.where(np.asarray(columns.p) > 0, np.int8(1), np.int8(-1))
            events = EventArray(
                np.asarray(columns.t, np.int64), np.asarray(columns.x, np.uint16),
                np.asarray(columns.y, np.uint16), p, *self._size,
            )  # fmt: skip
            if self._size != (0, 0) and len(events):
                self.state.saw(events)
                if self._recorder is not None:
                    self._recorder.push(events)
        self._do_what_is_due(idle=isinstance(piece, Idle))

    def _do_what_is_due(self, *, idle: bool) -> None:
        now = time.monotonic()
        watchdog_s = self._systemd.watchdog_s
        if watchdog_s is not None and now >= self._watchdog_at:
            self._watchdog_at = now + watchdog_s / 3.0
            self._systemd.tell("WATCHDOG=1")
        if now >= self._heartbeat_at:
            self._heartbeat_at = now + self._settings.watch.heartbeat_s
            problems = self.state.problems
            self._send(self._own("heartbeat", ready=not problems, problems=problems))

    def _take(self, record: LineRecord) -> None:
        """Send a record where it goes."""
        if self._sequence is not None:
            self._sequence.keep(record.sequence + 1)
        plain = record.to_dict()
        file = self._kept(record) if isinstance(record, PartRecord) else None
        if file is not None:
            plain["events"] = file
        modules = module_rows(record.reading.modules) if isinstance(record, ReadRecord) else ()
        self.state.take(plain, file=None if file is None else Path(file).name, modules=modules)
        self._send(plain)
        if isinstance(record, PartRecord):
            self._watch_read_rate(_is_read(record))

    def _kept(self, record: PartRecord) -> str | None:
        """Keep the events of a part, where they are wanted, and say where they will be."""
        if self._recorder is None:
            return None
        if _is_read(record) and self._settings.recorder.keep is Keep.NO_READ:
            return None
        starts = [time for time in (record.t_start_us, record.t_first_us) if time is not None]
        ends = [time for time in (record.t_end_us, record.t_last_us) if time is not None]
        if not starts or not ends:
            return None
        name = f"{record.t_utc or 'part'}-{record.part}"
        path = self._recorder.keep(name, min(starts) - AROUND_US, max(ends) + AROUND_US)
        return None if path is None else str(path)

    def _watch_read_rate(self, read: bool) -> None:
        settings = self._settings.watch
        self._recent.append(read)
        if settings.least_read_rate is None or len(self._recent) < settings.alarm_parts:
            return
        rate = sum(self._recent) / len(self._recent)
        alarm = rate < settings.least_read_rate
        if alarm != self._alarm:
            self._alarm = alarm
            said = f"{100 * rate:.1f} % of the last {len(self._recent)} parts are read"
            self.state.problem("read rate", said if alarm else "")
            (_LOG.error if alarm else _LOG.warning)("%s: %s", "alarm" if alarm else "alarm over", said)
            self._send(self._own("alarm", on=alarm, read_rate=rate, reason=said))

    def _own(self, kind: str, **fields: Any) -> dict[str, Any]:
        """Make a record that is no reader's; its time is its number."""
        settings = self._settings
        return {
            "record": kind, "line": settings.line, "camera": settings.camera,
            "t_utc": utc_text(), **fields,
        }  # fmt: skip

    def _send(self, record: Mapping[str, Any]) -> None:
        self._out(record)
        for _, outlet in self._outlets:
            outlet.put(record)


def _is_read(record: PartRecord) -> bool:
    """Whether a part says something, and not another thing than is expected."""
    return bool(record.texts) and record.matches is not False


def sinks_of(settings: ServiceSettings) -> Iterator[tuple[Sink, OutletSettings]]:
    """Make the sinks that settings name.

    Parameters
    ----------
    settings : ServiceSettings
        All of them.

    Yields
    ------
    sink, settings : Sink, OutletSettings
        In the order of the settings.

    Raises
    ------
    UsageError
        A setting makes no sense.
    MissingExtra
        A package is not installed.
    """
    for lines in settings.json_lines:
        yield JsonLines(lines.path), lines
    for database in settings.database:
        yield Database(database.path, keep_days=database.keep_days, keep_rows=database.keep_rows), database
    for tcp in settings.tcp:
        try:
            line = LineFormat(tcp.line, no_read=tcp.no_read)
        except ValueError as error:
            raise UsageError(f"tcp.line: {error}") from error
        yield TcpServer(tcp.host, tcp.port, line=line, kinds=tcp.kinds, needs_client=tcp.needs_client), tcp
    for mqtt in settings.mqtt:
        yield (
            Mqtt(
                mqtt.host, mqtt.port, topic=mqtt.topic, user=mqtt.user, password=mqtt.password, tls=mqtt.tls
            ),
            mqtt,
        )
    for webhook in settings.webhook:
        headers = None if webhook.bearer is None else {"Authorization": f"Bearer {webhook.bearer}"}
        yield Webhook(webhook.url, headers=headers), webhook
    for opcua in settings.opcua:
        yield OpcUa(opcua.endpoint), opcua
