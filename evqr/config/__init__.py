"""Settings: frozen, and refused where a value makes no sense.

All hang under `ReadConfig`, but what a line has beside it: its triggers and its jobs.  A field's text ends
with where its default comes from.  "Measured" names where; "chosen" means that nobody measured that number by
itself: all chosen ones together were checked with ``python perf/acceptance.py`` (200 simulated scenes that
must be read, 500 without a code that must give no text) and on the recordings of ``tests/shared``.
"""

from __future__ import annotations

from evqr.config.decode import DecodeConfig
from evqr.config.fit import AlignConfig, LagConfig, ModulesConfig
from evqr.config.line import JobConfig, LineConfig, TriggerConfig
from evqr.config.read import ReadConfig, Vote
from evqr.config.search import EdgeConfig, FinderConfig, FinderPass, MotionConfig
from evqr.config.settings import Settings
from evqr.config.stream import SchedulerConfig, TrackConfig

__all__ = [
    "AlignConfig",
    "DecodeConfig",
    "EdgeConfig",
    "FinderConfig",
    "FinderPass",
    "JobConfig",
    "LagConfig",
    "LineConfig",
    "ModulesConfig",
    "MotionConfig",
    "ReadConfig",
    "SchedulerConfig",
    "Settings",
    "TrackConfig",
    "TriggerConfig",
    "Vote",
]
