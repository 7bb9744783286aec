"""Array-in, array-out kernels for event cameras and planar codes.

Two doors: the functions of `evqr_kernels.ops`, which are here too, check their arguments and may allocate;
the methods of `get_backend` with the same names write to buffers that you own, unchecked.  Importing the
package loads no backend; it imports and runs on NumPy and Warp alone.

**What stays.**  Public are the names here, the functions of `evqr_kernels.torch` and `evqr_kernels.jax`,
`evqr_kernels.interop`, and the attributes that they document.  What a call with names for its optional
arguments gives stays, to rounding, while the first number of `__version__` that is not 0 does; new optional
arguments, operations and variants may come at any time, and a name that goes warns for one such number
before.  The rest may change: the arguments of launchers (the table tells them), scratch, variants, and the
modules of backends.
"""

# what is taken is what __all__ of each module lists
# ruff: noqa: F403
from __future__ import annotations

from typing import Any

from evqr_kernels import ops
from evqr_kernels.backend import KernelBackend
from evqr_kernels.call import make_scratch
from evqr_kernels.config import SplatConfig
from evqr_kernels.errors import BackendUnavailable, KernelError, OperationRefused
from evqr_kernels.event_columns import Columns, columns
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.ops import *
from evqr_kernels.registry import backend_names, get_backend, register_backend

__all__ = [
    "OPERATIONS",
    "BackendUnavailable",
    "Columns",
    "KernelBackend",
    "KernelError",
    "OperationRefused",
    "SplatConfig",
    "backend_names",
    "columns",
    "get_backend",
    "make_scratch",
    "register_backend",
]
__all__ += ops.__all__

__version__: str


def __getattr__(name: str) -> Any:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # here: it takes longer than all the rest

    from evqr_kernels.extras import DISTRIBUTION

    return version(DISTRIBUTION)
