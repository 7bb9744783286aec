"""What every variant of an alignment does with a pose; the formulas are in ``warp_backend/align.py``."""

from functools import cache

from evqr_kernels.taichi_backend.language import ti


@cache
def make_gain_factor(dtype):
    """Build what a term is multiplied with."""

    @ti.func
    def gain_factor(kind, gain_u, gain_v):
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
def make_gain(dtype, columns: int):
    """Build the gain at a pose, from the last two moments."""
    first = columns - 2
    second = columns - 1

    @ti.func
    def gain_at(gram: ti.template(), which, ridge, with_u, with_v):
        guu = gram[which, first, first]
        guv = gram[which, first, second]
        gvv = gram[which, second, second]
        extra = ridge * (guu + gvv)
        determinant = (guu + extra) * (gvv + extra) - guv * guv
        gain_u = -((gvv + extra) * with_u - guv * with_v) / determinant
        gain_v = -((guu + extra) * with_v - guv * with_u) / determinant
        return gain_u, gain_v

    return gain_at


@cache
def make_measure(dtype, columns: int):
    """Build what says how well model and image agree at a pose."""
    first = columns - 2
    second = columns - 1

    @ti.func
    def measure(
        gram: ti.template(),
        which,
        gain_u,
        gain_v,
        with_u,
        with_v,
        energy,
        points,
        h,
        result_out: ti.template(),
    ):
        guu = gram[which, first, first]
        guv = gram[which, first, second]
        gvv = gram[which, second, second]
        model = gain_u * gain_u * guu + dtype(2.0) * gain_u * gain_v * guv + gain_v * gain_v * gvv
        cross = -(gain_u * with_u + gain_v * with_v)
        noise = ti.max(energy - dtype(2.0) * cross + model, dtype(0.0))
        result_out[h, 0] = gain_u
        result_out[h, 1] = gain_v
        result_out[h, 2] = cross / ti.sqrt(ti.max(model * energy, dtype(1.0e-20)))
        result_out[h, 3] = noise / dtype(ti.max(points, 1))

    return measure


@cache
def make_move(dtype):
    """Build what moves a pose by a step: six numbers, and two of its tilt."""

    @ti.func
    def centred(offset_u, offset_v):
        one = dtype(1.0)
        zero = dtype(0.0)
        return ti.Matrix([[one, zero, offset_u], [zero, one, offset_v], [zero, zero, one]])

    @ti.func
    def move(
        settings: ti.template(), which, step: ti.template(), tilt_u, tilt_v, h, pose_inout: ti.template()
    ):
        centre_u = settings[which, 0]
        centre_v = settings[which, 1]
        scale_u = settings[which, 2]
        scale_v = settings[which, 3]
        longer = ti.max(scale_u, scale_v)
        one = dtype(1.0)
        warp = ti.Matrix(
            [
                [one + step[1] / scale_u, step[2] / scale_v, step[0]],
                [step[4] / scale_u, one + step[5] / scale_v, step[3]],
                [-tilt_u / (longer * scale_u), -tilt_v / (longer * scale_v), one],
            ]
        )
        pose = ti.Matrix.zero(dtype, 3, 3)
        for r, c in ti.static(ti.ndrange(3, 3)):
            pose[r, c] = pose_inout[h, 3 * r + c]
        forth, back = centred(-centre_u, -centre_v), centred(centre_u, centre_v)
        moved = pose @ back @ warp.inverse() @ forth
        for r, c in ti.static(ti.ndrange(3, 3)):
            pose_inout[h, 3 * r + c] = moved[r, c] / moved[2, 2]

    return move
