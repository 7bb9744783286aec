"""What was found out about a sensor and its light, in a file: the time constants of its pixels."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from evqr.errors import UsageError

FORMAT = "evqr sensor profile 1"
"""What the file says that it is."""

LONGEST_US = 1e5
"""No pixels are slower [us]."""


@dataclass(frozen=True, kw_only=True)
class SensorProfile:
    """How the pixels of a sensor respond in the light of its scene.

    Attributes
    ----------
    tau_on_us, tau_off_us : float [us]
        Time constants of the pixels, first-order low-passes, for ON and for OFF events.
    """

    tau_on_us: float
    tau_off_us: float

    @property
    def lag_us(self) -> tuple[float, float]:
        """What `ReadConfig.lag_us` takes [us]."""
        return self.tau_on_us, self.tau_off_us

    @property
    def bandwidth_hz(self) -> tuple[float, float]:
        """Corner frequencies for ON and for OFF events; infinite where pixels do not lag [Hz]."""
        on, off = (math.inf if tau == 0.0 else 1e6 / (2.0 * math.pi * tau) for tau in self.lag_us)
        return on, off

    def write(self, path: str | Path) -> None:
        """Write it to a file, as JSON.

        Parameters
        ----------
        path : str or Path
            Where.

        Raises
        ------
        UsageError
            The file cannot be written.
        """
        try:
            Path(path).write_text(json.dumps({"format": FORMAT, **asdict(self)}, indent=2) + "\n", "utf-8")
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def read_profile(path: str | Path) -> SensorProfile:
    """Read the profile of a sensor.

    Parameters
    ----------
    path : str or Path
        A file of `SensorProfile.write`.

    Returns
    -------
    profile : SensorProfile
        What it says.

    Raises
    ------
    UsageError
        It cannot be read, or is no such file.
    """
    try:
        said: Any = json.loads(Path(path).read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        said = None
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise UsageError(f"{path}: is no sensor profile; make one with evqr calibrate")
    names = ("tau_on_us", "tau_off_us")
    unknown = sorted(set(said) - {"format", *names})
    if unknown:
        raise UsageError(f"{path}: {unknown[0]} is unknown; a sensor profile has {' and '.join(names)}")
    for name in names:
        value = said.get(name)
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else -1.0
        if not 0.0 <= number <= LONGEST_US:
            raise UsageError(f"{path}: {name} is {value!r}, but must be 0 to {LONGEST_US:g} us")
    return SensorProfile(**{name: float(said[name]) for name in names})
