"""From what a user names to the source that is meant."""

from __future__ import annotations

from pathlib import Path

from evqr.live.cameras import Camera
from evqr.live.connection import Connection
from evqr.live.inivation import DvStream
from evqr.live.source import Reopened

KINDS = (Connection, DvStream, Camera)
"""Classes of sources without an end; each knows its names."""


def live_source(where: str) -> Reopened | None:
    """Give the source without an end that a text names.

    Parameters
    ----------
    where : str
        ``tcp://HOST:PORT``, ``unix:PATH``, ``-``, ``dv://HOST:PORT``, ``camera`` or ``camera:SERIAL``; a file
        of that name goes before it.

    Returns
    -------
    source : Reopened or None
        None where it is a recording.

    Raises
    ------
    UsageError
        It is nearly such a name.
    MissingExtra
        A package is not installed.
    """
    return next(kind for kind in KINDS if kind.meant(where))(where) if is_live(where) else None


def is_live(where: str) -> bool:
    """Tell whether a text names a source without an end, without opening it.

    Parameters
    ----------
    where : str
        As of `live_source`.

    Returns
    -------
    is_live : bool
        False where it is a recording.
    """
    return any(kind.meant(where) for kind in KINDS) and not Path(where).exists()
