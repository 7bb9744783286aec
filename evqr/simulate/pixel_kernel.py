"""The pixels of an event camera, one thread a pixel, on the Warp CPU device.

A moving object is a texture whose rows lie along the direction of travel, straight or in circles, so each
pixel walks backwards along one texture row at constant speed.  The knots of its signal are the moments at
which it crosses a texture column: the logarithm X of the light is known there, and linear in between.  In one
segment of such a ramp the photoreceptor, a low-pass of bandwidth r [rad/us],

    dY/dt = r (X - Y),

and a reference that leaks put the pixel, s microseconds after the segment's start, above its last event by

    level(s) = level + slope s - lag (1 - exp(-r s)),    slope = dX/dt + leak,    lag = Y - X + (dX/dt) / r

Events are the crossings of level(s) through +on or -off, found by bracketed Newton steps on this closed form:
there are no frames.  After an event the pixel is held in reset for the refractory time and starts again from
level 0.
"""

# A kernel is written in Warp's own language: pyright takes its types, indices and operators for Python's.
# pyright: reportInvalidTypeForm=false, reportAssignmentType=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

import warp as wp

# About what float32 levels and slopes can tell.
ROOT_TOLERANCE_US = wp.constant(0.02)
ROOT_STEPS = wp.constant(12)


@wp.func
def level_after(level: float, slope: float, lag: float, rate: float, s: float):
    """Level ``s`` microseconds after a moment at which it was ``level``."""
    return level + slope * s - lag * (1.0 - wp.exp(-rate * s))


@wp.func
def crossing(level: float, slope: float, lag: float, rate: float, first: float, last: float, target: float):
    """Time in [first, last], where the level is monotone and passes ``target``, of that passage [us]."""
    low = first
    high = last
    below = level_after(level, slope, lag, rate, first) - target
    above = level_after(level, slope, lag, rate, last) - target
    s = wp.clamp(first - below * (last - first) / (above - below), first, last)
    if lag == 0.0:  # a straight line
        return s
    for _ in range(ROOT_STEPS):
        miss = level_after(level, slope, lag, rate, s) - target
        if (miss < 0.0) == (below < 0.0):
            low = s
        else:
            high = s
        moved = s - miss / (slope - lag * rate * wp.exp(-rate * s))
        if not (moved >= low and moved <= high):
            moved = 0.5 * (low + high)
        change = wp.abs(moved - s)
        s = moved
        if change < ROOT_TOLERANCE_US:
            break
    return s


@wp.kernel(enable_backward=False)
def walk_pixels(
    texture: wp.array2d(dtype=wp.float32),
    cover_along: wp.array(dtype=wp.float32),
    cover_across: wp.array(dtype=wp.float32),
    background: wp.array2d(dtype=wp.float32),
    pixel: wp.array2d(dtype=wp.vec3f),
    begin: wp.array2d(dtype=wp.vec2d),
    clock_us: wp.vec3d,
    response: wp.vec4f,
    first_row: wp.int32,
    n_events_out: wp.array(dtype=wp.int32),
    t_out: wp.array(dtype=wp.float64),
    address_out: wp.array(dtype=wp.int32),
):
    """Write the events of each pixel; launch: (rows of a band, sensor width).

    texture : (V, U) light of the object times its coverage
    cover_along, cover_across : (U,), (V,) factors of the coverage
    background : (height, width) light where the object does not cover
    pixel : (height, width, 3) threshold on, threshold off (log units), level at the start
    begin : (height, width) texture (column, row) that each pixel sees at the start
    clock_us : start, end, microseconds a texture column
    response : bandwidth in the dark, bandwidth per unit of light [rad/us] (both 0: no low-pass), refractory
        time [us], leak rate [1/us]
    n_events_out : (1,) ACCUMULATED; beyond the capacity of the arrays below: launch again with larger ones
    t_out, address_out : (capacity,) time [us] and 2 (row width + column) + (1 if brighter), grouped by pixel
    """
    band_row, column = wp.tid()
    row = first_row + band_row
    width = background.shape[1]
    start = clock_us[0]
    end = clock_us[1]
    knot_us = clock_us[2]

    # The walk begins at the next texture column ahead of the pixel, or when the object's front comes.
    along = begin[row, column][0]
    across = begin[row, column][1]
    knot = wp.min(int(wp.ceil(along)), texture.shape[1] - 1)
    t = start + (along - wp.float64(knot)) * knot_us
    upper = int(wp.floor(across))
    on_object = upper >= 0 and upper < texture.shape[0] - 1 and knot > 0 and t < end
    steps = int(0)
    if on_object:
        steps = wp.min(knot, int(wp.ceil((end - t) / knot_us)))
    else:
        t = start

    ground = background[row, column]
    weight = float(0.0)
    cover = float(0.0)
    light = ground
    if on_object:
        weight = float(across - wp.float64(upper))
        cover = (1.0 - weight) * cover_across[upper] + weight * cover_across[upper + 1]
        light = (1.0 - weight) * texture[upper, knot] + weight * texture[upper + 1, knot]
        light += (1.0 - cover * cover_along[knot]) * ground
    log_light = wp.log(light)

    threshold_on = pixel[row, column][0]
    threshold_off = pixel[row, column][1]
    level = pixel[row, column][2]
    leak = response[3] * threshold_on
    filtered = response[0] + response[1] > 0.0
    gap = float(0.0)
    dead = float(0.0)

    # One segment a texture column; the last one stands still on the background (or ends in no time).
    for step in range(steps + 1):
        duration = float(knot_us)
        next_light = ground
        if step < steps:
            knot -= 1
            next_light = (1.0 - weight) * texture[upper, knot] + weight * texture[upper + 1, knot]
            next_light += (1.0 - cover * cover_along[knot]) * ground
        else:
            duration = float(end - t)
            next_light = light
        next_log = wp.log(next_light)

        ramp = float(0.0)
        rate = float(0.0)
        lag = float(0.0)
        if step < steps:
            ramp = (next_log - log_light) / duration
        if filtered:
            rate = response[0] + response[1] * 0.5 * (light + next_light)
            lag = gap + ramp / rate
        slope = ramp + leak

        elapsed = float(0.0)
        while elapsed < duration:
            if dead > 0.0:
                pause = wp.min(dead, duration - elapsed)
                lag *= wp.exp(-rate * pause)
                dead -= pause
                elapsed += pause
                continue
            rest = duration - elapsed
            decay = wp.exp(-rate * rest)
            end_level = level + slope * rest - lag * (1.0 - decay)
            first = float(0.0)
            last = rest
            reached = end_level
            if (slope - lag * rate) * (slope - lag * rate * decay) < 0.0:
                turn = wp.clamp(-wp.log(slope / (lag * rate)) / rate, 0.0, rest)
                turn_level = level_after(level, slope, lag, rate, turn)
                if turn_level >= threshold_on or turn_level <= -threshold_off:
                    last = turn
                    reached = turn_level
                else:
                    first = turn
            if reached < threshold_on and reached > -threshold_off:
                level = end_level
                lag *= decay
                break
            target = -threshold_off
            brighter = int(0)
            if reached >= threshold_on:
                target = threshold_on
                brighter = 1
            s = crossing(level, slope, lag, rate, first, last, target)
            slot = wp.atomic_add(n_events_out, 0, 1)
            if slot < t_out.shape[0]:
                t_out[slot] = t + wp.float64(elapsed + s)
                address_out[slot] = 2 * (row * width + column) + brighter
            lag *= wp.exp(-rate * s)
            elapsed += s
            level = 0.0
            dead = response[2]

        if filtered:
            gap = lag - ramp / rate
        light = next_light
        log_light = next_log
        t += wp.float64(duration)
