"""The Warp backend: buffers, devices and launches; the mathematics is in the files beside this one.

A launch on the CPU is one plain loop on the calling thread with the GIL released, so disjoint windows run on as many Python
threads as the caller likes.
"""

import numpy as np
import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend import code, motion, pose, splat, templates

_DTYPES = {np.dtype(np.float32): wp.float32, np.dtype(np.float64): wp.float64, np.dtype(np.int32): wp.int32}


class WarpBackend:
    """Kernels written in NVIDIA Warp, for CPUs and NVIDIA GPUs."""

    name = "warp"

    def __init__(self) -> None:
        level = wp.config.log_level
        wp.config.log_level = wp.LOG_ERROR  # a machine without a GPU is no reason for a warning
        wp.init()
        wp.config.log_level = max(level, wp.LOG_WARNING)

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that this machine has."""
        return tuple(d.alias for d in wp.get_devices())

    def empty(self, shape, dtype, device):
        """An array with undefined contents."""
        return wp.empty(shape, dtype=_DTYPES[np.dtype(dtype)], device=device)

    def from_host(self, array, device):
        """A copy of a NumPy array on the device; on the CPU the same memory."""
        array = np.ascontiguousarray(array)
        return wp.from_numpy(array, dtype=_DTYPES[array.dtype], device=device) if device != "cpu" else wp.array(
            array, dtype=_DTYPES[array.dtype], device=device, copy=False
        )

    def to_host(self, array):
        """A NumPy array with the contents; on the CPU the same memory."""
        return array.numpy()

    def synchronize(self, device) -> None:
        """Wait for everything launched on the device."""
        wp.synchronize_device(device)

    def bin_events(self, x, y, weight, window_ptr, reduction, image_out):
        kernel = splat.make_bin_events(x.dtype)
        wp.launch(kernel, x.shape[0], inputs=[x, y, weight, window_ptr, 1.0 / reduction], outputs=[image_out], device=x.device)

    def splat_events(self, x, y, t, weight, window_ptr, motion, lag, frame, image_out, cfg: SplatConfig):
        kernel = splat.make_splat_events(x.dtype, cfg)
        wp.launch(kernel, x.shape[0], inputs=[x, y, t, weight, window_ptr, motion, lag, frame], outputs=[image_out], device=x.device)

    def motion_correlation(self, first, second, radius, rows, correlation_out):
        rows_kernel, add = motion.make_motion_correlation(first.dtype)
        wp.launch(rows_kernel, first.shape[:2], inputs=[first, second, radius], outputs=[rows], device=first.device)
        wp.launch(add, correlation_out.shape, inputs=[rows], outputs=[correlation_out], device=first.device)

    def reduce_image(self, image, ratio, image_out):
        wp.launch(templates.make_reduce_image(image.dtype), image_out.shape, inputs=[image, ratio], outputs=[image_out], device=image.device)

    def correlate_templates(self, image, bank, disc, floor, response_out, angle_out):
        kernel = templates.make_correlate_templates(image.dtype)
        b, h, w = response_out.shape
        vec = wp.types.vector(length=templates.ANGLES, dtype=image.dtype)
        bank = bank.view(vec) if bank.ndim == 3 else bank
        wp.launch(kernel, (b, h, w // 4), inputs=[image, bank, disc, floor], outputs=[response_out, angle_out], device=image.device)

    def sample_moments(self, image, image_idx, p, active, points, table, chunks, moments_out):
        columns = table.shape[1]
        of_chunks, add = pose.make_sample_moments(image.dtype, columns)
        vec = wp.types.vector(length=columns, dtype=image.dtype)
        n = -(-points.shape[0] // pose.CHUNK)
        wp.launch(of_chunks, (p.shape[0], n), inputs=[image, image_idx, p, active, points, table.view(vec)], outputs=[chunks], device=image.device)
        wp.launch(add, moments_out.shape, inputs=[chunks, active, n], outputs=[moments_out], device=image.device)

    def code_rhs(self, image, p, lattice, profile, slope, gain, samples_a_module, samples, rows, rhs_out):
        sample_rows, fold = code.make_code_rhs(image.dtype)
        wp.launch(sample_rows, (p.shape[0], lattice.shape[0]), inputs=[image, p, lattice, profile, slope, samples_a_module], outputs=[samples, rows], device=image.device)
        wp.launch(fold, rhs_out.shape, inputs=[rows, profile, slope, gain, samples_a_module], outputs=[rhs_out], device=image.device)

    def solve_code(self, rhs, stencil, damping, free, q, scratch, iterations_out, *, max_iterations, tolerance):
        start, apply, update = code.make_solve_code(rhs.dtype)
        residual, da, db, product, ra, rb = scratch
        dim = (rhs.shape[0], rhs.shape[1])
        dev = rhs.device
        wp.launch(start, dim, inputs=[rhs, stencil, damping, free, q], outputs=[residual, da, ra], device=dev)
        iterations_out.zero_()
        for _ in range(max_iterations):
            wp.launch(apply, dim, inputs=[stencil, damping, free, residual, da, tolerance**2, ra], outputs=[db, product], device=dev)
            wp.launch(update, dim, inputs=[residual, db, product, tolerance**2, ra], outputs=[rb, q, iterations_out], device=dev)
            da, db, ra, rb = db, da, rb, ra


    def needs_compile(self, device: str = "cpu") -> bool:
        return False

    def load(self, device: str = "cpu") -> None:
        pass

    def supports(self, op, dtype, device):
        return None


def load() -> WarpBackend:
    """Entry point of the registry."""
    return WarpBackend()
