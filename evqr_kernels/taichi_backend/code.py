"""Stage two's right-hand side; the formulas are in ``warp_backend/code.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.pose import make_bilinear, make_project


@cache
def make_sample_rows(dtype):
    """Build the first pass; one thread per (window, lattice row)."""
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @ti.kernel
    def sample_rows(
        image: array(dtype, 3),
        pose: array(dtype, 2),
        lattice: array(dtype, 1),
        profile: array(dtype, 1),
        slope: array(dtype, 1),
        samples_a_module: ti.i32,
        samples_out: array(dtype, 3),
        rows_out: array(dtype, 4),
    ):
        for b, row in ti.ndrange(samples_out.shape[0], samples_out.shape[1]):
            count = lattice.shape[0]
            for i in range(count):
                x, y = project(pose, b, lattice[i], lattice[row])
                samples_out[b, row, i] = bilinear(image, b, x, y)
            support = profile.shape[0]
            before = (support - samples_a_module) // 2
            for j in range(rows_out.shape[3]):
                first = j * samples_a_module - before
                total = dtype(0.0)
                total_slope = dtype(0.0)
                for k in range(ti.max(0, -first), ti.min(support, count - first)):
                    e = samples_out[b, row, first + k]
                    total += e * profile[k]
                    total_slope += e * slope[k]
                rows_out[b, 0, row, j] = total
                rows_out[b, 1, row, j] = total_slope

    return sample_rows


@cache
def make_fold_columns(dtype):
    """Build the second pass; one thread per (window, row of modules)."""

    @ti.kernel
    def fold_columns(
        rows: array(dtype, 4),
        profile: array(dtype, 1),
        slope: array(dtype, 1),
        gain: array(dtype, 2),
        samples_a_module: ti.i32,
        rhs_out: array(dtype, 3),
    ):
        for b, i in ti.ndrange(rhs_out.shape[0], rhs_out.shape[1]):
            support = profile.shape[0]
            first = i * samples_a_module - (support - samples_a_module) // 2
            for j in range(rhs_out.shape[2]):
                total = dtype(0.0)
                for s in range(ti.max(0, -first), ti.min(support, rows.shape[2] - first)):
                    total += (gain[b, 0] * profile[s]) * rows[b, 1, first + s, j]
                    total += (gain[b, 1] * slope[s]) * rows[b, 0, first + s, j]
                rhs_out[b, i, j] = total

    return fold_columns


def code_rhs(
    image, pose, lattice, profile, slope, gain, samples_a_module: int, samples_out, rows_out, rhs_out
) -> None:
    """Launch both passes; overwrites."""
    dtype = float_of(image)
    first = make_sample_rows(dtype)
    launch(first, image, pose, lattice, profile, slope, samples_a_module, samples_out, rows_out)
    launch(make_fold_columns(dtype), rows_out, profile, slope, gain, samples_a_module, rhs_out)
