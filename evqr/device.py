"""Where to compute: the kernels of a backend, on a device that is there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evqr.errors import BackendError

if TYPE_CHECKING:
    from evqr_kernels import KernelBackend


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
    from evqr_kernels.errors import BackendUnavailable
    from evqr_kernels.registry import get_backend, require_device

    try:
        kernels = get_backend(backend)
        require_device(kernels, device)
    except (BackendUnavailable, ValueError) as error:
        raise BackendError(str(error)) from error
    return kernels
