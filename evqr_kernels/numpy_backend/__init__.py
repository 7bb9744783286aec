"""The specification: every kernel in plain NumPy, float32 and float64, written to be read and not to be fast.

One file a concept, mirroring ``warp_backend``.  The other backends are tested against this one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import OPS
from evqr_kernels.checks import check_contiguous
from evqr_kernels.config import DEFAULT_KERNELS, KernelSet
from evqr_kernels.numpy_backend import (
    align,
    banded,
    code,
    code_normal,
    cost,
    images,
    lag,
    motion,
    peaks,
    pose,
    pose_normal,
    pull,
    render,
    residual,
    solve,
    splat,
    templates,
)


class NumpyBackend:
    """Plain NumPy on the CPU."""

    name = "numpy"

    bin_events = staticmethod(splat.bin_events)
    splat_events = staticmethod(splat.splat_events)
    splat_events_adjoint = staticmethod(splat.splat_events_adjoint)
    deposit_events = staticmethod(lag.deposit_events)
    deposit_events_adjoint = staticmethod(lag.deposit_events_adjoint)
    lag_operator = staticmethod(lag.lag_operator)
    lag_operator_adjoint = staticmethod(lag.lag_operator_adjoint)
    motion_correlation = staticmethod(motion.motion_correlation)
    surface_peak = staticmethod(motion.surface_peak)
    clip_outliers = staticmethod(images.clip_outliers)
    reduce_image = staticmethod(images.reduce_image)
    mix_images = staticmethod(images.mix_images)
    correlate_templates = staticmethod(templates.correlate_templates)
    local_maxima = staticmethod(peaks.local_maxima)
    merge_maxima = staticmethod(peaks.merge_maxima)
    match_corners = staticmethod(peaks.match_corners)
    sample_moments = staticmethod(pose.sample_moments)
    sample_moments_adjoint = staticmethod(pose.sample_moments_adjoint)
    align_poses = staticmethod(align.align_poses)
    pose_normal_equations = staticmethod(pose_normal.pose_normal_equations)
    code_rhs = staticmethod(code.code_rhs)
    code_normal_equations = staticmethod(code_normal.code_normal_equations)
    code_product = staticmethod(code_normal.code_product)
    pull_modules = staticmethod(pull.pull_modules)
    solve_code = staticmethod(solve.solve_code)
    solve_code_banded = staticmethod(banded.solve_code_banded)
    render_code = staticmethod(render.render_code)
    render_code_adjoint = staticmethod(render.render_code_adjoint)
    brightness_residual = staticmethod(residual.brightness_residual)
    brightness_residual_adjoint = staticmethod(residual.brightness_residual_adjoint)
    brightness_cost = staticmethod(cost.brightness_cost)
    brightness_cost_adjoint = staticmethod(cost.brightness_cost_adjoint)

    def devices(self) -> tuple[str, ...]:
        """Name the CPU, the only one."""
        return ("cpu",)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> NDArray[Any]:
        """Make an array with undefined contents."""
        return np.empty(shape, dtype)

    def from_host(self, array: NDArray[Any], device: str) -> NDArray[Any]:
        """Give the same memory."""
        check_contiguous("array", array.flags.c_contiguous)
        return array

    def to_host(self, array: NDArray[Any]) -> NDArray[Any]:
        """Give the same memory."""
        return array

    def assign(self, array: NDArray[Any], values: NDArray[Any]) -> None:
        """Copy an array into another."""
        array[...] = values

    def clear(self, array: NDArray[Any]) -> None:
        """Fill an array with zeros."""
        array.fill(0)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Give the function itself."""
        return run

    def synchronize(self, device: str) -> None:
        """Do nothing: NumPy has finished when it returns."""

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        if op not in OPS:
            return f"no operation {op!r}"
        if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
            return f"dtype {np.dtype(dtype)} is neither float32 nor float64"
        return None if device == "cpu" else f"no device {device!r}"

    def needs_compile(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> bool:
        """Nothing to compile."""
        return False

    def load(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> None:
        """Nothing to load."""


def load() -> NumpyBackend:
    """Make the backend; the registry calls it."""
    return NumpyBackend()
