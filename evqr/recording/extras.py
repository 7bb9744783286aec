"""The packages of the extra ``formats``, imported when a file needs them."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from evqr_kernels.extras import install_command

from ..errors import MissingExtra


def required(module: str, path: str, what: str) -> ModuleType:
    """Import a package, or raise with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        raise MissingExtra(
            f"{path}: {what} needs the package {package}: {install_command('formats')} ({error})"
        ) from error
