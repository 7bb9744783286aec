"""Matched filters at reduced resolution.

``reduce_image``: sum over a coarser grid: the pixel of the coarse image covers ``ratio`` x ``ratio`` fine
pixels, with fractional coverage at its borders.

``correlate_templates``: normalised correlation with a bank of square templates (the angles of a finder
pattern, say), of which only the best one is kept:

    response(y, x) = sum_{j, i} T_a(j, i) image(y + j, x + i) / sqrt(energy(y, x) + floor)
    energy(y, x)   = sum_{j, i} D(j, i) image(y + j, x + i)^2

with a = angle(y, x) the one of largest magnitude.  D, 0 to 1, is the disc that the templates fill, and the
floor keeps quiet places quiet: where the energy under the disc is less than the floor the response is 0.  The
sign of the best response is kept: an inverted code answers with the opposite one.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import last_axis_as_vector, module_of, neighbours, vector

SPAN = 16
"""Neighbouring fine pixels that a reduction adds up together."""

ANGLES = 8
"""Templates in a bank."""

CPU_BLOCK, GPU_BLOCK = 16, 4
"""Neighbouring pixels of which one thread makes the responses, sharing each template load."""


def block_of(device: wp.Device, width: int) -> int:
    """Choose the block for a device and a width of the response, which is at least `GPU_BLOCK`."""
    return CPU_BLOCK if device.is_cpu and width >= CPU_BLOCK else GPU_BLOCK


@cache
def make_reduce_image(dtype: type) -> wp.Kernel:
    """Build the reduction; launch: one thread per coarse row, which it first adds up over fine rows."""
    vec_block = vector(SPAN, dtype)

    @wp.kernel(module=module_of("templates", dtype))
    def reduce_image(
        image: wp.array3d(dtype=dtype),
        image_blocks: wp.array3d(dtype=vec_block),
        ratio: dtype,
        rows_out: wp.array3d(dtype=dtype),
        row_blocks_out: wp.array3d(dtype=vec_block),
        image_out: wp.array3d(dtype=dtype),
    ):
        b, y = wp.tid()
        one = dtype(1.0)
        fine_width = image.shape[2]
        top = dtype(y) * ratio
        bottom = top + ratio
        first = int(top)
        last = wp.min(int(wp.ceil(bottom)), image.shape[1])
        whole = fine_width - fine_width % SPAN
        for x in range(0, whole, SPAN):
            block = vec_block()
            for j in range(first, last):
                block += (wp.min(bottom, dtype(j) + one) - wp.max(top, dtype(j))) * image_blocks[b, j, x]
            row_blocks_out[b, y, x] = block
        for x in range(whole, fine_width):
            total = dtype(0.0)
            for j in range(first, last):
                total += (wp.min(bottom, dtype(j) + one) - wp.max(top, dtype(j))) * image[b, j, x]
            rows_out[b, y, x] = total
        for x in range(image_out.shape[2]):
            left = dtype(x) * ratio
            right = left + ratio
            total = dtype(0.0)
            for i in range(int(left), wp.min(int(wp.ceil(right)), fine_width)):
                total += (wp.min(right, dtype(i) + one) - wp.max(left, dtype(i))) * rows_out[b, y, i]
            image_out[b, y, x] = total

    return reduce_image


def reduce_image(image, ratio: float, rows_out, image_out) -> None:
    """Launch; overwrites."""
    wp.launch(
        make_reduce_image(image.dtype),
        image_out.shape[:2],
        inputs=[image, neighbours(image, SPAN), ratio],
        outputs=[rows_out, neighbours(rows_out, SPAN), image_out],
        device=image.device,
    )


@cache
def make_correlate_templates(dtype: type, block: int) -> wp.Kernel:
    """Build the matched filter; launch: one thread per ``block`` neighbouring pixels of a row.

    ``pixels[b, y, x]`` is the vector of ``block`` pixels from x on.  The last block of a row ends with the
    row and may overlap the one before: those pixels are computed twice, with the same result.
    """
    vec_pixels = vector(block, dtype)
    vec_angles = vector(ANGLES, dtype)

    @wp.kernel(module=module_of(f"templates_{block}", dtype))
    def correlate_templates(
        pixels: wp.array3d(dtype=vec_pixels),
        bank: wp.array2d(dtype=vec_angles),
        disc: wp.array2d(dtype=dtype),
        floor: wp.array(dtype=dtype),
        response_out: wp.array3d(dtype=dtype),
        angle_out: wp.array3d(dtype=wp.int32),
    ):
        b, y, k = wp.tid()
        x = wp.min(block * k, response_out.shape[2] - block)
        # equal to block, which the compiler does not know: unrolled sixteen times, the end of the kernel
        # spoils its middle
        count = wp.min(block, response_out.shape[2] - x)
        size = disc.shape[0]
        for p in range(count):
            response_out[b, y, x + p] = dtype(0.0)
            angle_out[b, y, x + p] = 0

        # most of an image of events is empty: a bound that costs little, then the energy itself
        under_block = vec_pixels()
        for j in range(size):
            for i in range(0, size - 1 + block, block):
                v = pixels[b, y + j, x + wp.min(i, size - 1)]
                under_block += wp.cw_mul(v, v)
        bound = dtype(0.0)
        for p in range(block):
            bound += under_block[p]
        if bound < floor[b]:
            return
        energy = vec_pixels()
        for j in range(size):
            for i in range(size):
                v = pixels[b, y + j, x + i]
                energy += disc[j, i] * wp.cw_mul(v, v)
        if wp.max(energy) < floor[b]:
            return

        r0 = vec_pixels()
        r1 = vec_pixels()
        r2 = vec_pixels()
        r3 = vec_pixels()
        r4 = vec_pixels()
        r5 = vec_pixels()
        r6 = vec_pixels()
        r7 = vec_pixels()
        for j in range(size):
            for i in range(size):
                v = pixels[b, y + j, x + i]
                template = bank[j, i]
                r0 += template[0] * v
                r1 += template[1] * v
                r2 += template[2] * v
                r3 += template[3] * v
                r4 += template[4] * v
                r5 += template[5] * v
                r6 += template[6] * v
                r7 += template[7] * v
        for p in range(count):
            if energy[p] >= floor[b]:
                every = vec_angles(r0[p], r1[p], r2[p], r3[p], r4[p], r5[p], r6[p], r7[p])
                best = every[0]
                angle = wp.int32(0)
                for a in range(1, wp.static(ANGLES)):
                    if wp.abs(every[a]) > wp.abs(best):
                        best = every[a]
                        angle = a
                response_out[b, y, x + p] = best / wp.sqrt(energy[p] + floor[b])
                angle_out[b, y, x + p] = angle

    return correlate_templates


def correlate_templates(image, bank, disc, floor, response_out, angle_out) -> None:
    """Launch; overwrites."""
    batch, height, width = response_out.shape
    block = block_of(image.device, width)
    wp.launch(
        make_correlate_templates(image.dtype, block),
        (batch, height, -(-width // block)),
        inputs=[neighbours(image, block), last_axis_as_vector(bank), disc, floor],
        outputs=[response_out, angle_out],
        device=image.device,
    )
