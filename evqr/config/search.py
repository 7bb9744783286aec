"""Settings of the search: the motion from cold, and finder patterns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from evqr.config.settings import Count, NotNegative, Positive, Range, Settings, Share


@dataclass(frozen=True, kw_only=True)
class MotionConfig(Settings):
    """Motion from cold, by correlation of the two halves of a window.

    Attributes
    ----------
    probe_us : int [us]
        Length of the first window tried while the speed is unknown. Chosen.
    travel_px : float [px]
        Travel that the window for the estimate is lengthened or shortened to. Chosen.
    longest_us : int [us]
        A window is never made longer than this: slower motion is not read. Chosen.
    reduction : int [px]
        Width of the coarse cells that events are binned on first. Chosen.
    reach_px : int [px]
        Largest displacement between halves that the fine correlation covers. Chosen.
    clip : float [events]
        Count of a pixel and half above which more does not matter: hot pixels. Chosen.
    blur_px : float [px]
        Half width of the window around a shift that the correlation there is averaged over. Measured with
        ``perf/motion_errors.py``: from 3 px on, things that move another way beside the code are mixed in.
    min_peak : float
        Correlation below which there is no common motion, 0 to 1. Chosen.
    fewest_events : int [events]
        A window with fewer says nothing about motion. Chosen.
    most_events : int [events]
        Of a window with more, every n-th are correlated, so many at most. Measured with
        ``perf/motion_errors.py``: the error of the speed stays below 1 % (2 % on a sensor with much noise).
    most_times : int [events]
        Events whose times are averaged, at most: they are quantiles, so that the mean is as good as that of
        all. Chosen.
    """

    probe_us: Annotated[int, Range(least=20, most=10_000_000)] = 1000
    travel_px: Annotated[float, Range(least=0.2, most=50.0)] = 3.0
    longest_us: Annotated[int, Range(least=20, most=10_000_000)] = 50_000
    reduction: Annotated[int, Range(least=1, most=64)] = 4
    reach_px: Annotated[int, Range(least=1, most=64)] = 3
    clip: Positive = 2.0
    blur_px: Annotated[float, Range(above=0.0, most=32.0)] = 2.5
    min_peak: Share = 0.02
    fewest_events: Annotated[int, Range(least=2)] = 200
    most_events: Annotated[int, Range(least=2)] = 32_000
    most_times: Count = 256

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.probe_us > self.longest_us:
            raise ValueError(f"probe_us must be at most longest_us, {self.longest_us}, got {self.probe_us}")


@dataclass(frozen=True, kw_only=True)
class SearchPass(Settings):
    """How thoroughly one pass over a window searches for finder patterns.

    Attributes
    ----------
    smallest_module_px : float [px]
        Smallest module searched. Chosen: below it noise looks like finder patterns.
    largest_module_px : float [px]
        Largest module searched. Chosen.
    floor : float
        Energy under a template, relative to that over cells of rms strength, below which a place is quiet.
        Chosen.
    peaks : int
        Places kept, the best over all sizes. Chosen.
    hypotheses : int
        Codes with several finder patterns that are tried, the best by response. Chosen.
    single_patterns : int
        Finder patterns that are each tried as the only one of a code where no code with several is found, the
        best by response; 0: none. Chosen.
    min_score : float
        Coarse score that a candidate needs to be refined, -1 to 1. Chosen.
    """

    smallest_module_px: Annotated[float, Range(least=1.0, most=200.0)] = 3.2
    largest_module_px: Annotated[float, Range(least=1.0, most=200.0)] = 22.0
    floor: NotNegative = 0.3
    peaks: Annotated[int, Range(least=3, most=1024)] = 64
    hypotheses: Count = 48
    single_patterns: Annotated[int, Range(least=0, most=1024)] = 4
    min_score: Annotated[float, Range(least=-1.0, most=1.0)] = -1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.largest_module_px < self.smallest_module_px:
            raise ValueError(
                f"largest_module_px must be at least smallest_module_px, {self.smallest_module_px}, "
                f"got {self.largest_module_px}"
            )


def _quick(smallest_module_px: float, largest_module_px: float) -> SearchPass:
    return SearchPass(
        smallest_module_px=smallest_module_px, largest_module_px=largest_module_px, floor=0.8, peaks=24,
        hypotheses=4, single_patterns=0, min_score=0.5,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FinderConfig(Settings):
    """Search for finder patterns with a bank of matched filters.

    Attributes
    ----------
    passes : tuple of SearchPass
        One after another until a code is found, the cheapest first: large modules, then small ones, then all
        of them and quiet places too. Chosen.
    scale_ratio : float
        Step from one module size to the next. Chosen.
    cells_a_module : float [cells/module]
        Resolution of the search. Chosen.
    half : int [cells]
        Half width of a template. Chosen.
    lag_cells : tuple of 2 floats [cells]
        Lag that is undone for ON and OFF events while it is not known, in cells of a pass's finest level.
        Chosen: little enough to do no harm where pixels do not lag.
    clip : float
        Cells are clipped at so many times the mean strength of those that have events: a hot pixel is no
        edge. Chosen.
    peaks_a_row : int
        Peaks kept of one row of a level. Chosen.
    triples_a_corner : int
        Triples kept that have one corner. Chosen.
    min_response : float
        Normalised response of a finder pattern that counts, 0 to 1. Chosen.
    first_hypotheses : int
        Hypotheses tried before the others, with all versions of their triples: most often one is the code.
        Chosen.
    leg_tolerance : float
        |log| of the ratio of the two legs of a triple. Chosen.
    scale_tolerance : float
        |log| of leg length over what symbol and module size ask for. Chosen.
    angle_tolerance : float [rad]
        Between leg and finder pattern, and from a right angle. Chosen.
    margin_px : float [px]
        How far the pose of a hypothesis may be off, for the size of the region around it. Chosen.
    sure_travel_px : float [px]
        Travel in a window below which the direction of the motion is not sure. Chosen.
    unsure_turns : tuple of floats [rad]
        Directions tried where it is not sure, against the estimate. Chosen: the opposite ones look like an
        inverted code.
    """

    passes: tuple[SearchPass, ...] = (_quick(4.9, 11.0), _quick(3.2, 4.0), SearchPass())
    scale_ratio: Annotated[float, Range(least=1.01, most=3.0)] = 1.22
    cells_a_module: Annotated[float, Range(least=1.0, most=8.0)] = 1.25
    half: Annotated[int, Range(least=3, most=32)] = 6
    lag_cells: tuple[NotNegative, NotNegative] = (0.25, 0.5)
    clip: Positive = 3.0
    peaks_a_row: Count = 8
    triples_a_corner: Count = 8
    min_response: Share = 0.28
    first_hypotheses: Count = 4
    leg_tolerance: Positive = 0.2
    scale_tolerance: Positive = 0.16
    angle_tolerance: Annotated[float, Range(above=0.0, most=0.25 * math.pi)] = 0.24
    margin_px: NotNegative = 4.0
    sure_travel_px: NotNegative = 0.6
    unsure_turns: tuple[Annotated[float, Range(least=-math.pi, most=math.pi)], ...] = (
        0.0, 0.25 * math.pi, -0.25 * math.pi, 0.5 * math.pi,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("passes", "unsure_turns"):
            if not getattr(self, name):
                raise ValueError(f"{name} must be a tuple of at least one, got ()")
