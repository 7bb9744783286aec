"""Records as variables of an OPC UA server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from evqr.extras import needs_extra
from evqr.sinks.sink import JsonRecord

if TYPE_CHECKING:
    from asyncua.sync import Server

NAMESPACE = "urn:evqr:line"

VARIABLES: dict[str, Any] = {
    "Part": 0,
    "Trigger": -1,
    "Read": False,
    "Text": "",
    "Reason": "",
    "ReasonCode": "",
    "LatencyMs": 0.0,
    "TimeUtc": "",
    "PartsRead": 0,
    "PartsNotRead": 0,
}
"""Of the object Line, with what they are before the first part; Part is written last of each part's."""


class OpcUa:
    """Serves the last part and counts as variables, to which clients subscribe; ``Part`` changes last.

    What is delivered is in the server: OPC UA does not tell whether a client has seen it, and a client that
    is slower than the parts sees the last ones.

    Parameters
    ----------
    endpoint : str
        Where to serve, as ``opc.tcp://0.0.0.0:4840/evqr``.

    Raises
    ------
    MissingExtra
        Its package is not installed.
    """

    def __init__(self, endpoint: str = "opc.tcp://127.0.0.1:4840/evqr") -> None:
        with needs_extra("serving OPC UA", "asyncua", "opcua"):
            import asyncua.sync

        self._make = asyncua.sync.Server
        self.name = f"opc ua {endpoint}"
        self._endpoint = endpoint
        self._server: Server | None = None
        self._variables: dict[str, Any] = {}
        self._counts = {"PartsRead": 0, "PartsNotRead": 0}

    def open(self) -> None:
        """Serve."""
        server = self._make()
        try:
            server.set_endpoint(self._endpoint)
            server.set_server_name("evqr")
            space = server.register_namespace(NAMESPACE)
            line = server.nodes.objects.add_object(space, "Line")
            values = {**VARIABLES, **self._counts}
            self._variables = {name: line.add_variable(space, name, value) for name, value in values.items()}
            server.start()
        except BaseException:
            server.tloop.stop()
            raise
        self._server = server

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Set the variables, part by part."""
        for record in records:
            if record["record"] != "part":
                continue
            texts = record.get("texts") or []
            read = bool(texts) and record.get("matches") is not False
            self._counts["PartsRead" if read else "PartsNotRead"] += 1
            values = {
                "Trigger": -1 if record.get("trigger") is None else int(record["trigger"]),
                "Read": read,
                "Text": "|".join(texts),
                "Reason": record.get("reason") or "",
                "ReasonCode": record.get("reason_code") or "",
                "LatencyMs": float(record.get("latency_ms") or 0.0),
                "TimeUtc": record.get("t_utc") or "",
                **self._counts,
                "Part": int(record.get("part") or 0),
            }
            for name, value in values.items():
                self._variables[name].write_value(value)
        return ""

    def close(self) -> None:
        """Serve no more."""
        server, self._server = self._server, None
        if server is not None:
            server.stop()
