"""Events to images, of eight bytes each: column and row, and the time with the polarity in its last bit.

They are what ``bin_events`` and ``deposit_events`` make (``splat.py``, ``lag.py``) of

    x, y         integers
    t            time - t_ref [us], an exact difference of integers before it is a float
    weight       +1 where the last bit of the stamp is set, else -1

A stamp is twice the time plus that bit, modulo 2^32: a clock may have run for as long as it likes, since
``(stamp - 2 t_ref) >> 1``, of 32 bits with a sign, is right for whatever is within 2^30 us of t_ref.

Windows are ranges of events, which may overlap, and images may be larger than what a window has of them, its
extent: cells beyond are left alone.  A CPU's thread takes all events of a window, block by block: first where
each event of a block belongs, which vector units work out for several at once and without a branch, then it
adds them one by one.  On a GPU some hundred threads share a window's events out, neighbours to neighbours, so
that they are read side by side.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector
from evqr_kernels.warp_backend.transport import make_transport


@cache
def make_cell_along(dtype: type) -> wp.Function:
    """Build the function that gives the cell that a place is in, of ``size`` along an axis.

    Beside them it is -1 or ``size``; so it is for NaN and infinity, which no integer stands for.
    """

    @wp.func
    def cell_along(place: dtype, size: int) -> dtype:
        return wp.floor(wp.max(wp.min(place, dtype(size)), dtype(-1.0)))

    return cell_along


@wp.func
def is_on(stamp: wp.uint32) -> int:
    """Whether the pixel became brighter: 1 or 0."""
    return int(stamp & wp.uint32(1))


@wp.func
def place_of(row: int, column: int, height: int, width: int, row_length: int) -> int:
    """Give the place of a cell in an image with rows of ``row_length``; -1 beside ``height`` and ``width``.

    Without a branch, unlike ``and``: which events lie beside an image is what no processor guesses.
    """
    place = row * row_length + column
    place = wp.where(row < 0, -1, place)
    place = wp.where(column < 0, -1, place)
    place = wp.where(row < height, place, -1)
    return wp.where(column < width, place, -1)


@cache
def make_bin_packed_events(dtype: type, block: int, threads: int) -> wp.Kernel:
    """Build the binning kernel; launch: ``threads`` threads per window.

    Columns are `neighbours`, ``block`` of them.
    """
    vec_places = vector(block, wp.int32)
    cell_along = make_cell_along(dtype)

    @wp.kernel(module=module_of(f"packed_{block}_{threads}", dtype))
    def bin_packed_events(
        x: wp.array(dtype=vector(block, wp.uint16)),
        y: wp.array(dtype=vector(block, wp.uint16)),
        stamp: wp.array(dtype=vector(block, wp.uint32)),
        window_ptr: wp.array2d(dtype=wp.int32),
        inverse_reduction: dtype,
        height: int,
        width: int,
        pixels_out: wp.array2d(dtype=dtype),
    ):
        b, k = wp.tid()
        places = vec_places()
        last = window_ptr[b, 1]
        for e in range(window_ptr[b, 0] + block * k, last, block * threads):
            first = wp.min(e, x.shape[0] - 1)  # the last block ends with the columns: some of it was counted
            columns = x[first]
            rows = y[first]
            for p in range(block):
                column = int(cell_along((dtype(columns[p]) + dtype(0.5)) * inverse_reduction, width))
                row = int(cell_along((dtype(rows[p]) + dtype(0.5)) * inverse_reduction, height))
                place = wp.where(first + p < e, -1, place_of(row, column, height, width, width))
                places[p] = wp.where(first + p < last, place, -1)
            stamps = stamp[first]
            for p in range(block):
                place = places[p]
                if place >= 0:
                    wp.atomic_add(pixels_out, b, place, dtype(2 * is_on(stamps[p]) - 1))

    return bin_packed_events


def bin_packed_events(x, y, stamp, window_ptr, reduction: float, image_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    chosen = variant("bin_packed_events", x.device, x.shape[0])
    count, height, width = image_out.shape
    launch(
        make_bin_packed_events(image_out.dtype, chosen.tile, chosen.threads),
        (count, chosen.threads),
        inputs=[
            *(neighbours(column, chosen.tile) for column in (x, y, stamp)),
            window_ptr, 1.0 / reduction, height, width,
        ],
        outputs=[image_out.reshape((count, height * width))],
        device=x.device,
    )  # fmt: skip


@cache
def make_deposit_packed_events(dtype: type, block: int, threads: int) -> wp.Kernel:
    """Build the kernel; launch: ``threads`` threads per window.

    Columns are `neighbours`, ``block`` of them; ``pairs_out`` those of images without rows, two of them.
    """
    vec_floats, vec_places, vec_pair = vector(block, dtype), vector(block, wp.int32), vector(2, dtype)
    transport = make_transport(dtype)
    cell_along = make_cell_along(dtype)

    @wp.kernel(module=module_of(f"packed_{block}_{threads}", dtype))
    def deposit_packed_events(
        x: wp.array(dtype=vector(block, wp.uint16)),
        y: wp.array(dtype=vector(block, wp.uint16)),
        stamp: wp.array(dtype=vector(block, wp.uint32)),
        window_ptr: wp.array2d(dtype=wp.int32),
        t_ref: wp.array(dtype=wp.int32),
        motion: wp.array2d(dtype=dtype),
        frame: wp.array2d(dtype=dtype),
        extent: wp.array2d(dtype=wp.int32),
        width: int,
        pairs_out: wp.array3d(dtype=vec_pair),
    ):
        b, k = wp.tid()
        bottom = extent[b, 0] - 1
        right = extent[b, 1] - 1
        reference = wp.uint32(t_ref[b]) << wp.uint32(1)
        motion_x = motion[b, 0]
        motion_y = motion[b, 1]
        origin_x = frame[b, 0]
        origin_y = frame[b, 1]
        inverse_scale = dtype(1.0) / frame[b, 2]
        places = vec_places()
        across = vec_floats()
        down = vec_floats()
        last = window_ptr[b, 1]
        for e in range(window_ptr[b, 0] + block * k, last, block * threads):
            first = wp.min(e, x.shape[0] - 1)  # the last block ends with the columns: some of it was counted
            columns = x[first]
            rows = y[first]
            stamps = stamp[first]
            for p in range(block):
                t = dtype(wp.int32(stamps[p] - reference) >> 1)
                cx = transport(dtype(columns[p]), t, motion_x, origin_x, inverse_scale)
                cy = transport(dtype(rows[p]), t, motion_y, origin_y, inverse_scale)
                column = cell_along(cx, right)
                row = cell_along(cy, bottom)
                across[p] = cx - column
                down[p] = cy - row
                place = place_of(int(row), int(column), bottom, right, width)
                place = wp.where(first + p < e, -1, place)
                places[p] = wp.where(first + p < last, place, -1)
            for p in range(block):
                place = places[p]
                if place >= 0:
                    on = is_on(stamps[p])
                    w = dtype(2 * on - 1)
                    share = across[p] * w
                    pair = vec_pair(w - share, share)
                    below = down[p] * pair
                    wp.atomic_add(pairs_out, b, 1 - on, place, pair - below)
                    wp.atomic_add(pairs_out, b, 1 - on, place + width, below)

    return deposit_packed_events


def deposit_packed_events(x, y, stamp, window_ptr, t_ref, motion, frame, extent, deposit_out) -> None:
    """Launch; accumulates.  Float atomics: on a GPU sums repeat to a tolerance, not bit for bit."""
    chosen = variant("deposit_packed_events", x.device, x.shape[0])
    count, _, height, width = deposit_out.shape
    launch(
        make_deposit_packed_events(deposit_out.dtype, chosen.tile, chosen.threads),
        (count, chosen.threads),
        inputs=[
            *(neighbours(column, chosen.tile) for column in (x, y, stamp)),
            window_ptr, t_ref, motion, frame, extent, width,
        ],
        outputs=[neighbours(deposit_out.reshape((count, 2, height * width)), 2)],
        device=x.device,
    )  # fmt: skip
