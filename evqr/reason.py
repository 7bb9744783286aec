"""Why nothing was found or read: a closed set for programs, each with a text for people."""

from __future__ import annotations

from enum import Enum


class Reason(str, Enum):
    """Why there is no reading; the value is its code, as ``reason_code`` in records.

    Attributes
    ----------
    text : str
        The same in words.
    """

    text: str

    NO_EVENTS = "no_events", "no events"
    SOURCE_ERROR = "source_error", "the source cannot be read"
    MISSING_EXTRA = "missing_extra", "an optional package is needed"
    BACKEND_UNAVAILABLE = "backend_unavailable", "the backend or the device is not there"
    BAD_USE = "bad_use", "an option makes no sense"
    FAILED = "failed", "reading ended with an error that is not the recording's"
    WORKER_LOST = "worker_lost", "the process that read it has ended"
    RECORDING_ENDS = "recording_ends", "the recording ends"
    TOO_FEW_EVENTS = "too_few_events", "too few events"
    NOTHING_MOVES = "nothing_moves", "nothing moves"
    NO_FINDER_PATTERNS = "no_finder_patterns", "no finder patterns that fit together"
    DISAGREES = "disagrees", "what comes closest agrees too little with a code"
    NOT_DECODED = "not_decoded", "a code was followed but does not decode"
    FORMAT_UNREADABLE = "format_unreadable", "format information unreadable"
    TOO_MANY_ERRORS = "too_many_errors", "error correction failed"
    POSSIBLY_CHANCE = "possibly_chance", "possibly chance"
    NO_CONTENT = "no_content", "error correction succeeded, but the data is empty or malformed"

    NOTHING_LIKE_A_CODE = "nothing_like_a_code", "nothing like a code"
    PARTLY_IN_VIEW = "partly_in_view", "a code was never wholly in view"
    TOO_FAST = "too_fast", "too fast"
    TOO_SLOW = "too_slow", "too slow"
    OTHER_PART = "other_part", "the code in view was given to another part"
    NO_MATCH = "no_match", "what was read is not what was expected"
    DEADLINE = "deadline", "what was to be searched was not when the part had to be told"
    TRIGGER_LATE = "trigger_late", "the trigger came too late"
    OVERLOAD = "overload", "events came faster than they could be read"
    SILENCE = "silence", "no event came"
    INTERRUPTED = "interrupted", "the connection to the source was lost"
    EVENTS_DROPPED = "events_dropped", "events were wrong or came too late, and were left out"

    def __new__(cls, code: str, text: str) -> Reason:
        """Make a member of its code and its text."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    def __str__(self) -> str:
        return self.value

    def explained(self, detail: str = "") -> str:
        """Return the text, followed by what it was in one case.

        Parameters
        ----------
        detail : str
            In words; nothing is added where it is empty.

        Returns
        -------
        str
            One line.
        """
        return f"{self.text}: {detail}" if detail else self.text
