"""Settings of the stages, frozen; the defaults read everything in the project's own tests."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum


class Vote(str, Enum):
    """How windows of one code are combined."""

    MODE = "mode"
    """each module's majority over the windows, as in the paper"""
    SOFT = "soft"
    """mean of the real-valued estimates, weighted by their windows' information"""
    INFORMATION = "information"
    """sum of the windows' normal equations, solved once: the least-squares answer for all of them"""


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Motion from cold, by correlation of the two halves of a window.

    Attributes
    ----------
    probe_us      length of the first window tried while the speed is unknown [us]
    travel_px     travel that the window for the estimate is lengthened or shortened to [px]
    longest_us    a window is never made longer than this: slower motion is not read [us]
    reduction     coarse binning for the first look [px]
    reach_px      largest displacement between halves that the fine look covers [px]
    clip          event count of a pixel and half above which more does not matter (hot pixels)
    blur_px       blur of the correlation surface [px]
    min_peak      correlation below which there is no common motion, 0 to 1
    """

    probe_us: int = 1000
    travel_px: float = 3.0
    longest_us: int = 50_000
    reduction: int = 4
    reach_px: int = 3
    clip: float = 2.0
    blur_px: float = 2.0
    min_peak: float = 0.02


@dataclass(frozen=True, kw_only=True)
class LookConfig:
    """How thoroughly finder patterns are searched for.

    Attributes
    ----------
    smallest_module_px, largest_module_px   module sizes searched [px]
    floor         energy under a template, relative to that over cells of rms strength, below which a place is
                  quiet
    peaks         places kept, the best over all sizes
    hypotheses    codes that are tried, the best by response
    min_score     coarse score that a candidate needs for a closer look
    """

    smallest_module_px: float = 3.2
    largest_module_px: float = 22.0
    floor: float = 0.3
    peaks: int = 64
    hypotheses: int = 48
    min_score: float = -1.0


def _quick(smallest_module_px: float, largest_module_px: float) -> LookConfig:
    return LookConfig(
        smallest_module_px=smallest_module_px, largest_module_px=largest_module_px, floor=0.8, peaks=24,
        hypotheses=4, min_score=0.5,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FinderConfig:
    """Search for finder patterns with a bank of matched filters.

    Attributes
    ----------
    looks            one after another until a code is found, the cheapest first: large modules, then small
                     ones, then all of them and quiet places too
    scale_ratio      step from one module size to the next
    cells_a_module   resolution of the search: cells of the reduced image a module
    half             half width of a template [cells]
    lag_cells        lag that is undone for ON and OFF events while it is not known: little enough to do no
                     harm where pixels do not lag [cells of a look's finest level]
    min_response     normalised response of a finder pattern that counts, 0 to 1
    first_hypotheses tried before the others, with all versions of their triples: most often one is the code
    leg_tolerance    |log| of the ratio of the two legs
    scale_tolerance  |log| of leg length over what version and module size ask for
    angle_tolerance  between leg and finder pattern, and from a right angle [rad]
    """

    looks: tuple[LookConfig, ...] = (_quick(4.9, 11.0), _quick(3.2, 4.0), LookConfig())
    scale_ratio: float = 1.22
    cells_a_module: float = 1.25
    half: int = 6
    lag_cells: tuple[float, float] = (0.25, 0.5)
    min_response: float = 0.28
    first_hypotheses: int = 4
    leg_tolerance: float = 0.2
    scale_tolerance: float = 0.16
    angle_tolerance: float = 0.24


@dataclass(frozen=True, kw_only=True)
class StageOneConfig:
    """Pose and gain, by Gauss-Newton on the known modules.

    Attributes
    ----------
    cells_a_module     resolution of the image around the code: cells a module
    sigma              blur of the model at the last level [modules]
    coarse_levels      blur [modules] and samples a module of the levels before it, for a pose from the search
    samples            samples a module at the last level
    max_iterations     at each level
    tolerance          step at which the last level has converged [modules]
    coarse_tolerance   step at which the levels before it have [modules]
    damping            Levenberg-Marquardt, relative to the diagonal
    closer_looks       candidates of the coarse look that are refined
    shift_gain         score that a one-module shift must gain to be taken
    min_score          correlation with the known modules below which there is no code, 0 to 1
    clear_score        coarse correlation with which the best triple ends the screening: wrong ones reach 0.66
    good_score         correlation that ends the search for a better candidate: one module off scores 0.56 to
                       0.67
    sharp_score        correlation above which pixels do not lag enough to look for it
    """

    cells_a_module: float = 2.2
    sigma: float = 0.36
    coarse_levels: tuple[tuple[float, int], ...] = ((0.9, 1), (0.5, 2))
    samples: int = 2
    max_iterations: int = 8
    tolerance: float = 0.01
    coarse_tolerance: float = 0.05
    damping: float = 1e-3
    closer_looks: int = 3
    shift_gain: float = 0.02
    min_score: float = 0.5
    clear_score: float = 0.75
    good_score: float = 0.8
    sharp_score: float = 0.96


@dataclass(frozen=True, kw_only=True)
class StageTwoConfig:
    """Modules, by a damped linear least-squares problem.

    Attributes
    ----------
    samples          samples a module
    damping          pull on a module, in the units of equations that are weighted by one over the noise
    damping_range    its bounds, relative to the largest diagonal entry of the normal matrix
    passes           solutions at most: the first pulls modules to grey, each later one to what the one before
                     says
    certainty        factor by which a pass goes beyond what the one before said, up to dark or light: what
                     does not get there is unclear; at least 1, or known modules would be
    unclear          share of unclear modules that ends the passes: the decoder corrects more than that
    tolerance        of the residual of a pass, relative
    max_iterations   of conjugate gradients, a pass
    """

    samples: int = 2
    damping: float = 6.0
    damping_range: tuple[float, float] = (0.04, 0.5)
    passes: int = 3
    certainty: float = 4.0
    unclear: float = 0.005
    tolerance: float = 0.05
    max_iterations: int = 40

    def __post_init__(self) -> None:
        if self.passes < 1:
            raise ValueError(f"passes must be at least 1, got {self.passes}")
        if not 0.0 < self.damping_range[0] <= self.damping_range[1]:
            raise ValueError(f"damping_range must be two positive numbers in order, got {self.damping_range}")
        if not 1.0 <= self.certainty < math.inf:
            raise ValueError(f"certainty must be at least 1 and finite, got {self.certainty}")


@dataclass(frozen=True, kw_only=True)
class ReadConfig:
    """What a reader does with a recording.

    Attributes
    ----------
    window_us        length of a window; None: as long as ``travel_px`` takes [us]
    travel_px        travel of the code in one window [px]
    max_windows      stop after so many windows; None: all
    lag_us           time constants of the pixels for ON and for OFF events; None: estimated [us]
    vote             how windows are combined
    search_px        travel between two searches for a code while none is tracked [px]
    follow_px        travel between two windows of a code that is read already [px]
    """

    window_us: int | None = None
    travel_px: float = 2.0
    max_windows: int | None = None
    lag_us: tuple[float, float] | None = None
    vote: Vote = Vote.INFORMATION
    search_px: float = 10.0
    follow_px: float = 8.0
    motion: MotionConfig = field(default_factory=MotionConfig)
    finder: FinderConfig = field(default_factory=FinderConfig)
    stage_one: StageOneConfig = field(default_factory=StageOneConfig)
    stage_two: StageTwoConfig = field(default_factory=StageTwoConfig)

    def __post_init__(self) -> None:
        if self.window_us is not None and self.window_us < 1:
            raise ValueError(f"window_us must be at least 1, got {self.window_us}")
        if self.max_windows is not None and self.max_windows < 1:
            raise ValueError(f"max_windows must be at least 1, got {self.max_windows}")
        if not 0.2 <= self.travel_px <= 50.0:
            raise ValueError(f"travel_px must be 0.2 to 50, got {self.travel_px}")
        if self.lag_us is not None and not all(0.0 <= lag <= 1e5 for lag in self.lag_us):
            raise ValueError(f"lag_us must be two times from 0 to 100000 us, got {self.lag_us}")
