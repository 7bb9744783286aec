"""The profile of a splat along one axis, g of `SplatConfig`, and its derivatives.

    g'(r)  = -r gauss(r) / c q k,    q = 1 - (r / R)^2,    k = q / eps^2 + 4 / R^2
    g''(r) = gauss(r) / c ((r^2 / eps^2 - 1) q k + 2 (r / R)^2 (2 q / eps^2 + 4 / R^2))

On CPUs the Gaussians at all taps are products that start from two exponentials; on GPUs, which compute them
in hardware and have few registers, each tap has one of its own.
"""

from functools import cache

import warp as wp

from evqr_kernels.config import SplatConfig
from evqr_kernels.warp_backend.language import vector


@cache
def make_splat_taps(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that gives the Gaussian, g and g' at the taps around an event.

    The event is ``offset`` px off the middle one.
    """
    if cfg.kind == "bilinear":
        return make_hat_taps(dtype)
    reach = cfg.reach
    vec_taps = vector(2 * reach + 1, dtype)
    gauss_at_taps = wp.constant(vec_taps(*(cfg.norm * cfg.gauss(k) for k in range(-reach, reach + 1))))
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    inverse_radius_sq = wp.constant(dtype(1.0 / cfg.radius_px**2))

    @wp.func
    def splat_taps(offset: dtype):
        # exp(-(k - f)^2 / 2 eps^2) = exp(-f^2 / 2 eps^2) exp(f / eps^2)^k exp(-k^2 / 2 eps^2): two exps, not
        # one a tap
        gauss = vec_taps()
        value = vec_taps()
        slope = vec_taps()
        up = wp.exp(offset * inverse_variance)
        down = dtype(1.0) / up
        right = wp.exp(dtype(-0.5) * offset * offset * inverse_variance)
        left = right
        for k in range(wp.static(reach + 1)):
            gauss[reach + k] = right * gauss_at_taps[reach + k]
            gauss[reach - k] = left * gauss_at_taps[reach - k]
            right *= up
            left *= down
        for k in range(wp.static(2 * reach + 1)):
            r = dtype(k - reach) - offset
            q = wp.max(dtype(1.0) - r * r * inverse_radius_sq, dtype(0.0))
            value[k] = gauss[k] * q * q
            slope[k] = -r * gauss[k] * q * (q * inverse_variance + dtype(4.0) * inverse_radius_sq)
        return gauss, value, slope

    return splat_taps


@cache
def make_hat_tap(dtype: type) -> wp.Function:
    """Build the function that gives max(0, 1 - |r|) and its derivatives, whatever the Gaussian there."""

    @wp.func
    def hat_tap(gauss: dtype, r: dtype):
        value = wp.max(dtype(1.0) - wp.abs(r), dtype(0.0))
        slope = dtype(0.0)
        if value > dtype(0.0) and r != dtype(0.0):
            slope = wp.where(r < dtype(0.0), dtype(1.0), dtype(-1.0))
        return value, slope, dtype(0.0)

    return hat_tap


@cache
def make_hat_taps(dtype: type) -> wp.Function:
    """Build the function that gives max(0, 1 - |r|) and its slope at the three taps around an event."""
    vec_taps = vector(3, dtype)
    hat_tap = make_hat_tap(dtype)

    @wp.func
    def hat_taps(offset: dtype):
        value = vec_taps()
        slope = vec_taps()
        for k in range(wp.static(3)):
            at, grown, _bend = hat_tap(dtype(0.0), dtype(k - 1) - offset)
            value[k] = at
            slope[k] = grown
        return vec_taps(), value, slope

    return hat_taps


@cache
def make_splat_tap(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that gives g, g' and g'' at a tap that is ``r`` px off, from the Gaussian there."""
    if cfg.kind == "bilinear":
        return make_hat_tap(dtype)
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    inverse_radius_sq = wp.constant(dtype(1.0 / cfg.radius_px**2))

    @wp.func
    def splat_tap(gauss: dtype, r: dtype):
        q = wp.max(dtype(1.0) - r * r * inverse_radius_sq, dtype(0.0))
        rate = q * inverse_variance + dtype(4.0) * inverse_radius_sq
        bend = dtype(2.0) * q * inverse_variance + dtype(4.0) * inverse_radius_sq
        second = (r * r * inverse_variance - dtype(1.0)) * q * rate
        second += dtype(2.0) * r * r * inverse_radius_sq * bend
        curvature = wp.where(q > dtype(0.0), gauss * second, dtype(0.0))
        return gauss * q * q, -r * gauss * q * rate, curvature

    return splat_tap


@cache
def make_gauss_around(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the start of a walk over taps, away from the middle one, which is ``-offset`` px off.

    It gives the Gaussian there, and by what it grows to the tap on the right and to that on the left; with
    each further step that shrinks by the Gaussian's value at a pixel, squared: two exps, not one a tap.
    """
    norm = wp.constant(dtype(cfg.norm))
    inverse_variance = wp.constant(dtype(1.0 / cfg.epsilon_px**2))
    shrink = wp.constant(dtype(cfg.gauss(1.0) ** 2))

    @wp.func
    def gauss_around(offset: dtype):
        up = wp.exp((offset - dtype(0.5)) * inverse_variance)
        return norm * wp.exp(dtype(-0.5) * offset * offset * inverse_variance), up, shrink / up

    return gauss_around


@cache
def make_splat_profile(dtype: type, cfg: SplatConfig) -> wp.Function:
    """Build the function that gives g, g' and g'' ``r`` px off, with an exponential."""
    norm = wp.constant(dtype(cfg.norm))
    half_inverse_variance = wp.constant(dtype(0.5 / cfg.epsilon_px**2))
    splat_tap = make_splat_tap(dtype, cfg)

    @wp.func
    def splat_profile(r: dtype):
        return splat_tap(norm * wp.exp(-r * r * half_inverse_variance), r)

    return splat_profile
