"""Settings of the fit: pose and gain, lags, modules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from evqr.config.settings import Ascending, Count, NotNegative, Positive, Range, Settings, Share

Samples = Annotated[int, Range(least=1, most=16)]


@dataclass(frozen=True, kw_only=True)
class AlignConfig(Settings):
    """Pose and gain, by Gauss-Newton on the known modules: the paper's step one.

    Attributes
    ----------
    cells_a_module : float [cells/module]
        Resolution of the image around the code. Chosen.
    blur_cells : float [cells]
        Blur of that image beyond that of the deposit, whose tent has 0.41. Chosen: about a quarter of a
        module in all, or the estimate of the lags favours small ones.
    sigma : float [modules]
        Blur of the model at the last level. Chosen.
    coarse_levels : tuple of (float [modules], int)
        Blur and samples a module of the levels before it, for a pose from the search. Chosen.
    samples : int
        Samples a module at the last level. Chosen.
    max_iterations : int
        At each level. Chosen.
    tolerance : float [modules]
        Step at which the last level has converged. Chosen.
    coarse_tolerance : float [modules]
        Step at which the levels before it have. Chosen.
    damping : float
        Levenberg-Marquardt, relative to the diagonal. Chosen.
    ridge : float
        Regularises the gain where the known modules leave a direction open, relative to the trace. Chosen.
    refined_candidates : int
        Candidates of the screening that are refined. Chosen.
    shift_gain : float
        Score that a shift by one module must gain to be taken. Chosen.
    min_score : float
        Correlation with the known modules below which there is no code, 0 to 1. Chosen.
    single_score : float
        The same, to find a symbol with a single finder pattern. Chosen: the corner of a QR code was seen to
        reach 0.64, symbols with slow and noisy pixels 0.6 to 0.75, others 0.7 to 0.88.
    coarse_score : float
        Correlation at the coarse levels below which a candidate is not refined, -1 to 1. Chosen.
    good_score : float
        Correlation that ends the search for a better candidate; above 1, never. Chosen: one module off scores
        0.56 to 0.67.
    sharp_score : float
        Correlation above which pixels do not lag enough for the lags to be estimated; above 1,
        they always are. Chosen.
    """

    cells_a_module: Annotated[float, Range(least=1.0, most=16.0)] = 2.2
    blur_cells: Annotated[float, Range(least=0.1, most=2.0)] = 0.55
    sigma: Annotated[float, Range(least=0.05, most=2.0)] = 0.36
    coarse_levels: tuple[tuple[Annotated[float, Range(least=0.05, most=4.0)], Samples], ...] = (
        (0.9, 1), (0.5, 2),
    )  # fmt: skip
    samples: Samples = 2
    max_iterations: Annotated[int, Range(least=1, most=1000)] = 8
    tolerance: Positive = 0.01
    coarse_tolerance: Positive = 0.05
    damping: NotNegative = 1e-3
    ridge: Positive = 1e-3
    refined_candidates: Count = 3
    shift_gain: NotNegative = 0.02
    min_score: Share = 0.5
    single_score: Share = 0.6
    coarse_score: Annotated[float, Range(least=-1.0, most=1.0)] = 0.4
    good_score: NotNegative = 0.8
    sharp_score: NotNegative = 0.96


@dataclass(frozen=True, kw_only=True)
class LagConfig(Settings):
    """How far the pixels lag: the pair of lags whose image agrees best with the known modules.

    Attributes
    ----------
    first_on : tuple of floats [modules]
        Lags of ON events that are tried first. Chosen.
    off_over_on : float
        Lag of OFF over that of ON events, for the lags tried first. Chosen: OFF events lag about twice as
        much as ON events on the sensors modelled, a darker pixel is slower.
    factors : tuple of floats
        Around the best first pair, for ON and for OFF events each. Chosen; with 1, which is that pair itself.
    max_iterations : int
        Steps of Gauss-Newton for each pair. Chosen: a step or two settle which pair is best.
    """

    first_on: tuple[NotNegative, ...] = (0.0, 0.2, 0.4, 0.7, 1.0, 1.5)
    off_over_on: Positive = 1.6
    factors: tuple[Positive, ...] = (0.6, 1.0, 1.6)
    max_iterations: Annotated[int, Range(least=1, most=1000)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.first_on[:1] != (0.0,):
            raise ValueError(f"first_on must be a tuple that begins with 0, no lag, got {self.first_on}")
        if 1.0 not in self.factors:
            raise ValueError(f"factors must be a tuple with 1 among them, got {self.factors}")


@dataclass(frozen=True, kw_only=True)
class ModulesConfig(Settings):
    """Modules, by a damped linear least-squares problem: the paper's step two.

    Attributes
    ----------
    samples : int
        Samples a module. Chosen.
    damping : float
        Pull on a module, in the units of equations that are weighted by one over the noise. Chosen.
    damping_range : tuple of 2 floats
        Its bounds, relative to the largest diagonal entry of the normal matrix. Chosen.
    passes : int
        Solutions at most: the first pulls modules to grey, each later one to what the one before says.
        Chosen.
    certainty : float
        Factor by which a pass goes beyond what the one before said, up to dark or light: what does not get
        there is unclear; at least 1, or known modules would be. Chosen.
    unclear : float
        Share of unclear modules that ends the passes. Chosen: the decoder corrects more than that.
    tolerance : float
        Of the residual of a pass, relative. Chosen.
    max_iterations : int
        Of conjugate gradients, a pass. Chosen.
    """

    samples: Samples = 2
    damping: NotNegative = 6.0
    damping_range: Annotated[tuple[Positive, Positive], Ascending] = (0.04, 0.5)
    passes: Annotated[int, Range(least=1, most=100)] = 3
    certainty: Annotated[float, Range(least=1.0)] = 4.0
    unclear: Share = 0.005
    tolerance: Positive = 0.05
    max_iterations: Count = 40
