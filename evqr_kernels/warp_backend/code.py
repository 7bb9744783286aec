"""Right-hand side of the equations of modules.

The model of the residual image in code coordinates is ``A q = a_u B q B'^T + a_v B' q B^T`` (rows v, columns
u), with B the module profile sampled K times a module and B' its derivative: left of q for V modules along
v, right of it for U along u.  With E the image sampled on the same lattice under a pose:

    rhs = A^T E = a_u B^T (E B') + a_v B'^T (E B)

``sample_rows`` samples one row of the lattice and folds it with the two profiles at once, ``fold_columns``
finishes.  The profile covers the module it belongs to and as many samples before as after.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, vector
from evqr_kernels.warp_backend.pose import make_bilinear, make_project

TAPS = 4
"""Neighbouring samples that the first pass multiplies with the profiles at once."""

BLOCK = 8
"""Neighbouring modules that one thread of the second pass does together, where there are as many."""


@cache
def make_sample_rows(dtype: type) -> wp.Kernel:
    """Build the first pass; launch: one thread per (window, lattice row).

    ``pairs``: see `make_bilinear`; ``.._taps``: `neighbours` of the array before.
    """
    vec_taps = vector(TAPS, dtype)
    bilinear = make_bilinear(dtype)
    project = make_project(dtype)

    @wp.kernel(module=module_of("code", dtype))
    def sample_rows(
        pairs: wp.array3d(dtype=vector(2, dtype)),
        pose: wp.array2d(dtype=dtype),
        lattice_u: wp.array(dtype=dtype),
        lattice_v: wp.array(dtype=dtype),
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        profile_taps: wp.array(dtype=vec_taps),
        slope_taps: wp.array(dtype=vec_taps),
        samples_a_module: int,
        samples_out: wp.array3d(dtype=dtype),
        sample_taps_out: wp.array3d(dtype=vec_taps),
        rows_out: wp.array4d(dtype=dtype),
    ):
        b, row = wp.tid()
        count = lattice_u.shape[0]
        for i in range(count):
            x, y = project(pose, b, lattice_u[i], lattice_v[row])
            samples_out[b, row, i] = bilinear(pairs, b, x, y)
        support = profile.shape[0]
        before = (support - samples_a_module) // 2
        for j in range(rows_out.shape[3]):
            first = j * samples_a_module - before
            begin = wp.max(0, -first)
            end = wp.min(support, count - first)
            rest = end - (end - begin) % TAPS
            by_profile = vec_taps()
            by_slope = vec_taps()
            for k in range(begin, rest, TAPS):
                taps = sample_taps_out[b, row, first + k]
                by_profile += wp.cw_mul(taps, profile_taps[k])
                by_slope += wp.cw_mul(taps, slope_taps[k])
            total = dtype(0.0)
            total_slope = dtype(0.0)
            for c in range(TAPS):
                total += by_profile[c]
                total_slope += by_slope[c]
            for k in range(rest, end):
                e = samples_out[b, row, first + k]
                total += e * profile[k]
                total_slope += e * slope[k]
            rows_out[b, 0, row, j] = total
            rows_out[b, 1, row, j] = total_slope

    return sample_rows


@cache
def make_fold_columns(dtype: type, block: int) -> wp.Kernel:
    """Build the second pass; launch: one thread per (window, row of modules, block of modules).

    The last block of a row ends with the row and may overlap the one before: the same modules with the same
    result.
    """
    vec_block = vector(block, dtype)

    @wp.kernel(module=module_of("code" if block == BLOCK else f"code_{block}", dtype))
    def fold_columns(
        row_blocks: wp.array4d(dtype=vec_block),
        profile: wp.array(dtype=dtype),
        slope: wp.array(dtype=dtype),
        gain: wp.array2d(dtype=dtype),
        samples_a_module: int,
        rhs_blocks_out: wp.array3d(dtype=vec_block),
    ):
        b, i, k = wp.tid()
        j = wp.min(block * k, rhs_blocks_out.shape[2] - 1)
        support = profile.shape[0]
        first = i * samples_a_module - (support - samples_a_module) // 2
        total = vec_block()
        for s in range(wp.max(0, -first), wp.min(support, row_blocks.shape[2] - first)):
            total += (gain[b, 0] * profile[s]) * row_blocks[b, 1, first + s, j]
            total += (gain[b, 1] * slope[s]) * row_blocks[b, 0, first + s, j]
        rhs_blocks_out[b, i, j] = total

    return fold_columns


def code_rhs(
    image, pose, lattice_u, lattice_v, profile, slope, gain, samples_a_module: int, samples_out, rows_out,
    rhs_out,
) -> None:  # fmt: skip
    """Launch both passes; overwrites."""
    dtype, device = image.dtype, image.device
    batch, rows, columns = rhs_out.shape
    block = BLOCK if columns >= BLOCK else 1
    launch(
        make_sample_rows(dtype),
        (batch, lattice_v.shape[0]),
        inputs=[
            neighbours(image, 2),
            pose,
            lattice_u,
            lattice_v,
            profile,
            slope,
            neighbours(profile, TAPS),
            neighbours(slope, TAPS),
            samples_a_module,
        ],
        outputs=[samples_out, neighbours(samples_out, TAPS), rows_out],
        device=device,
    )
    launch(
        make_fold_columns(dtype, block),
        (batch, rows, -(-columns // block)),
        inputs=[neighbours(rows_out, block), profile, slope, gain, samples_a_module],
        outputs=[neighbours(rhs_out, block)],
        device=device,
    )
