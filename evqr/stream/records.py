"""What a stream gives, a record each time something is certain; no record is changed afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from evqr.fit.detection import NotFound, Target
from evqr.motion import Motion
from evqr.results import CodeReading
from evqr.symbol.decoded import DecodeFailure
from evqr.values import Value


@dataclass(frozen=True, eq=False)
class CodeRead(Value):
    """A code has been read, for the first time.

    Attributes
    ----------
    code : int
        Its number: 0, 1, ... in the order in which codes are read.
    reading : CodeReading
        As it is known when the code decodes: ``t_last_us`` is the end of the window with which it did.
    """

    code: int
    reading: CodeReading


@dataclass(frozen=True)
class CodeLeft:
    """A code that was read is seen no more: it has left, or the stream has ended.

    Attributes
    ----------
    code : int
        Its number.
    t_last_us : int [us]
        End of the last window that showed it.
    """

    code: int
    t_last_us: int


@dataclass(frozen=True)
class CodeAgain:
    """A code that had left has been found and read again; another `CodeLeft` follows.

    Attributes
    ----------
    code : int
        The number that it had.
    t_first_us : int [us]
        Start of the window that showed it again.
    """

    code: int
    t_first_us: int


@dataclass(frozen=True)
class CodeUnread:
    """Something that looked like a code has been followed in vain.

    Attributes
    ----------
    t_first_us, t_last_us : int [us]
        Start of the first window that showed it, and end of the last one.
    windows : int
        Windows that showed it.
    score : float
        Correlation with the known modules in the last one, 0 to 1.
    failure : DecodeFailure
        Why it does not decode.
    target : Target
        What it was taken for, and where, in the last one; does not count in comparisons.
    mean_score : float
        Correlation with the known modules, mean over the windows; the first was chosen for it, the others
        were not.
    clear_modules : float
        Share of the other modules that are clearly dark or light in the sum of the windows.
    events_an_edge : float
        Events that an edge causes in a pixel that it passes.
    """

    t_first_us: int
    t_last_us: int
    windows: int
    score: float
    failure: DecodeFailure
    target: Target = field(repr=False, compare=False)
    mean_score: float = 0.0
    clear_modules: float = 0.0
    events_an_edge: float = 0.0

    def agrees(self, least: float) -> bool:
        """Tell whether it was a code, and not something that looked like one for a moment.

        Parameters
        ----------
        least : float
            Correlation that its known modules must reach in the mean, `AlignConfig.good_score`.

        Returns
        -------
        agrees : bool
            Of one window or of many.
        """
        return self.mean_score >= least


@dataclass(frozen=True)
class Searched:
    """A window has been searched.

    Attributes
    ----------
    start_us, end_us : int [us]
        Its bounds; equal where nothing moves, so that nothing could be searched.
    codes : int
        Codes found in it.
    not_found : NotFound, optional
        Why there is none.
    motion : Motion, optional
        How things move in it; does not count in comparisons.
    """

    start_us: int
    end_us: int
    codes: int
    not_found: NotFound | None
    motion: Motion | None = field(default=None, repr=False, compare=False)


StreamRecord: TypeAlias = CodeRead | CodeLeft | CodeAgain | CodeUnread | Searched
