"""Array-in, array-out kernels for event cameras and planar codes.

Two doors: the functions of `evqr_kernels.ops`, which are here too, check their arguments and may allocate;
the methods of `get_backend` with the same names write to buffers that you own, unchecked.  Importing the
package loads no backend.
"""

# ruff: noqa: F403
from evqr_kernels import ops
from evqr_kernels.backend import KernelBackend
from evqr_kernels.call import make_scratch
from evqr_kernels.config import SplatConfig
from evqr_kernels.errors import BackendUnavailable, KernelError, OperationRefused
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.ops import *
from evqr_kernels.registry import backend_names, get_backend, register_backend

__all__ = [
    "OPERATIONS",
    "BackendUnavailable",
    "KernelBackend",
    "KernelError",
    "OperationRefused",
    "SplatConfig",
    "backend_names",
    "get_backend",
    "make_scratch",
    "register_backend",
]
__all__ += ops.__all__
