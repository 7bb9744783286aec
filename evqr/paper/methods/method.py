"""What every method of the comparison has in common: what it takes, what it gives, who watches it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window, make_window


class Watch(Protocol):
    """Whoever wants to see the iterates of a method."""

    def __call__(self, iteration: int, estimate: NDArray[Any], converged: bool, /) -> bool:
        """Look at what an iteration gave, modules or an image, and say whether enough was seen.

        ``converged``: the method itself would end, or has ended, with this or an earlier iterate.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a method made of what it saw.

    Attributes
    ----------
    modules : (r, r) float
        < 0 dark, > 0 light; None without a code, or for a method that gives an image.
    image : (Y, X) float, optional
        Luminance, larger is lighter; None for a method that gives modules.
    text : str, optional
        What it reads; None when nothing, or when reading its image is left to others.
    converged : bool
        Whether it ended by its own criterion.
    pose : (3, 3) float64, optional
        Code coordinates to px at the middle of its last window, of modules; or None.
    time_us : float [us], optional
        Time that the image or the modules are of; None: the middle of what was seen.
    windows : int
        Windows of events that it needed, of those it was given.
    confidence : float, optional
        That the text is right, 0 to 1; None where it does not say.
    start : str, optional
        Which of several starts it took; None: it has one, or none was found.
    pose_iterations : int, optional
        That it took before those that are watched; None: none.
    search_seconds : float [s], optional
        Of its time, spent on finding the code; None where that is no step of its own.
    """

    modules: NDArray[np.floating[Any]] | None = None
    image: NDArray[Any] | None = None
    text: str | None = None
    converged: bool = True
    pose: NDArray[np.float64] | None = None
    time_us: float | None = None
    windows: int = 1
    confidence: float | None = None
    start: str | None = None
    pose_iterations: int | None = None
    search_seconds: float | None = None


class Method(Protocol):
    """A way to read a code.

    Attributes
    ----------
    takes : Literal['events', 'frame']
        "events": a `Window`; "frame": an image (Y, X) uint8.
    windows : int
        Windows of the scene's length that one `Window` holds.
    matched : bool
        Whether codes are read from its image by the paper's pattern matching (section 4.4).
    """

    takes: Literal["events", "frame"]
    windows: int
    matched: bool

    def read(self, seen: Any, watch: Watch) -> Outcome:
        """Read a code from what is seen, and let each iterate be watched."""
        ...


def unwatched(iteration: int, estimate: NDArray[Any], converged: bool) -> bool:
    """Watch nothing, and see enough at once."""
    return True


def cut(window: Window, count: int, index: int) -> Window:
    """Give the ``index``-th of ``count`` equal parts of a window, its times relative to its own middle."""
    step = (window.end_us - window.start_us) / count
    start, end = (window.start_us + round(step * k) for k in (index, index + 1))
    return make_window(window.events, start, end)
