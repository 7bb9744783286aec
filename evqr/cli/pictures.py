"""Where the pictures of readings go: the first to a file, or all of them to a folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evqr.cli.sources import Named
from evqr.errors import UsageError
from evqr.output.drawing import require_drawable, save_figure
from evqr.output.nothing_read import draw_nothing_read
from evqr.output.picture import picture_events, save_picture
from evqr.results import ReadResult, ReadStatus


class Pictures:
    """Draws what recordings gave.

    Parameters
    ----------
    place : path
        A file, whose ending says of what kind, for one recording; or a folder, which is made.
    recordings : sequence of Named
        All that will be read, for names that differ.

    Raises
    ------
    MissingExtra
        Matplotlib is not installed.
    UsageError
        The place cannot be drawn to, or is a file for several recordings.
    """

    def __init__(self, place: Path, recordings: Sequence[Named]) -> None:
        self._place = place
        self._folder = place.is_dir() or not place.suffix
        if self._folder:
            try:
                place.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UsageError(f"{place}: cannot be made ({error.strerror or error})") from error
            require_drawable(place / "reading.png")
        elif len(recordings) != 1:
            raise UsageError(
                f"--picture {place} is one file: name a folder for the pictures of several recordings"
            )
        else:
            require_drawable(place)
        stems = Counter(_stem(named) for named in recordings)
        self._stems = {
            named.name: _stem(named) if stems[_stem(named)] == 1 else f"{_stem(named)}-{index}"
            for index, named in enumerate(recordings, start=1)
        }

    def draw(self, named: Named, result: ReadResult, opening: Mapping[str, Any]) -> None:
        """Draw what a recording gave; one that could not be read has no picture."""
        if result.status is ReadStatus.ERROR:
            return
        from evqr.recording import open_recording

        stem = self._stems[named.name]
        with open_recording(named.path, **opening) as recording:
            shown = result.readings if self._folder else result.readings[:1]
            for number, reading in enumerate(shown, start=1):
                path = self._place / f"{stem}-{number}.png" if self._folder else self._place
                save_picture(path, picture_events(recording, reading), reading)
            if not shown:
                path = self._place / f"{stem}-nothing-read.png" if self._folder else self._place
                save_figure(path, draw_nothing_read(recording, result))


def _stem(named: Named) -> str:
    return "stdin" if named.name == "-" else Path(named.name).stem
