"""What each pixel saw: counts and last times; the formulas are in ``warp_backend/pixels.py``."""

import math
from functools import cache

from evqr_kernels.taichi_backend.lag_adjoint import window_of
from evqr_kernels.taichi_backend.language import array, float_of, ti
from evqr_kernels.taichi_backend.launches import launch
from evqr_kernels.taichi_backend.splat import chunks_of, events_of, length_of_chunk, owners
from evqr_kernels.taichi_backend.transcendental import make_exp


@cache
def make_no_event(dtype):
    """Build the filling with -infinity; one thread per pixel."""

    @ti.kernel
    def no_event(surface_out: array(dtype, 4)):
        for place in ti.grouped(surface_out):
            surface_out[place] = dtype(-math.inf)

    return no_event


@cache
def make_last_times(dtype, shared: bool, alone: bool):
    """Build the search of the last times; one thread per (window, chunk of events)."""

    @ti.kernel
    def last_times(
        x: array(dtype, 1),
        y: array(dtype, 1),
        t: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        chunks: ti.i32,
        surface_out: array(dtype, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(surface_out.shape[0], chunks):
            if ti.static(not shared):
                if k > 0:
                    continue
            right = dtype(surface_out.shape[3])
            bottom = dtype(surface_out.shape[2])
            begin, end = events_of(window_ptr, b, x.shape[0])
            length = length_of_chunk(end - begin, chunks, shared)
            first = begin + k * length
            for e in range(first, ti.min(first + length, end)):
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                seen = t[e]
                # written so that it is false for NaN
                if (
                    seen == seen
                    and column >= dtype(0.0)
                    and row >= dtype(0.0)
                    and column < right
                    and row < bottom
                ):
                    image = ti.select(weight[e] < dtype(0.0), 1, 0)
                    place = ti.Vector([b, image, int(row), int(column)])
                    if ti.static(shared):
                        ti.atomic_max(surface_out[place], seen)
                    else:
                        surface_out[place] = ti.max(surface_out[place], seen)

    return last_times


@cache
def make_decay(dtype):
    """Build the decay; one thread per pixel."""
    exp = make_exp(dtype)

    @ti.kernel
    def decay_times(decay: dtype, surface_inout: array(dtype, 4)):
        for place in ti.grouped(surface_inout):
            seen = surface_inout[place]
            surface_inout[place] = ti.select(seen > dtype(-math.inf), exp(seen / decay), dtype(0.0))

    return decay_times


def time_surface(x, y, t, weight, window_ptr, decay: float, surface_out) -> None:
    """Launch the passes; overwrites."""
    dtype, threads = float_of(x), owners(x, window_ptr)
    launch(make_no_event(dtype), surface_out)
    kernel = make_last_times(dtype, *threads)
    launch(kernel, x, y, t, weight, window_ptr, chunks_of(x, window_ptr, *threads), surface_out)
    if decay > 0:
        launch(make_decay(dtype), decay, surface_out)


@cache
def make_histogram_of_windows(dtype, alone: bool):
    """Build the counting for CPUs; one thread per window."""

    @ti.kernel
    def histogram_of_windows(
        x: array(dtype, 1),
        y: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        indices: ti.i32,
        counts_out: array(ti.i32, 4),
    ):
        ti.loop_config(serialize=alone)
        for b, k in ti.ndrange(counts_out.shape[0], indices):
            if k > 0:
                continue
            begin, end = events_of(window_ptr, b, x.shape[0])
            for e in range(begin, end):
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                # written so that it is false for NaN
                if (
                    column >= dtype(0.0)
                    and row >= dtype(0.0)
                    and column < dtype(counts_out.shape[3])
                    and row < dtype(counts_out.shape[2])
                ):
                    place = ti.Vector([b, ti.select(weight[e] < dtype(0.0), 1, 0), int(row), int(column)])
                    counts_out[place] = counts_out[place] + 1

    return histogram_of_windows


@cache
def make_histogram_of_events(dtype):
    """Build the counting for GPUs; one thread per event.

    Of several additions of a thread to one integer Mesa's Vulkan on a CPU makes two.
    """

    @ti.kernel
    def histogram_of_events(
        x: array(dtype, 1),
        y: array(dtype, 1),
        weight: array(dtype, 1),
        window_ptr: array(ti.i32, 1),
        counts_out: array(ti.i32, 4),
    ):
        for e in range(x.shape[0]):
            b = window_of(window_ptr, e)
            column = x[e] + dtype(0.5)
            row = y[e] + dtype(0.5)
            # written so that it is false for NaN
            if (
                b >= 0
                and b < counts_out.shape[0]
                and column >= dtype(0.0)
                and row >= dtype(0.0)
                and column < dtype(counts_out.shape[3])
                and row < dtype(counts_out.shape[2])
            ):
                image = ti.select(weight[e] < dtype(0.0), 1, 0)
                counts_out[b, image, int(row), int(column)] += 1  # atomic

    return histogram_of_events


def event_histogram(x, y, weight, window_ptr, counts_out) -> None:
    """Launch; accumulates."""
    shared, alone = owners(x, window_ptr)
    if shared:
        launch(make_histogram_of_events(float_of(x)), x, y, weight, window_ptr, counts_out)
        return
    kernel = make_histogram_of_windows(float_of(x), alone)
    launch(kernel, x, y, weight, window_ptr, chunks_of(x, window_ptr, shared, alone), counts_out)
