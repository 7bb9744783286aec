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
every response.  Responses of magnitude below ``least`` are 0.

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
    """Build the floor from the columns' sums; launch: one thread per image."""

    @wp.kernel(module=module_of("templates", dtype))
    def quiet_floor(
        squares: wp.array3d(dtype=dtype),
        busy: wp.array(dtype=dtype),
        spans: wp.array2d(dtype=wp.int32),
        quiet: dtype,
        floor_out: wp.array(dtype=dtype),
    ):
        b = wp.tid()
        total = dtype(0.0)
        for x in range(squares.shape[2]):
            total += squares[b, squares.shape[1] - 1, x]
        places = wp.int32(0)
        for i in range(spans.shape[0]):
            places += spans[i, 1] - spans[i, 0]
        floor_out[b] = quiet * dtype(places) * total / wp.max(busy[b], dtype(1.0))

    return quiet_floor


@cache
def make_correlate_basis(dtype: type, block: int) -> wp.Kernel:
    """Build the correlation with the basis; launch: one thread per ``block`` neighbouring pixels of a row.

    ``pixels[b, y, x]`` is the vector of ``block`` pixels from x on, ``squares`` that of running sums.  The
    last block of a row ends with the row and may overlap the one before: those pixels are computed twice,
    with the same result.  Behind the sums come the energies.
    """
    vec_pixels = vector(block, dtype)
    vec_terms = vector(TERMS, dtype)

    @wp.kernel(module=module_of(f"templates_{block}", dtype))
    def correlate_basis(
        pixels: wp.array3d(dtype=vec_pixels),
        basis: wp.array2d(dtype=vec_terms),
        spans: wp.array2d(dtype=wp.int32),
        squares: wp.array3d(dtype=vec_pixels),
        floor: wp.array(dtype=dtype),
        sums_out: wp.array4d(dtype=vec_pixels),
    ):
        b, y, k = wp.tid()
        x = wp.min(block * k, sums_out.shape[3] - 1)
        size = spans.shape[0]
        energy = vec_pixels()
        for i in range(size):
            energy += squares[b, y + spans[i, 1], x + i] - squares[b, y + spans[i, 0], x + i]
        sums_out[b, TERMS, y, x] = energy
        if not wp.max(energy) > floor[b]:
            return
        s0 = vec_pixels()
        s1 = vec_pixels()
        s2 = vec_pixels()
        s3 = vec_pixels()
        s4 = vec_pixels()
        for i in range(size):
            for j in range(spans[i, 0], spans[i, 1]):
                v = pixels[b, y + j, x + i]
                term = basis[j, i]
                s0 += term[0] * v
                s1 += term[1] * v
                s2 += term[2] * v
                s3 += term[3] * v
                s4 += term[4] * v
        sums_out[b, 0, y, x] = s0
        sums_out[b, 1, y, x] = s1
        sums_out[b, 2, y, x] = s2
        sums_out[b, 3, y, x] = s3
        sums_out[b, 4, y, x] = s4

    return correlate_basis


@cache
def make_best_template(dtype: type) -> wp.Kernel:
    """Build the choice of the best template; launch: one thread per row.

    A kernel of its own: behind the correlation it would take the registers that its sums need.
    """
    vec_terms = vector(TERMS, dtype)

    @wp.kernel(module=module_of("templates", dtype))
    def best_template(
        sums: wp.array4d(dtype=dtype),
        mix: wp.array(dtype=vec_terms),
        floor: wp.array(dtype=dtype),
        least: dtype,
        response_out: wp.array3d(dtype=dtype),
        angle_out: wp.array3d(dtype=wp.int32),
    ):
        b, y = wp.tid()
        for x in range(response_out.shape[2]):
            best = dtype(0.0)
            angle = wp.int32(0)
            energy = sums[b, TERMS, y, x]
            if energy > floor[b]:
                here = vec_terms(
                    sums[b, 0, y, x], sums[b, 1, y, x], sums[b, 2, y, x], sums[b, 3, y, x], sums[b, 4, y, x]
                )
                weakest = least * least * (energy + floor[b])
                if wp.dot(here, here) >= weakest:  # no template answers more than this
                    for a in range(mix.shape[0]):
                        value = wp.dot(mix[a], here)
                        if wp.abs(value) > wp.abs(best):
                            best = value
                            angle = a
                    if best * best >= weakest:
                        best /= wp.sqrt(energy + floor[b])
                    else:
                        best = dtype(0.0)
                        angle = 0
            response_out[b, y, x] = best
            angle_out[b, y, x] = angle

    return best_template


def correlate_templates(
    image, busy, basis, mix, spans, quiet: float, least: float, squares_out, floor_out, sums_out,
    response_out, angle_out,
) -> None:  # fmt: skip
    """Launch the running sums, the floor, the correlation and the choice; overwrites."""
    dtype, device = image.dtype, image.device
    batch, height, width = response_out.shape
    if not response_out.size:
        return
    block = variant("correlate_templates", device, width).tile
    pixels, squares = neighbours(image, block), neighbours(squares_out, block)
    launch(
        make_running_squares(dtype, block),
        (batch, -(-image.shape[2] // block)),
        inputs=[pixels],
        outputs=[squares],
        device=device,
    )
    launch(
        make_quiet_floor(dtype),
        batch,
        inputs=[squares_out, busy, spans, quiet],
        outputs=[floor_out],
        device=device,
    )
    launch(
        make_correlate_basis(dtype, block),
        (batch, height, -(-width // block)),
        inputs=[pixels, last_axis_as_vector(basis), spans, squares, floor_out],
        outputs=[neighbours(sums_out, block)],
        device=device,
    )
    launch(
        make_best_template(dtype),
        (batch, height),
        inputs=[sums_out, last_axis_as_vector(mix), floor_out, least],
        outputs=[response_out, angle_out],
        device=device,
    )
