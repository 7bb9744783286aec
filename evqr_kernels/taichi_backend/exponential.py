"""exp in both precisions on every device: the Vulkan standard library has none for float64.

    exp(x) = 2^n exp(r),    n = round(x / ln 2),    r = x - n ln 2 in [-0.35, 0.35]

with exp(r) by its series, whose 14th power of r no longer matters.
"""

import math
from functools import cache

from evqr_kernels.taichi_backend.language import ti

INVERSE_LN2 = 1.0 / math.log(2.0)

LAST_POWER = 13

LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
"""ln 2 with so few bits that a small multiple is exact; `LN2_LOW` has the others."""

LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")


@cache
def make_exp(dtype):
    """Build the function; float64 is for gradient checks and takes its time."""

    @ti.func
    def exp32(x):
        return ti.exp(x)

    @ti.func
    def exp64(x):
        n = int(ti.floor(x * dtype(INVERSE_LN2) + dtype(0.5)))
        r = (x - dtype(n) * dtype(LN2_HIGH)) - dtype(n) * dtype(LN2_LOW)
        value = dtype(1.0)
        for k in ti.static(range(LAST_POWER, 0, -1)):
            value = dtype(1.0) + value * r * dtype(1.0 / k)
        factor = ti.select(n > 0, dtype(2.0), dtype(0.5))
        for _ in range(ti.abs(n)):
            value *= factor
        return value

    return exp32 if dtype == ti.f32 else exp64
