"""Records to an MQTT broker."""

from __future__ import annotations

import string
from collections.abc import Sequence
from typing import Any

from evqr.extras import needs_extra
from evqr.sinks.sink import JsonRecord
from evqr.values import json_line

ANSWER_S = 10.0
"""How long the broker may take to answer."""


class Mqtt:
    """Publishes each record as a JSON object; delivered is what the broker has acknowledged (QoS 1).

    Parameters
    ----------
    host, port : str, int
        Of the broker.
    topic : str
        Where to, with keys of records in braces. What stands for an empty one is "-".
    user, password : str, optional
        Of an account there.
    tls : bool
        Encrypt, and check the broker's certificate by the system's.
    client : str
        Name of this client, which the broker knows only once.

    Raises
    ------
    MissingExtra
        Its package is not installed.
    """

    def __init__(
        self,
        host: str,
        port: int = 1883,
        *,
        topic: str = "evqr/{line}/{camera}/{record}",
        user: str | None = None,
        password: str | None = None,
        tls: bool = False,
        client: str = "",
    ) -> None:
        with needs_extra("publishing to MQTT", "paho-mqtt", "line"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion

        self.name = f"mqtt {host}:{port}"
        self._host, self._port = host, port
        self._topic = [(literal, name) for literal, name, _, _ in string.Formatter().parse(topic)]
        self._client = Client(CallbackAPIVersion.VERSION2, client_id=client, clean_session=not client)
        self._client.connect_timeout = ANSWER_S
        self._client.on_connect = self._connected
        if user is not None:
            self._client.username_pw_set(user, password)
        if tls:
            self._client.tls_set()
        self._refusal = ""

    def open(self) -> None:
        """Connect, and wait for the broker to agree."""
        self._refusal = ""
        self._client.connect(self._host, self._port)
        self._client.loop_start()

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Publish records, and wait until the broker has them."""
        sent = [self._client.publish(self._where(record), json_line(record), qos=1) for record in records]
        for each in sent:
            try:
                each.wait_for_publish(ANSWER_S)
            except RuntimeError as error:  # what the client says where there is no connection
                raise ConnectionError(self._refusal or str(error)) from error
            if not each.is_published():
                raise ConnectionError(self._refusal or "the broker does not answer")
        return ""

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._refusal = f"the broker refuses: {reason}" if reason.is_failure else ""

    def _where(self, record: JsonRecord) -> str:
        return "".join(
            literal + ("" if name is None else _level(record.get(name))) for literal, name in self._topic
        )


def _level(value: Any) -> str:
    """Give a level of a topic: signs that mean something there are left out."""
    return "".join(c for c in str(value if value is not None else "") if c not in "/+#\0") or "-"
