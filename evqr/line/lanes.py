"""Lanes on which calls of many cameras are done, in their order: a process a camera, or all at once."""

from __future__ import annotations

import logging
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from evqr.config import JobConfig, ReadConfig, TriggerConfig
from evqr.errors import EvqrError
from evqr.line.records import LineRecord
from evqr.line.scheduler import LineScheduler
from evqr.recording import TimeUnit
from evqr.seen import Statistics
from evqr.solver import Solver
from evqr.work import Working, answer, together

_LOG = logging.getLogger(__name__)

TRIES = 3
"""Processes of a camera that may end one after another, without having done anything, until there is none."""

BATCH_S = 250e-6
"""Time from one batch of all cameras to the next, where more is due already [s]."""


class Call(NamedTuple):
    """What a reader is to do.

    Attributes
    ----------
    camera : str
        Whose.
    name : {"push", "advance", "interrupt", "trigger", "use", "close"}
        What.
    given : any
        Its argument; None for "close".
    arrived_s : (float, float) [s]
        When it was asked, by `time.monotonic` and `time.time`, which all processes share.
    """

    camera: str
    name: str
    given: Any
    arrived_s: tuple[float, float]


class Done(NamedTuple):
    """What came of a call.

    Attributes
    ----------
    call : Call
        Without what was given, unless it is small.
    records : sequence of LineRecord
        Of the camera.
    known_us : int [us]
        Up to where it is read.
    error : Exception, optional
        For which it was refused.
    lost : str
        What became of the process that should have done it; "" where it has.
    statistics : Statistics
        What the camera's reader has done so far.
    """

    call: Call
    records: Sequence[LineRecord] = ()
    known_us: int = 0
    error: Exception | None = None
    lost: str = ""
    statistics: Statistics = Statistics()


class Making(NamedTuple):
    """What a reader is made of.

    Attributes
    ----------
    size : (int, int) [px]
        Of the sensor.
    config, triggers, jobs, backend, device, time_unit, line, camera : as of `Reader`
        The same.
    """

    size: tuple[int, int]
    config: ReadConfig | None
    triggers: TriggerConfig | None
    jobs: Mapping[str, JobConfig] | None
    backend: str
    device: str
    time_unit: TimeUnit
    line: str
    camera: str

    def solver(self) -> Solver:
        """Make what computes."""
        return Solver(self.config, backend=self.backend, device=self.device)

    def made(self, solver: Solver) -> LineScheduler:
        """Make the reader."""
        return LineScheduler(
            solver, self.size, self.triggers, jobs=self.jobs, time_unit=self.time_unit, line=self.line,
            camera=self.camera, sequence=0,
        )  # fmt: skip


def doing(line: LineScheduler, call: Call) -> Working[Done]:
    """Do a call; what is refused is in what came of it.

    Parameters
    ----------
    line : LineScheduler
        Does it.
    call : Call
        What.

    Returns
    -------
    done : Done
        What came of it.
    """
    line.arrived_s = call.arrived_s
    records: Sequence[LineRecord] = ()
    error = None
    try:
        if call.name == "push":
            records = yield from line.pushing(call.given)
        elif call.name == "advance":
            records = yield from line.advancing(call.given)
        elif call.name == "close":
            records = yield from line.closing()
        else:
            records = getattr(line, call.name)(call.given) or ()
    except Exception as caught:  # told to whoever asks next
        error = caught
    return Done(_short(call), records, line.known_us, error, statistics=line.statistics)


def _short(call: Call) -> Call:
    return call._replace(given=None) if call.name == "push" else call


class Worker(Protocol):
    """Does calls, of one camera or of many.

    Attributes
    ----------
    at_once : int
        Calls that it is given at most.
    batch_s : float [s]
        Time from one batch to the next.
    """

    at_once: int
    batch_s: float

    def do(self, calls: Sequence[Call]) -> list[Done]:
        """Do calls, those of a camera in their order."""
        ...

    def close(self) -> None:
        """End."""
        ...


class Together:
    """All cameras in this process: what is due of them is done in batches, on one solver.

    Parameters
    ----------
    makings : sequence of Making
        One a camera; of one configuration, backend and device.
    """

    at_once, batch_s = 1 << 16, BATCH_S

    def __init__(self, makings: Sequence[Making]) -> None:
        self._solver = makings[0].solver()
        self._lines = {making.camera: making.made(self._solver) for making in makings}

    def do(self, calls: Sequence[Call]) -> list[Done]:
        """Do calls, those of all cameras side by side."""
        asked: dict[str, list[Call]] = {}
        for call in calls:
            asked.setdefault(call.camera, []).append(call)
        done = answer(together(self._doing(each) for each in asked.values()), self._solver)
        return [one for each in done for one in each]

    def _doing(self, calls: Sequence[Call]) -> Working[list[Done]]:
        done = []
        for call in calls:
            done.append((yield from doing(self._lines[call.camera], call)))
        return done

    def close(self) -> None:
        """Nothing is held."""


class Beside:
    """One camera, in a process of its own; another takes its place where it ends.

    Parameters
    ----------
    making : Making
        Of the camera's reader.

    Attributes
    ----------
    process : multiprocessing.Process
        The one that there is now.
    """

    at_once, batch_s = 1, 0.0

    def __init__(self, making: Making) -> None:
        self._making, self._ended, self._job = making, 0, ""
        context = multiprocessing.get_context("spawn")  # kernels and their threads do not survive a fork
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_read, args=(theirs, making), name=f"evqr {making.camera}", daemon=True
        )
        self.process.start()
        theirs.close()

    def begin(self) -> None:
        """Let the process, which has started, make its reader."""
        try:
            refused = self._asked(None)
        except (EOFError, OSError) as error:
            self.close()
            raise EvqrError(f"{self._making.camera}: its process ended, {self._status}") from error
        if refused is not None:
            self.close()
            raise refused

    def do(self, calls: Sequence[Call]) -> list[Done]:
        """Do a call; where the process ends meanwhile, say so, and begin another."""
        (call,) = calls
        if call.name == "use":
            self._job = call.given
        if self._ended >= TRIES:
            return [Done(_short(call), lost=f"{self._ended} have, one after another; there is no other")]
        try:
            done: Done = self._asked(call)
        except (EOFError, OSError):
            self.close()
            said = self._status
            if call.name != "close":
                self._begin_another()
            return [Done(_short(call), lost=said)]
        except Exception as error:  # it cannot travel
            return [Done(_short(call), error=error)]
        self._ended = 0
        return [done]

    def _begin_another(self) -> None:
        self._ended += 1
        while self._ended < TRIES:
            another = Beside(self._making)
            self._pipe, self.process = another._pipe, another.process
            try:
                self.begin()
                self._asked(Call(self._making.camera, "use", self._job, (time.monotonic(), time.time())))
            except Exception as error:
                _LOG.error("%s: its process does not begin again: %s", self._making.camera, error)
                self._ended += 1
            else:
                return

    @property
    def _status(self) -> str:
        return f"exit status {self.process.exitcode}"

    def _asked(self, call: Call | None) -> Any:
        self._pipe.send(call)
        return self._pipe.recv()

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self.process.join(5.0)
        if self.process.is_alive():
            self.process.terminate()
            self.process.join()


def _read(pipe: Any, making: Making) -> None:
    """Read for a camera, in its process, until the one that began it closes the pipe, or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches it too; it is told what to do
    try:
        pipe.recv()
        try:
            solver = making.solver()
            line = making.made(solver)
        except Exception as error:
            pipe.send(error)
            return
        pipe.send(None)
        while True:
            pipe.send(answer(doing(line, pipe.recv()), solver))
    except (EOFError, OSError):
        return


class Lane:
    """A queue of calls, and the thread that has them done.

    Parameters
    ----------
    worker : Worker
        Does them.
    room : int
        Calls that may wait; who puts one more waits, too.
    take : callable
        Is given what came of each.
    """

    def __init__(self, worker: Worker, room: int, take: Callable[[Done], None]) -> None:
        self.worker, self._take = worker, take
        self._calls: queue.Queue[Call | None] = queue.Queue(room)
        self._thread = threading.Thread(target=self._run, name="evqr lane", daemon=True)
        self._thread.start()

    def put(self, call: Call) -> None:
        """Have a call done behind those before it."""
        self._calls.put(call)

    def close(self) -> None:
        """Wait until all is done."""
        self._calls.put(None)
        self._thread.join()
        self.worker.close()

    def _run(self) -> None:
        next_s = 0.0
        while (call := self._calls.get()) is not None:
            time.sleep(max(0.0, next_s - time.monotonic()))
            next_s = time.monotonic() + self.worker.batch_s
            calls, over = [call], False
            while not over and len(calls) < self.worker.at_once and not self._calls.empty():
                call = self._calls.get()
                over = call is None
                if call is not None:
                    calls.append(call)
            for done in self._done(calls):
                self._take(done)
            if over:
                return

    def _done(self, calls: Sequence[Call]) -> list[Done]:
        try:
            return self.worker.do(calls)
        except Exception as error:  # whatever it is, the next are taken
            return [Done(_short(call), error=error) for call in calls]
