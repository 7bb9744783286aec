"""What reading a code launches: kernels to compile or load before threads start."""

from __future__ import annotations

from evqr.fit.image import blur_taps
from evqr.fit.model import MOMENTS
from evqr.workspace import FEWEST_EVENTS

LAUNCHED = (
    ("bin_packed_events", {"E": FEWEST_EVENTS}),
    ("motion_correlation", {}),
    ("surface_peak", {}),
    ("deposit_packed_events", {"E": FEWEST_EVENTS}),
    ("lag_operator", {"K": blur_taps(1.0).shape[1]}),
    ("clip_outliers", {}),
    ("reduce_image", {}),
    ("mix_images", {}),
    ("correlate_templates", {"X": 128}),
    ("local_maxima", {}),
    ("merge_maxima", {}),
    ("match_corners", {}),
    ("line_runs", {}),
    ("score_poses", {}),
    ("align_poses", {"C": MOMENTS, "N": 1}),
    ("align_poses", {"C": MOMENTS, "N": 2}),
    ("code_rhs", {}),
    ("sum_equations", {}),
    ("pull_modules", {}),
    ("solve_code", {}),
)
"""Operations, each with those of its sizes that its kernels are built for: one pose and several are two."""
