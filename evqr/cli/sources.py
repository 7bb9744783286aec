"""From what a user names to the recordings that are meant: files, folders, patterns, ``-``."""

from __future__ import annotations

import glob
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from evqr.errors import UsageError

STANDARD_INPUT = "-"

SUFFIXES = (
    ".h5", ".hdf5", ".npz", ".npy", ".txt", ".csv", ".tsv", ".raw", ".dat", ".aedat4", ".aedat", ".bag",
    ".mcap", ".db3", ".mat",
)  # fmt: skip
"""What recordings in a folder end in; files that are named are taken whatever their name."""


class Named(NamedTuple):
    """A recording to read.

    Attributes
    ----------
    name : str
        As the user knows it; "-" for standard input.
    path : Path
        Where it is.
    """

    name: str
    path: Path


@contextmanager
def recordings_of(sources: Sequence[str]) -> Iterator[list[Named]]:
    """Give the recordings that are meant, in order.

    Raises
    ------
    UsageError
        A folder or a pattern has none; standard input cannot be kept.
    """
    with _Input() as standard_input:
        yield [named for source in sources for named in _found(source, standard_input)]


def _found(source: str, standard_input: _Input) -> list[Named]:
    try:
        return list(_meant(source, standard_input))
    except OSError:  # it cannot be looked at: reading it says why, and goes on with the others
        return [Named(source, Path(source))]


def _meant(source: str, standard_input: _Input) -> Iterator[Named]:
    if source == STANDARD_INPUT:
        yield Named(source, standard_input.path())
        return
    path = Path(source)
    if path.is_dir() and not (path / "metadata.yaml").exists():  # the folder of a ROS 2 bag is a recording
        inside = sorted(each for each in path.iterdir() if _may_be_a_recording(each))
        if not inside:
            raise UsageError(
                f"{source}: no recordings in this folder (names that end in {', '.join(SUFFIXES)})"
            )
        yield from (Named(str(each), each) for each in inside)
    elif glob.has_magic(source) and not path.exists():
        matching = sorted(glob.glob(source, recursive=True))
        if not matching:
            raise UsageError(f"{source}: no file matches this pattern")
        yield from (Named(each, Path(each)) for each in matching if not os.path.isdir(each))
    else:
        yield Named(source, path)


def _may_be_a_recording(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    return path.suffix.lower() in SUFFIXES if path.is_file() else (path / "metadata.yaml").exists()


class _Input:
    """Standard input as a file, since formats are recognised and read at several places of a file."""

    def __init__(self) -> None:
        self._path: Path | None = None

    def __enter__(self) -> _Input:
        return self

    def __exit__(self, *failure: object) -> None:
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def path(self) -> Path:
        """Read standard input, once."""
        if self._path is None:
            stream = getattr(sys.stdin, "buffer", None)
            if stream is None or stream.isatty():
                raise UsageError("-: nothing comes by standard input; pipe a recording into evqr")
            try:
                number, name = tempfile.mkstemp(prefix="evqr-stdin-")
                self._path = Path(name)
                with os.fdopen(number, "wb") as file:
                    shutil.copyfileobj(stream, file, 1 << 20)
            except OSError as error:
                raise UsageError(
                    f"-: what comes by standard input cannot be kept among temporary files"
                    f" ({error.strerror or error}); name a file instead"
                ) from error
        return self._path
