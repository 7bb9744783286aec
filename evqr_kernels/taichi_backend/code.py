"""Right-hand side of the equations of modules; the formulas are in ``warp_backend/code.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, row_of, row_of_plane, run_at, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.pose import make_bilinear, make_project

BLOCK = 8
"""Neighbouring samples, or modules where there are as many, done together."""


@cache
def make_sample_rows(dtype):
    """Build the first pass; one thread per (window, lattice row)."""
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @ti.kernel
    def sample_rows(
        image: array(dtype, 3),
        pose: array(dtype, 2),
        lattice_u: array(dtype, 1),
        lattice_v: array(dtype, 1),
        profile: array(dtype, 1),
        slope: array(dtype, 1),
        samples_a_module: ti.i32,
        samples_out: array(dtype, 3),
        rows_out: array(dtype, 4),
    ):
        for b, row in ti.ndrange(samples_out.shape[0], samples_out.shape[1]):
            count = lattice_u.shape[0]
            for i in range(count):
                x, y = project(pose, b, lattice_u[i], lattice_v[row])
                samples_out[b, row, i] = bilinear(image, b, x, y)
            support = profile.shape[0]
            before = (support - samples_a_module) // 2
            for j in range(rows_out.shape[3]):
                first = j * samples_a_module - before
                begin = ti.max(0, -first)
                end = ti.min(support, count - first)
                whole = (end - begin) // BLOCK
                by_profile = ti.Vector.zero(dtype, BLOCK)
                by_slope = ti.Vector.zero(dtype, BLOCK)
                for m in range(whole):
                    tap = run_at(begin + BLOCK * m)
                    at = run_at(row_of(samples_out, b, row) + first + begin + BLOCK * m)
                    for p in ti.static(range(BLOCK)):
                        by_profile[p] += samples_out[0, 0, at + p] * profile[tap + p]
                        by_slope[p] += samples_out[0, 0, at + p] * slope[tap + p]
                total = by_profile.sum()
                total_slope = by_slope.sum()
                for k in range(begin + BLOCK * whole, end):
                    e = samples_out[b, row, first + k]
                    total += e * profile[k]
                    total_slope += e * slope[k]
                rows_out[b, 0, row, j] = total
                rows_out[b, 1, row, j] = total_slope

    return sample_rows


@cache
def make_fold_columns(dtype, block: int):
    """Build the second pass; one thread per (window, row of modules).

    The last block of a row ends with the row and may overlap the one before: the same modules with the same
    result.
    """

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
            modules = rhs_out.shape[2]
            support = profile.shape[0]
            first = i * samples_a_module - (support - samples_a_module) // 2
            begin = ti.max(0, -first)
            end = ti.min(support, rows.shape[2] - first)
            for k in range((modules + block - 1) // block):
                j = ti.min(block * k, modules - block)
                total = ti.Vector.zero(dtype, block)
                for s in range(begin, end):
                    by_slope = gain[b, 0] * profile[s]
                    by_profile = gain[b, 1] * slope[s]
                    slopes = run_at(row_of_plane(rows, b, 1, first + s) + j)
                    values = run_at(row_of_plane(rows, b, 0, first + s) + j)
                    for p in ti.static(range(block)):
                        total[p] += by_slope * rows[0, 0, 0, slopes + p]
                        total[p] += by_profile * rows[0, 0, 0, values + p]
                to = run_at(row_of(rhs_out, b, i) + j)
                for p in ti.static(range(block)):
                    rhs_out[0, 0, to + p] = total[p]

    return fold_columns


def code_rhs(
    image, pose, lattice_u, lattice_v, profile, slope, gain, samples_a_module: int, samples_out, rows_out,
    rhs_out,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    dtype = float_of(image)
    first = make_sample_rows(dtype)
    lattices = lattice_u, lattice_v
    launch(first, image, pose, *lattices, profile, slope, samples_a_module, samples_out, rows_out)
    fold = make_fold_columns(dtype, BLOCK if rhs_out.shape[2] >= BLOCK else 1)
    launch(fold, rows_out, profile, slope, gain, samples_a_module, rhs_out)
