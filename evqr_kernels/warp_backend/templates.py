"""Matched filters at reduced resolution.

``reduce_image``: area average onto a coarser grid: the pixel of the coarse image covers ``ratio`` x ``ratio`` fine pixels,
with fractional coverage at its borders.

``correlate_templates``: normalised correlation with a bank of A square templates (8 angles of a finder pattern, say), and
only its best angle kept:

    response(y, x, a) = sum_{j, i} T_a(j, i) image(y + j, x + i) / sqrt(sum_{j, i} D(j, i) image(y + j, x + i)^2 + floor)

D is the disc of the template, and the floor keeps quiet places quiet.  The bank's last channel is D.  The sign of the
best response is kept: an inverted code answers with the opposite one.  Four neighbours share each template load, which
is what makes it run at several multiply-adds a cycle on a CPU.
"""

from functools import cache

import warp as wp

ANGLES = 8


@cache
def make_reduce_image(dtype: type):
    """Build the reduction; launch: one thread per coarse pixel."""

    @wp.kernel(module="unique", enable_backward=False)
    def reduce_image(
        image: wp.array3d(dtype=dtype),
        ratio: dtype,
        image_out: wp.array3d(dtype=dtype),
    ):
        b, y, x = wp.tid()
        one = dtype(1.0)
        top = dtype(y) * ratio
        left = dtype(x) * ratio
        bottom = top + ratio
        right = left + ratio
        total = dtype(0.0)
        for j in range(int(top), wp.min(int(wp.ceil(bottom)), image.shape[1])):
            share_y = wp.min(bottom, dtype(j) + one) - wp.max(top, dtype(j))
            for i in range(int(left), wp.min(int(wp.ceil(right)), image.shape[2])):
                share_x = wp.min(right, dtype(i) + one) - wp.max(left, dtype(i))
                total += share_y * share_x * image[b, j, i]
        image_out[b, y, x] = total

    return reduce_image


@cache
def make_correlate_templates(dtype: type):
    """Build the matched filter; launch: one thread per four neighbouring pixels of a row."""
    vec_angles = wp.types.vector(length=ANGLES, dtype=dtype)

    @wp.func
    def best_angle(response: vec_angles) -> int:
        angle = int(0)
        for a in range(1, wp.static(ANGLES)):
            if wp.abs(response[a]) > wp.abs(response[angle]):
                angle = a
        return angle

    @wp.kernel(module="unique", enable_backward=False)
    def correlate_templates(
        image: wp.array3d(dtype=dtype),
        bank: wp.array2d(dtype=vec_angles),
        disc: wp.array2d(dtype=dtype),
        floor: wp.array(dtype=dtype),
        response_out: wp.array3d(dtype=dtype),
        angle_out: wp.array3d(dtype=wp.int32),
    ):
        b, y, quad = wp.tid()
        x = 4 * quad
        size = disc.shape[0]
        energy0 = dtype(0.0)
        energy1 = dtype(0.0)
        energy2 = dtype(0.0)
        energy3 = dtype(0.0)
        for j in range(size):
            for i in range(size):
                if disc[j, i] > dtype(0.0):
                    v0 = image[b, y + j, x + i]
                    v1 = image[b, y + j, x + i + 1]
                    v2 = image[b, y + j, x + i + 2]
                    v3 = image[b, y + j, x + i + 3]
                    energy0 += v0 * v0
                    energy1 += v1 * v1
                    energy2 += v2 * v2
                    energy3 += v3 * v3
        for k in range(4):
            response_out[b, y, x + k] = dtype(0.0)
            angle_out[b, y, x + k] = 0
        if wp.max(wp.max(energy0, energy1), wp.max(energy2, energy3)) < floor[b]:
            return
        r0 = vec_angles()
        r1 = vec_angles()
        r2 = vec_angles()
        r3 = vec_angles()
        for j in range(size):
            for i in range(size):
                template = bank[j, i]
                r0 += image[b, y + j, x + i] * template
                r1 += image[b, y + j, x + i + 1] * template
                r2 += image[b, y + j, x + i + 2] * template
                r3 += image[b, y + j, x + i + 3] * template
        a0 = best_angle(r0)
        a1 = best_angle(r1)
        a2 = best_angle(r2)
        a3 = best_angle(r3)
        response_out[b, y, x] = r0[a0] / wp.sqrt(energy0 + floor[b])
        response_out[b, y, x + 1] = r1[a1] / wp.sqrt(energy1 + floor[b])
        response_out[b, y, x + 2] = r2[a2] / wp.sqrt(energy2 + floor[b])
        response_out[b, y, x + 3] = r3[a3] / wp.sqrt(energy3 + floor[b])
        angle_out[b, y, x] = a0
        angle_out[b, y, x + 1] = a1
        angle_out[b, y, x + 2] = a2
        angle_out[b, y, x + 3] = a3

    return correlate_templates
