"""What all pictures share: matplotlib, colours, panels in inches, events as images."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evqr.errors import MissingExtra, UsageError
from evqr.events.array import EventArray
from evqr_kernels.extras import install_command

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ON, OFF, INK, GREY, FOUND = "#d9480f", "#1864ab", "#212529", "#adb5bd", "#2b8a3e"
FALSE_DARK, FALSE_LIGHT = "#e6009e", "#2fb344"  # magenta and green, as in Figure 8 of the paper

WIDTH, MARGIN, GAP, HEAD, TITLE, LEGEND = 12.0, 0.4, 0.35, 0.85, 0.3, 0.4
"""Of a page and its parts [inches]."""

TITLE_SIZE = 19.0
"""Of the heading's first line [points]."""

LONGEST_TITLE = 60 * TITLE_SIZE
"""Characters that a heading shows, times their size [points]."""

MOST_CELLS = 2000
"""Along one side of an image that events are added up in."""


def figure_class() -> type[Figure]:
    """Return matplotlib's `Figure`; raise MissingExtra where it is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra(f"drawing a picture needs matplotlib: {install_command('plot')}") from error
    except OSError as error:  # it wants a directory of its own
        raise UsageError(f"matplotlib cannot draw here: {' '.join(str(error).split())}") from error
    return Figure


def require_drawable(path: str | os.PathLike[str]) -> None:
    """Raise what `save_figure` raises for this path whatever it is to draw, before anything is computed."""
    path = Path(path)
    ending = path.suffix.removeprefix(".").lower()
    if ending not in figure_class()().canvas.get_supported_filetypes():
        raise UsageError(f"{path}: unknown picture format {ending!r}: end the name in .png, .svg or .pdf")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: cannot write the picture: no such folder")


def save_figure(path: str | os.PathLike[str], figure: Figure) -> None:
    """Write a figure to a PNG, SVG or PDF file, by its ending."""
    try:
        with warnings.catch_warnings():
            # A text in a script that the font lacks shows boxes here; the reading itself has it.
            warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
            figure.savefig(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot write the picture: {error.strerror or error}") from error


class Page:
    """A figure of panels that are placed in inches, from its lower left corner.

    Parameters
    ----------
    height : float [inches]
        Of all below the heading.
    title : str
        Its first line, shortened.
    facts : sequence of str
        Its second line.
    size : float [points]
        Of the first line.
    """

    def __init__(self, height: float, title: str, facts: Sequence[str], *, size: float = TITLE_SIZE) -> None:
        self._size = WIDTH, height + HEAD
        self.figure = figure_class()(figsize=self._size, dpi=110, facecolor="white")
        most = int(LONGEST_TITLE / size)
        title = title if len(title) <= most else title[: most - 1] + "\N{HORIZONTAL ELLIPSIS}"
        left, top = MARGIN / WIDTH, height + HEAD
        first, second = 1 - 0.5 / top, 1 - 0.8 / top
        self.figure.text(left, first, title, size=size, weight="bold", color=INK, parse_math=False)
        self.figure.text(left, second, "     ".join(facts), size=10.5, color="#495057", parse_math=False)

    def panel(self, left: float, bottom: float, width: float, height: float) -> Axes:
        """Make a panel."""
        across, up = self._size
        return self.figure.add_axes((left / across, bottom / up, width / across, height / up))


def frame(axes: Axes, title: str, *, ticks: bool = False) -> None:
    """Give a panel its title and its border."""
    axes.set_title(title, loc="left", size=11, color=INK, pad=5)
    if not ticks:
        axes.set(xticks=[], yticks=[])
    axes.tick_params(colors=GREY, labelsize=8.5)
    for spine in axes.spines.values():
        spine.set_color(GREY)


def legend(axes: Axes, entries: Sequence[tuple[str, str]]) -> None:
    """Coloured squares with their meaning, under a panel."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker="s", linestyle="", label=label) for colour, label in entries
    ]
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0, 0),
        ncols=len(handles),
        frameon=False,
        borderpad=0.4,
        borderaxespad=0,
        handletextpad=0.1,
        fontsize=9.5,
        labelcolor=INK,
    )


def outline(axes: Axes, corners: NDArray[np.float64], *, linewidth: float, dashed: bool = False) -> None:
    """Outer edge of a symbol; a dot at the corner where its rows and columns begin.

    What lies outside the panel is not shown, and the panel stays as it is.
    """
    from matplotlib.patches import Polygon

    style = "--" if dashed else "-"
    axes.add_patch(
        Polygon(corners, closed=True, fill=False, edgecolor=FOUND, linewidth=linewidth, linestyle=style)
    )
    axes.plot(*corners[0], "o", color=FOUND, markersize=3 * linewidth, scalex=False, scaley=False)


def arrow(axes: Axes, velocity: NDArray[np.float64]) -> None:
    """Direction of travel, in the lower left corner of a panel."""
    width, height = axes.bbox.width, axes.bbox.height
    vx, vy = velocity / max(float(np.hypot(*velocity)), 1e-9)
    side = min(width, height)
    reach_x, reach_y = 0.05 * side / width, 0.05 * side / height  # fractions of the panel
    x, y = 1.7 * reach_x, 1.7 * reach_y
    axes.annotate(
        "",
        xy=(x + reach_x * vx, y - reach_y * vy),
        xytext=(x - reach_x * vx, y + reach_y * vy),
        xycoords="axes fraction",
        arrowprops={
            "arrowstyle": "-|>",
            "color": INK,
            "linewidth": 2,
            "mutation_scale": 16,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def show_last_events(axes: Axes, events: EventArray) -> None:
    """Draw the last event of each pixel."""
    image = np.zeros((events.height, events.width), np.int8)
    image[events.y, events.x] = events.p
    axes.imshow(image, cmap=event_colours(), vmin=-1, vmax=1, interpolation="nearest")


def show_compensated(
    axes: Axes,
    events: EventArray,
    velocity: NDArray[np.float64],
    at_us: float,
    view: tuple[float, float, float, float],
) -> None:
    """Draw events moved to where they would be at a time, added up, in a view (x0, x1, y0, y1) [px]."""
    x0, x1, y0, y1 = view
    age_s = (events.t - at_us) * 1e-6
    # two cells a pixel: transported events lie between the pixels
    cells = [min(2 * int(np.ceil(side)), MOST_CELLS) for side in (y1 - y0, x1 - x0)]
    image, _, _ = np.histogram2d(
        events.y - velocity[1] * age_s,
        events.x - velocity[0] * age_s,
        bins=cells,
        range=((y0, y1), (x0, x1)),
        weights=events.p.astype(np.float64),
    )
    image = blur(image)
    strong = np.abs(image[image != 0.0])
    scale = float(np.quantile(strong, 0.98)) if strong.size else 1.0
    axes.imshow(
        image,
        cmap=event_colours(),
        vmin=-scale,
        vmax=scale,
        extent=(x0, x1, y1, y0),
        interpolation="bilinear",
    )


def event_colours():
    """Give the colours of sums of polarities, from darker to brighter."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("events", [OFF, "white", ON])


def blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Binomial blur, three cells wide."""
    for axis in (0, 1):
        image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image
