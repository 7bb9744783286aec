"""Settings of a reader: what users set, and the settings of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from evqr.config.decode import DecodeConfig
from evqr.config.fit import AlignConfig, LagConfig, ModulesConfig
from evqr.config.line import LineConfig
from evqr.config.search import EdgeConfig, FinderConfig, MotionConfig
from evqr.config.settings import Count, NotEmpty, Range, Settings
from evqr.config.stream import SchedulerConfig, TrackConfig
from evqr.symbology import Symbology

Lag = Annotated[float, Range(least=0.0, most=1e5)]


class Vote(str, Enum):
    """How windows of one code are combined."""

    MODE = "mode"
    """each module's majority over the windows, as in the paper"""
    SOFT = "soft"
    """mean of the real-valued estimates, weighted by their windows' information"""
    INFORMATION = "information"
    """sum of the windows' normal equations, solved once: the least-squares answer for all of them"""


@dataclass(frozen=True, kw_only=True)
class ReadConfig(Settings):
    """What a reader does with a recording.

    Attributes
    ----------
    window_us : int [us], optional
        Length of a window. Default: as long as ``travel_px`` takes.
    travel_px : float [px]
        Travel of the code in one window. Chosen: 0.3 to 8 were seen to work.
    max_windows : int, optional
        Stop after so many windows. Default: all.
    lag_us : tuple of 2 floats [us], optional
        Time constants of the pixels for ON and for OFF events. Default: estimated.
    symbologies : tuple of Symbology
        Kinds of symbols that are searched for, those with three finder patterns first, the others where none
        of these is found. Default: all; to leave some out costs less where there is no code.
    vote : Vote
        How windows are combined. Measured: INFORMATION leaves the fewest modules wrong
        (tests/solver/test_vote.py).
    search_px : float [px]
        Travel between two searches for a code while none is tracked. Chosen.
    follow_px : float [px]
        Travel between two windows of a code that is read already. Chosen.
    motion : MotionConfig
        Motion from cold.
    finder : FinderConfig
        Search for finder patterns.
    edges : EdgeConfig
        Search for straight edges, of symbols that have no finder patterns.
    align : AlignConfig
        Pose and gain.
    lag : LagConfig
        Estimate of the lags.
    modules : ModulesConfig
        Estimate of the modules.
    decode : DecodeConfig
        From modules to text.
    scheduler : SchedulerConfig
        When a stream is searched.
    track : TrackConfig
        How a code is followed.
    line : LineConfig
        How a stream that comes bit by bit is taken.
    """

    window_us: Count | None = None
    travel_px: Annotated[float, Range(least=0.2, most=50.0)] = 2.0
    max_windows: Count | None = None
    lag_us: tuple[Lag, Lag] | None = None
    symbologies: Annotated[tuple[Symbology, ...], NotEmpty] = tuple(Symbology)
    vote: Vote = Vote.INFORMATION
    search_px: Annotated[float, Range(least=0.2, most=1000.0)] = 10.0
    follow_px: Annotated[float, Range(least=0.2, most=1000.0)] = 8.0
    motion: MotionConfig = field(default_factory=MotionConfig)
    finder: FinderConfig = field(default_factory=FinderConfig)
    edges: EdgeConfig = field(default_factory=EdgeConfig)
    align: AlignConfig = field(default_factory=AlignConfig)
    lag: LagConfig = field(default_factory=LagConfig)
    modules: ModulesConfig = field(default_factory=ModulesConfig)
    decode: DecodeConfig = field(default_factory=DecodeConfig)
    scheduler: SchedulerConfig = field(default_factory=SchedulerConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    line: LineConfig = field(default_factory=LineConfig)

    @classmethod
    def of(cls, config: ReadConfig | None) -> ReadConfig:
        """Give what was configured, or what is usual.

        Parameters
        ----------
        config : ReadConfig or None
            What a caller gave.

        Returns
        -------
        config : ReadConfig
            The same, or `ReadConfig()` for None.

        Raises
        ------
        TypeError
            It is something else.
        """
        if config is not None and not isinstance(config, cls):
            raise TypeError(f"config must be a ReadConfig or None, got {type(config).__name__}")
        return cls() if config is None else config
