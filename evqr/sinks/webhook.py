"""Records to a web address."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from evqr.extras import needs_extra
from evqr.sinks.sink import JsonRecord
from evqr.values import json_line

ANSWER_S = 10.0
"""How long the server may take to answer."""

NOT_NOW = (408, 425, 429)
"""HTTP statuses, beside those of 500 and more, after which the same is sent again."""


class Webhook:
    """Posts records, several together, as a JSON list; what is answered with 2xx is delivered.

    Other answers below 500 mean that these records are refused for good: they are counted and left out.

    Parameters
    ----------
    url : str
        Where to.
    headers : mapping of str to str
        Such as ``{"Authorization": "Bearer ..."}``.

    Raises
    ------
    MissingExtra
        Its package is not installed.
    """

    def __init__(self, url: str, *, headers: Mapping[str, str] | None = None) -> None:
        with needs_extra("posting to a web address", "httpx", "line"):
            import httpx

        self._httpx = httpx
        self.name = f"webhook {httpx.URL(url).copy_with(username=None, password=None, query=None)}"
        self._url = url
        self._headers = {"Content-Type": "application/json", **(headers or {})}

    def open(self) -> None:
        """Begin a session."""
        self._client = self._httpx.Client(timeout=ANSWER_S, headers=self._headers)

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Post records."""
        body = "[" + ",".join(map(json_line, records)) + "]"
        try:
            answer = self._client.post(self._url, content=body.encode("ascii"))
        except self._httpx.HTTPError as error:
            raise ConnectionError(str(error) or type(error).__name__) from error
        said = f"the server answers {answer.status_code} {answer.reason_phrase}"
        if answer.status_code >= 500 or answer.status_code in NOT_NOW:
            raise ConnectionError(said)
        return "" if answer.is_success else said

    def close(self) -> None:
        """End the session."""
        self._client.close()
