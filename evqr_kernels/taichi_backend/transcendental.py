"""exp, log, atan2 and erf in both precisions on every device: Vulkan has none of them for float64.

    exp(x) = 2^n exp(r),            n = round(x / ln 2),    r = x - n ln 2 in [-0.35, 0.35], by its series
    log(x) = y + 2 (x - e) / (x + e),    y = log(x) in float32,    e = exp(y)
    atan(z) = 2 atan(z / (1 + sqrt(1 + z^2)))   twice, which leaves less than 0.2, then by its series
    erf(x)  = 2 / sqrt(pi) exp(-x^2) (x + 2 x^3 / 3 + 4 x^5 / 15 + ...), all of one sign

In float64, which is for gradient checks, they take their time.
"""

import math
from functools import cache

from evqr_kernels.taichi_backend.language import ti

PI = math.pi

INVERSE_LN2 = 1.0 / math.log(2.0)

LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
"""ln 2 with so few bits that a small multiple is exact; `LN2_LOW` has the others."""

LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")

POWERS = range(13, 0, -1)
"""Powers of the series of exp."""

ODD_POWERS = range(23, 0, -2)
"""Powers of the series of atan."""


@cache
def make_exp(dtype):
    """Build the exponential."""

    @ti.func
    def exp32(x):
        return ti.exp(x)

    @ti.func
    def exp64(x):
        n = int(ti.floor(x * dtype(INVERSE_LN2) + dtype(0.5)))
        r = (x - dtype(n) * dtype(LN2_HIGH)) - dtype(n) * dtype(LN2_LOW)
        value = dtype(1.0)
        for k in ti.static(POWERS):
            value = dtype(1.0) + value * r * dtype(1.0 / k)
        factor = ti.select(n > 0, dtype(2.0), dtype(0.5))
        for _ in range(ti.abs(n)):
            value *= factor
        return value

    return exp32 if dtype == ti.f32 else exp64


@cache
def make_log(dtype):
    """Build the logarithm, of what float32 can hold."""
    exp = make_exp(dtype)

    @ti.func
    def log32(x):
        return ti.log(x)

    @ti.func
    def log64(x):
        y = dtype(ti.log(ti.f32(x)))
        e = exp(y)
        return y + dtype(2.0) * (x - e) / (x + e)

    return log32 if dtype == ti.f32 else log64


@cache
def make_atan2(dtype):
    """Build the angle of a vector."""

    @ti.func
    def atan2_32(y, x):
        return ti.atan2(y, x)

    @ti.func
    def atan2_64(y, x):
        across = ti.abs(y)
        along = ti.abs(x)
        z = ti.min(across, along) / ti.max(across, along, dtype(1.0e-300))
        for _ in ti.static(range(2)):
            z /= dtype(1.0) + ti.sqrt(dtype(1.0) + z * z)
        series = dtype(0.0)
        for k in ti.static(ODD_POWERS):
            series = dtype(1.0 / k) - series * z * z
        angle = dtype(4.0) * z * series
        if across > along:
            angle = dtype(0.5 * PI) - angle
        if x < dtype(0.0):
            angle = dtype(PI) - angle
        if y < dtype(0.0):
            angle = -angle
        return angle

    return atan2_32 if dtype == ti.f32 else atan2_64


TWO_BY_SQRT_PI = 2.0 / math.sqrt(PI)


@cache
def make_erf(dtype):
    """Build the error function, up to about 5 on either side, which no device has; in float64 inside."""
    f64 = ti.f64
    exp = make_exp(f64)

    @ti.func
    def erf(x):
        square = f64(x) * f64(x)
        term = f64(TWO_BY_SQRT_PI) * f64(x) * exp(-square)
        total = term
        n = f64(1.0)
        while ti.abs(term) > f64(1e-18):
            n += f64(2.0)
            term *= f64(2.0) * square / n
            total += term
        return dtype(total)

    return erf
