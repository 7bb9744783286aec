"""Which code runs the kernels: the interface of a backend, and the registry that loads one on demand.

A backend is unchecked and writes into buffers that the caller owns: the hot path.  ``evqr_kernels.ops`` is
the other door, which checks and may allocate.
"""

from __future__ import annotations

import importlib
import logging
import threading
from collections.abc import Callable
from typing import Any, Protocol

from numpy.typing import DTypeLike, NDArray

from evqr_kernels.config import DEFAULT_KERNELS, KernelSet, SplatConfig

AUTO = "warp"
"""What "auto" stands for: compiled kernels on every CPU, and on NVIDIA GPUs.  There is no silent second
choice."""

Array = Any
"""An array of the backend's own kind: NumPy's, Warp's, ..."""

_log = logging.getLogger(__name__)


class KernelBackend(Protocol):
    """What every backend offers.  Shapes and units are those of the functions in `evqr_kernels.ops`.

    Outputs come last and end in ``_out`` (overwritten, unless the method says that it accumulates) or
    ``_inout``; those called rows, chunks or scratch hold partial sums, so that no result depends on the order
    of threads.
    """

    name: str

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that this machine has; "cpu" first."""
        ...

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, device: str) -> Array:
        """Make an array with undefined contents."""
        ...

    def from_host(self, array: NDArray[Any], device: str) -> Array:
        """Bring a C-contiguous NumPy array to the device; on the CPU it is the same memory."""
        ...

    def to_host(self, array: Array) -> NDArray[Any]:
        """Bring an array back; on the CPU it is the same memory.  Waits for the device."""
        ...

    def assign(self, array: Array, values: NDArray[Any]) -> None:
        """Copy a NumPy array of the same shape and dtype into an array."""
        ...

    def clear(self, array: Array) -> None:
        """Fill an array with zeros."""
        ...

    def record(self, run: Callable[[], None]) -> Callable[[], None]:
        """Note down what ``run``, made of this backend's operations and `clear`, launches, launching nothing.

        The result launches it all on the same arrays, as often as it is called, with little to do between
        launches.  Several threads may record and replay at once.  Keep it for as long as a graph lives that
        it was captured in.
        """
        ...

    def synchronize(self, device: str) -> None:
        """Wait for everything launched on the device."""
        ...

    def supports(self, op: str, dtype: DTypeLike, device: str) -> str | None:
        """None when the operation can run, otherwise the reason why not."""
        ...

    def needs_compile(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> bool:
        """Whether some of the kernels are not yet in this machine's cache, so that `load` takes seconds."""
        ...

    def load(self, device: str = "cpu", kernels: KernelSet = DEFAULT_KERNELS) -> None:
        """Compile or load kernels (float32); call it before threads start."""
        ...

    def bin_events(
        self, x: Array, y: Array, weight: Array, window_ptr: Array, reduction: float, image_out: Array
    ) -> None:
        """Count events into pixels of ``reduction`` px; accumulates.

        The last entry of ``window_ptr`` may be less than E: what is behind it belongs to no window.
        """
        ...

    def splat_events(
        self, x: Array, y: Array, t: Array, weight: Array, window_ptr: Array, motion: Array, lag: Array,
        frame: Array, image_out: Array, cfg: SplatConfig,
    ) -> None:  # fmt: skip
        """Scatter transported events as splats; accumulates."""
        ...

    def splat_events_adjoint(
        self, x: Array, y: Array, t: Array, weight: Array, window_ptr: Array, motion: Array, lag: Array,
        frame: Array, adj_image: Array, chunks_out: Array, adj_weight_out: Array, adj_motion_out: Array,
        cfg: SplatConfig,
    ) -> None:  # fmt: skip
        """Adjoint of `splat_events` in weight and motion (B, P); ``chunks_out`` is (B, any chunks, P)."""
        ...

    def deposit_events(
        self, x: Array, y: Array, t: Array, weight: Array, window_ptr: Array, motion: Array, frame: Array,
        deposit_out: Array,
    ) -> None:  # fmt: skip
        """Share transported events among four cells each, ON and OFF apart (B, 2, Y, X); accumulates.

        The last entry of ``window_ptr`` may be less than E, as with `bin_events`.
        """
        ...

    def deposit_events_adjoint(
        self, x: Array, y: Array, t: Array, weight: Array, window_ptr: Array, motion: Array, frame: Array,
        adj_deposit: Array, adj_weight_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `deposit_events` in the weights."""
        ...

    def lag_operator(
        self, deposit: Array, deposit_idx: Array, direction: Array, lag: Array, taps: Array, rows_out: Array,
        image_out: Array,
    ) -> None:  # fmt: skip
        """Blur deposits and undo the pixels' lag; ``rows_out`` is (N, 2, Y, X), X at least 16 + taps."""
        ...

    def lag_operator_adjoint(
        self, deposit_idx: Array, direction: Array, lag: Array, taps: Array, adj_image: Array,
        rows_out: Array, adj_deposit_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `lag_operator` in the deposit; ``rows_out`` is (N, 2, Y, X)."""
        ...

    def motion_correlation(
        self, images_inout: Array, clip: float, radius: int, found_out: Array, rows_out: Array,
        energy_rows_out: Array, correlation_out: Array, energy_out: Array,
    ) -> None:  # fmt: skip
        """Correlate pairs of images (B, 2, Y, X) over shifts, clipping them in place.

        ``found_out``, int32, is (B, Y, X), ``rows_out`` (B, Y, 2 R + 1, W) with W the next multiple of 16 of
        2 R + 1, ``energy_rows_out`` (B, Y, 2).
        """
        ...

    def surface_peak(
        self, surface: Array, smoother: Array, rows_out: Array, smooth_out: Array, peak_out: Array
    ) -> None:
        """Find the highest point of blurred surfaces; ``rows_out`` and ``smooth_out`` are as the surface."""
        ...

    def clip_outliers(
        self, image: Array, factor: float, rows_out: Array, limit_out: Array, busy_out: Array,
        image_out: Array,
    ) -> None:  # fmt: skip
        """Clip at a multiple of the mean magnitude; ``rows_out`` is (B, Y, 2), ``limit_out`` (B,)."""
        ...

    def reduce_image(self, image: Array, ratio: float, rows_out: Array, image_out: Array) -> None:
        """Sum an image (B, Y, X) over coarser pixels; ``rows_out`` is (B, coarse Y, X)."""
        ...

    def mix_images(self, images: Array, weight: Array, images_out: Array) -> None:
        """Weighted sums of K images (K, Y, X), N of them; X is at least 16."""
        ...

    def correlate_templates(
        self, image: Array, busy: Array, basis: Array, mix: Array, spans: Array, quiet: float, least: float,
        squares_out: Array, floor_out: Array, sums_out: Array, response_out: Array, angle_out: Array,
    ) -> None:  # fmt: skip
        """Correlate with n x n templates; image = response + n - 1, response at least 4 wide.

        ``squares_out`` is as the image with one more row, ``floor_out`` (B,), ``sums_out`` (B, 6, rows and
        columns of the response).
        """
        ...

    def local_maxima(
        self, response: Array, angle: Array, least: float, cell: float, size: float, turn: float,
        maxima_out: Array,
    ) -> None:  # fmt: skip
        """Find the local maxima of one level; ``maxima_out`` is (B, Y, most of a row, 5)."""
        ...

    def merge_maxima(
        self, maxima: Array, apart: float, log_ratio: float, strength_out: Array, index_out: Array,
        peaks_out: Array,
    ) -> None:  # fmt: skip
        """Keep the best of N maxima (B, N, 5); ``strength_out`` and ``index_out``, int32, are (B, N)."""
        ...

    def match_corners(
        self, peaks: Array, tolerances: Array, ends_out: Array, legs_out: Array, triples_out: Array
    ) -> None:
        """Triples of P peaks; ``ends_out``, int32, is (B, P, P), ``legs_out`` (B, P, P, 3)."""
        ...

    def sample_moments(
        self, image: Array, image_idx: Array, pose: Array, active: Array, points: Array, table: Array,
        chunks_out: Array, moments_out: Array,
    ) -> None:  # fmt: skip
        """Moments of images seen through poses; ``chunks_out`` is (N, any number of chunks, C + 1)."""
        ...

    def sample_moments_adjoint(
        self, image: Array, image_idx: Array, pose: Array, active: Array, points: Array, table: Array,
        adj_moments: Array, adj_image_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `sample_moments` in the image; accumulates."""
        ...

    def align_poses(
        self, image: Array, image_idx: Array, points: Array, table: Array, gram: Array, terms: Array,
        factors: Array, settings: Array, max_iterations: int, pose_inout: Array, result_out: Array,
    ) -> None:  # fmt: skip
        """Gauss-Newton on poses; result (N, 5).

        ``settings``: centre along u and v, scale along u and v, ridge, damping, tolerance.
        """
        ...

    def code_rhs(
        self, image: Array, pose: Array, lattice_u: Array, lattice_v: Array, profile: Array, slope: Array,
        gain: Array, samples_a_module: int, samples_out: Array, rows_out: Array, rhs_out: Array,
    ) -> None:  # fmt: skip
        """Right-hand side of stage two; ``samples_out`` is (B, T, S), ``rows_out`` (B, 2, T, U)."""
        ...

    def pose_normal_equations(
        self, moments: Array, gram: Array, terms: Array, factors: Array, ridge: float, gain_out: Array,
        matrix_out: Array, rhs_out: Array,
    ) -> None:  # fmt: skip
        """Gain (N, 2), matrix (N, n, n) and right-hand side (N, n) of a step on poses, from moments."""
        ...

    def code_normal_equations(
        self, image: Array, pose: Array, lattice_u: Array, lattice_v: Array, profile: Array, slope: Array,
        gain: Array, samples_a_module: int, samples_out: Array, rows_out: Array, stencil_out: Array,
        rhs_out: Array,
    ) -> None:  # fmt: skip
        """Stencil of A^T A, and A^T E with scratch as in `code_rhs`."""
        ...

    def code_product(self, q: Array, stencil: Array, damping: Array, free: Array, product_out: Array) -> None:
        """Product (stencil + damping I) q on the free modules, 0 elsewhere."""
        ...

    def solve_code_banded(
        self, rhs: Array, stencil: Array, damping: Array, free: Array, band_out: Array, q_inout: Array
    ) -> None:
        """Banded Cholesky over free modules.

        ``band_out`` is (B, V U, (K // 2) (M + 1) + 1), with M the lesser of V and U.
        """
        ...

    def pull_modules(
        self, seen: Array, q: Array, damping: Array, certainty: float, rhs_out: Array, unclear_out: Array
    ) -> None:
        """Right-hand side whose damping pulls to dark or light; ``unclear_out`` is (B, V) int32."""
        ...

    def solve_code(
        self, rhs: Array, stencil: Array, damping: Array, free: Array, q_inout: Array,
        scratch: tuple[Array, ...], iterations_out: Array, *, max_iterations: int, tolerance: float,
    ) -> None:  # fmt: skip
        """Conjugate gradients over free modules; ``scratch`` is four (B, V, U) and two (B, 4, V)."""
        ...

    def render_code(
        self, grid: Array, to_grid: Array, outside: Array, sigma: float, image_out: Array
    ) -> None:
        """Image of a grid under an affine map (B, 6) or a homography (B, 8); bilinear with ``sigma`` 0."""
        ...

    def render_code_adjoint(
        self, grid: Array, to_grid: Array, outside: Array, sigma: float, adj_image: Array, rows_out: Array,
        adj_grid_out: Array, adj_to_grid_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `render_code` in grid and map (B, P); ``rows_out`` is (B, Y, P)."""
        ...

    def brightness_residual(
        self, luminance: Array, events_image: Array, motion: Array, residual_out: Array
    ) -> None:
        """Slope of the luminance along the motion, plus the events' image."""
        ...

    def brightness_residual_adjoint(
        self, luminance: Array, motion: Array, adj_residual: Array, rows_out: Array, adj_luminance_out: Array,
        adj_motion_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `brightness_residual` in luminance and motion; ``rows_out`` is (B, Y, 2)."""
        ...

    def brightness_cost(
        self, luminance: Array, events_image: Array, motion: Array, mask: Array, rows_out: Array,
        cost_out: Array,
    ) -> None:  # fmt: skip
        """Half the weighted sum of squared residuals (B,); ``rows_out`` is (B, Y)."""
        ...

    def brightness_cost_adjoint(
        self, luminance: Array, events_image: Array, motion: Array, mask: Array, adj_cost: Array,
        rows_out: Array, adj_luminance_out: Array, adj_events_out: Array, adj_motion_out: Array,
    ) -> None:  # fmt: skip
        """Adjoint of `brightness_cost` in all but the mask; ``rows_out`` is (B, Y, 2)."""
        ...


OPS = (
    "bin_events",
    "splat_events",
    "splat_events_adjoint",
    "deposit_events",
    "deposit_events_adjoint",
    "lag_operator",
    "lag_operator_adjoint",
    "motion_correlation",
    "surface_peak",
    "clip_outliers",
    "reduce_image",
    "mix_images",
    "correlate_templates",
    "local_maxima",
    "merge_maxima",
    "match_corners",
    "sample_moments",
    "sample_moments_adjoint",
    "align_poses",
    "pose_normal_equations",
    "code_rhs",
    "code_normal_equations",
    "code_product",
    "pull_modules",
    "solve_code",
    "solve_code_banded",
    "render_code",
    "render_code_adjoint",
    "brightness_residual",
    "brightness_residual_adjoint",
    "brightness_cost",
    "brightness_cost_adjoint",
)
"""Names of the operations: the methods of a backend that compute."""


class BackendUnavailable(ImportError):
    """A backend that is known but cannot be loaded here; the message carries the cause and the remedy."""


_targets = {
    "numpy": "evqr_kernels.numpy_backend:load",
    "warp": "evqr_kernels.warp_backend:load",
    "taichi": "evqr_kernels.taichi_backend:load",
}
_extras = {"warp": "evqr", "taichi": "evqr[taichi]"}
_loaded: dict[str, KernelBackend] = {}
_lock = threading.RLock()  # what makes a backend may ask for another


def register_backend(name: str, target: str) -> None:
    """Add or replace a backend.

    Parameters
    ----------
    name
        What `get_backend` shall know it by; "auto" is taken.
    target
        ``"module:attribute"``, imported when the backend is first asked for; the attribute is called without
        arguments and returns a `KernelBackend`.

    Raises
    ------
    ValueError
        If the name is "auto" or the target is not of that form.
    """
    module, colon, attribute = target.partition(":")
    if name == "auto":
        raise ValueError("name must not be 'auto'")
    if not (module and colon and attribute):
        raise ValueError(f"target must be 'module:attribute', got {target!r}")
    with _lock:
        _targets[name] = target
        _loaded.pop(name, None)


def backend_names() -> tuple[str, ...]:
    """Names that `get_backend` knows, whether or not they can be loaded here."""
    return tuple(_targets)


def get_backend(name: str = "auto") -> KernelBackend:
    """Load a backend by name, once; "auto" is `AUTO`.  A named backend never falls back to another.

    Raises
    ------
    ValueError
        If the name is not registered.
    BackendUnavailable
        If the backend cannot be imported here, or its target names nothing to call.
    """
    if name == "auto":
        name = AUTO
        if name not in _loaded:
            _log.info("backend 'auto' is %r", name)
    with _lock:
        if name not in _targets:
            raise ValueError(f"backend must be one of {', '.join(('auto', *_targets))}, got {name!r}")
        if name not in _loaded:
            _loaded[name] = _load(name)
        return _loaded[name]


def _load(name: str) -> KernelBackend:
    module, _, attribute = _targets[name].partition(":")
    try:
        make: Callable[[], KernelBackend] | None = getattr(importlib.import_module(module), attribute, None)
        if not callable(make):
            raise ImportError(f"{_targets[name]!r} names nothing to call", name=module)
        return make()
    except ImportError as error:
        if error.name == module:
            remedy = "this version does not contain it"
        elif name in _extras:
            remedy = f'install it with: pip install "{_extras[name]}"'
        else:
            remedy = f"it is registered as {_targets[name]!r}"
        raise BackendUnavailable(
            f"backend {name!r} cannot be loaded ({type(error).__name__}: {error}); {remedy}",
            name=error.name,
            path=error.path,
        ) from error


def require_device(backend: KernelBackend, device: str) -> None:
    """Raise ValueError, with the devices there are, unless the backend has this one."""
    if device not in backend.devices():
        raise ValueError(
            f"device of {backend.name} must be one of {', '.join(backend.devices())}, got {device!r}"
        )
