"""What the arguments of operations must be, through whichever door they come: dtypes, shapes and settings.

The checked functions and the differentiable ones ask here, so that neither lets through what the other
refuses.  No values are looked at: of a tensor on a GPU there is a shape, and nothing else for free.
"""

from __future__ import annotations

from evqr_kernels.checks import ArrayChecks, Floats, Ints


def events(checks: ArrayChecks, window_ptr: Ints, **columns: Floats) -> None:
    """Check columns of events, and the windows that they are of."""
    for name, column in columns.items():
        checks.floats(name, column, "E")
    checks.windows(window_ptr)


def splat_events(
    checks: ArrayChecks, x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats,
    lag: Floats | None, frame: Floats | None,
) -> None:  # fmt: skip
    """Check what `splat_events` and its adjoint share."""
    events(checks, window_ptr, x=x, y=y, t=t, weight=weight)
    checks.parameters("motion", motion, (2, 6))
    if lag is not None:
        checks.floats("lag", lag, "B", 2)
    if frame is not None:
        checks.floats("frame", frame, "B", 3)


def deposit_events(
    checks: ArrayChecks, x: Floats, y: Floats, t: Floats, weight: Floats, window_ptr: Ints, motion: Floats,
    frame: Floats | None,
) -> None:  # fmt: skip
    """Check what `deposit_events` and its adjoint share."""
    events(checks, window_ptr, x=x, y=y, t=t, weight=weight)
    checks.parameters("motion", motion, (2,))
    if frame is not None:
        checks.floats("frame", frame, "B", 3)


def lag_operator(
    checks: ArrayChecks, deposit: Floats, deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats
) -> None:
    """Check `lag_operator`, whose kernels work on sixteen neighbours and what the taps reach beyond."""
    checks.floats("deposit", deposit, "B", 2, "Y", "X")
    lags(checks, deposit_idx, direction, lag, taps)
    checks.choice("deposit_idx", deposit_idx, len(deposit))
    width, least = deposit.shape[3], 16 + taps.shape[1]
    if width < least:
        raise ValueError(f"deposit must be at least 16 + K = {least} wide, got {width}")


def lags(checks: ArrayChecks, deposit_idx: Ints, direction: Floats, lag: Floats, taps: Floats) -> None:
    """Check what `lag_operator` and its adjoint share."""
    checks.ints("deposit_idx", deposit_idx, "N")
    checks.floats("direction", direction, "N", 2)
    checks.floats("lag", lag, "N", 2)
    checks.floats("taps", taps, 2, "K")
    size = taps.shape[1]
    if size < 3 or size % 2 == 0:
        raise ValueError(f"taps must have shape (2, K) with K odd and at least 3, got {taps.shape}")


def sample_moments(
    checks: ArrayChecks, image: Floats, image_idx: Ints, pose: Floats, active: Ints | None, points: Floats,
    table: Floats,
) -> None:  # fmt: skip
    """Check what `sample_moments`, its adjoint and `align_poses` share."""
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("pose", pose, "N", 9)
    checks.ints("image_idx", image_idx, "N")
    checks.floats("points", points, "S", 2)
    checks.floats("table", table, "S", "C")
    checks.at_least("C", table.shape[1], 1)
    if active is not None:
        checks.ints("active", active, "N")
    checks.choice("image_idx", image_idx, len(image))


def code_rhs(
    checks: ArrayChecks, image: Floats, pose: Floats, lattice_u: Floats, lattice_v: Floats, profile: Floats,
    slope: Floats, gain: Floats,
) -> None:  # fmt: skip
    """Check what `code_rhs` and `code_normal_equations` share."""
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("pose", pose, "B", 9)
    checks.floats("lattice_u", lattice_u, "S")
    checks.floats("lattice_v", lattice_v, "T")
    checks.floats("profile", profile, "P")
    checks.floats("slope", slope, "P")
    checks.floats("gain", gain, "B", 2)


def render_code(checks: ArrayChecks, grid: Floats, to_grid: Floats, outside: Floats, sigma: float) -> None:
    """Check what `render_code` and its adjoint share."""
    checks.floats("grid", grid, "B", "G", "H")
    checks.parameters("to_grid", to_grid, (6, 8))
    checks.floats("outside", outside, "B")
    if not (sigma == 0.0 or 0.02 <= sigma <= 1.0):
        raise ValueError(f"sigma must be 0, or 0.02 to 1, got {sigma}")


def brightness_residual(checks: ArrayChecks, luminance: Floats, events_image: Floats, motion: Floats) -> None:
    """Check `brightness_residual`."""
    checks.floats("luminance", luminance, "B", "Y", "X")
    checks.floats("events_image", events_image, "B", "Y", "X")
    checks.floats("motion", motion, "B", 2)


def brightness_cost(
    checks: ArrayChecks, luminance: Floats, events_image: Floats, motion: Floats, mask: Floats | None
) -> None:
    """Check what `brightness_cost` and its adjoint share."""
    brightness_residual(checks, luminance, events_image, motion)
    if mask is not None:
        checks.floats("mask", mask, "B", "Y", "X")
