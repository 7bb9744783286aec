"""Messages that several symbols carry between them (structured append), put together from what was read."""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from evqr.symbol.payload import CharsetSource, Payload
from evqr.values import Value

MOST_COMBINATIONS = 4096
"""Ways to put parts together that are tried, where several messages have one parity."""

_Group = list[dict[bytes, tuple[int, Payload]]]
"""For each index the different parts that were read, by content; with the place in which each came first."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Message(Value):
    """A message, or what has passed of it.

    Attributes
    ----------
    text : str or None
        All of it; None while a part is missing.
    data : bytes or None
        The same as bytes.
    count : int
        Parts that it has.
    parity : int
        What its parts have in common; see `StructuredAppend`.
    missing : tuple of int
        Parts that were not read, 0 for the first.
    parity_agrees : bool or None
        Whether the bytes have the parity that a QR code says; None for other symbologies, and while a part is
        missing. Encoders that count bytes of another character set cause a False too.
    parts : tuple of Payload
        The parts that were read, in order: `CodeReading` objects when made of such.
    """

    text: str | None
    data: bytes | None
    count: int
    parity: int
    missing: tuple[int, ...] = ()
    parity_agrees: bool | None = None
    parts: tuple[Payload, ...] = field(repr=False)

    @property
    def complete(self) -> bool:
        """Whether all parts were read."""
        return not self.missing

    def __str__(self) -> str:
        name = f"message of {self.count} parts, parity {self.parity}"
        if self.complete:
            odd = "; the bytes have another parity" if self.parity_agrees is False else ""
            return f"{name}: {self.text!r}{odd}"
        missing = ", ".join(str(index + 1) for index in self.missing)
        return f"{name}: {len(self.parts)} passed, missing: {missing}"


def join_messages(readings: Iterable[Payload]) -> tuple[Message, ...]:
    """Put the parts of messages together, in whatever order they passed and however often.

    Parts belong together when symbology, parity and count are the same.  Where several messages agree in all
    of these, parts are chosen such that their bytes have the parity, those that passed closest together
    first.

    Parameters
    ----------
    readings : iterable of Payload
        What was read, of one recording or of several; what is no part is passed over.

    Returns
    -------
    messages : tuple of Message
        In the order in which their first parts came, complete or not.
    """
    groups: dict[tuple[str, int, int], _Group] = {}
    for place, reading in enumerate(readings):
        part = reading.structured_append
        if part is None or not 0 <= part.index < part.count:
            continue
        key = reading.symbology_identifier[:2], part.parity, part.count
        group = groups.setdefault(key, [{} for _ in range(part.count)])
        group[part.index].setdefault(reading.data, (place, reading))
    found = [placed for group in groups.values() for placed in _messages(group)]
    return tuple(message for _, message in sorted(found, key=operator.itemgetter(0)))


def _messages(group: _Group) -> Iterator[tuple[int, Message]]:
    """Give each message of one parity and count, with the place of its first part."""
    while any(group):
        chosen = _choice(group)
        for index, (_, part) in chosen.items():
            del group[index][part.data]
        places = [place for place, _ in chosen.values()]
        yield min(places), _message({index: part for index, (_, part) in chosen.items()}, len(group))


def _choice(group: _Group) -> dict[int, tuple[int, Payload]]:
    """Choose one part of each index that has any."""
    there = [index for index, parts in enumerate(group) if parts]
    ways = math.prod(len(group[index]) for index in there)
    if ways == 1 or len(there) < len(group) or ways > MOST_COMBINATIONS:
        return {index: next(iter(group[index].values())) for index in there}

    def span(way: Sequence[tuple[int, Payload]]) -> tuple[bool, int]:
        places = [place for place, _ in way]
        return not _agrees([part for _, part in way]), max(places) - min(places)

    best = min(itertools.product(*(parts.values() for parts in group)), key=span)
    return dict(enumerate(best))


def _message(parts: dict[int, Payload], count: int) -> Message:
    ordered = [parts[index] for index in sorted(parts)]
    append = ordered[0].structured_append
    assert append is not None
    complete = len(ordered) == count
    return Message(
        text=_text(ordered) if complete else None,
        data=b"".join(part.data for part in ordered) if complete else None,
        count=count,
        parity=append.parity,
        missing=tuple(index for index in range(count) if index not in parts),
        parity_agrees=_agrees(ordered) if complete and _is_qr(ordered[0]) else None,
        parts=tuple(ordered),
    )


def _is_qr(part: Payload) -> bool:
    return part.symbology_identifier.startswith("]Q")


def _agrees(parts: Sequence[Payload]) -> bool:
    """Whether the bytes have the parity; ISO/IEC 18004, 8.3.  True where no parity is known."""
    append = parts[0].structured_append
    if append is None or not _is_qr(parts[0]):
        return True
    return functools.reduce(operator.xor, b"".join(part.data for part in parts), 0) == append.parity


def _text(parts: Sequence[Payload]) -> str:
    """Join the texts; in one piece where they are of one character set, because a character may be cut."""
    data = b"".join(part.data for part in parts)
    sources = {part.charset_source for part in parts if part.charset != "ascii"}
    names = {part.charset for part in parts} - {"ascii"}
    if sources == {CharsetSource.GUESSED}:
        names = {"utf-8"}  # of which a part alone may be no more than a half
    if len(sources) == 1 and len(names) == 1 and None not in names:
        try:
            return data.decode(str(names.pop()))
        except UnicodeError:
            pass
    return "".join(part.text for part in parts)
