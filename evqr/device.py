"""Where to compute: the kernels of a backend, on a device that is there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from evqr.errors import BackendError

if TYPE_CHECKING:
    from evqr_kernels import KernelBackend
    from evqr_kernels.backend import Calls


@contextmanager
def kernels_failing() -> Iterator[None]:
    """Make what kernels say of a backend, a device or a directory for kernels an error of evqr's."""
    from evqr_kernels.errors import BackendUnavailable

    try:
        yield
    except (BackendUnavailable, ValueError) as error:
        raise BackendError(str(error)) from error


def kernels_on(backend: str, device: str) -> KernelBackend:
    """Return the kernels of a backend, once it is sure that they run on a device.

    Parameters
    ----------
    backend : str
        "auto", "warp", "taichi", "numpy", or a registered name.
    device : str
        "cpu", "cuda:0", ...

    Returns
    -------
    kernels : KernelBackend
        Not yet compiled for the device.

    Raises
    ------
    BackendError
        There is no such backend or device here; the message names those that are, or what to install.
    """
    from evqr_kernels.registry import get_backend, require_device

    with kernels_failing():
        kernels = get_backend(backend)
        require_device(kernels, device)
        return kernels


def load(kernels: KernelBackend, device: str, calls: Calls) -> None:
    """Compile or load kernels.

    Parameters
    ----------
    kernels : KernelBackend
        As `kernels_on` gives them.
    device : str
        Where.
    calls : iterable of (str, mapping)
        What is launched, such as `LAUNCHED`.

    Raises
    ------
    BackendError
        They can be kept nowhere; the message says what helps.
    """
    with kernels_failing():
        kernels.load(device, calls)


def cache_of(kernels: KernelBackend) -> str:
    """Name the directory where a backend keeps compiled kernels; "" where it keeps none.

    Parameters
    ----------
    kernels : KernelBackend
        As `kernels_on` gives them.

    Returns
    -------
    directory : str
        Its path.
    """
    named = getattr(type(kernels), "cache_dir", None)
    return "" if named is None else named(kernels)
