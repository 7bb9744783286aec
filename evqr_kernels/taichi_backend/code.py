"""Right-hand side of the equations of modules; the formulas are in ``warp_backend/code.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import array, float_of, row_of, row_of_plane, run_at, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.pose import make_bilinear, make_project

BLOCK = 8
"""Neighbouring modules, or samples of them, done together, where there are as many."""


@ti.func
def reach_of(profile, samples_a_module):
    """Give how many modules beside a module its profile covers."""
    twice = 2 * samples_a_module
    return ti.max(profile - samples_a_module + twice - 1, 0) // twice


@cache
def make_sample_lattice(dtype):
    """Build the first pass; one thread per (window, lattice row)."""
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @ti.kernel
    def sample_lattice(
        image: array(dtype, 3),
        pose: array(dtype, 2),
        space_idx: array(ti.i32, 1),
        lattice_u: array(dtype, 2),
        lattice_v: array(dtype, 2),
        sides: array(ti.i32, 2),
        profile: array(dtype, 1),
        samples_a_module: ti.i32,
        samples_out: array(dtype, 3),
    ):
        for b, row in ti.ndrange(samples_out.shape[0], samples_out.shape[1]):
            m = space_idx[b]
            if row < sides[m, 0] * samples_a_module:
                modules = sides[m, 1]
                run = samples_out.shape[2] // samples_a_module
                before = reach_of(profile.shape[0], samples_a_module)
                for phase in range(samples_a_module):
                    first = phase * run
                    for j in range(before):
                        samples_out[b, row, first + j] = dtype(0.0)
                    for j in range(modules):
                        u = lattice_u[m, j * samples_a_module + phase]
                        x, y = project(pose, b, u, lattice_v[m, row])
                        samples_out[b, row, first + before + j] = bilinear(image, b, x, y)
                    for j in range(before + modules, run):
                        samples_out[b, row, first + j] = dtype(0.0)

    return sample_lattice


@cache
def make_fold_samples(dtype, block: int):
    """Build the second pass; one thread per (window, row of modules).

    The last block of a row ends with the row of the array and may overlap the one before: the same modules
    with the same result.
    """

    @ti.kernel
    def fold_samples(
        samples: array(dtype, 3),
        space_idx: array(ti.i32, 1),
        sides: array(ti.i32, 2),
        profile: array(dtype, 1),
        slope: array(dtype, 1),
        gain: array(dtype, 2),
        samples_a_module: ti.i32,
        rows_out: array(dtype, 4),
        rhs_out: array(dtype, 3),
    ):
        for b, i in ti.ndrange(rhs_out.shape[0], rhs_out.shape[1]):
            m = space_idx[b]
            rows = sides[m, 0]
            columns = sides[m, 1]
            width = rhs_out.shape[2]
            support = profile.shape[0]
            before = (support - samples_a_module) // 2
            reach = reach_of(support, samples_a_module)
            length = samples.shape[2]
            run = length // samples_a_module
            if i < rows:
                first = i * samples_a_module - before
                begin = ti.max(0, -first)
                end = ti.min(support, rows * samples_a_module - first)
                for n in range(length // BLOCK):
                    along_u = ti.Vector.zero(dtype, BLOCK)
                    along_v = ti.Vector.zero(dtype, BLOCK)
                    for s in range(begin, end):
                        at = run_at(row_of(samples, b, first + s) + BLOCK * n)
                        for p in ti.static(range(BLOCK)):
                            along_u[p] += profile[s] * samples[0, 0, at + p]
                            along_v[p] += slope[s] * samples[0, 0, at + p]
                    to_u = run_at(row_of_plane(rows_out, b, 0, i) + BLOCK * n)
                    to_v = run_at(row_of_plane(rows_out, b, 1, i) + BLOCK * n)
                    for p in ti.static(range(BLOCK)):
                        rows_out[0, 0, 0, to_u + p] = gain[b, 0] * along_u[p]
                        rows_out[0, 0, 0, to_v + p] = gain[b, 1] * along_v[p]
            for k in range((width + block - 1) // block):
                j = ti.min(block * k, width - block)
                total = ti.Vector.zero(dtype, block)
                if i < rows and j < columns:
                    for phase in range(samples_a_module):
                        # the profile's first sample that falls on this one of a module, and on which module
                        s = (phase + before + samples_a_module) % samples_a_module
                        at = phase * run + reach + j + (s - before - phase) // samples_a_module
                        while s < support:
                            along_u = run_at(row_of_plane(rows_out, b, 0, i) + at)
                            along_v = run_at(row_of_plane(rows_out, b, 1, i) + at)
                            for p in ti.static(range(block)):
                                total[p] += slope[s] * rows_out[0, 0, 0, along_u + p]
                                total[p] += profile[s] * rows_out[0, 0, 0, along_v + p]
                            s += samples_a_module
                            at += 1
                to = run_at(row_of(rhs_out, b, i) + j)
                for p in ti.static(range(block)):
                    rhs_out[0, 0, to + p] = ti.select(j + p < columns, total[p], dtype(0.0))

    return fold_samples


def code_rhs(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module: int,
    samples_out, rows_out, rhs_out,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    dtype = float_of(image)
    launch(
        make_sample_lattice(dtype),
        *(image, pose, space_idx, lattice_u, lattice_v, sides, profile, samples_a_module, samples_out),
    )
    launch(
        make_fold_samples(dtype, BLOCK if rhs_out.shape[2] >= BLOCK else 1),
        *(samples_out, space_idx, sides, profile, slope, gain, samples_a_module, rows_out, rhs_out),
    )
