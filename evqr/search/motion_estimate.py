"""Motion from cold: the displacement between the two halves of a window.

The paper takes the first principal component of the events in space-time; over a whole view that finds the
extent of the object rather than its motion.  Instead the signed counts of the two halves are correlated, and
the displacement of the peak is divided by the difference of the halves' mean times.  The sign comes from the
order of time.

Windows are worked on together, those of sensors of different sizes in images as large as the largest.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from evqr.config import MotionConfig
from evqr.events.batch import EventBatch
from evqr.events.buffer import Asking
from evqr.events.window import Window
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.search.noise import LEAST_CELL_PX, noise_squares
from evqr.values import Value
from evqr.workspace import EventRoom, Staging, Workspace
from evqr_kernels.operations.images import taps_beside

MOST_PROBES, LONGER = 4, 4
"""Windows tried while the speed is unknown, each so many times as long as the one before."""

LEAST_TRAVEL_PX = 1.0
"""Travel in such a window that tells a speed [px]."""

FRESH = 4
"""A window that begins less than one such part of its length after another one shows mostly the same."""

LEAST_HALF = 2.0
"""Half width of the window that blurs a correlation, at least [binned px]."""

CLEAR_PEAK = 0.1
"""Correlation of some of a window's events that needs no others."""

NOISE_PEAK = 5.0
"""Standard deviations of the correlation of halves that have nothing to do with each other, which the highest
of them all does not reach."""

BYTES_A_CELL = 20
"""Bytes of all arrays, a binned pixel of a window. Measured."""


@dataclass(frozen=True, eq=False)
class MotionEstimate(Value):
    """The motion common to a window's events.

    Attributes
    ----------
    motion : Motion
        At the middle of the window.
    correlation : float
        Normalised correlation of the two halves, 0 to 1.
    timings_ms : mapping of str to float [ms]
        By stage; does not count in comparisons.
    """

    motion: Motion
    correlation: float
    timings_ms: Mapping[str, float] = field(default_factory=dict, compare=False)


class _Correlator:
    """Correlates the halves of so many windows, over one square of shifts."""

    def __init__(
        self, events: EventRoom, count: int, height: int, width: int, reduction: int, radius: int,
        half: float, cfg: MotionConfig, workspace: Workspace,
    ) -> None:  # fmt: skip
        backend, shifts, staging = workspace.backend, 2 * radius + 1, Staging(workspace, events)
        self._ptr, self._quiet = staging.input((2 * count, 2), np.int32), staging.input((count, 2))
        self._peak, self._energy = staging.output((count, 3)), staging.output((count, 2))
        halves = workspace.empty(2 * count, height, width)
        pairs = halves.reshape((count, 2, height, width))
        scratch = workspace.scratch("motion_correlation", B=count, Y=height, X=width, radius=radius)
        surface = workspace.empty(count, shifts, shifts)
        blurred = workspace.scratch("surface_peak", B=count, N=shifts)

        def launch() -> None:
            backend.clear(halves)
            backend.bin_packed_events(events.x, events.y, events.stamp, self._ptr.device, reduction, halves)
            backend.motion_correlation(
                pairs, self._quiet.device, cfg.clip, radius, *scratch, surface, self._energy.device
            )
            backend.surface_peak(surface, half, *blurred, self._peak.device)

        self._run, self._reduction = staging.sequence(launch), reduction

    def __call__(
        self, samples: Sequence[_Sample], batch: EventBatch
    ) -> list[tuple[tuple[float, float], float]]:
        """Give each sample's shift (x, y) of highest correlation [binned px], and that correlation."""
        self._quiet.host[...] = 0.0
        halves: list[tuple[int, int]] = []
        for k, (sample, (first, last)) in enumerate(zip(samples, batch.window_ptr.tolist(), strict=True)):
            middle = first + sample.middle
            halves += (first, middle), (middle, last)
            if self._reduction >= LEAST_CELL_PX:
                on = int(np.count_nonzero(sample.window.events.p > 0))
                cells = 2.0 * sample.window.width * sample.window.height / self._reduction**2
                self._quiet.host[k] = noise_squares(last - first, on, cells)
        self._ptr.fill(halves)
        self._run()
        peaks, energies = self._peak.read().tolist(), self._energy.read().tolist()
        return [
            ((x, y), highest / max(math.sqrt(first * second), 1e-9))
            for (x, y, highest), (first, second), _ in zip(peaks, energies, samples, strict=False)
        ]


@dataclass(frozen=True, eq=False)
class _Sample:
    """Every ``step``-th event of a window, as a window, which has so many of them before its middle."""

    window: Window
    step: int
    middle: int

    @classmethod
    def of(cls, window: Window, middle: int, most: int) -> _Sample:
        step = max(1, -(-len(window) // most))
        return cls(window.thinned(step), step, -(-middle // step))


def estimate_motions(
    windows: Sequence[Window], cfg: MotionConfig, *, workspace: Workspace, reduction: int = 1,
    reach: int | None = None, thorough: bool = True,
) -> list[MotionEstimate | Reason]:  # fmt: skip
    """Estimate the motion common to each window's events.

    Parameters
    ----------
    windows : sequence of Window
        Whose motions; of one sensor or of several.
    cfg : MotionConfig
        Settings.
    workspace : Workspace
        Buffers.
    reduction : int [px]
        Binning; 1 is the precise estimate.
    reach : int [binned px]
        Largest displacement between the halves; default ``cfg.reach_px``, and more where the peak lies there.
    thorough : bool
        Whether to look for larger displacements even where the halves do not agree clearly, and at all events
        where some do not.

    Returns
    -------
    estimates : list of MotionEstimate or Reason
        NO_EVENTS at all, TOO_FEW_EVENTS in a half of the window, or NOTHING_MOVES where the halves do not
        correlate.
    """
    found: list[MotionEstimate | Reason] = [
        Reason.TOO_FEW_EVENTS if len(window) else Reason.NO_EVENTS for window in windows
    ]
    middles = [_middle_of(window, cfg) for window in windows]
    waiting = [
        (k, _Sample.of(window, middle, cfg.most_events), reach)
        for k, (window, middle) in enumerate(zip(windows, middles, strict=True))
        if min(middle, len(window) - middle) >= cfg.fewest_events // 2
    ]
    half = max(cfg.blur_px / reduction, LEAST_HALF)
    pixels = max((window.width * window.height for window in windows), default=1)
    together = workspace.windows_at_once(BYTES_A_CELL * pixels / reduction**2)
    while waiting:
        now_reach = waiting[0][2]
        now = [one for one in waiting if one[2] == now_reach][:together]
        waiting = [one for one in waiting if one not in now]
        peaks = _correlate(
            [sample for _, sample, _ in now], reduction, now_reach or cfg.reach_px, half, cfg, workspace
        )
        for (k, sample, _), (shift, correlation) in zip(now, peaks, strict=True):
            window = windows[k]
            cells = window.width * window.height / reduction**2
            agree = correlation >= max(cfg.min_peak, NOISE_PEAK * 0.75 / (half * math.sqrt(cells)))
            far = now_reach is None and max(map(abs, shift)) >= cfg.reach_px
            if far and (agree or (thorough and correlation > 0.0)):
                waiting.append((k, sample, 4 * cfg.reach_px))
            elif thorough and sample.step > 1 and correlation < CLEAR_PEAK:
                waiting.append((k, _Sample.of(window, middles[k], len(window)), now_reach))
            else:
                found[k] = _estimate(window, middles[k], shift, reduction, correlation, agree, cfg)
    return found


def _middle_of(window: Window, cfg: MotionConfig) -> int:
    """Give the place of the first event of a window's second half.

    Where its events end early, as a recording may do, the time in which there are any is halved instead.
    """
    middle = window.events.first_at(window.middle_us)
    if 0 < len(window) < middle + cfg.fewest_events // 2:
        last_us = int(window.events.t[-1])
        middle = window.events.first_at((window.start_us + last_us + 1) // 2)
    return middle


def _correlate(
    samples: Sequence[_Sample], reduction: int, reach: int, half: float, cfg: MotionConfig,
    workspace: Workspace,
) -> list[tuple[tuple[float, float], float]]:  # fmt: skip
    """Correlate the halves of windows."""
    count = 1 << (len(samples) - 1).bit_length()
    batch = EventBatch.of([sample.window for sample in samples])
    events = workspace.events(batch)
    height = -(-max(sample.window.height for sample in samples) // reduction)
    width = -(-max(sample.window.width for sample in samples) // reduction)
    radius = reach + taps_beside(half)
    correlate = workspace.once(
        ("motion", events.size, count, height, width, reduction, radius, half, cfg.clip),
        lambda: _Correlator(events, count, height, width, reduction, radius, half, cfg, workspace),
    )
    return correlate(samples, batch)


def _estimate(
    window: Window, middle: int, shift: tuple[float, float], reduction: int, correlation: float, agree: bool,
    cfg: MotionConfig,
) -> MotionEstimate | Reason:  # fmt: skip
    """Make a motion of a shift [binned px]."""
    if not agree:
        return Reason.NOTHING_MOVES
    between = _mean_us(window, middle, len(window), cfg) - _mean_us(window, 0, middle, cfg)
    if between <= 0.0:
        return Reason.NOTHING_MOVES
    velocity = np.array(shift) * (1e6 * reduction / between)
    return MotionEstimate(Motion(velocity, window.middle_us), correlation)


def estimate_motion(
    window: Window, cfg: MotionConfig, *, workspace: Workspace, reduction: int = 1, reach: int | None = None
) -> MotionEstimate | Reason:
    """Estimate the motion common to a window's events: `estimate_motions` of one."""
    return estimate_motions([window], cfg, workspace=workspace, reduction=reduction, reach=reach)[0]


def _mean_us(window: Window, first: int, last: int, cfg: MotionConfig) -> float:
    """Mean time of some events since the window's start [us], from every n-th: they are in order of time."""
    step = 1 + (last - first) // cfg.most_times
    times = window.events.t[first + step // 2 : last : step]
    return (int(times.sum()) - window.start_us * len(times)) / len(times)


class QuietSpells:
    """Where in a stream windows of each length showed nothing that moves.

    Searches follow each other at times that suit the shortest window; a long one, which takes most of the
    time where there is nothing, would be much the same again and again.
    """

    def __init__(self) -> None:
        self._began: dict[int, int] = {}

    def covers(self, start_us: int, length_us: int) -> bool:
        """Tell whether a window is not worth a look.

        Parameters
        ----------
        start_us : int [us]
            Where it begins.
        length_us : int [us]
            How long it is.

        Returns
        -------
        covers : bool
            Whether one as long that began shortly before showed nothing.
        """
        began_us = self._began.get(length_us)
        return began_us is not None and 0 <= start_us - began_us < length_us // FRESH

    def add(self, start_us: int, length_us: int) -> None:
        """Take note of a window that showed nothing.

        Parameters
        ----------
        start_us : int [us]
            Where it began.
        length_us : int [us]
            How long it was.
        """
        self._began[length_us] = start_us


class Probe(NamedTuple):
    """A window from which a motion is to be estimated, and how.

    Attributes
    ----------
    start_us, end_us : int [us]
        Its bounds.
    reduction : int [px]
        Binning, as of `estimate_motions`.
    thorough : bool
        As of `estimate_motions`.
    """

    start_us: int
    end_us: int
    reduction: int
    thorough: bool


def motion_probes(
    start_us: int, cfg: MotionConfig, *, guess: Motion | None = None, quiet: QuietSpells | None = None,
    since_us: int | None = None,
) -> Generator[Probe, MotionEstimate | Reason, MotionEstimate | Reason]:  # fmt: skip
    """Say from which windows the motion at a time is estimated from cold: coarsely, then as suits the speed.

    Which windows it takes depends on what the ones before say, so it asks for them one by one.

    Parameters
    ----------
    start_us : int [us]
        The shortest window begins here, and so does that of which the motion is.
    cfg : MotionConfig
        Settings.
    guess : Motion
        From an earlier window, for its speed; None: nothing known.
    quiet : QuietSpells
        Of earlier searches in the same stream: windows that it covers are left out. None: none are.
    since_us : int [us]
        Longer windows may begin before, but not before this, so that they end with the shortest: nothing is
        waited for where nothing moves, and what is slow is seen in events that are here. Those that tell the
        speed are left out as long as there have not been so many. None: all begin at the same time.

    Returns
    -------
    estimate : MotionEstimate or Reason
        As of `estimate_motion`; NO_EVENTS where there is none in the shortest window: a longer one would
        show what one shows that begins later.

    Yields
    ------
    probe : Probe
        To be answered with what `estimate_motions` gives for it.
    """
    length, quiet = cfg.probe_us, quiet or QuietSpells()
    cold = guess is None
    for _ in range(MOST_PROBES if cold else 0):
        first_us, last_us = _ending_early(start_us, length, cfg, since_us)
        if since_us is not None and last_us > start_us + cfg.probe_us:
            return Reason.NOTHING_MOVES  # the stream is too young
        if not quiet.covers(start_us, length):
            # what is so fast that halves of the shortest window are far apart is no better seen in a longer
            coarse = yield Probe(first_us, last_us, cfg.reduction, length == cfg.probe_us)
            if coarse is Reason.NO_EVENTS:
                return coarse
            if isinstance(coarse, MotionEstimate) and coarse.motion.travel_px(length) >= LEAST_TRAVEL_PX:
                guess = coarse.motion
                break
            quiet.add(start_us, length)
        if length >= cfg.longest_us:
            return Reason.NOTHING_MOVES
        length = min(LONGER * length, cfg.longest_us)
    if guess is None:
        return Reason.NOTHING_MOVES
    window_us = guess.window_us(cfg.travel_px, longest_us=cfg.longest_us)
    found = yield Probe(*_ending_early(start_us, window_us, cfg, since_us), 1, False)
    if cold and not isinstance(found, MotionEstimate):
        quiet.add(start_us, length)  # what moves comes late in the window, and shorter ones will show it
    return found


def _ending_early(start_us: int, length_us: int, cfg: MotionConfig, since_us: int | None) -> tuple[int, int]:
    """Give the bounds of a window that ends with the shortest where it may begin before."""
    first_us = start_us
    if since_us is not None:
        first_us = min(max(since_us, start_us + cfg.probe_us - length_us), start_us)
    return first_us, first_us + length_us


def find_motion(
    start_us: int, cfg: MotionConfig, *, workspace: Workspace, guess: Motion | None = None,
    quiet: QuietSpells | None = None,
) -> Asking[MotionEstimate | Reason]:  # fmt: skip
    """Estimate the motion at a time from cold, of one stream alone.

    Parameters
    ----------
    start_us : int [us]
        As of `motion_probes`.
    cfg, guess, quiet : as of `motion_probes`
        The same.
    workspace : Workspace
        Buffers.

    Returns
    -------
    estimate : MotionEstimate or Reason
        As of `estimate_motion`; `EventBuffer.answer` runs it where all events are there.
    """
    probes, estimate = motion_probes(start_us, cfg, guess=guess, quiet=quiet), None
    while True:
        try:
            probe = probes.send(estimate)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value
        window = yield probe.start_us, probe.end_us
        (estimate,) = estimate_motions(
            [window], cfg, workspace=workspace, reduction=probe.reduction, thorough=probe.thorough
        )
