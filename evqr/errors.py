"""The errors that evqr raises for input it cannot use; misuse of a function is a TypeError or a ValueError.

| error | means | what to do |
|---|---|---|
| `EvqrError` | base of all below | catch it to go on with the next recording |
| `RecordingError` | a recording that cannot be read | its message says where, and the way out |
| `StreamChoice` | a recording with several streams | name one of its `StreamChoice.streams` |
| `MissingExtra` | a format or an option needs an optional package | run the pip command in the message |
| `UsageError` | an option, or a combination of options, makes no sense | change it as the message says |
| `BackendError` | there is no such backend or device on this machine | choose one that the message names |

Every message is one line: what, where, which value, what to do.  The command line prints it and exits with 2;
`read_many` makes it a result with status ERROR, whose ``reason_code`` is the error's `reason`.
"""

from __future__ import annotations

from typing import ClassVar

from evqr.reason import Reason


class EvqrError(Exception):
    """Base of the errors that a user's input can cause."""

    reason: ClassVar[Reason] = Reason.FAILED
    """What programs can branch on"""


class RecordingError(EvqrError, ValueError):
    """A recording that cannot be read: missing, truncated, not an event file, inconsistent."""

    reason = Reason.SOURCE_ERROR


class StreamChoice(RecordingError):
    """A recording with several event streams, of which one must be named.

    Attributes
    ----------
    streams : tuple of str
        Their names.
    """

    def __init__(self, message: str, streams: tuple[str, ...]) -> None:
        super().__init__(message, streams)  # both, so that it can be pickled and come back from a worker
        self.streams = streams

    def __str__(self) -> str:
        return str(self.args[0])


class MissingExtra(EvqrError, ImportError):
    """A format or option needs an optional package; the message names the pip command."""

    reason = Reason.MISSING_EXTRA


class UsageError(EvqrError, ValueError):
    """An option, or a combination of options, that makes no sense."""

    reason = Reason.BAD_USE


class BackendError(EvqrError, ValueError):
    """A backend or a device that is not there; the message names those that are, or what to install."""

    reason = Reason.BACKEND_UNAVAILABLE
