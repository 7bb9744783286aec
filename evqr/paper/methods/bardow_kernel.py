"""One iteration of the primal-dual method on the cost of Bardow et al., one thread a pixel.

Arrays are (Y, X, K): a thread walks along the K slices of its pixel.  Differences are forward ones, and zero
beyond the last pixel or slice.  Duals, in the order of the cost's terms, are

    0 1 2 3   slopes of u and v in x and y            |.| <= lambda_1
    4 5       change of u and v from slice to slice   |.| <= lambda_2
    6 7       slopes of L in x and y                  |.| <= lambda_3
    8         optical flow, linear at (L0, u0, v0)    |.| <= lambda_4
    9         events: L against L at the last event   |.| <= 1, or lambda_5 where there is none

Steps are those of diagonal preconditioning: one over the sum of a row's, or a column's, absolute entries.
"""

# A kernel is written in Warp's own language: pyright takes its types, indices and operators for Python's.
# pyright: reportInvalidTypeForm=false, reportAssignmentType=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

import warp as wp


@wp.func
def ahead(field: wp.array3d(dtype=float), y: int, x: int, k: int, axis: int):
    """Forward difference along x (0), y (1) or the slices (2)."""
    here = field[y, x, k]
    if axis == 0:
        return field[y, wp.min(x + 1, field.shape[1] - 1), k] - here
    if axis == 1:
        return field[wp.min(y + 1, field.shape[0] - 1), x, k] - here
    return field[y, x, wp.min(k + 1, field.shape[2] - 1)] - here


@wp.func
def behind(dual: wp.array4d(dtype=float), n: int, y: int, x: int, k: int, axis: int):
    """Adjoint of the forward difference."""
    total = float(0.0)
    if axis == 0:
        if x + 1 < dual.shape[2]:
            total -= dual[n, y, x, k]
        if x > 0:
            total += dual[n, y, x - 1, k]
    elif axis == 1:
        if y + 1 < dual.shape[1]:
            total -= dual[n, y, x, k]
        if y > 0:
            total += dual[n, y - 1, x, k]
    else:
        if k + 1 < dual.shape[3]:
            total -= dual[n, y, x, k]
        if k > 0:
            total += dual[n, y, x, k - 1]
    return total


@wp.func
def raised(dual: wp.array4d(dtype=float), n: int, y: int, x: int, k: int, step: float, bound: float):
    """Take a step of a dual and clip it."""
    dual[n, y, x, k] = wp.clamp(dual[n, y, x, k] + step, -bound, bound)


@wp.kernel(enable_backward=False)
def raise_duals(
    luminance: wp.array3d(dtype=float),
    flow_x: wp.array3d(dtype=float),
    flow_y: wp.array3d(dtype=float),
    luminance_0: wp.array3d(dtype=float),
    flow_x_0: wp.array3d(dtype=float),
    flow_y_0: wp.array3d(dtype=float),
    events: wp.array3d(dtype=float),
    seen: wp.array3d(dtype=wp.uint8),
    weights: wp.array(dtype=float),
    threshold: float,
    dual: wp.array4d(dtype=float),
):
    """Step all duals; launch: (Y, X).

    luminance, flow_x, flow_y : extrapolated primals
    events : mean of the polarities of a slice; seen : 1 where it has events
    weights : (5,) lambda_1 to lambda_5
    dual : (10, Y, X, K) UPDATED
    """
    y, x = wp.tid()
    last = int(0)
    half = float(0.5)
    for k in range(luminance.shape[2]):
        raised(dual, 0, y, x, k, half * ahead(flow_x, y, x, k, 0), weights[0])
        raised(dual, 1, y, x, k, half * ahead(flow_x, y, x, k, 1), weights[0])
        raised(dual, 2, y, x, k, half * ahead(flow_y, y, x, k, 0), weights[0])
        raised(dual, 3, y, x, k, half * ahead(flow_y, y, x, k, 1), weights[0])
        raised(dual, 4, y, x, k, half * ahead(flow_x, y, x, k, 2), weights[1])
        raised(dual, 5, y, x, k, half * ahead(flow_y, y, x, k, 2), weights[1])
        slope_x = ahead(luminance, y, x, k, 0)
        slope_y = ahead(luminance, y, x, k, 1)
        raised(dual, 6, y, x, k, half * slope_x, weights[2])
        raised(dual, 7, y, x, k, half * slope_y, weights[2])

        if k + 1 < luminance.shape[2]:
            u = flow_x_0[y, x, k]
            v = flow_y_0[y, x, k]
            at_x = ahead(luminance_0, y, x, k, 0)
            at_y = ahead(luminance_0, y, x, k, 1)
            flow = slope_x * u + slope_y * v + ahead(luminance, y, x, k, 2)
            flow += at_x * (flow_x[y, x, k] - u) + at_y * (flow_y[y, x, k] - v)
            row = 2.0 * (wp.abs(u) + wp.abs(v) + 1.0) + wp.abs(at_x) + wp.abs(at_y)
            raised(dual, 8, y, x, k, flow / row, weights[3])

        if k > 0:
            change = luminance[y, x, k] - luminance[y, x, last]
            if seen[y, x, k] != wp.uint8(0):
                raised(dual, 9, y, x, k, half * (change - threshold * events[y, x, k]), 1.0)
            else:
                moved = dual[9, y, x, k] + half * change
                shrunk = wp.max(wp.abs(moved) - half * threshold, 0.0)
                dual[9, y, x, k] = wp.sign(moved) * wp.min(shrunk, weights[4])
        if seen[y, x, k] != wp.uint8(0):
            last = k


@wp.kernel(enable_backward=False)
def lower_primals(
    dual: wp.array4d(dtype=float),
    luminance_0: wp.array3d(dtype=float),
    flow_x_0: wp.array3d(dtype=float),
    flow_y_0: wp.array3d(dtype=float),
    seen: wp.array3d(dtype=wp.uint8),
    luminance: wp.array3d(dtype=float),
    flow_x: wp.array3d(dtype=float),
    flow_y: wp.array3d(dtype=float),
    luminance_out: wp.array3d(dtype=float),
    flow_x_out: wp.array3d(dtype=float),
    flow_y_out: wp.array3d(dtype=float),
):
    """Step all primals; launch: (Y, X).

    luminance, flow_x, flow_y : UPDATED
    luminance_out, flow_x_out, flow_y_out : the same, extrapolated
    """
    y, x = wp.tid()
    slices = luminance.shape[2]
    pulled = float(0.0)  # by the slices that refer to the one of the event before them
    pulling = float(0.0)
    for step in range(slices):
        k = slices - 1 - step
        is_reference = k == 0 or seen[y, x, k] != wp.uint8(0)

        adj = behind(dual, 6, y, x, k, 0) + behind(dual, 7, y, x, k, 1) + behind(dual, 8, y, x, k, 2)
        column = float(7.0)
        if k + 1 < slices:
            u = flow_x_0[y, x, k]
            v = flow_y_0[y, x, k]
            if x + 1 < luminance.shape[1]:
                adj -= u * dual[8, y, x, k]
                column += wp.abs(u)
            if y + 1 < luminance.shape[0]:
                adj -= v * dual[8, y, x, k]
                column += wp.abs(v)
            if x > 0:
                before = flow_x_0[y, x - 1, k]
                adj += before * dual[8, y, x - 1, k]
                column += wp.abs(before)
            if y > 0:
                before = flow_y_0[y - 1, x, k]
                adj += before * dual[8, y - 1, x, k]
                column += wp.abs(before)
        if is_reference:
            adj -= pulled
            column += pulling
            pulled = float(0.0)
            pulling = float(0.0)
        if k > 0:
            adj += dual[9, y, x, k]
            pulled += dual[9, y, x, k]
            pulling += 1.0
        old = luminance[y, x, k]
        new = old - adj / column
        luminance[y, x, k] = new
        luminance_out[y, x, k] = 2.0 * new - old

        at_x = float(0.0)
        at_y = float(0.0)
        if k + 1 < slices:
            at_x = ahead(luminance_0, y, x, k, 0)
            at_y = ahead(luminance_0, y, x, k, 1)
        adj_u = behind(dual, 0, y, x, k, 0) + behind(dual, 1, y, x, k, 1) + behind(dual, 4, y, x, k, 2)
        adj_v = behind(dual, 2, y, x, k, 0) + behind(dual, 3, y, x, k, 1) + behind(dual, 5, y, x, k, 2)
        old_u = flow_x[y, x, k]
        old_v = flow_y[y, x, k]
        new_u = old_u - (adj_u + at_x * dual[8, y, x, k]) / (6.0 + wp.abs(at_x))
        new_v = old_v - (adj_v + at_y * dual[8, y, x, k]) / (6.0 + wp.abs(at_y))
        flow_x[y, x, k] = new_u
        flow_y[y, x, k] = new_v
        flow_x_out[y, x, k] = 2.0 * new_u - old_u
        flow_y_out[y, x, k] = 2.0 * new_v - old_v
