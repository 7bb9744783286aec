"""The backends by name: loaded when they are first asked for, once.

A backend named by the caller never falls back to another, and one that cannot be loaded says why.
"""

from __future__ import annotations

import importlib
import logging
import threading
from collections.abc import Callable

from evqr_kernels.backend import KernelBackend
from evqr_kernels.errors import BackendUnavailable
from evqr_kernels.extras import install_command

AUTO = "warp"
"""What "auto" stands for: compiled kernels on every CPU, and on NVIDIA GPUs.  There is no silent second
choice."""

_log = logging.getLogger(__name__)

_targets = {
    "numpy": "evqr_kernels.numpy_backend:load",
    "warp": "evqr_kernels.warp_backend:load",
    "taichi": "evqr_kernels.taichi_backend:load",
}
_extras = {"warp": "", "taichi": "taichi"}
_loaded: dict[str, KernelBackend] = {}
_lock = threading.RLock()  # what makes a backend may ask for another


def register_backend(name: str, target: str) -> None:
    """Add or replace a backend.

    Parameters
    ----------
    name : str
        What `get_backend` shall know it by; "auto" is taken.
    target : str
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
    """Name what `get_backend` knows, whether or not it can be loaded here.

    Returns
    -------
    names : tuple of str
        In the order in which they were registered.
    """
    return tuple(_targets)


def get_backend(name: str = "auto") -> KernelBackend:
    """Load a backend by name, once.  A named backend never falls back to another.

    Parameters
    ----------
    name : str
        A registered one; "auto" is `AUTO`.

    Returns
    -------
    backend : KernelBackend
        The same one every time.

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
    except BackendUnavailable:  # it says what is to be done
        raise
    except ImportError as error:
        if error.name == module:
            remedy = "this version does not contain it"
        elif name in _extras:
            remedy = f"install it with: {install_command(_extras[name])}"
        else:
            remedy = f"it is registered as {_targets[name]!r}"
        raise BackendUnavailable(
            f"backend {name!r} cannot be loaded ({type(error).__name__}: {error}); {remedy}",
            name=error.name,
            path=error.path,
        ) from error


def require_device(backend: KernelBackend, device: str) -> None:
    """Refuse a device that a backend does not have.

    Parameters
    ----------
    backend : KernelBackend
        Of which.
    device : str
        "cpu", "cuda:0", ...

    Raises
    ------
    ValueError
        If it does not have the device; it names those that there are.
    """
    if device not in backend.devices():
        raise ValueError(
            f"device of {backend.name} must be one of {', '.join(backend.devices())}, got {device!r}"
        )
