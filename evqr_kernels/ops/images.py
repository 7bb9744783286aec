"""Checked functions from images to motion and to places of templates."""

from __future__ import annotations

import numpy as np

from evqr_kernels.checks import ArrayChecks, Floats, Ints
from evqr_kernels.launch import Launch


def motion_correlation(
    first: Floats, second: Floats, *, radius: int, backend: str = "auto", device: str | None = None
) -> Floats:
    """Correlate two images over a square of shifts.

    Parameters
    ----------
    first, second : (B, Y, X)
    radius                      largest shift along an axis [px]

    Returns
    -------
    (B, 2 R + 1, 2 R + 1)   entry (j, i) is the sum of first(y, x) second(y + j - R, x + i - R)
    """
    checks = ArrayChecks()
    checks.floats("first", first, "B", "Y", "X")
    checks.floats("second", second, "B", "Y", "X")
    checks.at_least("radius", radius, 0)
    launch = Launch("motion_correlation", checks, backend, device)
    shifts, (batch, height, _) = 2 * radius + 1, first.shape
    rows = launch.scratch(batch, height, shifts, -(-shifts // 16) * 16)
    launch.run(*launch.put(first, second), radius, rows, launch.result(None, batch, shifts, shifts))
    return launch.results()[0]


def reduce_image(image: Floats, *, ratio: float, backend: str = "auto", device: str | None = None) -> Floats:
    """Sum an image over coarser pixels, with fractional coverage at their borders.

    Parameters
    ----------
    image : (B, Y, X)
    ratio               side of a coarse pixel in fine ones, at least 1

    Returns
    -------
    (B, ceil(Y / ratio), ceil(X / ratio))
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.at_least("ratio", ratio, 1.0)
    launch = Launch("reduce_image", checks, backend, device)
    batch, height, width = image.shape
    coarse_height = int(np.ceil(height / ratio))
    out = launch.result(None, batch, coarse_height, int(np.ceil(width / ratio)))
    launch.run(*launch.put(image), ratio, launch.scratch(batch, coarse_height, width), out)
    return launch.results()[0]


def correlate_templates(
    image: Floats,
    bank: Floats,
    disc: Floats,
    floor: Floats,
    *,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:
    """Correlate an image with a bank of templates, normalised by the energy under them; keep the best.

    Parameters
    ----------
    image : (B, Y, X)
    bank : (N, N, 8)
    disc : (N, N)       weight of each place in the energy, 0 to 1
    floor : (B,)        energy below which a place is quiet; positive

    Returns
    -------
    (B, Y - N + 1, X - N + 1), the same in int32   response, its sign kept, and the index of its template
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("bank", bank, "N", "N", 8)
    checks.floats("disc", disc, "N", "N")
    checks.floats("floor", floor, "B")
    if disc.size and not (disc.min() >= 0 and disc.max() <= 1):
        raise ValueError(f"disc must be 0 to 1, got {disc.min()} to {disc.max()}")
    n, (batch, height, width) = len(disc), image.shape
    # the last columns may be computed for nothing: kernels work on at least four neighbours
    wide = max(4, width - n + 1)
    image = np.pad(image, ((0, 0), (0, 0), (0, wide - (width - n + 1))))
    launch = Launch("correlate_templates", checks, backend, device)
    shape = (batch, max(0, height - n + 1), wide)
    response, angle = launch.result(None, *shape), launch.result(None, *shape, dtype=np.int32)
    launch.run(*launch.put(image, bank, disc, floor), response, angle)
    response, angle = launch.results()
    keep = max(0, width - n + 1)
    return response[:, :, :keep], angle[:, :, :keep]
