"""Matched filters: normalised correlation with the templates of a bank, of which only the best one is kept.

    response(y, x) = sum_{(j, i) in disc} T_a(j, i) image(y + j, x + i) / sqrt(energy(y, x) + floor)
    energy(y, x)   = sum_{(j, i) in disc} image(y + j, x + i)^2
    floor          = quiet |disc| sum image^2 / busy

with a = angle(y, x) the template of largest magnitude, and ``busy`` the number of pixels that the image's
energy is spread over.  The floor keeps quiet places quiet: where the energy
under the disc is less the response is 0.  The sign of the best response is kept: an inverted code answers
with the opposite one.

Templates that are turned copies of one pattern lie in a space of few dimensions (steerable filters: Freeman
and Adelson, PAMI 1991), so the bank comes as a basis of five and as the mixture that each template is of it:

    T_a(j, i) = sum_k mix(a, k) basis(j, i, k)

The basis is orthonormal and the rows of the mixture are no longer than 1, so the length of the sums bounds
every response.  Responses of magnitude below ``least`` are 0, and so are those of places where the first term
alone, normalised likewise, is below ``first``: of templates that all have much of it the other terms need not
be summed there.

The disc is given by the ends of its columns, ``spans`` (N, 2): energies are then differences of running sums,
and the corners of the templates' squares, a quarter of them, cost nothing.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import (
    last_axis_as_vector,
    launch,
    module_of,
    neighbours,
    variant,
    vector,
)

TERMS = 5
"""Size of the basis: a round pattern at eight angles is in it to 0.4 %."""


@cache
def make_running_squares(dtype: type, block: int) -> wp.Kernel:
    """Build the running sums of squares down columns; launch: one thread per block of columns."""
    vec_pixels = vector(block, dtype)

    @wp.kernel(module=module_of(f"templates_{block}", dtype))
    def running_squares(
        pixels: wp.array3d(dtype=vec_pixels),
        squares_out: wp.array3d(dtype=vec_pixels),
    ):
        b, k = wp.tid()
        # the last block overlaps the one before: what they share is written twice, alike
        x = wp.min(block * k, pixels.shape[2] - 1)
        total = vec_pixels()
        squares_out[b, 0, x] = total
        for y in range(pixels.shape[1]):
            v = pixels[b, y, x]
            total += wp.cw_mul(v, v)
            squares_out[b, y + 1, x] = total

    return running_squares


@cache
def make_quiet_floor(dtype: type) -> wp.Kernel:
    """Build the floor from the columns' sums; launch: one thread per level of an image."""

    @wp.kernel(module=module_of("templates", dtype))
    def quiet_floor(
        squares: wp.array3d(dtype=dtype),
        busy: wp.array(dtype=dtype),
        spans: wp.array2d(dtype=wp.int32),
        rows: wp.array2d(dtype=wp.int32),
        extent: wp.array3d(dtype=wp.int32),
        quiet: wp.array(dtype=dtype),
        floor_out: wp.array2d(dtype=dtype),
    ):
        b, k = wp.tid()
        top = wp.int32(0)
        for y in range(rows.shape[0]):
            if rows[y, 0] == k and rows[y, 1] == 0:
                top = y
        size = spans.shape[0]
        total = dtype(0.0)
        if extent[b, k, 0] > 0:
            bottom = wp.min(top + extent[b, k, 0] + size, squares.shape[1]) - 1
            for x in range(wp.min(extent[b, k, 1] + size - 1, squares.shape[2])):
                total += squares[b, bottom, x] - squares[b, top, x]
        places = wp.int32(0)
        for i in range(size):
            places += spans[i, 1] - spans[i, 0]
        floor_out[b, k] = quiet[k] * dtype(places) * total / wp.max(busy[b], dtype(1.0))

    return quiet_floor


@cache
def make_correlate_first(dtype: type, block: int) -> wp.Kernel:
    """Build the energies and the first term's sums; launch: ``parts`` threads per row, block by block.

    ``pixels[b, y, x]`` is the vector of ``block`` pixels from x on, ``squares`` that of running sums.  The
    last block of a row ends with the row and may overlap the one before: those pixels are computed twice,
    with the same result.
    """
    vec_pixels = vector(block, dtype)
    vec_terms = vector(TERMS, dtype)

    @wp.kernel(module=module_of(f"templates_first_{block}", dtype))
    def correlate_first(
        pixels: wp.array3d(dtype=vec_pixels),
        basis: wp.array3d(dtype=vec_terms),
        spans: wp.array2d(dtype=wp.int32),
        rows: wp.array2d(dtype=wp.int32),
        extent: wp.array3d(dtype=wp.int32),
        squares: wp.array3d(dtype=vec_pixels),
        floor: wp.array2d(dtype=dtype),
        parts: int,
        sums_out: wp.array4d(dtype=vec_pixels),
    ):
        b, y, part = wp.tid()
        level = rows[y, 0]
        if level < 0 or rows[y, 1] >= extent[b, level, 0]:
            return
        size = spans.shape[0]
        quiet = floor[b, level]
        for begin in range(block * part, extent[b, level, 1], block * parts):
            x = wp.min(begin, sums_out.shape[3] - 1)
            energy = vec_pixels()
            for i in range(size):
                energy += squares[b, y + spans[i, 1], x + i] - squares[b, y + spans[i, 0], x + i]
            sums_out[b, TERMS, y, x] = energy
            total = vec_pixels()
            if wp.max(energy) > quiet:
                for i in range(size):
                    for j in range(spans[i, 0], spans[i, 1]):
                        total += basis[b, j, i][0] * pixels[b, y + j, x + i]
            sums_out[b, 0, y, x] = total

    return correlate_first


@cache
def make_correlate_others(dtype: type, block: int) -> wp.Kernel:
    """Build the other terms' sums, where the first is strong; launch: ``parts`` threads per row."""
    vec_pixels = vector(block, dtype)
    vec_terms = vector(TERMS, dtype)

    @wp.kernel(module=module_of(f"templates_{block}", dtype))
    def correlate_others(
        pixels: wp.array3d(dtype=vec_pixels),
        basis: wp.array3d(dtype=vec_terms),
        spans: wp.array2d(dtype=wp.int32),
        rows: wp.array2d(dtype=wp.int32),
        extent: wp.array3d(dtype=wp.int32),
        floor: wp.array2d(dtype=dtype),
        first: dtype,
        parts: int,
        sums_out: wp.array4d(dtype=vec_pixels),
    ):
        b, y, part = wp.tid()
        level = rows[y, 0]
        if level < 0 or rows[y, 1] >= extent[b, level, 0]:
            return
        size = spans.shape[0]
        quiet = floor[b, level]
        for begin in range(block * part, extent[b, level, 1], block * parts):
            x = wp.min(begin, sums_out.shape[3] - 1)
            s0 = sums_out[b, 0, y, x]
            energy = sums_out[b, TERMS, y, x]
            strong = wp.cw_mul(s0, s0) - first * first * energy
            if wp.max(strong) >= first * first * quiet and wp.max(energy) > quiet:
                s1 = vec_pixels()
                s2 = vec_pixels()
                s3 = vec_pixels()
                s4 = vec_pixels()
                for i in range(size):
                    for j in range(spans[i, 0], spans[i, 1]):
                        v = pixels[b, y + j, x + i]
                        term = basis[b, j, i]
                        s1 += term[1] * v
                        s2 += term[2] * v
                        s3 += term[3] * v
                        s4 += term[4] * v
                sums_out[b, 1, y, x] = s1
                sums_out[b, 2, y, x] = s2
                sums_out[b, 3, y, x] = s3
                sums_out[b, 4, y, x] = s4

    return correlate_others


@cache
def make_best_template(dtype: type, together: int) -> wp.Kernel:
    """Build the choice of the best template; launch: ``parts`` threads per row, block by block.

    A kernel of its own: behind the correlation it would take the registers that its sums need.
    """
    vec_pixels = vector(together, dtype)
    vec_indices = vector(together, wp.int32)
    vec_pair = vector(2, dtype)
    vec_terms = vector(TERMS, dtype)

    @wp.kernel(module=module_of(f"templates_best_{together}", dtype))
    def best_template(
        sums: wp.array4d(dtype=vec_pixels),
        mix: wp.array2d(dtype=vec_terms),
        rows: wp.array2d(dtype=wp.int32),
        extent: wp.array3d(dtype=wp.int32),
        floor: wp.array2d(dtype=dtype),
        limits: vec_pair,
        parts: int,
        response_out: wp.array3d(dtype=dtype),
        response_blocks_out: wp.array3d(dtype=vec_pixels),
        angle_out: wp.array3d(dtype=wp.int32),
        angle_blocks_out: wp.array3d(dtype=vec_indices),
    ):
        b, y, part = wp.tid()
        level = rows[y, 0]
        if level < 0 or rows[y, 1] >= extent[b, level, 0]:
            return
        width = extent[b, level, 1]
        quiet = floor[b, level]
        first = limits[0] * limits[0]
        least = limits[1] * limits[1]
        for from_x in range(together * part, width, together * parts):
            begin = wp.min(from_x, response_blocks_out.shape[2] - 1)
            energies = sums[b, TERMS, y, begin]
            s0 = sums[b, 0, y, begin]
            best = vec_pixels()
            angle = vec_indices()
            if wp.max(wp.cw_mul(s0, s0) - first * energies) >= first * quiet and wp.max(energies) > quiet:
                s1 = sums[b, 1, y, begin]
                s2 = sums[b, 2, y, begin]
                s3 = sums[b, 3, y, begin]
                s4 = sums[b, 4, y, begin]
                for a in range(mix.shape[1]):
                    share = mix[b, a]
                    value = share[0] * s0 + share[1] * s1 + share[2] * s2 + share[3] * s3 + share[4] * s4
                    for p in range(together):
                        better = wp.abs(value[p]) > wp.abs(best[p])
                        best[p] = wp.where(better, value[p], best[p])
                        angle[p] = wp.where(better, a, angle[p])
                # without a branch, so that vector units choose for all neighbours at once
                for p in range(together):
                    bound = energies[p] + quiet
                    answer = wp.where(best[p] * best[p] >= least * bound, best[p], dtype(0.0))
                    answer = wp.where(s0[p] * s0[p] >= first * bound, answer, dtype(0.0))
                    answer = wp.where(energies[p] > quiet, answer, dtype(0.0))
                    angle[p] = wp.where(answer != dtype(0.0), angle[p], 0)
                    best[p] = answer / wp.sqrt(wp.where(answer != dtype(0.0), bound, dtype(1.0)))
            if begin + together <= width:
                response_blocks_out[b, y, begin] = best
                angle_blocks_out[b, y, begin] = angle
            else:
                for p in range(width - begin):
                    response_out[b, y, begin + p] = best[p]
                    angle_out[b, y, begin + p] = angle[p]

    return best_template


def correlate_templates(
    image, busy, basis, mix, spans, rows, extent, quiet, first: float, least: float, squares_out, floor_out,
    sums_out, response_out, angle_out,
) -> None:  # fmt: skip
    """Launch the running sums, the floor, the correlations and the choice; overwrites within the extent."""
    dtype, device = image.dtype, image.device
    batch, height, width = response_out.shape
    if not response_out.size or not floor_out.size:
        return
    chosen = variant("correlate_templates", device, width)
    block, wide = chosen.tile, chosen.tile * chosen.rows
    if width < wide:
        wide = block
    pixels, squares = neighbours(image, block), neighbours(squares_out, block)
    # what a thread begins with takes a CPU as long as a block in which nothing is
    parts, wide_parts = (1 if device.is_cpu else -(-width // each) for each in (block, wide))
    one = block if device.is_cpu else 1  # neighbours' sums would take a GPU more registers than there are
    terms = last_axis_as_vector(basis)
    launch(
        make_running_squares(dtype, block),
        (batch, -(-image.shape[2] // block)),
        inputs=[pixels],
        outputs=[squares],
        device=device,
    )
    launch(
        make_quiet_floor(dtype),
        floor_out.shape,
        inputs=[squares_out, busy, spans, rows, extent, quiet],
        outputs=[floor_out],
        device=device,
    )
    launch(
        make_correlate_first(dtype, wide),
        (batch, height, wide_parts),
        inputs=[
            neighbours(image, wide), terms, spans, rows, extent, neighbours(squares_out, wide), floor_out,
            wide_parts,
        ],
        outputs=[neighbours(sums_out, wide)],
        device=device,
    )  # fmt: skip
    launch(
        make_correlate_others(dtype, block),
        (batch, height, parts),
        inputs=[pixels, terms, spans, rows, extent, floor_out, first, parts],
        outputs=[neighbours(sums_out, block)],
        device=device,
    )
    launch(
        make_best_template(dtype, one),
        (batch, height, parts if device.is_cpu else width),
        inputs=[
            neighbours(sums_out, one), last_axis_as_vector(mix), rows, extent, floor_out,
            vector(2, dtype)(first, least), parts if device.is_cpu else width,
        ],
        outputs=[response_out, neighbours(response_out, one), angle_out, neighbours(angle_out, one)],
        device=device,
    )  # fmt: skip
