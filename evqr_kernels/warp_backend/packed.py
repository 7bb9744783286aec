"""Events to images, of eight bytes each: column and row, and the time with the polarity in its last bit.

They are what ``bin_events`` and ``deposit_events`` make (``splat.py``, ``lag.py``) of

    x, y         integers
    t            (stamp >> 1) - t_ref    [us], an exact difference of integers before it is a float
    weight       +1 where the last bit of the stamp is set, else -1

Windows are ranges of events, which may overlap, and images may be larger than what a window has of them, its
extent: cells beyond are left alone.  A CPU's thread takes all of a window's events; on a GPU some hundred
threads share them out, neighbours to neighbours, so that they are read side by side.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.transport import make_transport


@cache
def make_bin_packed_events(dtype: type, threads: int) -> wp.Kernel:
    """Build the binning kernel; launch: ``threads`` threads per window."""

    @wp.kernel(module=module_of(f"packed_{threads}", dtype))
    def bin_packed_events(
        x: wp.array(dtype=wp.uint16),
        y: wp.array(dtype=wp.uint16),
        stamp: wp.array(dtype=wp.uint32),
        window_ptr: wp.array2d(dtype=wp.int32),
        inverse_reduction: dtype,
        image_out: wp.array3d(dtype=dtype),
    ):
        b, k = wp.tid()
        height = image_out.shape[1]
        width = image_out.shape[2]
        for e in range(window_ptr[b, 0] + k, window_ptr[b, 1], threads):
            column = int((dtype(x[e]) + dtype(0.5)) * inverse_reduction)
            row = int((dtype(y[e]) + dtype(0.5)) * inverse_reduction)
            if column < width and row < height:
                sign = 2 * int(stamp[e] & wp.uint32(1)) - 1
                wp.atomic_add(image_out, b, row, column, dtype(sign))

    return bin_packed_events


def bin_packed_events(x, y, stamp, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    threads = variant("bin_packed_events", x.device).threads
    launch(
        make_bin_packed_events(image_out.dtype, threads),
        (image_out.shape[0], threads),
        inputs=[x, y, stamp, window_ptr, 1.0 / reduction],
        outputs=[image_out],
        device=x.device,
    )


@cache
def make_deposit_packed_events(dtype: type, threads: int) -> wp.Kernel:
    """Build the kernel; launch: ``threads`` threads per window."""
    vec_pair = vector(2, dtype)
    transport = make_transport(dtype)

    @wp.kernel(module=module_of(f"packed_{threads}", dtype))
    def deposit_packed_events(
        x: wp.array(dtype=wp.uint16),
        y: wp.array(dtype=wp.uint16),
        stamp: wp.array(dtype=wp.uint32),
        window_ptr: wp.array2d(dtype=wp.int32),
        t_ref: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        extent: wp.array2d(dtype=wp.int32),
        pairs_out: wp.array4d(dtype=vec_pair),
    ):
        b, k = wp.tid()
        bottom = dtype(extent[b, 0] - 1)
        right = dtype(extent[b, 1] - 1)
        reference = t_ref[b]
        motion_x = motion[b, 0]
        motion_y = motion[b, 1]
        origin_x = frame[b, 0]
        origin_y = frame[b, 1]
        inverse_scale = dtype(1.0) / frame[b, 2]
        for e in range(window_ptr[b, 0] + k, window_ptr[b, 1], threads):
            t = dtype(int(stamp[e] >> wp.uint32(1)) - reference)
            cx = transport(dtype(x[e]), t, motion_x, origin_x, inverse_scale)
            cy = transport(dtype(y[e]), t, motion_y, origin_y, inverse_scale)
            # written so that it is false for NaN
            if cx >= dtype(0.0) and cy >= dtype(0.0) and cx < right and cy < bottom:
                column = int(cx)
                row = int(cy)
                on = int(stamp[e] & wp.uint32(1))
                w = dtype(2 * on - 1)
                share = (cx - dtype(column)) * w
                pair = vec_pair(w - share, share)
                below = (cy - dtype(row)) * pair
                wp.atomic_add(pairs_out, b, 1 - on, row, column, pair - below)
                wp.atomic_add(pairs_out, b, 1 - on, row + 1, column, below)

    return deposit_packed_events


def deposit_packed_events(x, y, stamp, window_ptr, t_ref, motion, frame, extent, deposit_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    threads = variant("deposit_packed_events", x.device).threads
    launch(
        make_deposit_packed_events(deposit_out.dtype, threads),
        (deposit_out.shape[0], threads),
        inputs=[x, y, stamp, window_ptr, t_ref, motion, frame, extent],
        outputs=[neighbours(deposit_out, 2)],
        device=x.device,
    )
