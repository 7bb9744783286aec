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
class FinderPass(Settings):
    """What one pass over a window takes for a finder pattern.

    Attributes
    ----------
    least_module_px : float [px]
        Smallest module that it searches; 0: all that are searched. Chosen: two thirds of the cells are for
        smaller ones.
    floor : float
        Energy under a template, relative to that over cells of rms strength, below which a place is quiet.
        Chosen.
    min_first : float
        The same of the part of a pattern that is alike in all directions, which is computed first. Chosen:
        those of codes were seen to be 0.44 and more.
    min_response : float
        Normalised response of a finder pattern that counts, 0 to 1. Chosen.
    slack : float
        Factor on the tolerances of triples. Chosen.
    """

    least_module_px: NotNegative = 0.0
    floor: NotNegative = 0.5
    min_first: Share = 0.27
    min_response: Share = 0.32
    slack: Positive = 1.0


@dataclass(frozen=True, kw_only=True)
class FinderConfig(Settings):
    """Search for finder patterns with a bank of matched filters, and for the codes that they belong to.

    Attributes
    ----------
    smallest_module_px : float [px]
        Smallest module searched. Chosen: below it noise looks like finder patterns.
    largest_module_px : float [px]
        Largest module searched. Chosen.
    scale_ratio : float
        Step from one module size to the next. Chosen.
    smaller_sizes : int
        Module sizes below the smallest, a step apart, that are searched for QR codes where no code is read
        otherwise; 0: none. Chosen: down to 2 px.
    cells_a_module : float [cells/module]
        Resolution of the search. Chosen.
    half : int [cells]
        Half width of a template. Chosen.
    lag_cells : tuple of 2 floats [cells]
        Lag that is undone for ON and OFF events while it is not known, in cells of the finest level. Chosen:
        little enough to do no harm where pixels do not lag.
    clip : float
        Cells are clipped at so many times the mean strength of those that have events: a hot pixel is no
        edge. Chosen.
    passes : tuple of FinderPass
        One after another until a code is found that agrees well: large modules that stand out, then all, then
        three patterns as a code shows that is tilted by up to 45 degrees. Chosen.
    peaks_a_row : int
        Peaks kept of one row of a level. Chosen.
    peaks : int
        Places kept, the best over all sizes. Chosen: twice the finder patterns of 16 codes.
    triples_a_corner : int
        Triples kept that have one corner. Chosen: the corners of 16 codes in rows make that many.
    leg_tolerance : float
        |log| of the ratio of the two legs of a triple. Chosen.
    scale_tolerance : float
        |log| of leg length over what symbol and module size ask for. Chosen.
    angle_tolerance : float [rad]
        Between leg and finder pattern, and from a right angle. Chosen.
    first_hypotheses : int
        Codes with several finder patterns that are scored before the others, the best by response. Chosen:
        most often the code is among them.
    hypotheses : int
        Codes with several finder patterns that are scored in a window. Chosen.
    min_match : float
        Mean correlation with finder patterns and timing that a code needs to be looked at closely, -1 to 1.
        Chosen: codes were seen to have 0.43 and more, what is none mostly less.
    clear_match : float
        The same with which one is clearly a code: others are looked at only where there is none. Chosen.
    tries : int
        What is looked at closely in a window without being a code, in a row, at most. Chosen.
    hidden_below : float
        Correlation with all that is known below which a code is not taken for one that shows all of its
        finder patterns, unless it is read: one of them may be hidden then. Chosen: with a pattern
        that is none they were seen to have up to 0.93, most of those that show all have more.
    hidden_hypotheses : int
        Codes of which two finder patterns are seen that are scored in a window, the best; 0: none. Chosen:
        those of codes were seen to be the first or second.
    min_hidden_match : float
        As ``min_match``, of those. Chosen: codes were seen to have 0.64 and more, what is none at most 0.58.
    hidden_tries : int
        As ``tries``, of those. Chosen.
    single_patterns : int
        Finder patterns that are each tried as the only one of a code, the best that belong to no code with
        several; 0: none. Chosen.
    min_single_match : float
        As ``min_match``, of those. Chosen: a pattern was aligned alone before, and a short timing pattern is
        easily like another; codes were seen to have 0.61 and more, what is none mostly less.
    single_candidates : int
        Sizes and directions in which each of them is looked at closely, the best. Chosen.
    single_tries : int
        As ``tries``, of those. Chosen.
    margin_px : float [px]
        How far the pose of a hypothesis may be off, for the size of the region around it. Chosen.
    sure_travel_px : float [px]
        Travel in a window below which the direction of the motion is not sure. Chosen.
    unsure_turns : tuple of floats [rad]
        Directions tried where it is not sure, against the estimate. Chosen: the opposite ones look like an
        inverted code.
    """

    smallest_module_px: Annotated[float, Range(least=1.0, most=200.0)] = 3.2
    largest_module_px: Annotated[float, Range(least=1.0, most=200.0)] = 22.0
    scale_ratio: Annotated[float, Range(least=1.01, most=3.0)] = 1.22
    smaller_sizes: Annotated[int, Range(least=0, most=8)] = 2
    cells_a_module: Annotated[float, Range(least=1.0, most=8.0)] = 1.25
    half: Annotated[int, Range(least=3, most=32)] = 6
    lag_cells: tuple[NotNegative, NotNegative] = (0.25, 0.5)
    clip: Positive = 3.0
    passes: tuple[FinderPass, ...] = (
        FinderPass(least_module_px=4.3, floor=0.8, min_first=0.33, min_response=0.38), FinderPass(),
        FinderPass(slack=2.2),
    )  # fmt: skip
    peaks_a_row: Count = 8
    peaks: Annotated[int, Range(least=3, most=1024)] = 96
    triples_a_corner: Count = 16
    leg_tolerance: Positive = 0.2
    scale_tolerance: Positive = 0.16
    angle_tolerance: Annotated[float, Range(above=0.0, most=0.25 * math.pi)] = 0.24
    first_hypotheses: Count = 64
    hypotheses: Count = 2048
    min_match: Annotated[float, Range(least=-1.0, most=1.0)] = 0.35
    clear_match: Annotated[float, Range(least=-1.0, most=1.0)] = 0.5
    tries: Count = 4
    hidden_below: NotNegative = 0.94
    hidden_hypotheses: Annotated[int, Range(least=0, most=4096)] = 512
    min_hidden_match: Annotated[float, Range(least=-1.0, most=1.0)] = 0.55
    hidden_tries: Count = 2
    single_patterns: Annotated[int, Range(least=0, most=1024)] = 8
    min_single_match: Annotated[float, Range(least=-1.0, most=1.0)] = 0.58
    single_candidates: Count = 6
    single_tries: Count = 2
    margin_px: NotNegative = 4.0
    sure_travel_px: NotNegative = 0.6
    unsure_turns: tuple[Annotated[float, Range(least=-math.pi, most=math.pi)], ...] = (
        0.0, 0.25 * math.pi, -0.25 * math.pi, 0.5 * math.pi,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.largest_module_px < self.smallest_module_px:
            raise ValueError(
                f"largest_module_px must be at least smallest_module_px, {self.smallest_module_px}, "
                f"got {self.largest_module_px}"
            )
        for name in ("passes", "unsure_turns"):
            if not getattr(self, name):
                raise ValueError(f"{name} must be a tuple of at least one, got ()")


@dataclass(frozen=True, kw_only=True)
class EdgeConfig(Settings):
    """Search for straight edges, and for the codes that have one as a leg of their L: Data Matrix.

    Attributes
    ----------
    strength : float
        Of an edge across the motion that counts, in the rms of the cells that have events. Chosen.
    least_across : float
        Sine of the angle between edge and motion below which edges count as at that angle. Chosen: those
        that run along the motion cause few events.
    least_sum : float
        Sum over an edge of its strength beyond that. Chosen: the leg of a code of 32 px has 12.
    most : int
        Edges of a window that are tried, the best. Chosen.
    min_match : float [nats]
        What the correlation with its dashed sides must say for a code to be aligned. Chosen.
    tries : int
        Codes of a window that are aligned, the best. Chosen.
    min_score : float
        Mean correlation of an aligned code with all that is known, and with its dashed sides alone, for it to
        be looked at closely, -1 to 1. Chosen.
    failures : int
        What is looked at closely in a window without being a code, in a row, at most. Chosen.
    """

    strength: Positive = 0.45
    least_across: Annotated[float, Range(above=0.0, most=1.0)] = 0.25
    least_sum: NotNegative = 8.0
    most: Annotated[int, Range(least=1, most=256)] = 20
    min_match: NotNegative = 3.0
    tries: Annotated[int, Range(least=1, most=256)] = 32
    min_score: Annotated[float, Range(least=-1.0, most=1.0)] = 0.52
    failures: Annotated[int, Range(least=1, most=256)] = 3
