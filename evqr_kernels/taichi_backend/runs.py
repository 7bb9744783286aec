"""Runs of one sign along straight lines; the formulas are in ``warp_backend/runs.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch


@cache
def make_line_runs(dtype):
    """Build the kernel; one thread per line."""

    @ti.kernel
    def line_runs(
        image: array(dtype, 3),
        slope: array(dtype, 1),
        steep: array(ti.i32, 1),
        threshold: array(dtype, 2),
        most: dtype,
        runs_out: array(dtype, 4),
    ):
        for b, a, line in ti.ndrange(runs_out.shape[0], runs_out.shape[1], runs_out.shape[3]):
            across = image.shape[1]
            along = image.shape[2]
            if steep[a] != 0:
                across = image.shape[2]
                along = image.shape[1]
            begin = dtype(line)
            if slope[a] > dtype(0.0):
                begin -= dtype(along)
            light = dtype(0.0)
            dark = dtype(0.0)
            light_best = dtype(0.0)
            dark_best = dtype(0.0)
            if threshold[b, a] > dtype(0.0):
                scale = dtype(1.0) / threshold[b, a]
                for t in range(along):
                    at = begin + slope[a] * dtype(t)
                    first = int(ti.floor(at))
                    if first >= -1 and first < across:
                        near = dtype(0.0)
                        far = dtype(0.0)
                        if first >= 0:
                            near = image[b, t, first] if steep[a] != 0 else image[b, first, t]
                        if first + 1 < across:
                            far = image[b, t, first + 1] if steep[a] != 0 else image[b, first + 1, t]
                        e = scale * (near + (at - dtype(first)) * (far - near))
                        e = ti.max(ti.min(e, most), -most)
                        light = ti.max(light, dtype(0.0)) + e - dtype(1.0)
                        dark = ti.max(dark, dtype(0.0)) - e - dtype(1.0)
                        light_best = ti.max(light_best, light)
                        dark_best = ti.max(dark_best, dark)
            runs_out[b, a, 0, line] = light_best
            runs_out[b, a, 1, line] = dark_best

    return line_runs


def line_runs(image, slope, steep, threshold, most: float, runs_out) -> None:
    """Launch; overwrites."""
    if 0 in runs_out.shape:
        return
    launch(make_line_runs(float_of(image)), image, slope, steep, threshold, most, runs_out)
