"""The paper's metrics (section 4.4), and those that a production line asks for.

The paper's read rate counts the trials that *converged*: 8.77 % and 1.30 % in its Table 1 are 5 of 57 and 1
of 77, and no share of its N = 150 trials.  A trial in which no code was found, or which did not converge, is
missing from it.  `read_rate` follows the paper; `yield_rate` counts every trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evqr.paper.dataset.truth import Modules, Truth

FEW_WRONG = 5
"""Wrong codewords up to which a code can be decoded, as the paper has it (section 4.1): about a tenth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """What one attempt of one method gave.

    Attributes
    ----------
    modules : (r, r) int8
        -1 dark, +1 light, when it ended; None where no code was found.
    converged : bool
        Whether it ended by its own criterion.
    text : str, optional
        What it read when it ended; None when nothing.
    image_text : str, optional
        What an ordinary decoder read from its image; None when nothing.
    has_image : bool
        Whether it gives an image at all.
    best_accuracy : float, optional
        Bit accuracy of its best iterate; None where no code was found.
    iterations_to_read : int, optional
        Of its first iterate that decodes to the true text, None where there is none.
    seconds_to_read : float [s], optional
        Computing time to that iterate.
    seconds : float [s]
        Computing time until it ended by its own criterion, or gave up.
    windows : int
        Windows of events that it needed.
    confidence : float, optional
        That its text is right, 0 to 1; None where it does not say.
    events_per_edge : float, optional
        Events it had, over the edges between the code's modules (`edges_of`).
    start : str, optional
        Which of several starts it took; None: it has one, or none was found.
    pose_iterations : int, optional
        Before the iterates that count; None: none.
    iterations_to_few : int, optional
        Of its first iterate with up to `FEW_WRONG` wrong codewords; None: there is none.
    search_seconds : float, optional
        Of ``seconds_to_read``, spent on finding the code; None: no step apart.
    """

    modules: Modules | None = None
    converged: bool = False
    text: str | None = None
    image_text: str | None = None
    has_image: bool = False
    best_accuracy: float | None = None
    iterations_to_read: int | None = None
    seconds_to_read: float | None = None
    seconds: float = 0.0
    windows: int = 1
    confidence: float | None = None
    events_per_edge: float | None = None
    start: str | None = None
    pose_iterations: int | None = None
    iterations_to_few: int | None = None
    search_seconds: float | None = None


@dataclass(frozen=True, kw_only=True)
class Score:
    """A cell of the table; shares are 0 to 1, None where nothing can be said.

    Attributes
    ----------
    trials : int
        N of the paper.
    found : int
        Trials in which a code was found and that converged.
    mode_accuracy : float, optional
        Of the mode over the trials that converged.
    max_accuracy : float, optional
        Of the best iterate of the best trial.
    seconds_to_read, iterations_to_read : float, optional
        Means over the trials that read at some iterate.
    median_seconds_to_read : float, optional
        Of the same trials.
    median_search_seconds : float, optional
        Part of it that is spent on finding the code.
    read_rate : float, optional
        Of the trials that converged (the paper's).
    yield_rate : float, optional
        Of all trials.
    image_read_rate : float, optional
        Of all trials, from the image, by an ordinary decoder.
    false_read_rate : float, optional
        Trials that gave a wrong text, of all trials.
    seconds : float [s], optional
        Mean computing time of a trial.
    windows : float, optional
        Mean number of windows of the trials that read.
    """

    trials: int
    found: int
    mode_accuracy: float | None
    max_accuracy: float | None
    seconds_to_read: float | None
    iterations_to_read: float | None
    median_seconds_to_read: float | None
    median_search_seconds: float | None
    read_rate: float | None
    yield_rate: float | None
    image_read_rate: float | None
    false_read_rate: float | None
    seconds: float | None
    windows: float | None


@dataclass(frozen=True, kw_only=True)
class Bin:
    """Values whose key lies in one interval.

    Attributes
    ----------
    low, high : float
        Bounds of the key, the upper one not included (but for the last interval).
    count : int
        How many.
    key, value : float
        Their means.
    """

    low: float
    high: float
    count: int
    key: float
    value: float


def bit_accuracy(modules: Modules, truth: Truth) -> float:
    """Share of the modules outside the known part that are right."""
    free = ~truth.known
    return float(np.mean(np.sign(modules[free]) == truth.modules[free]))


def mode_of(grids: Sequence[Modules]) -> Modules:
    """Majority of each module over grids; a tie is light."""
    return np.where(np.sum(grids, axis=0, dtype=np.int64) < 0, -1, 1).astype(np.int8)


def mode_accuracy(trials: Sequence[Trial], truth: Truth) -> float | None:
    """Bit accuracy of the mode over the trials that converged; None without one."""
    grids = [trial.modules for trial in trials if trial.converged and trial.modules is not None]
    return bit_accuracy(mode_of(grids), truth) if grids else None


def max_accuracy(trials: Sequence[Trial]) -> float | None:
    """Bit accuracy of the best iterate, converged or not; None where no code was ever found."""
    return max((t.best_accuracy for t in trials if t.best_accuracy is not None), default=None)


def mean_to_read(trials: Sequence[Trial]) -> tuple[float | None, float | None]:
    """Mean seconds and iterations to the first iterate that reads, over the trials that have one."""
    seconds = [t.seconds_to_read for t in trials if t.seconds_to_read is not None]
    iterations = [t.iterations_to_read for t in trials if t.iterations_to_read is not None]
    return _mean(seconds), _mean(iterations)


def median_to_read(trials: Sequence[Trial]) -> float | None:
    """Median seconds to the first iterate that reads: being stopped for a while does not move it."""
    return _median([t.seconds_to_read for t in trials if t.seconds_to_read is not None])


def median_search(trials: Sequence[Trial]) -> float | None:
    """Median seconds that the same trials spent on finding the code; None where it is no step apart."""
    read = [trial for trial in trials if trial.seconds_to_read is not None]
    return _median([t.search_seconds for t in read if t.search_seconds is not None])


def wrong_codewords(modules: Modules, truth: Truth, bits: NDArray[np.intp]) -> int:
    """Count the codewords with a wrong bit.

    Parameters
    ----------
    modules : (V, U) int8
        -1 dark, +1 light.
    truth : Truth
        What the code says.
    bits : (8 n,) intp
        Flat module index of each codeword's bits, `evqr.symbol.qr_codewords.codeword_layout`.
    """
    wrong = np.sign(modules.ravel()[bits]) != truth.modules.ravel()[bits]
    return int(wrong.reshape(-1, 8).any(axis=1).sum())


def read_rate(trials: Sequence[Trial], truth: Truth) -> float | None:
    """Share of the trials that converged which read the true text; 0 where none converged."""
    if not trials:
        return None
    return _mean([t.text == truth.text for t in trials if t.converged]) or 0.0


def yield_rate(trials: Sequence[Trial], truth: Truth) -> float | None:
    """Share of all trials that read the true text."""
    return _mean([t.text == truth.text for t in trials])


def image_read_rate(trials: Sequence[Trial], truth: Truth) -> float | None:
    """Share of all trials whose image an ordinary decoder reads; None for a method without images."""
    return _mean([t.image_text == truth.text for t in trials if t.has_image])


def false_read_rate(trials: Sequence[Trial], truth: Truth) -> float | None:
    """Share of all trials that gave a text, from modules or image, that is wrong."""
    wrong = [{t.text, t.image_text} - {None, truth.text} for t in trials]
    return _mean([bool(texts) for texts in wrong])


def score(trials: Sequence[Trial], truth: Truth) -> Score:
    """Take all metrics of a cell."""
    seconds_to_read, iterations_to_read = mean_to_read(trials)
    return Score(
        trials=len(trials),
        found=sum(t.converged for t in trials),
        mode_accuracy=mode_accuracy(trials, truth),
        max_accuracy=max_accuracy(trials),
        seconds_to_read=seconds_to_read,
        iterations_to_read=iterations_to_read,
        median_seconds_to_read=median_to_read(trials),
        median_search_seconds=median_search(trials),
        read_rate=read_rate(trials, truth),
        yield_rate=yield_rate(trials, truth),
        image_read_rate=image_read_rate(trials, truth),
        false_read_rate=false_read_rate(trials, truth),
        seconds=_mean([t.seconds for t in trials]),
        windows=_mean([t.windows for t in trials if t.text == truth.text]),
    )


def binned(keys: ArrayLike, values: ArrayLike, bounds: Sequence[float]) -> list[Bin]:
    """Give the mean of values whose keys lie in the same interval, for every interval that is not empty.

    With accuracies or reads (0, 1) as values and events per edge as keys this is bits or read rate against
    events per module edge.

    Parameters
    ----------
    keys, values : (N,) float64
        What is sorted into intervals by its key.
    bounds : (K + 1,)
        Ascending; keys outside of them are left out.
    """
    key, value = np.asarray(keys, np.float64), np.asarray(values, np.float64)
    place = np.searchsorted(bounds, key, side="right") - 1
    place[key == bounds[-1]] = len(bounds) - 2
    bins = []
    for index in range(len(bounds) - 1):
        inside = place == index
        if inside.any():
            bins.append(
                Bin(
                    low=float(bounds[index]),
                    high=float(bounds[index + 1]),
                    count=int(inside.sum()),
                    key=float(key[inside].mean()),
                    value=float(value[inside].mean()),
                )
            )
    return bins


def calibration(confidence: ArrayLike, right: ArrayLike, bounds: Sequence[float]) -> tuple[list[Bin], float]:
    """Compare stated confidence with the share that is right.

    Returns
    -------
    bins : list of Bin
        Mean confidence (key) and share right (value) of each interval of confidence.
    error : float
        Mean distance of the two, weighted by how many: the expected calibration error; 0 without any.
    """
    bins = binned(confidence, right, bounds)
    count = sum(entry.count for entry in bins)
    error = sum(entry.count * abs(entry.key - entry.value) for entry in bins) / max(count, 1)
    return bins, error


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
