"""Checked functions from images to motion and to places of templates."""

from __future__ import annotations

from evqr_kernels.call import checked
from evqr_kernels.checks import Floats, Ints

__all__ = [
    "clip_outliers",
    "correlate_templates",
    "line_runs",
    "local_maxima",
    "match_corners",
    "merge_maxima",
    "mix_images",
    "motion_correlation",
    "reduce_image",
    "surface_peak",
]


@checked
def motion_correlation(
    images: Floats,
    quiet: Floats | None = None,
    *,
    radius: int,
    clip: float,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Floats]:
    """Correlate pairs of images, clipped, over a square of shifts.

    Parameters
    ----------
    images : (B, 2, Y, X) float [weight]
        The first and the second of each pair; they are left as they are.
    quiet : (B, 2) float [weight^2]
        Least and greatest sum of the squares of a pair, before clipping, that is not worth while: its
        correlation is 0. Default: 0 and 0.
    radius : int [px]
        R, the largest shift along an axis.
    clip : float [weight]
        Magnitude at which values are clipped.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    correlation : (B, 2 R + 1, 2 R + 1) float [weight^2]
        Entry (j, i) is the sum of first(y, x) second(y + j - R, x + i - R).
    energy : (B, 2) float [weight^2]
        Sums of the squares of the two images, clipped.

    Raises
    ------
    ValueError
        If ``radius`` or ``clip`` is less than 0.

    See Also
    --------
    surface_peak

    Notes
    -----
    Cost: (2 R + 1)^2 multiply-adds for each pixel of the first image that is not 0, then Y (2 R + 1)^2
    additions; four passes, of which quiet pairs take two.  Scratch: a copy of the images, (B, Y, X) int32,
    (B, Y, 2 R + 1, 2 R + 1 up to a multiple of 16), (B, Y, 4) and (B,) int32.

    Determinism: bit for bit.
    """
    ...


@checked
def surface_peak(surface: Floats, *, half: float, backend: str = "auto", device: str | None = None) -> Floats:
    """Find the highest point of surfaces, blurred, to a fraction of a step.

    Parameters
    ----------
    surface : (B, N, N) float [any]
        N odd and at least 3.
    half : float [steps]
        Half width of the window that blurs, 1 to (N + 1) / 2. Of one that is whole or half a step the windows
        around all points weigh alike.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    peak : (B, 3) float [steps, steps, of surface]
        x and y from the middle entry, and the blurred surface there.

    Raises
    ------
    ValueError
        If N is even or less than 3, or ``half`` is out of its range.

    See Also
    --------
    motion_correlation

    Notes
    -----
    Points whose window hangs over the border are not looked at: what is seen of a peak on one side only would
    move it.  The middle entry, which says more of the pixels than of the motion, is taken to be what lies as
    far on the other side of a peak that is a step away or more; to find it, the mean of the four neighbours
    where it is below them.

    Cost: 4 N^2 ``half`` multiply-adds a surface and some 10 ``half`` sines, by one thread; scratch of
    (B, N, N).

    Determinism: bit for bit.
    """
    ...


@checked
def clip_outliers(
    image: Floats, *, factor: float, backend: str = "auto", device: str | None = None
) -> tuple[Floats, Floats]:
    """Clip images at a multiple of the mean magnitude of what is not 0 in them.

    Parameters
    ----------
    image : (B, Y, X) float [any]
        The images.
    factor : float [1]
        How many times the mean magnitude values are clipped at.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    clipped : (B, Y, X) float [of image]
        The images, clipped.
    busy : (B,) float [px]
        How many pixels of each image are not 0.

    Raises
    ------
    ValueError
        If ``factor`` is less than 0.

    See Also
    --------
    correlate_templates

    Notes
    -----
    Cost: two reads and a write a pixel, in three passes; scratch of (B, Y, 2) and (B,).

    Determinism: bit for bit.
    """
    ...


@checked
def reduce_image(image: Floats, *, ratio: float, backend: str = "auto", device: str | None = None) -> Floats:
    """Sum an image over coarser pixels, with fractional coverage at their borders.

    Parameters
    ----------
    image : (B, Y, X) float [any]
        The fine images.
    ratio : float [px]
        Side of a coarse pixel in fine ones.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    coarse : (B, ceil(Y / ratio), ceil(X / ratio)) float [of image]
        The coarse images: sums, not means.

    Raises
    ------
    ValueError
        If ``ratio`` is less than 1.

    Notes
    -----
    Cost: at most two multiply-adds a fine pixel down columns, then about ``ratio`` + 1 a coarse pixel along
    rows, by one thread a coarse row; scratch of (B, ceil(Y / ratio), X).

    Determinism: bit for bit.
    """
    ...


@checked
def mix_images(
    images: Floats, weight: Floats, *, image_idx: Ints | None = None, backend: str = "auto",
    device: str | None = None,
) -> Floats:  # fmt: skip
    """Make weighted sums of images.

    The adjoint in the images is the operation itself, with the weights transposed.

    Parameters
    ----------
    images : (M, K, Y, X) or (K, Y, X) float [any]
        What is mixed: K images of each of M things, or of one.
    weight : (N, K) float [1]
        How much of each image is in each sum.
    image_idx : (N,) int32
        Whose images each sum is of; by default the first's.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    mixed : (N, Y, X) float [of images]
        Image n is the sum of weight(n, k) times image k of its thing.

    Raises
    ------
    ValueError
        If an entry of ``image_idx`` is not 0 to M - 1.

    Notes
    -----
    Cost: K multiply-adds a pixel of each sum, in one pass; scratch: a copy of the images.

    Determinism: bit for bit.
    """
    ...


@checked
def correlate_templates(
    image: Floats,
    busy: Floats,
    basis: Floats,
    mix: Floats,
    spans: Ints,
    rows: Ints,
    extent: Ints,
    quiet: Floats,
    *,
    first: float = 0.0,
    least: float = 0.0,
    backend: str = "auto",
    device: str | None = None,
) -> tuple[Floats, Ints]:
    """Correlate an image with a bank of templates, normalised by the energy under them; keep the best.

    Parameters
    ----------
    image : (B, Y, X) float [any]
        The images, or K levels of pyramids, one below the other, with N - 1 rows and columns of zeros or more
        between them.
    busy : (B,) float [px]
        Pixels that the energy of the image is spread over: see `clip_outliers`.
    basis : (B, N, N, 5) float [1]
        Five templates, orthonormal, for each image.
    mix : (B, A, 5) float [1]
        Mixture of the basis that each of A templates is, no longer than 1.
    spans : (N, 2) int32
        In each column of a template the first row that counts, and the one behind the last.
    rows : (R, 2) int32
        R = Y - N + 1: of each row of the response the level, or -1, and which row of the level it is, from 0
        on.
    extent : (B, K, 2) int32
        Rows and columns of each level that are the image's own; the rest is not looked at.
    quiet : (K,) float [1]
        Energy, relative to that of busy pixels, up to which a place is quiet: its response is 0.
    first : float [1]
        Magnitude of the first template of the basis, normalised likewise, below which a response is 0.
    least : float [1]
        Magnitude below which a response is 0.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    response : (B, Y - N + 1, X - N + 1) float [1]
        Of the best template at each place within the extent, its sign kept.
    angle : (B, Y - N + 1, X - N + 1) int32
        Index of that template; 0 where the response is 0.

    Raises
    ------
    ValueError
        If ``spans`` are not 0 to N or decrease within a column, ``rows`` or ``extent`` do not lie in the
        response, or ``first`` or ``least`` is less than 0.

    See Also
    --------
    local_maxima

    Notes
    -----
    Cost: one multiply-add a pixel for running sums and 2 N additions a place for its energy; where that is
    not quiet, one multiply-add a place and pixel that counts, of which there are up to N^2; where the first
    template answers, 4 more, and 5 A; five passes.  Places are left out by blocks of 16 on a CPU, of 4 on a
    GPU.  Scratch: a copy of the image,
    (B, Y + 1, X), (B, K), and six of the response's size.

    Determinism: bit for bit.
    """
    ...


@checked
def local_maxima(
    response: Floats,
    angle: Ints,
    rows: Ints,
    extent: Ints,
    levels: Floats,
    origin: Floats,
    *,
    least: float,
    turn: float,
    most: int = 8,
    backend: str = "auto",
    device: str | None = None,
) -> Floats:
    """Find the local maxima and minima of a response in the interior of each level.

    Parameters
    ----------
    response : (B, Y, X) float [any]
        Of K levels, one below the other.
    angle : (B, Y, X) int32
        Index of the template of each response.
    rows : (Y, 2) int32
        Of each row the level, or -1, and which row of the level it is: 0, 1, ...
    extent : (B, K, 2) int32
        Rows and columns of each level that are the image's own; the rest is not looked at.
    levels : (K, 2) float [px]
        Of each level the size of an entry, and what is written to its maxima: what it stands for.
    origin : (B, 2) float [px]
        Outer corner (x, y) of the first entry of every level.
    least : float [of response]
        Magnitude that a maximum exceeds.
    turn : float [rad]
        Angle of one step of ``angle``.
    most : int
        Maxima kept of a row, the strongest.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    maxima : (B, Y, most, 5) float [of response, px, px, px, rad]
        Response, x, y, size and angle, by x; response 0 where there is none.

    Raises
    ------
    ValueError
        If ``rows`` or ``extent`` do not lie in the response, ``least`` is less than 0, or ``most`` less than
        1.

    See Also
    --------
    merge_maxima

    Notes
    -----
    Cost: one read an entry, and nine where its magnitude exceeds ``least``, by one thread a row; no scratch.

    Determinism: bit for bit.
    """
    ...


@checked
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
    maxima : (B, N, 5) float [any, px, px, px, rad]
        Response, x, y, size and angle, as of `local_maxima`; those of response 0 are none.
    apart : float [sizes]
        Distance, in sizes of the stronger one, within which a weaker one of the same sign is left out.
    log_ratio : float [1]
        Logarithm of the ratio of sizes, as a magnitude, from which on two are different.
    most : int
        How many are kept.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    peaks : (B, most, 5) float [of maxima]
        As the maxima; response 0 behind the last.

    Raises
    ------
    ValueError
        If ``apart`` or ``log_ratio`` is less than 0, or ``most`` less than 1.

    See Also
    --------
    match_corners

    Notes
    -----
    Cost: each peak kept looks twice at all maxima that are not 0: at most 2 ``most`` N steps a window, by one
    thread; scratch of (B, N), and (B, N) int32.

    Determinism: bit for bit.
    """
    ...


@checked
def match_corners(
    peaks: Floats, tolerances: Floats, *, most: int = 8, backend: str = "auto", device: str | None = None
) -> Floats:
    """Find triples of peaks that make the corners of a code.

    Parameters
    ----------
    peaks : (B, P, 5) float [any, px, px, px, rad]
        Response, x, y, size and angle, as of `merge_maxima`: none of response 0 before another.
    tolerances : (5,) float [1, 1, rad, 1, 1]
        Logarithm of the ratio of the legs, as a magnitude; the same of sizes; angles; logarithms of the
        fewest and the most modules between two peaks.
    most : int
        Triples kept of a corner, the best.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    triples : (B, P, most, 4) float [any, index, index, 1]
        For each peak as the corner: sum of the three responses' magnitudes, index of the peak along u, of the
        one along v, and logarithm of the modules between them; best first, 0 where there is none.

    Raises
    ------
    ValueError
        If ``most`` is less than 1.

    See Also
    --------
    merge_maxima

    Notes
    -----
    Cost: for each peak P others are tried as the end of a leg, and all pairs of those that may be one: at
    most P^3 steps a window, by one thread a peak; scratch of (B, P, P, 3), and (B, P, P) int32.

    Determinism: bit for bit.
    """
    ...


@checked
def line_runs(
    image: Floats,
    slope: Floats,
    steep: Ints,
    threshold: Floats,
    *,
    most: float,
    lines: int,
    backend: str = "auto",
    device: str | None = None,
) -> Floats:
    """Measure the best run of one sign along each of many straight lines: where an edge may be.

    Parameters
    ----------
    image : (B, Y, X) float [any]
        With edges that are light or dark all along.
    slope : (A,) float [1]
        Of the lines: how y changes with x, or x with y where they are steep.
    steep : (A,) int32
        0 where lines cross the columns of the image, 1 where they cross its rows.
    threshold : (B, A) float [of image]
        Magnitude of an edge of that direction that counts; 0: no run is looked for.
    most : float [1]
        Magnitude beyond which more does not matter, in thresholds.
    lines : int
        Parallel lines, a pixel apart; all that cross the image are Y + X.
    backend, device : str
        See `evqr_kernels.ops`.

    Returns
    -------
    runs : (B, A, 2, lines) float [1]
        Of each line the best light run, and the best dark one: sum of the magnitudes, in thresholds, less 1 a
        step; 0 where there is none.

    Raises
    ------
    ValueError
        If ``most`` or ``lines`` is less than 1.

    See Also
    --------
    local_maxima

    Notes
    -----
    Cost: two pixels and 12 operations a step, of all rows or columns; lines go by 16 on a CPU; no scratch.

    Determinism: bit for bit.
    """
    ...
