"""Runs of one sign along straight lines: where an image may have a straight edge.

A line is seen where it crosses the columns of the image, t = 0, 1, ..., or, where it is steep, its rows:

    e_t = image at  y = l - (X where slope > 0) + slope t,  x = t        or with x and y, X and Y swapped

linear between two pixels, 0 outside the image: lines of a slope lie side by side, a pixel apart, and where
they lie does not depend on the image's size.  Of each sign s

    x_t = min(max(s e_t / threshold, -most), most) - 1

is above 0 on an edge that is stronger than the threshold; the greatest sum of x_t over any run of t is found
in one go (Kadane's algorithm), for some neighbouring lines together.
"""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import launch, module_of, neighbours, variant, vector


@cache
def make_line_runs(dtype: type, tile: int) -> wp.Kernel:
    """Build the kernel; launch: one thread per ``tile`` lines."""
    vec_tile = vector(tile, dtype)

    @wp.kernel(module=module_of("runs", dtype))
    def line_runs(
        image: wp.array3d(dtype=dtype),
        beside: wp.array3d(dtype=vec_tile),
        slope: wp.array(dtype=dtype),
        steep: wp.array(dtype=wp.int32),
        threshold: wp.array2d(dtype=dtype),
        most: dtype,
        runs_out: wp.array4d(dtype=dtype),
    ):
        b, a, block = wp.tid()
        across = image.shape[1]
        along = image.shape[2]
        if steep[a] != 0:
            across = image.shape[2]
            along = image.shape[1]
        lines = runs_out.shape[3]
        begin = dtype(tile * block)
        if slope[a] > dtype(0.0):
            begin -= dtype(along)
        light = vec_tile()
        dark = vec_tile()
        light_best = vec_tile()
        dark_best = vec_tile()
        if threshold[b, a] > dtype(0.0):
            scale = dtype(1.0) / threshold[b, a]
            top = vec_tile(most)
            bottom = vec_tile(-most)
            one = vec_tile(dtype(1.0))
            for t in range(along):
                at = begin + slope[a] * dtype(t)
                first = int(wp.floor(at))
                if first > -tile - 1 and first < across:
                    share = at - dtype(first)
                    near = vec_tile()
                    far = vec_tile()
                    if first >= 0 and first + tile < across:
                        if steep[a] != 0:
                            near = beside[b, t, first]
                            far = beside[b, t, first + 1]
                        else:
                            for k in range(tile):
                                near[k] = image[b, first + k, t]
                                far[k] = image[b, first + k + 1, t]
                    else:
                        for k in range(tile):
                            i = first + k
                            if i >= 0 and i < across:
                                if steep[a] != 0:
                                    near[k] = image[b, t, i]
                                else:
                                    near[k] = image[b, i, t]
                            if i + 1 >= 0 and i + 1 < across:
                                if steep[a] != 0:
                                    far[k] = image[b, t, i + 1]
                                else:
                                    far[k] = image[b, i + 1, t]
                    e = wp.max(wp.min(scale * (near + share * (far - near)), top), bottom)
                    light = wp.max(light, vec_tile()) + e - one
                    dark = wp.max(dark, vec_tile()) - e - one
                    light_best = wp.max(light_best, light)
                    dark_best = wp.max(dark_best, dark)
        for k in range(tile):
            line = tile * block + k
            if line < lines:
                runs_out[b, a, 0, line] = light_best[k]
                runs_out[b, a, 1, line] = dark_best[k]

    return line_runs


def line_runs(image, slope, steep, threshold, most: float, runs_out) -> None:
    """Launch; overwrites."""
    if not runs_out.size:
        return
    tile = variant("line_runs", image.device).tile
    launch(
        make_line_runs(image.dtype, tile),
        (*runs_out.shape[:2], -(-runs_out.shape[3] // tile)),
        inputs=[image, neighbours(image, tile), slope, steep, threshold, most],
        outputs=[runs_out],
        device=image.device,
    )
