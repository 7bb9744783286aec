"""The Taichi backend: buffers, devices and dispatch; the mathematics is in the files beside this one.

One file a concept, mirroring ``warp_backend``.  On the CPU an array is a NumPy array: Taichi's kernels take
its memory as it is.  A launch there runs on all cores and holds the GIL, so that Python threads take turns.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from evqr_kernels.backend import OPS
from evqr_kernels.checks import check_contiguous
from evqr_kernels.config import DEFAULT_KERNELS, KernelSet, SplatConfig
from evqr_kernels.taichi_backend import (
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
    residual,
    runtime,
    solve,
    splat,
    splat_adjoint,
    sums,
    templates,
)
from evqr_kernels.taichi_backend.arrays import DeviceArray, write
from evqr_kernels.taichi_backend.language import CPU_BLOCK, DTYPES, GPU_BLOCK, ti
from evqr_kernels.taichi_backend.launches import LOCK, compile_kernel, launch, record

TAPS = 5
"""Taps of the lag operator that reading a code asks for."""


class TaichiBackend:
    """Kernels written in Taichi, for CPUs, NVIDIA GPUs and whatever runs Vulkan or Metal."""

    name = "taichi"

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
        self._loaded: set[KernelSet] = set()

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that can be asked for: once Taichi runs, the one where it runs."""
        running = runtime.running_on()
        return runtime.devices() if running is None else (running,)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> Any:
        """Make an array with undefined contents."""
        runtime.require(device)
        if math.prod(shape) > np.iinfo(np.int32).max:
            raise ValueError(f"an array of Taichi's must have fewer than 2^31 elements, got shape {shape}")
        if device == "cpu" or 0 in shape:  # Taichi has no empty arrays of its own
            return np.empty(shape, dtype)
        with LOCK:
            return DeviceArray(DTYPES[np.dtype(dtype)], shape)

    def from_host(self, array: NDArray[Any], device: str) -> Any:
        """Bring a NumPy array to the device; on the CPU it is the same memory."""
        check_contiguous("array", array.flags.c_contiguous)
        if device == "cpu" or array.size == 0:
            runtime.require(device)
            return array
        there = self.empty(array.shape, array.dtype, device)
        self.assign(there, array)
        return there

    def to_host(self, array: Any) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device."""
        if isinstance(array, np.ndarray):
            return array
        with LOCK:
            return array.to_numpy()

    def assign(self, array: Any, values: NDArray[Any]) -> None:
        """Copy a NumPy array of the same shape and dtype into an array."""
        with LOCK:
            write(array, values)

    def clear(self, array: Any) -> None:
        """Fill an array with zeros."""
        launch(array.fill, 0)

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what ``run`` launches; the result launches it again."""
        return record(run)

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on the device."""
        runtime.require(device)
        with LOCK:
            ti.sync()

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        if op not in OPS:
            return f"no operation {op!r}"
        dtype = np.dtype(dtype)
        if dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
            return f"dtype {dtype} is neither float32 nor float64"
        if device not in self.devices():
            return f"no device {device!r}"
        if dtype == np.float64 and not runtime.has_float64(device):
            return (
                f"{device} computes in float32 only, not in float64: give float32 arrays, or another device"
            )
        return None

    def needs_compile(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> bool:
        """Whether `load` is still to be called, which takes a second even from Taichi's own cache."""
        runtime.require(device)
        return kernels not in self._loaded

    def load(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> None:
        """Compile or load kernels (float32); call it before threads start."""
        runtime.require(device)
        with LOCK:
            if kernels not in self._loaded:
                for kernel in _kernels(kernels):
                    compile_kernel(kernel)
                self._loaded.add(kernels)


def _kernels(kernels: KernelSet) -> list[Any]:
    """List the kernels that reading a code, one window at a time, launches, and those of the splats named."""
    f32 = ti.f32
    on_cpu = runtime.running_on() == "cpu"
    block = CPU_BLOCK if on_cpu else GPU_BLOCK
    return [
        splat.make_bin_events(f32, not on_cpu, on_cpu),
        lag.make_deposit_events(f32, not on_cpu, on_cpu),
        lag.make_lag_rows(f32, TAPS, min(block, lag.MOST_CELLS)),
        lag.make_lag_columns(f32, TAPS, min(block, lag.MOST_CELLS)),
        motion.make_clip_rows(f32),
        motion.make_correlate_rows(f32),
        motion.make_add_rows(f32),
        motion.make_surface_peak(f32, on_cpu),
        images.make_measure_rows(f32),
        images.make_limit(f32, on_cpu),
        images.make_clip_rows(f32),
        images.make_reduce_image(f32),
        images.make_mix_images(f32, block),
        templates.make_running_squares(f32, block),
        templates.make_quiet_floor(f32, on_cpu),
        templates.make_correlate_basis(f32, block),
        templates.make_best_template(f32),
        peaks.make_local_maxima(f32),
        peaks.make_merge_maxima(f32, on_cpu),
        peaks.make_match_corners(f32),
        *(align.make_align_poses(f32, kernels.table_columns, alone) for alone in {False, on_cpu}),
        code.make_sample_rows(f32),
        code.make_fold_columns(f32, code.BLOCK),
        pull.make_pull_modules(f32),
        *solve.make_kernels(f32, on_cpu),
        *(kernel for cfg in kernels.splats for kernel in _splat_kernels(cfg, on_cpu)),
    ]


def _splat_kernels(cfg: SplatConfig, on_cpu: bool) -> list[Any]:
    """List the kernels of a splat and its adjoint, for one window and several, and both kinds of motion."""
    made = [sums.make_add_partials(ti.f32)]
    for parameters in (2, 6):
        made.append(splat_adjoint.make_splat_events_adjoint(ti.f32, cfg, parameters))
        for alone in {False, on_cpu}:
            made.append(splat.make_splat_events(ti.f32, cfg, parameters, not on_cpu, alone))
    return made


def load() -> TaichiBackend:
    """Make the backend; the registry calls it."""
    return TaichiBackend()
