"""What systemd is told of a service, by its own protocol (sd_notify(3)); elsewhere, nothing happens."""

from __future__ import annotations

import os
import socket
from contextlib import suppress


class Notifier:
    """Tells systemd how a service is doing.

    Attributes
    ----------
    watchdog_s : float or None [s]
        Within which time it wants to hear of it; None: it does not.
    """

    def __init__(self) -> None:
        where = os.environ.get("NOTIFY_SOCKET", "")
        self._where = "\0" + where[1:] if where.startswith("@") else where
        watchdog = os.environ.get("WATCHDOG_USEC", "")
        ours = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(watchdog) / 1e6 if ours and watchdog.isdecimal() else None

    def tell(self, *lines: str) -> None:
        """Send lines such as ``READY=1``."""
        if not self._where:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as connection:
            connection.sendto("\n".join(lines).encode(), self._where)
