"""Starting Taichi: one runtime a process, on one device.

A runtime that the user has started is used as it is; without one, the first use of a device starts it there.
It is never replaced: that would make the user's arrays, and ours, unreadable.
"""

import contextlib
import io
import logging
import os
from functools import cache

from evqr_kernels.errors import BackendUnavailable
from evqr_kernels.native_output import without_lines
from evqr_kernels.own_directory import own_directory, why_not_writable
from evqr_kernels.taichi_backend.language import environment, ti
from evqr_kernels.taichi_backend.launches import LOCK, compile_kernel, require_own_runtime
from evqr_kernels.taichi_backend.sums import make_add_partials

PLACE = "TI_OFFLINE_CACHE_FILE_PATH"
"""The environment variable that says where Taichi keeps compiled kernels."""

_log = logging.getLogger(__name__)

_DEVICES = {"cpu": "cpu", "cuda:0": "cuda", "vulkan": "vulkan", "metal": "metal"}
"""What Taichi calls a device."""

_NAMES = {ti.x64: "cpu", ti.arm64: "cpu", ti.cuda: "cuda:0"}
"""Names of architectures that are not their own."""

_NOISE = b"libcuda.so lib not found", b"RHI Error: Can not create Vulkan instance"


def running_on() -> str | None:
    """Name the device of this process's runtime; None where there is none yet."""
    config = ti.cfg
    if config is None:
        return None
    arch = config.arch
    return _NAMES[arch] if arch in _NAMES else arch.name


@cache
def devices() -> tuple[str, ...]:
    """Names of the devices that this machine has; "cpu" first."""
    with LOCK, without_lines(*_NOISE):
        return tuple(
            name for name, arch in _DEVICES.items() if ti.lang.misc.is_arch_supported(getattr(ti, arch))
        )


def require(device: str) -> None:
    """Start Taichi on a device, unless it runs there; raise ValueError where it cannot.

    Any thread may compile kernels once the one that started Taichi has compiled one.
    """
    require_own_runtime()
    with LOCK:
        found = running_on()
        if found is None:
            _start(device)
        elif found != device:
            raise ValueError(
                f"device must be {found!r}, where this process's Taichi runs, got {device!r}: "
                "Taichi has one device a process"
            )


@cache
def has_float64(device: str) -> bool:
    """Whether a device computes in float64, which GPUs with Vulkan or Metal need not; starts Taichi there.

    Taichi tells by refusing to compile.
    """
    if device == "cpu" or device.startswith("cuda"):
        return True
    require(device)
    try:
        compile_kernel(make_add_partials(ti.f64))
    except RuntimeError:
        return False
    return True


@cache
def cache_dir() -> str:
    """Give the directory where Taichi keeps compiled kernels, another than its own where that is read-only.

    Raises
    ------
    BackendUnavailable
        There is none that can be written: Taichi would end in a crash.
    """
    wanted = os.environ.get(PLACE) or os.path.expanduser("~/.cache/taichi/ticache")
    with contextlib.suppress(OSError):
        os.makedirs(wanted, exist_ok=True)
    why = why_not_writable(wanted)
    if why is None:
        return wanted
    advice = f"set {PLACE} to a directory that can be written"
    try:
        place = os.path.join(own_directory(), "taichi")
        os.makedirs(place, exist_ok=True)
    except OSError as error:
        raise BackendUnavailable(
            f"compiled kernels of Taichi cannot be kept in {wanted} ({why.strerror or why}), nor among"
            f" temporary files; {advice}"
        ) from error
    _log.warning(
        "%s cannot be written (%s): compiled kernels of Taichi are kept in %s; to keep them, %s",
        wanted, why.strerror or why, place, advice,
    )  # fmt: skip
    return place


def _start(device: str) -> None:
    if device not in devices():
        raise ValueError(f"device of taichi must be one of {', '.join(devices())}, got {device!r}")
    with environment(TI_SKIP_VERSION_CHECK="ON"), contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=getattr(ti, _DEVICES[device]),
            enable_fallback=False,
            fast_math=False,  # which takes for granted that no coordinate is NaN
            offline_cache=True,
            offline_cache_file_path=cache_dir(),
            log_level=ti.WARN,
            unrolling_limit=0,  # no warning of a wide splat's many taps
        )
    if running_on() != device:
        raise RuntimeError(f"Taichi was asked to run on {device!r} and runs on {running_on()!r}")
    compile_kernel(make_add_partials(ti.f32))
