"""Checked functions from images to motion and to places of templates."""

from __future__ import annotations

import numpy as np

from evqr_kernels.checks import ArrayChecks, Floats, Ints
from evqr_kernels.interop import any_arrays
from evqr_kernels.launch import Launch


@any_arrays
def motion_correlation(
    images: Floats, *, radius: int, clip: float, backend: str = "auto", device: str | None = None
) -> tuple[Floats, Floats]:
    """Correlate pairs of images, clipped, over a square of shifts.

    Parameters
    ----------
    images : (B, 2, Y, X)
    radius                  largest shift along an axis [px]
    clip                    magnitude at which values are clipped, at least 0

    Returns
    -------
    (B, 2 R + 1, 2 R + 1)   entry (j, i) is the sum of first(y, x) second(y + j - R, x + i - R)
    (B, 2)                  sums of the squares of the two images
    """
    checks = ArrayChecks()
    checks.floats("images", images, "B", 2, "Y", "X")
    checks.at_least("radius", radius, 0)
    checks.at_least("clip", clip, 0.0)
    launch = Launch("motion_correlation", checks, backend, device)
    shifts, (batch, _, height, width) = 2 * radius + 1, images.shape
    found = launch.backend.empty((batch, height, width), np.int32, launch.device)
    rows = launch.scratch(batch, height, shifts, -(-shifts // 16) * 16)
    correlation, energy = launch.result(None, batch, shifts, shifts), launch.result(None, batch, 2)
    energy_rows = launch.scratch(batch, height, 2)
    launch.run(*launch.put(images.copy()), clip, radius, found, rows, energy_rows, correlation, energy)
    correlation, energy = launch.results()
    return correlation, energy


@any_arrays
def surface_peak(
    surface: Floats, smoother: Floats, *, backend: str = "auto", device: str | None = None
) -> Floats:
    """Find the highest interior point of surfaces, blurred, to a fraction of a step.

    Parameters
    ----------
    surface : (B, N, N)    N odd and at least 3
    smoother : (N, N)      blurs along either axis

    Returns
    -------
    (B, 3)   x and y from the middle, and the blurred surface's value at the entry nearest to them
    """
    checks = ArrayChecks()
    checks.floats("surface", surface, "B", "N", "N")
    checks.floats("smoother", smoother, "N", "N")
    batch, size, _ = surface.shape
    if size < 3 or size % 2 == 0:
        raise ValueError(f"surface must have an odd size of at least 3, got {size}")
    launch = Launch("surface_peak", checks, backend, device)
    scratch = launch.scratch(batch, size, size), launch.scratch(batch, size, size)
    launch.run(*launch.put(surface, smoother), *scratch, launch.result(None, batch, 3))
    return launch.results()[0]


@any_arrays
def clip_outliers(
    image: Floats, *, factor: float, backend: str = "auto", device: str | None = None
) -> tuple[Floats, Floats]:
    """Clip images at a multiple of the mean magnitude of what is not 0 in them.

    Parameters
    ----------
    image : (B, Y, X)
    factor              of the mean magnitude, at least 0

    Returns
    -------
    (B, Y, X)
    (B,)        how many pixels of each image are not 0
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.at_least("factor", factor, 0.0)
    launch = Launch("clip_outliers", checks, backend, device)
    batch, height, _ = image.shape
    scratch = launch.scratch(batch, height, 2), launch.scratch(batch)
    busy, clipped = launch.result(None, batch), launch.result(None, *image.shape)
    launch.run(*launch.put(image), factor, *scratch, busy, clipped)
    busy, clipped = launch.results()
    return clipped, busy


@any_arrays
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


@any_arrays
def mix_images(images: Floats, weight: Floats, *, backend: str = "auto", device: str | None = None) -> Floats:
    """Make weighted sums of images.

    The adjoint in the images is the operation itself, with the weights transposed.

    Parameters
    ----------
    images : (K, Y, X)
    weight : (N, K)

    Returns
    -------
    (N, Y, X)   image n is the sum of weight(n, k) times image k
    """
    checks = ArrayChecks()
    checks.floats("images", images, "K", "Y", "X")
    checks.floats("weight", weight, "N", "K")
    _, height, width = images.shape
    # the last columns may be computed for nothing: kernels work on at least sixteen neighbours
    images = np.pad(images, ((0, 0), (0, 0), (0, max(0, 16 - width))))
    launch = Launch("mix_images", checks, backend, device)
    launch.run(*launch.put(images, weight), launch.result(None, len(weight), height, images.shape[2]))
    return np.ascontiguousarray(launch.results()[0][:, :, :width])


@any_arrays
def correlate_templates(
    image: Floats,
    busy: Floats,
    basis: Floats,
    mix: Floats,
    spans: Ints,
    *,
    quiet: float,
    least: float = 0.0,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:
    """Correlate an image with a bank of templates, normalised by the energy under them; keep the best.

    Parameters
    ----------
    image : (B, Y, X)
    busy : (B,)         pixels that the energy of the image is spread over
    basis : (N, N, 5)   orthonormal
    mix : (A, 5)        mixture of the basis that each of A templates is, no longer than 1
    spans : (N, 2)      in each column of a template the first row that counts, and the one behind the last
    quiet               energy, relative to that of busy pixels, up to which a place is quiet: 0
    least               magnitude below which a response is 0

    Returns
    -------
    (B, Y - N + 1, X - N + 1), the same in int32   response, its sign kept, and the index of its template
    """
    checks = ArrayChecks()
    checks.floats("image", image, "B", "Y", "X")
    checks.floats("busy", busy, "B")
    checks.floats("basis", basis, "N", "N", 5)
    checks.floats("mix", mix, "A", 5)
    checks.ints("spans", spans, "N", 2)
    checks.at_least("quiet", quiet, 0.0)
    checks.at_least("least", least, 0.0)
    n, (batch, height, width) = len(spans), image.shape
    if n and not (spans.min() >= 0 and spans.max() <= n and (spans[:, 0] <= spans[:, 1]).all()):
        raise ValueError(f"spans must be 0 to {n} and not decrease, got {spans.min()} to {spans.max()}")
    # the last columns may be computed for nothing: kernels work on at least four neighbours
    wide, tall = max(4, width - n + 1), max(0, height - n + 1)
    image = np.pad(image, ((0, 0), (0, 0), (0, wide - (width - n + 1))))
    launch = Launch("correlate_templates", checks, backend, device)
    shape = (batch, tall, wide)
    response, angle = launch.result(None, *shape), launch.result(None, *shape, dtype=np.int32)
    launch.run(
        *launch.put(image, busy, basis, mix, spans),
        quiet,
        least,
        launch.scratch(batch, height + 1, image.shape[2]),
        launch.scratch(batch),
        launch.scratch(batch, 6, tall, wide),
        response,
        angle,
    )
    response, angle = launch.results()
    keep = max(0, width - n + 1)
    return np.ascontiguousarray(response[:, :, :keep]), np.ascontiguousarray(angle[:, :, :keep])


@any_arrays
def local_maxima(
    response: Floats,
    angle: Ints,
    *,
    least: float,
    cell: float,
    size: float,
    turn: float,
    most: int = 8,
    backend: str = "auto",
    device: str | None = None,
) -> Floats:
    """Find the local maxima and minima of a response in the interior of a level.

    Parameters
    ----------
    response, angle : (B, Y, X)   Y and X at least 3; ``angle`` is int32
    least                         magnitude that a maximum exceeds, at least 0
    cell                          size of an entry [px]
    size                          written to the maxima: what the level stands for [px]
    turn                          angle of one step of ``angle`` [rad]
    most                          maxima kept of a row, the strongest

    Returns
    -------
    (B, Y, most, 5)   response, x, y [px], size, angle [rad]; response 0 where there is none
    """
    checks = ArrayChecks()
    checks.floats("response", response, "B", "Y", "X")
    checks.ints("angle", angle, "B", "Y", "X")
    for name, value in (("least", least), ("cell", cell), ("size", size)):
        checks.at_least(name, value, 0.0)
    checks.at_least("most", most, 1)
    batch, height, width = response.shape
    if min(height, width) < 3:
        raise ValueError(f"response must have at least 3 rows and columns, got {height} and {width}")
    launch = Launch("local_maxima", checks, backend, device)
    out = launch.result(None, batch, height, most, 5)
    launch.run(*launch.put(response, angle), least, cell, size, turn, out)
    return launch.results()[0]


@any_arrays
def merge_maxima(
    maxima: Floats,
    *,
    apart: float,
    log_ratio: float,
    most: int,
    backend: str = "auto",
    device: str | None = None,
) -> Floats:
    """Keep the strongest maxima, best first, one a place and size.

    Parameters
    ----------
    maxima : (B, N, 5)   of `local_maxima`
    apart                distance within which a weaker one of the same sign is left out [its sizes]
    log_ratio            |log| of the ratio of sizes from which on two are different
    most                 kept

    Returns
    -------
    (B, most, 5)   as the maxima; response 0 behind the last
    """
    checks = ArrayChecks()
    checks.floats("maxima", maxima, "B", "N", 5)
    checks.at_least("apart", apart, 0.0)
    checks.at_least("log_ratio", log_ratio, 0.0)
    checks.at_least("most", most, 1)
    launch = Launch("merge_maxima", checks, backend, device)
    batch, count, _ = maxima.shape
    index = launch.backend.empty((batch, count), np.int32, launch.device)
    out = launch.result(None, batch, most, 5)
    launch.run(*launch.put(maxima), apart, log_ratio, launch.scratch(batch, count), index, out)
    return launch.results()[0]


@any_arrays
def match_corners(
    peaks: Floats, tolerances: Floats, *, most: int = 8, backend: str = "auto", device: str | None = None
) -> Floats:
    """Find triples of peaks that make the corners of a code.

    Parameters
    ----------
    peaks : (B, P, 5)    of `merge_maxima`
    tolerances : (5,)    |log| of the ratio of the legs; |log| of sizes; angles [rad]; logarithms of the
                         fewest and the most modules between the finder patterns of a code
    most                 kept of a corner, the best

    Returns
    -------
    (B, P, most, 4)   for each peak as the corner: sum of the three |responses|, index of the peak along u,
                      of the one along v, and log modules between them; best first, 0 where there is none
    """
    checks = ArrayChecks()
    checks.floats("peaks", peaks, "B", "P", 5)
    checks.floats("tolerances", tolerances, 5)
    checks.at_least("most", most, 1)
    launch = Launch("match_corners", checks, backend, device)
    batch, count, _ = peaks.shape
    ends = launch.backend.empty((batch, count, count), np.int32, launch.device)
    out = launch.result(None, batch, count, most, 4)
    launch.run(*launch.put(peaks, tolerances), ends, launch.scratch(batch, count, count, 3), out)
    return launch.results()[0]
