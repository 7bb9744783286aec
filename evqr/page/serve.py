"""Serving the page from a thread beside the line."""

from __future__ import annotations

import ipaddress
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from evqr.errors import UsageError
from evqr.extras import needs_extra
from evqr.page.app import make_app
from evqr.page.state import LineState

START_S = 10.0

LOOPBACK_NAMES = ("localhost", "127.0.0.1")


class PageServer:
    """Serves the page of a line; a context manager.

    Parameters
    ----------
    state : LineState
        What it tells.
    host, port : str, int
        Where; port 0: any that is free, `port` says which.
    token : str, optional
        What who asks must have; needed where others than this machine can ask.
    no_reads : Path, optional
        The folder of the flight recorder.
    use : callable, optional
        Changes the job, for who has the token.

    Raises
    ------
    UsageError
        Others could ask without a token, or the port is taken.
    MissingExtra
        Its packages are not installed.
    """

    def __init__(
        self,
        state: LineState,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        token: str | None = None,
        no_reads: Path | None = None,
        use: Callable[[str], None] | None = None,
    ) -> None:
        with needs_extra("the page of a line", "uvicorn", "line"):
            import uvicorn

        local = _is_loopback(host)
        if not local and not token:
            raise UsageError(f"the page on {host} can be asked for by other machines: set a token")
        app = make_app(state, no_reads=no_reads, token=token, hosts=LOOPBACK_NAMES if local else (), use=use)
        config = uvicorn.Config(app, host, port, log_config=None, access_log=False, lifespan="off", ws="none")
        self.host, self.port = host, port
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host.strip("[]"), port), family=family)
        except OSError as error:
            raise UsageError(
                f"the page cannot be served on {host}:{port} ({error.strerror or error}); name another port"
            ) from error
        self.port = int(self._socket.getsockname()[1])
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, name="evqr page", daemon=True
        )

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self.host}:{self.port}/"

    def __enter__(self) -> PageServer:
        self._thread.start()
        ends = time.monotonic() + START_S
        while not self._server.started and self._thread.is_alive() and time.monotonic() < ends:
            time.sleep(0.01)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.should_exit = True
        self._thread.join(START_S)
        self._socket.close()


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
