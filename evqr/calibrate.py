"""The response of a sensor's pixels, found out from a recording with a code in it.

In one window time constants are estimated by how well known modules agree, which says little where pixels lag
by a module and more.  They are the sensor's and the light's, though, the same in all windows: so those are
taken with which most windows of a recording are read, each alone, and with most error correction left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from evqr.config import ReadConfig
from evqr.offline import read_windows
from evqr.sensor_profile import SensorProfile

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from evqr.recording import RecordingOptions

TAU_ON_US = (0.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1_300.0, 2_500.0, 5_000.0, 7_000.0, 10_000.0)
"""Time constants for ON events that are tried [us]."""

OFF_OVER_ON = (2.0, 1.0, 4.0)
"""Those for OFF events over them, as darker pixels are slower; the others with the best of the first."""

WINDOWS = 8
"""Windows of the recording that are read with each pair."""


def calibrate(
    source: Any,
    *,
    config: ReadConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
    **opening: Unpack[RecordingOptions],
) -> SensorProfile | None:
    """Find out how the pixels of a sensor respond.

    Parameters
    ----------
    source : path, EventArray, array or tuple
        A recording with a code in it, in the light of those that are to be read; as for `read_windows`.
    config : ReadConfig, optional
        Settings; ``lag_us`` is what is looked for.
    progress : callable, optional
        Called with the pairs of time constants that were tried, and how many there are.
    **opening : as for `read_windows`
        The same.

    Returns
    -------
    profile : SensorProfile or None
        With which most windows are read; None where none is.

    Raises
    ------
    RecordingError, MissingExtra, UsageError, BackendError, TypeError, ValueError
        As for `read_windows`.
    """
    cfg = ReadConfig.of(config)
    cfg = replace(cfg, max_windows=cfg.max_windows or WINDOWS)
    first, *others = OFF_OVER_ON
    done, count = 0, len(TAU_ON_US) + len(others)

    def merit(profile: SensorProfile) -> float:
        nonlocal done
        windows = read_windows(source, config=replace(cfg, lag_us=profile.lag_us), **opening)
        read = [code for window in windows for code in window.codes if code.text is not None]
        done += 1
        if progress is not None:
            progress(done, count)
        # a reading counts 1, and what is left of its error correction decides among as many
        return sum(1.0 + (code.unused_correction or 0.0) for code in read)

    def best_of(profiles: list[SensorProfile]) -> tuple[float, SensorProfile]:
        return max(((merit(each), each) for each in profiles), key=lambda one: one[0])

    most, best = best_of([SensorProfile(tau_on_us=on, tau_off_us=first * on) for on in TAU_ON_US])
    around = [SensorProfile(tau_on_us=best.tau_on_us, tau_off_us=each * best.tau_on_us) for each in others]
    most, best = max((most, best), best_of(around), key=lambda one: one[0])
    return best if most > 0.0 else None
