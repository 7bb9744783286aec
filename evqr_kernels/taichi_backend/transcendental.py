"""exp, log, cos, sin, atan2 and erf in both precisions on every device: Vulkan has none of them for float64.

    exp(x) = 2^n exp(r),            n = round(x / ln 2),    r = x - n ln 2 in [-0.35, 0.35], by its series
    log(x) = y + 2 (x - e) / (x + e),    y = log(x) in float32,    e = exp(y)
    cos(x), sin(x)   by their series, for half a turn on either side
    atan(z) = 2 atan(z / (1 + sqrt(1 + z^2)))   twice, which leaves less than 0.2, then by its series
    erf(x)  = x p(x^2)   up to 1,   1 - exp(-x^2) q(x)   beyond, with polynomials p and q

All of them without loops, of which Mesa's Vulkan on a CPU gives a thread 65535 rounds in all.
"""

import math
from functools import cache

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from evqr_kernels.taichi_backend.language import ti

PI = math.pi

INVERSE_LN2 = 1.0 / math.log(2.0)

LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
"""ln 2 with so few bits that a small multiple is exact; `LN2_LOW` has the others."""

LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")

POWERS = range(13, 0, -1)
"""Powers of the series of exp."""

EXPONENT_BITS = 11

HALF_TURN_POWERS = range(30, 0, -2)
"""Powers of the series of cos and sin that count at half a turn."""

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
        power = ti.select(n > 0, dtype(2.0), dtype(0.5))
        for bit in ti.static(range(EXPONENT_BITS)):
            if (ti.abs(n) >> bit) & 1 == 1:
                value *= power
            power *= power
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
def make_cos(dtype):
    """Build the cosine, of up to half a turn on either side."""

    @ti.func
    def cos32(x):
        return ti.cos(x)

    @ti.func
    def cos64(x):
        value = dtype(1.0)
        for k in ti.static(HALF_TURN_POWERS):
            value = dtype(1.0) - value * x * x * dtype(1.0 / (k * (k - 1)))
        return value

    return cos32 if dtype == ti.f32 else cos64


@cache
def make_sin(dtype):
    """Build the sine, of up to half a turn on either side."""

    @ti.func
    def sin32(x):
        return ti.sin(x)

    @ti.func
    def sin64(x):
        value = dtype(1.0)
        for k in ti.static(HALF_TURN_POWERS):
            value = dtype(1.0) - value * x * x * dtype(1.0 / (k * (k + 1)))
        return x * value

    return sin32 if dtype == ti.f32 else sin64


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


ERF_END = 4.25
"""Where `make_erf` ends: 6 standard deviations of the normal distribution."""

ERF_MIDDLE, ERF_HALF = (ERF_END + 1.0) / 2.0, (ERF_END - 1.0) / 2.0


def _polynomial(function, degree: int) -> list[float]:
    """Give the coefficients of the polynomial through a function at Chebyshev's points of [-1, 1]."""
    sampled = Chebyshev.interpolate(np.vectorize(function), degree)
    return sampled.convert(kind=Polynomial).coef.tolist()


def _below_one(s: float) -> float:
    """Give erf(x) / x, with x^2 = (s + 1) / 2."""
    x = math.sqrt(0.5 * (s + 1.0))
    return math.erf(x) / x if x else 2.0 / math.sqrt(PI)


def _beyond_one(s: float) -> float:
    """Give (1 - erf(x)) exp(x^2), with x from 1 to `ERF_END`."""
    x = ERF_MIDDLE + ERF_HALF * s
    return math.erfc(x) * math.exp(x * x)


@cache
def make_erf(dtype):
    """Build the error function up to `ERF_END` on either side, which no device has.

    It takes exp(-x^2) as well, which its caller has.  To 1.5e-7 in float32, to 3e-15 in float64.
    """
    degrees = (6, 10) if dtype == ti.f32 else (12, 22)
    below, beyond = map(_polynomial, (_below_one, _beyond_one), degrees)

    @ti.func
    def polynomial(coefficients: ti.template(), s):
        total = dtype(0.0)
        for coefficient in ti.static(coefficients[::-1]):
            total = total * s + dtype(coefficient)
        return total

    @ti.func
    def erf(x, gauss):
        size = ti.abs(x)
        value = x * polynomial(below, dtype(2.0) * x * x - dtype(1.0))
        if size > dtype(1.0):
            s = (size - dtype(ERF_MIDDLE)) * dtype(1.0 / ERF_HALF)
            value = dtype(1.0) - gauss * polynomial(beyond, s)
            value = ti.select(x < dtype(0.0), -value, value)
        return value

    return erf
