"""How many instructions a thread of each kernel runs: its machine code, with loops as sizes tell.

A table that knows the kernels' sources.  Of a kernel that it does not have, a thread is taken to walk along
the longest axis of its operation's arrays, but for the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from machine_code import Code

BUSY = 0.06
"""Pixels of an image that are not empty."""

FOUND = 200
"""Maxima of a window that are merged."""


@dataclass(frozen=True)
class Sizes:
    """What the work of a thread depends on.

    Attributes
    ----------
    given       arguments of the operation: shapes of arrays, values of settings
    events      of a window
    threads     of the launch
    iterations  that the operation took, the most of any window or pose; None: unknown
    samples     that alignment took in all of them; None: unknown
    """

    given: dict[str, Any]
    events: int
    threads: int
    iterations: float | None = None
    samples: float | None = None

    def of(self, name: str, axis: int = -1) -> int:
        """Give a size of an array."""
        return self.given[name][axis]


@dataclass(frozen=True)
class Work:
    """What a thread runs.

    Attributes
    ----------
    around  turns of the loops that have others in them
    steps   of the innermost loop
    loads   of global memory that its source has a step; 0: those of a turn
    """

    around: float
    steps: float
    loads: float


LANES = 256
"""Threads of a block that share a window or a pose."""


def _iterations(s: Sizes) -> float:
    return s.given["max_iterations"] if s.iterations is None else s.iterations


def _solution(s: Sizes) -> Work:
    """Count passes over the modules of a thread: three an iteration, one of them by the stencil."""
    modules = math.ceil(s.of("rhs", 1) * s.of("rhs") / LANES)
    return Work(3 * _iterations(s) * modules, (1 + _iterations(s)) * modules * s.of("stencil") ** 2, 2)


def _events(s: Sizes) -> Work:
    steps = s.events * s.of("window_ptr", 0) / s.threads
    return Work(steps, steps, 3)


def _alignment(s: Sizes) -> Work:
    """Count the points of a thread; an entry of a system is of 4 x 4 terms, and passes 10 pivots."""
    turns = 1 + _iterations(s)
    points = turns * s.of("points", 0) if s.samples is None else s.samples
    return Work(turns, points / LANES + turns * (16 + 2 * 10), 26)


def _shifts(s: Sizes) -> Work:
    """Count a row of the correlation: blocks of four shifts along x, two rows of shifts at a time."""
    width, blocks = s.of("images_inout"), s.of("rows_out") / 4
    turns = math.ceil(s.of("rows_out", 2) / 2) * blocks
    return Work(turns + width / 4, turns * BUSY * width, 10)


def _peak(s: Sizes) -> Work:
    size, taps = s.of("surface"), 2 * s.given["half"] + 1
    inner = max(size - taps + 1, 1)
    return Work(size * inner + inner**2, (size * inner + inner**2) * taps, 2)


def _merged(s: Sizes) -> Work:
    found, kept = min(FOUND, s.of("maxima", 1)), s.of("peaks_out", 1)
    return Work(kept, s.of("maxima", 1) + 2 * kept * found, 3)


def _fold(s: Sizes) -> Work:
    blocks, columns = s.of("samples_out") / 8, s.of("rhs_out") / 8
    return Work(blocks + columns, (blocks + columns) * s.of("profile"), 10)


def _reduced(s: Sizes) -> Work:
    blocks, rows = s.of("image") / 16, math.ceil(s.given["ratio"]) + 1
    return Work(blocks + s.of("image_out"), blocks * rows, 16)


def _disc(s: Sizes, loads: int) -> Work:
    return Work(s.of("spans", 0), math.pi / 4 * s.of("spans", 0) ** 2, loads)


WORK: dict[str, Callable[[Sizes], Work]] = {
    "bin_packed_events.bin_packed_events": _events,
    "deposit_packed_events.deposit_packed_events": _events,
    "voxel_grid.voxel_grid": _events,
    "voxel_grid_adjoint.voxel_grid_adjoint": lambda s: Work(0, 1, 6),
    "time_surface.no_event": lambda s: Work(0, 1, 0),
    "time_surface.last_times": _events,
    "time_surface.decay_times": lambda s: Work(0, 1, 1),
    "event_histogram.event_histogram": _events,
    "splat_events_adjoint.seen_where_it_moves": lambda s: Work(0, 1, 6),
    "lag_operator.lag_rows": lambda s: Work(0, s.of("taps"), 10),
    "lag_operator.lag_columns": lambda s: Work(0, s.of("taps"), 10),
    "align_poses.align_blocks": _alignment,
    "score_poses.score_poses": lambda s: Work(0, s.of("model", 0) / s.of("model_ptr", 0), 8),
    "code_rhs.sample_lattice": lambda s: Work(s.given["samples_a_module"], s.of("samples_out"), 5),
    "code_rhs.fold_samples": _fold,
    "sum_equations.sum_equations": lambda s: Work(0, s.of("rhs") / 8, 24),
    "pull_modules.pull_modules": lambda s: Work(0, s.of("q") / 8, 17),
    "solve_code.solve_blocks": _solution,
    "motion_correlation.clip_rows": lambda s: Work(0, s.of("images_inout") / 4, 4),
    "motion_correlation.judge_pairs": lambda s: Work(0, s.of("images_inout", 2), 4),
    "motion_correlation.correlate_rows": _shifts,
    "motion_correlation.add_rows": lambda s: Work(0, s.of("images_inout", 2), 4),
    "surface_peak.surface_peak": _peak,
    "clip_outliers.measure_rows": lambda s: Work(0, s.of("image") / 16, 16),
    "clip_outliers.limit": lambda s: Work(0, s.of("image", 1), 2),
    "clip_outliers.clip_rows": lambda s: Work(0, s.of("image") / 16, 16),
    "reduce_image.reduce_image": _reduced,
    "mix_images.mix_images": lambda s: Work(0, s.of("weight"), 17),
    "correlate_templates.running_squares": lambda s: Work(0, s.of("image", 1), 4),
    "correlate_templates.quiet_floor": lambda s: Work(0, s.of("image"), 1),
    # a thread takes some neighbours on a GPU, not a row
    "correlate_templates.correlate_first": lambda s: _disc(s, 5),
    "correlate_templates.correlate_others": lambda s: _disc(s, 9),
    "correlate_templates.best_template": lambda s: Work(1, BUSY * s.of("mix", 1), 5),
    "local_maxima.local_maxima": lambda s: Work(s.of("response"), BUSY * s.of("response") * 9, 1),
    "merge_maxima.merge_maxima": _merged,
    "line_runs.line_runs": lambda s: Work(s.of("image", 1), s.of("image", 1), 12),
    "match_corners.match_corners": lambda s: Work(s.of("peaks", 1), s.of("peaks", 1), 0),
}
"""By operation and kernel."""

ATOMICS: dict[str, Callable[[Sizes], float]] = {
    "bin_packed_events.bin_packed_events": lambda s: s.events * s.of("window_ptr", 0),
    "deposit_packed_events.deposit_packed_events": lambda s: 4 * s.events * s.of("window_ptr", 0),
    "voxel_grid.voxel_grid": lambda s: 2 * s.events * s.of("span", 0),
    "time_surface.last_times": lambda s: s.events * s.of("surface_out", 0),
    "event_histogram.event_histogram": lambda s: s.events * s.of("counts_out", 0),
}
"""Additions to memory of a launch."""


def work_of(name: str, sizes: Sizes) -> Work:
    """Count what a thread of a kernel runs.

    Parameters
    ----------
    name : str
        Operation and kernel.
    sizes : Sizes
        Of its launch.

    Returns
    -------
    work : Work
        From the table, or guessed.
    """
    if name in WORK:
        return WORK[name](sizes)
    longest = max(
        (max(value[1:], default=0) for value in sizes.given.values() if isinstance(value, tuple)), default=0
    )
    return Work(0, longest, 0)


def instructions(code: Code, work: Work) -> float:
    """Count instructions of a thread.

    Parameters
    ----------
    code : Code
        The kernel's.
    work : Work
        What a thread runs of it.

    Returns
    -------
    count : float
        Loops around others are those of all nests together, once a turn.
    """
    unrolled = max(1, round(code.loads / work.loads)) if work.loads else 1
    return code.once + code.around * work.around + code.inside / unrolled * work.steps
