"""Array-in, array-out kernels for event cameras and planar codes.

Two doors: the functions below check their arguments and may allocate; the methods of `get_backend` with the
same names write to buffers that you own, unchecked.  Importing the package loads no backend.
"""

from evqr_kernels.backend import (
    BackendUnavailable,
    KernelBackend,
    backend_names,
    get_backend,
    register_backend,
)
from evqr_kernels.config import KernelSet, SplatConfig
from evqr_kernels.ops import (
    align_poses,
    bin_events,
    brightness_residual,
    brightness_residual_adjoint,
    clip_outliers,
    code_rhs,
    correlate_templates,
    deposit_events,
    deposit_events_adjoint,
    lag_operator,
    lag_operator_adjoint,
    local_maxima,
    match_corners,
    merge_maxima,
    motion_correlation,
    reduce_image,
    render_affine,
    render_affine_adjoint,
    sample_moments,
    sample_moments_adjoint,
    solve_code,
    splat_events,
    splat_events_adjoint,
    surface_peak,
)

__all__ = [
    "BackendUnavailable",
    "KernelBackend",
    "KernelSet",
    "SplatConfig",
    "align_poses",
    "backend_names",
    "bin_events",
    "brightness_residual",
    "brightness_residual_adjoint",
    "clip_outliers",
    "code_rhs",
    "correlate_templates",
    "deposit_events",
    "deposit_events_adjoint",
    "get_backend",
    "lag_operator",
    "lag_operator_adjoint",
    "local_maxima",
    "match_corners",
    "merge_maxima",
    "motion_correlation",
    "reduce_image",
    "register_backend",
    "render_affine",
    "render_affine_adjoint",
    "sample_moments",
    "sample_moments_adjoint",
    "solve_code",
    "splat_events",
    "splat_events_adjoint",
    "surface_peak",
]
