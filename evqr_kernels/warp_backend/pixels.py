"""What each pixel saw, ON and OFF events (the sign of the weight) apart: how many, and when the last.

``event_histogram`` counts them, in integers.  ``time_surface`` keeps the latest time of a pixel's events,

    last(p, y, x) = max of t over the events there, -infinity without any

and, with a decay, gives ``exp(last / decay)``: 1 for an event at the reference time, 0 without any.  The
greatest of several times does not depend on their order, nor does a count: results repeat bit for bit though
threads share pixels.
"""

from functools import cache

import warp as wp

from evqr_kernels.operations.events import CHUNK
from evqr_kernels.warp_backend.language import launch, module_of
from evqr_kernels.warp_backend.transport import window_of


@cache
def make_no_event(dtype: type) -> wp.Kernel:
    """Build the filling with -infinity; launch: one thread per entry."""

    @wp.kernel(module=module_of("surface", dtype))
    def no_event(surface_out: wp.array(dtype=dtype)):
        surface_out[wp.tid()] = -dtype(wp.inf)

    return no_event


@cache
def make_last_times(dtype: type) -> wp.Kernel:
    """Build the search of the last times; launch: one thread per chunk of events."""

    @wp.kernel(module=module_of("surface", dtype))
    def last_times(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        t: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        surface_out: wp.array4d(dtype=dtype),
    ):
        right = dtype(surface_out.shape[3])
        bottom = dtype(surface_out.shape[2])
        first = wp.tid() * CHUNK
        last = wp.min(first + CHUNK, window_ptr[window_ptr.shape[0] - 1])
        b = window_of(window_ptr, first)
        if b < 0 or last > x.shape[0]:  # some of them no window names
            first = wp.max(first, window_ptr[0])
            last = wp.min(last, x.shape[0])
            b = window_of(window_ptr, first)
        while first < last:  # ends with the last window
            stop = wp.min(last, window_ptr[b + 1])
            for e in range(first, stop):
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
                    image = wp.where(weight[e] < dtype(0.0), 1, 0)
                    wp.atomic_max(surface_out, b, image, int(row), int(column), seen)
            first = wp.max(first, stop)
            b += 1

    return last_times


@cache
def make_decay(dtype: type) -> wp.Kernel:
    """Build the decay; launch: one thread per entry."""

    @wp.kernel(module=module_of("surface", dtype))
    def decay_times(decay: dtype, surface_inout: wp.array(dtype=dtype)):
        k = wp.tid()
        surface_inout[k] = wp.exp(surface_inout[k] / decay)

    return decay_times


def time_surface(x, y, t, weight, window_ptr, decay: float, surface_out) -> None:
    """Launch the passes; overwrites."""
    dtype, device = x.dtype, x.device
    flat = surface_out.flatten()
    launch(make_no_event(dtype), flat.shape[0], inputs=[], outputs=[flat], device=device)
    launch(
        make_last_times(dtype),
        -(-x.shape[0] // CHUNK),
        inputs=[x, y, t, weight, window_ptr],
        outputs=[surface_out],
        device=device,
    )
    if decay > 0:
        launch(make_decay(dtype), flat.shape[0], inputs=[decay], outputs=[flat], device=device)


@cache
def make_event_histogram(dtype: type) -> wp.Kernel:
    """Build the counting; launch: one thread per chunk of events, whatever windows they are of."""

    @wp.kernel(module=module_of("histogram", dtype))
    def event_histogram(
        x: wp.array(dtype=dtype),
        y: wp.array(dtype=dtype),
        weight: wp.array(dtype=dtype),
        window_ptr: wp.array(dtype=wp.int32),
        counts_out: wp.array4d(dtype=wp.int32),
    ):
        right = dtype(counts_out.shape[3])
        bottom = dtype(counts_out.shape[2])
        first = wp.tid() * CHUNK
        last = wp.min(first + CHUNK, window_ptr[window_ptr.shape[0] - 1])
        b = window_of(window_ptr, first)
        if b < 0 or last > x.shape[0]:  # some of them no window names
            first = wp.max(first, window_ptr[0])
            last = wp.min(last, x.shape[0])
            b = window_of(window_ptr, first)
        while first < last:  # ends with the last window
            stop = wp.min(last, window_ptr[b + 1])
            for e in range(first, stop):
                column = x[e] + dtype(0.5)
                row = y[e] + dtype(0.5)
                # written so that it is false for NaN
                if column >= dtype(0.0) and row >= dtype(0.0) and column < right and row < bottom:
                    image = wp.where(weight[e] < dtype(0.0), 1, 0)
                    wp.atomic_add(counts_out, b, image, int(row), int(column), 1)
            first = wp.max(first, stop)
            b += 1

    return event_histogram


def event_histogram(x, y, weight, window_ptr, counts_out) -> None:
    """Launch; accumulates."""
    launch(
        make_event_histogram(x.dtype),
        -(-x.shape[0] // CHUNK),
        inputs=[x, y, weight, window_ptr],
        outputs=[counts_out],
        device=x.device,
    )
