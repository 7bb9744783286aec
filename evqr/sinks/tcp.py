"""A TCP server that sends a line a record to whoever is connected."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Sequence

from evqr.sinks.line_format import LineFormat
from evqr.sinks.sink import JsonRecord

MOST_UNSENT = 1 << 20
"""Bytes that a client may leave unread before it is dropped."""

START_S = 10.0


class TcpServer:
    """Sends records of some kinds as lines; TCP does not tell whether a client has made use of one.

    Parameters
    ----------
    host, port : str, int
        Where to listen; port 0: any that is free, `port` says which.
    line : LineFormat
        What a record becomes.
    end : str
        What ends a line.
    kinds : sequence of str
        Kinds of records that are sent.
    needs_client : bool
        Records wait until somebody is connected. Otherwise they go to nobody.
    encoding : str
        Of lines; characters that it lacks are sent as "?".
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        line: LineFormat,
        end: str = "\r\n",
        kinds: Sequence[str] = ("part",),
        needs_client: bool = False,
        encoding: str = "utf-8",
    ) -> None:
        self.name = f"tcp {host}:{port}"
        self.host, self.port = host, port
        self._line, self._end, self._kinds = line, end, frozenset(kinds)
        self._needs_client, self._encoding = needs_client, encoding
        self._clients: set[asyncio.StreamWriter] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Listen."""
        loop = asyncio.new_event_loop()
        thread = threading.Thread(target=loop.run_forever, name=f"evqr {self.name}", daemon=True)
        thread.start()
        self._loop, self._thread = loop, thread
        try:
            asyncio.run_coroutine_threadsafe(self._listen(), loop).result(START_S)
        except BaseException:
            self.close()
            raise

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Send lines to all clients."""
        assert self._loop is not None
        lines = [self._line.fill(record) + self._end for record in records if record["record"] in self._kinds]
        if lines:
            sending = self._send("".join(lines).encode(self._encoding, "replace"))
            asyncio.run_coroutine_threadsafe(sending, self._loop).result(START_S)
        return ""

    def close(self) -> None:
        """Part from all clients, and listen no more."""
        loop, thread = self._loop, self._thread
        self._loop = self._thread = None
        if loop is None or thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._leave(), loop).result(START_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(START_S)
        loop.close()

    async def _listen(self) -> None:
        self._server = await asyncio.start_server(self._serve, self.host, self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Keep a client until it leaves; what it says is of no interest."""
        self._clients.add(writer)
        try:
            while await reader.read(4096):
                pass
        except OSError:
            pass
        finally:
            self._clients.discard(writer)
            writer.close()

    async def _send(self, data: bytes) -> None:
        if not self._clients and self._needs_client:
            raise ConnectionError("nobody is connected")
        for client in list(self._clients):
            if client.transport.get_write_buffer_size() > MOST_UNSENT:
                client.transport.abort()  # it does not read: it would keep lines for ever
            else:
                client.write(data)

    async def _leave(self) -> None:
        if hasattr(self, "_server"):
            self._server.close()
        for client in list(self._clients):
            client.close()
        await asyncio.sleep(0)
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            task.cancel()
        await asyncio.sleep(0)
