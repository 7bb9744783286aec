"""The reader of a line for programs that run on asyncio: it works on a thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Literal, TypeVar

from evqr.line.reader import Reader
from evqr.line.records import LineRecord
from evqr.seen import Statistics

T = TypeVar("T")


class AsyncReader:
    """Reads a stream of events that comes bit by bit; an asynchronous context manager.

    Calls may be made at the same time: they are done in the order in which they were made.

    Parameters
    ----------
    *given, **named : as for `Reader`
        The same; it is made, and kernels are loaded, in the first call.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        self._make: Callable[[], Reader] = lambda: Reader(*given, **named)
        self._reader: Reader | None = None
        self._thread: ThreadPoolExecutor | None = ThreadPoolExecutor(1, thread_name_prefix="evqr-reader")

    async def _do(self, work: Callable[[Reader], T]) -> T:
        def run() -> T:
            if self._reader is None:
                self._reader = self._make()
            return work(self._reader)

        if self._thread is None:
            raise ValueError("the reader is closed")
        return await asyncio.get_running_loop().run_in_executor(self._thread, run)

    async def push(self, events: Any) -> list[LineRecord]:
        """Take the next events, as `Reader.push` does.

        Parameters
        ----------
        events : as for `Reader.push`
            The same; not to be changed before this has returned.

        Returns
        -------
        records : list of LineRecord
            What has become certain, in order.
        """
        return await self._do(lambda reader: reader.push(events))

    async def advance(self, t_us: int) -> list[LineRecord]:
        """Let time pass, as `Reader.advance` does.

        Parameters
        ----------
        t_us : int [us]
            By the clock of the events.

        Returns
        -------
        records : list of LineRecord
            What has become certain by that, in order.
        """
        return await self._do(lambda reader: reader.advance(t_us))

    async def trigger(
        self,
        t_us: int,
        kind: Literal["pulse", "start", "end", "ticks"] = "pulse",
        index: int | None = None,
        ticks: float | None = None,
    ) -> None:
        """Take a trigger, as `Reader.trigger` does.

        Parameters
        ----------
        t_us : int [us]
            When, by the clock of the events.
        kind : "pulse", "start", "end" or "ticks"
            What it says.
        index : int, optional
            Of the part.
        ticks : float, optional
            Where the encoder is.
        """
        await self._do(lambda reader: reader.trigger(t_us, kind, index, ticks))

    async def use(self, job: str) -> None:
        """Change what is expected, as `Reader.use` does.

        Parameters
        ----------
        job : str
            Its name.
        """
        await self._do(lambda reader: reader.use(job))

    async def statistics(self) -> Statistics:
        """Tell what has been done so far.

        Returns
        -------
        statistics : Statistics
            Over all clocks of the source.
        """
        return await self._do(lambda reader: reader.statistics)

    async def close(self) -> list[LineRecord]:
        """Take the stream as ended, as `Reader.close` does.

        Returns
        -------
        records : list of LineRecord
            The last ones; none when it was closed before.
        """
        if self._thread is None:
            return []
        try:
            return await self._do(lambda reader: reader.close())
        finally:
            self._thread.shutdown(wait=False)
            self._thread = None

    async def __aenter__(self) -> AsyncReader:
        await self._do(lambda reader: None)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()
