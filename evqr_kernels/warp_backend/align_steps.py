"""What every variant of an alignment does with a pose; the formulas are in ``align``."""

from functools import cache

import warp as wp

from evqr_kernels.warp_backend.language import vector

MOST = 8
"""Parameters of a pose, at most."""

TERMS = 4
"""Columns of the table that the derivative in one parameter is made of, at most."""

SETTINGS = 7
"""Numbers that a launch is told: centre and scale along u and v, ridge, damping, tolerance."""


@cache
def make_gain_factor(dtype: type) -> wp.Function:
    """Build what a term is multiplied with."""

    @wp.func
    def gain_factor(kind: int, gain_u: dtype, gain_v: dtype) -> dtype:
        factor = dtype(0.0)
        if kind == 1:
            factor = gain_u
        elif kind == 2:
            factor = gain_v
        elif kind == 3:
            factor = dtype(1.0)
        return factor

    return gain_factor


@cache
def make_move(dtype: type) -> wp.Function:
    """Build what moves a pose by a step."""
    vec = vector(MOST, dtype)
    vec_settings = vector(SETTINGS, dtype)
    mat33 = wp.types.matrix(shape=(3, 3), dtype=dtype)

    @wp.func
    def move(
        settings: wp.array(dtype=vec_settings),
        which: int,
        step: vec,
        h: int,
        pose_inout: wp.array2d(dtype=dtype),
    ):
        centre_u = settings[which][0]
        centre_v = settings[which][1]
        scale_u = settings[which][2]
        scale_v = settings[which][3]
        longer = wp.max(scale_u, scale_v)
        one = dtype(1.0)
        zero = dtype(0.0)
        inverse_sq = one / (longer * longer)
        tilt_u = step[6] / (scale_u / longer)
        tilt_v = step[7] / (scale_v / longer)
        warp_inverse = wp.inverse(
            mat33(
                one + step[1] / scale_u, step[2] / scale_v, step[0],
                step[4] / scale_u, one + step[5] / scale_v, step[3],
                -tilt_u * inverse_sq, -tilt_v * inverse_sq, one,
            )
        )  # fmt: skip
        moved = (
            mat33(
                pose_inout[h, 0], pose_inout[h, 1], pose_inout[h, 2],
                pose_inout[h, 3], pose_inout[h, 4], pose_inout[h, 5],
                pose_inout[h, 6], pose_inout[h, 7], pose_inout[h, 8],
            )
            * mat33(one, zero, centre_u, zero, one, centre_v, zero, zero, one)
            * warp_inverse
            * mat33(one, zero, -centre_u, zero, one, -centre_v, zero, zero, one)
        )  # fmt: skip
        for r in range(3):
            for c in range(3):
                pose_inout[h, 3 * r + c] = moved[r, c] / moved[2, 2]

    return move


@cache
def make_gain(dtype: type, columns: int) -> wp.Function:
    """Build the gain at a pose, from the last two moments."""
    along_u, along_v = columns - 2, columns - 1

    @wp.func
    def gain_at(gram: wp.array2d(dtype=dtype), which: int, ridge: dtype, with_u: dtype, with_v: dtype):
        guu = gram[which, columns * along_u + along_u]
        guv = gram[which, columns * along_u + along_v]
        gvv = gram[which, columns * along_v + along_v]
        extra = ridge * (guu + gvv)
        determinant = (guu + extra) * (gvv + extra) - guv * guv
        gain_u = -((gvv + extra) * with_u - guv * with_v) / determinant
        gain_v = -((guu + extra) * with_v - guv * with_u) / determinant
        return gain_u, gain_v

    return gain_at


@cache
def make_measure(dtype: type, columns: int) -> wp.Function:
    """Build what says how well model and image agree at a pose."""
    along_u, along_v = columns - 2, columns - 1

    @wp.func
    def measure(
        gram: wp.array2d(dtype=dtype),
        which: int,
        gain_u: dtype,
        gain_v: dtype,
        with_u: dtype,
        with_v: dtype,
        energy: dtype,
        points: int,
        h: int,
        result_out: wp.array2d(dtype=dtype),
    ):
        guu = gram[which, columns * along_u + along_u]
        guv = gram[which, columns * along_u + along_v]
        gvv = gram[which, columns * along_v + along_v]
        model = gain_u * gain_u * guu + dtype(2.0) * gain_u * gain_v * guv + gain_v * gain_v * gvv
        cross = -(gain_u * with_u + gain_v * with_v)
        noise = wp.max(energy - dtype(2.0) * cross + model, dtype(0.0))
        result_out[h, 0] = gain_u
        result_out[h, 1] = gain_v
        result_out[h, 2] = cross / wp.sqrt(wp.max(model * energy, dtype(1.0e-20)))
        result_out[h, 3] = noise / dtype(wp.max(points, 1))

    return measure
