"""Bytes from a socket or from standard input, decoded; a socket that is lost is connected to again."""

from __future__ import annotations

import os
import selectors
import socket
import sys
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

from evqr.errors import RecordingError, UsageError
from evqr.live.evt3_stream import Evt3Decoder
from evqr.live.packed_stream import MAGIC, PackedDecoder
from evqr.live.pieces import Idle, Piece
from evqr.live.source import IDLE_S, RETRY_S, Reopened

AT_ONCE = 1 << 20
"""Bytes taken at once at most."""

CONNECT_S = 5.0

SCHEMES = "tcp://HOST:PORT, unix:PATH or -"

Decoder = PackedDecoder | Evt3Decoder


class Connection(Reopened):
    """A stream of events from a socket that somebody listens on, or from standard input.

    The first bytes of each connection tell whether it is a packed stream or EVT3.

    Parameters
    ----------
    where : str
        ``tcp://HOST:PORT``, ``unix:PATH``, or ``-`` for standard input.
    retry_s : (float, float) [s]
        First and longest time between two tries to connect.

    Raises
    ------
    UsageError
        It is none of these.
    """

    def __init__(self, where: str, *, retry_s: tuple[float, float] = RETRY_S) -> None:
        super().__init__(where, retry_s)
        self._connect = _connector(where)

    @staticmethod
    def meant(where: str) -> bool:
        """Whether a text names such a source."""
        return where == "-" or where.startswith(("tcp://", "unix:"))

    def pieces(self) -> Iterator[Piece]:
        """Give what comes, until it is stopped; of standard input, until its end.

        Yields
        ------
        piece : Piece
            `Idle` where nothing comes; `Interrupted` once for each time that the connection is lost or cannot
            be made.

        Raises
        ------
        RecordingError
            Standard input is no stream of events. What a connection sends that is none is a reason to connect
            again.
        """
        return self._from(sys.stdin.fileno()) if self._connect is None else super().pieces()

    def _opened(self) -> Iterator[Piece]:
        assert self._connect is not None
        with self._connect() as connected:
            connected.setblocking(False)
            yield from self._from(connected.fileno())

    def _from(self, number: int) -> Iterator[Piece]:
        """Decode what comes from a file descriptor, up to its end."""
        decoder: Decoder | None = None
        begun = b""
        with selectors.DefaultSelector() as selector:
            try:
                selector.register(number, selectors.EVENT_READ)
            except PermissionError:  # a file on a disk: there is never anything to wait for
                selector = None
            while not self._stopped.is_set():
                if selector is not None and not selector.select(IDLE_S):
                    yield Idle()
                    continue
                try:
                    data = os.read(number, AT_ONCE)
                except BlockingIOError:
                    continue
                if not data:
                    break
                if decoder is None:
                    begun += data
                    decoder = self._decoder(begun)
                    if decoder is None:
                        continue
                    data = begun
                yield from decoder.feed(data)

    def _decoder(self, begun: bytes) -> Decoder | None:
        """Tell by the first bytes what is sent; None while they are too few."""
        if begun[: len(MAGIC)] == MAGIC:
            return PackedDecoder(self.name)
        if begun[:2] == b"% ":
            return Evt3Decoder(self.name)
        if MAGIC.startswith(begun) or b"% ".startswith(begun):
            return None
        raise RecordingError(
            f"{self.name}: begins with {begun[:8]!r}, neither a packed stream nor EVT3; see what sends it"
        )


def _connector(where: str) -> Callable[[], socket.socket] | None:
    """Give what connects; None for standard input."""
    if where == "-":
        return None
    if where.startswith("unix:") and len(where) > len("unix:"):
        path = where.removeprefix("unix:").removeprefix("//")

        def connect_to_path() -> socket.socket:
            connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            connected.settimeout(CONNECT_S)
            try:
                connected.connect(path)
            except BaseException:
                connected.close()
                raise
            return connected

        return connect_to_path
    try:
        parts = urlsplit(where)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not where.startswith("tcp://") or not host or not port:
        raise UsageError(f"{where}: is no source of events; write {SCHEMES}")
    return lambda: socket.create_connection((host, port), CONNECT_S)
