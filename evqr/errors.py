"""The errors that evqr raises for input it cannot use.

Every message is one line: what, where, which value, what to do.  The command line prints it and exits with 2.
"""


class EvqrError(Exception):
    """Base of the errors that a user's input can cause."""


class RecordingError(EvqrError, ValueError):
    """A recording that cannot be read: missing, truncated, not an event file, inconsistent."""


class MissingExtra(EvqrError, ImportError):
    """A format or option needs an optional package; the message names the pip command."""


class UsageError(EvqrError, ValueError):
    """An option, or a combination of options, that makes no sense."""
