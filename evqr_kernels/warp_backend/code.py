"""Right-hand side of the equations of modules.

The model of the residual image in code coordinates is ``A q = a_u B q B'^T + a_v B' q B^T`` (rows v, columns
u), with B the module profile sampled K times a module and B' its derivative: left of q for V modules along
v, right of it for U along u.  With E the image sampled on the same lattice under a pose:

    rhs = A^T E = (a_u B^T E) B' + (a_v B'^T E) B

Each window has a lattice of one of several codes, which may be smaller than the arrays are: what lies beyond
it is 0.  ``sample_lattice`` samples a row of the lattice, ``fold_samples`` folds the rows that a module
reaches into one, and that with the profiles along u.  The profile covers the module it belongs to and as many
samples before as after.

A row is stored with the first samples of all modules side by side, then their second samples, ..., so that
what neighbouring modules take lies side by side in memory; each run has zeros on either side, as many modules
as a profile reaches.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.pose import make_bilinear, make_project

BLOCK = 8
"""Neighbouring modules, or samples of them, done together, where there are as many."""


@wp.func
def reach_of(profile: int, samples_a_module: int) -> int:
    """Give how many modules beside a module its profile covers."""
    twice = 2 * samples_a_module
    return wp.max(profile - samples_a_module + twice - 1, 0) // twice


@cache
def make_sample_lattice(dtype: type) -> wp.Kernel:
    """Build the first pass; launch: one thread per (window, lattice row).  ``pairs``: see `make_bilinear`."""
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @wp.kernel(module=module_of("code", dtype))
    def sample_lattice(
        pairs: wp.array3d(dtype=vector(2, dtype)),
        pose: wp.array2d(dtype=dtype),
        space_idx: wp.array(dtype=wp.int32),
        lattice_u: wp.array2d(dtype=dtype),
        lattice_v: wp.array2d(dtype=dtype),
        sides: wp.array2d(dtype=wp.int32),
        profile: wp.array(dtype=dtype),
        samples_a_module: int,
        samples_out: wp.array3d(dtype=dtype),
    ):
        b, row = wp.tid()
        m = space_idx[b]
        if row >= sides[m, 0] * samples_a_module:
            return
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
                samples_out[b, row, first + before + j] = bilinear(pairs, b, x, y)
            for j in range(before + modules, run):
                samples_out[b, row, first + j] = dtype(0.0)

    return sample_lattice


@cache
def make_fold_samples(dtype: type, block: int) -> wp.Kernel:
    """Build the second pass; launch: one thread per (window, row of modules).

    The last block of a row ends with the row of the array and may overlap the one before: the same modules
    with the same result.  ``.._blocks``: `neighbours`.
    """
    vec = vector(BLOCK, dtype)
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of("code" if block == BLOCK else f"code_{block}", dtype))
    def fold_samples(
        sample_blocks: wp.array3d(dtype=vec),
        space_idx: wp.array(dtype=wp.int32),
        sides: wp.array2d(dtype=wp.int32),
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        samples_a_module: int,
        row_blocks_out: wp.array4d(dtype=vec),
        row_parts_out: wp.array4d(dtype=vec_block),
        rhs_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, i = wp.tid()
        m = space_idx[b]
        rows = sides[m, 0]
        columns = sides[m, 1]
        width = rhs_blocks_out.shape[2] + block - 1
        support = profile.shape[0]
        before = (support - samples_a_module) // 2
        reach = reach_of(support, samples_a_module)
        length = sample_blocks.shape[2] + BLOCK - 1
        run = length // samples_a_module
        if i < rows:
            first = i * samples_a_module - before
            begin = wp.max(0, -first)
            end = wp.min(support, rows * samples_a_module - first)
            for n in range(0, length, BLOCK):
                along_u = vec()
                along_v = vec()
                for s in range(begin, end):
                    samples = sample_blocks[b, first + s, n]
                    along_u += profile[s] * samples
                    along_v += slope[s] * samples
                row_blocks_out[b, 0, i, n] = gain[b, 0] * along_u
                row_blocks_out[b, 1, i, n] = gain[b, 1] * along_v
        for k in range((width + block - 1) // block):
            j = wp.min(block * k, width - block)
            total = vec_block()
            if i < rows and j < columns:
                for phase in range(samples_a_module):
                    # the profile's first sample that falls on this one of a module, and on which module
                    s = (phase + before + samples_a_module) % samples_a_module
                    at = phase * run + reach + j + (s - before - phase) // samples_a_module
                    while s < support:
                        total += slope[s] * row_parts_out[b, 0, i, at]
                        total += profile[s] * row_parts_out[b, 1, i, at]
                        s += samples_a_module
                        at += 1
                if j + block > columns:
                    for c in range(wp.static(block)):
                        if j + c >= columns:
                            total[c] = dtype(0.0)
            rhs_blocks_out[b, i, j] = total

    return fold_samples


def code_rhs(
    image, pose, space_idx, lattice_u, lattice_v, sides, profile, slope, gain, samples_a_module: int,
    samples_out, rows_out, rhs_out,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    dtype, device = image.dtype, image.device
    batch, rows, columns = rhs_out.shape
    block = BLOCK if columns >= BLOCK else 1
    launch(
        make_sample_lattice(dtype),
        samples_out.shape[:2],
        inputs=[
            neighbours(image, 2),
            pose,
            space_idx,
            lattice_u,
            lattice_v,
            sides,
            profile,
            samples_a_module,
        ],
        outputs=[samples_out],
        device=device,
    )
    launch(
        make_fold_samples(dtype, block),
        (batch, rows),
        inputs=[neighbours(samples_out, BLOCK), space_idx, sides, profile, slope, gain, samples_a_module],
        outputs=[neighbours(rows_out, BLOCK), neighbours(rows_out, block), neighbours(rhs_out, block)],
        device=device,
    )
