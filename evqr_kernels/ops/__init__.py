"""The checked door: functions on arrays that check, choose a backend, allocate, and compute.

They take NumPy's arrays, and those in the host's memory of any library that speaks DLPack or
``__array_interface__``, which are read in place; they return NumPy's.  Only an array of NumPy that is not
C-contiguous is copied.  `evqr_kernels.torch` and `evqr_kernels.jax` work on a GPU's memory as well.

All arrays of a call are float32, or all float64; index arrays are int32.  Each function takes ``backend`` (a
name for `evqr_kernels.backend.get_backend`) and ``device`` ("cpu", "cuda:0", ...; by default the backend's
first), and raises

TypeError            what is no array or cannot be read in place, or is of the wrong dtype
ValueError           a wrong shape, range, name or device
BackendUnavailable   a backend that cannot be loaded here
NotImplementedError  an operation that the backend refuses, with its reason

Who owns device buffers calls the methods of the backend, which have the same names and take the same arrays.
Shape letters: B windows, E events, Y and X image rows and columns.
"""

from evqr_kernels.ops.codes import (
    align_poses,
    code_rhs,
    pull_modules,
    sample_moments,
    sample_moments_adjoint,
    solve_code,
)
from evqr_kernels.ops.events import (
    bin_events,
    deposit_events,
    deposit_events_adjoint,
    lag_operator,
    lag_operator_adjoint,
    splat_events,
    splat_events_adjoint,
)
from evqr_kernels.ops.images import (
    clip_outliers,
    correlate_templates,
    local_maxima,
    match_corners,
    merge_maxima,
    mix_images,
    motion_correlation,
    reduce_image,
    surface_peak,
)
from evqr_kernels.ops.normal import (
    code_normal_equations,
    code_product,
    pose_normal_equations,
    solve_code_banded,
)
from evqr_kernels.ops.render import (
    brightness_cost,
    brightness_cost_adjoint,
    brightness_residual,
    brightness_residual_adjoint,
    render_code,
    render_code_adjoint,
)

__all__ = [
    "align_poses",
    "bin_events",
    "brightness_cost",
    "brightness_cost_adjoint",
    "brightness_residual",
    "brightness_residual_adjoint",
    "clip_outliers",
    "code_normal_equations",
    "code_product",
    "code_rhs",
    "correlate_templates",
    "deposit_events",
    "deposit_events_adjoint",
    "lag_operator",
    "lag_operator_adjoint",
    "local_maxima",
    "match_corners",
    "merge_maxima",
    "mix_images",
    "motion_correlation",
    "pose_normal_equations",
    "pull_modules",
    "reduce_image",
    "render_code",
    "render_code_adjoint",
    "sample_moments",
    "sample_moments_adjoint",
    "solve_code",
    "solve_code_banded",
    "splat_events",
    "splat_events_adjoint",
    "surface_peak",
]
