"""The Warp backend: buffers, devices and dispatch; the mathematics is in the files beside this one.

A launch on the CPU is one plain loop on the calling thread with the GIL released, so disjoint windows run on
as many Python threads as the caller likes (call `WarpBackend.load` before they start).
"""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import OPS, require_device
from evqr_kernels.checks import check_contiguous
from evqr_kernels.config import DEFAULT_KERNELS, KernelSet, SplatConfig
from evqr_kernels.native_output import without_lines
from evqr_kernels.warp_backend import (
    align,
    banded,
    code,
    code_normal,
    cost,
    images,
    lag,
    lag_adjoint,
    motion,
    peaks,
    pose,
    pose_normal,
    pull,
    render,
    render_adjoint,
    replay,
    residual,
    solve,
    splat,
    splat_adjoint,
    splat_strips,
    sums,
    templates,
)
from evqr_kernels.warp_backend.language import clear, record

_DTYPES = {np.dtype(np.float32): wp.float32, np.dtype(np.float64): wp.float64, np.dtype(np.int32): wp.int32}
_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


class WarpBackend:
    """Kernels written in NVIDIA Warp, for CPUs and NVIDIA GPUs."""

    name = "warp"

    bin_events = staticmethod(splat.bin_events)
    splat_events = staticmethod(splat.splat_events)
    splat_events_adjoint = staticmethod(splat_adjoint.splat_events_adjoint)
    deposit_events = staticmethod(lag.deposit_events)
    deposit_events_adjoint = staticmethod(lag_adjoint.deposit_events_adjoint)
    lag_operator = staticmethod(lag.lag_operator)
    lag_operator_adjoint = staticmethod(lag_adjoint.lag_operator_adjoint)
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
    render_code_adjoint = staticmethod(render_adjoint.render_code_adjoint)
    brightness_residual = staticmethod(residual.brightness_residual)
    brightness_residual_adjoint = staticmethod(residual.brightness_residual_adjoint)
    brightness_cost = staticmethod(cost.brightness_cost)
    brightness_cost_adjoint = staticmethod(cost.brightness_cost_adjoint)

    def __init__(self) -> None:
        level = wp.config.log_level
        wp.config.log_level = wp.LOG_ERROR
        with without_lines(_NO_DRIVER):  # a machine without a GPU is no reason for a warning
            wp.init()
        self._cpu = wp.get_device("cpu")
        self._names = tuple(device.alias for device in wp.get_devices())
        wp.config.log_level = max(level, wp.LOG_WARNING)  # each load of a module would be a line

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that this machine has; "cpu" first."""
        return self._names

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> wp.array:
        """Make an array with undefined contents."""
        require_device(self, device)
        return wp.empty(shape, dtype=_DTYPES[np.dtype(dtype)], device=device)

    def from_host(self, array: NDArray[Any], device: str) -> wp.array:
        """Bring a NumPy array to the device; on the CPU it is the same memory."""
        require_device(self, device)
        check_contiguous("array", array.flags.c_contiguous)
        if device != "cpu":
            return wp.array(array, dtype=_DTYPES[array.dtype], device=device)
        # half the time that Warp takes to look the array over, some fifty times a window
        address = array.__array_interface__["data"][0]
        wrapped = wp.array(ptr=address, dtype=_DTYPES[array.dtype], shape=array.shape, device=self._cpu)
        wrapped._ref = array  # keeps the memory for as long as the wrapper lives, as Warp does
        return wrapped

    def to_host(self, array: wp.array) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device."""
        return array.numpy()

    def assign(self, array: wp.array, values: NDArray[Any]) -> None:
        """Copy a NumPy array of the same shape and dtype into an array."""
        array.assign(values)

    def clear(self, array: wp.array) -> None:
        """Fill an array with zeros."""
        clear(array)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what ``run`` launches; the result launches it again at a fraction of the cost."""
        return record(run)

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on the device."""
        wp.synchronize_device(device)

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        if op not in OPS:
            return f"no operation {op!r}"
        if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
            return f"dtype {np.dtype(dtype)} is neither float32 nor float64"
        return None if device in self.devices() else f"no device {device!r}"

    def needs_compile(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> bool:
        """Whether some of the kernels are not yet in this machine's cache, so that `load` takes seconds."""
        require_device(self, device)
        return not all(is_compiled(module, device) for module in _modules(kernels, device))

    def load(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> None:
        """Compile or load kernels (float32); call it before threads start."""
        require_device(self, device)
        for module in _modules(kernels, device):
            wp.load_module(module, device=device)


def is_compiled(module: wp.Module, device: str) -> bool:
    """Whether a module, as it is now, is in this machine's cache."""
    name = module.get_module_identifier(1 if device == "cpu" else None)  # the block size is part of the hash
    return os.path.isdir(os.path.join(str(wp.config.kernel_cache_dir), name))


def _modules(kernels: KernelSet, device: str) -> list[wp.Module]:
    """List the Warp modules of the kernels that reading a code launches, and of the splats named."""
    f32 = wp.float32
    block = templates.block_of(wp.get_device(device), width=640)
    made = [
        splat.make_bin_events(f32),
        lag.make_deposit_events(f32),
        lag.make_lag_rows(f32, lag.block_of(wp.get_device(device))),
        lag.make_lag_columns(f32, lag.block_of(wp.get_device(device))),
        motion.make_clip_rows(f32, motion.block_of(wp.get_device(device))),
        motion.make_correlate_rows(
            f32, motion.block_of(wp.get_device(device)), motion.rows_of(wp.get_device(device))
        ),
        motion.make_add_rows(f32, motion.block_of(wp.get_device(device))),
        motion.make_surface_peak(f32),
        images.make_measure_rows(f32),
        images.make_limit(f32),
        images.make_clip_rows(f32),
        images.make_reduce_image(f32),
        images.make_mix_images(f32),
        templates.make_running_squares(f32, block),
        templates.make_quiet_floor(f32),
        templates.make_correlate_basis(f32, block),
        templates.make_best_template(f32),
        peaks.make_local_maxima(f32, peaks.block_of(wp.get_device(device))),
        peaks.make_merge_maxima(f32),
        peaks.make_match_corners(f32),
        align.make_align_poses(f32, kernels.table_columns, unrolled=device == "cpu"),
        code.make_sample_rows(f32),
        code.make_fold_columns(f32, code.BLOCK),
        pull.make_pull_modules(f32),
        *solve.make_kernels(f32, on_cpu=device == "cpu"),
        *([replay.run_sequence] if device == "cpu" else []),
        *(kernel for cfg in kernels.splats for kernel in splat_kernels(cfg, wp.get_device(device))),
    ]
    return list(dict.fromkeys(kernel.module for kernel in made))


def splat_kernels(cfg: SplatConfig, device: wp.Device) -> list[wp.Kernel]:
    """List the kernels of a splat and its adjoint, for motions of two and of six parameters.

    They are those for images that are not narrower than the splat.
    """
    f32, on_cpu, columns = wp.float32, splat_strips.holds_rows(device), 2 * cfg.reach + 1
    columns = columns if on_cpu else splat_strips.strip_columns(cfg, columns)
    kernels = [sums.make_add_partials(f32)]
    for parameters in (2, 6):
        kernels.append(splat.make_splat_events(f32, cfg, parameters, columns, on_cpu))
        kernels.append(splat_adjoint.make_splat_events_adjoint(f32, cfg, parameters, columns, on_cpu))
    return kernels


def load() -> WarpBackend:
    """Make the backend; the registry calls it."""
    return WarpBackend()
