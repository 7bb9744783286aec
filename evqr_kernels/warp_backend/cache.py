"""Where compiled kernels are kept: in Warp's cache, or elsewhere where that cannot be written.

What cannot be loaded from there, since a file was cut short, is compiled again.
"""

import logging
import os
import shutil
import threading

import warp as wp

from evqr_kernels.errors import BackendUnavailable
from evqr_kernels.native_output import without_lines
from evqr_kernels.own_directory import own_directory, why_not_writable

_log = logging.getLogger(__name__)
_lock = threading.RLock()
_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"
_DAMAGED = (b"error: ", b"Error: ", b"Failed to ")
"""What Warp and LLVM print of an object file that they cannot load, beside the exception."""

ELSEWHERE = "set WARP_CACHE_PATH to a directory that can be written"


def start() -> None:
    """Start Warp, with another place for the kernels where its own cannot be made.

    Raises
    ------
    BackendUnavailable
        There is no such place at all.
    """
    level = wp.config.log_level
    wp.config.log_level = wp.LOG_ERROR
    try:
        with without_lines(_NO_DRIVER):  # a machine without a GPU is no reason for a warning
            try:
                wp.init()
            except OSError as error:
                wanted = str(wp.config.kernel_cache_dir or error.filename)
                wp.config.kernel_cache_dir = os.path.dirname(_another(wanted, error))  # Warp adds its version
                wp.init()
    finally:
        wp.config.log_level = max(level, wp.LOG_WARNING)  # each load of a module would be a line


def directory() -> str:
    """Give the directory where kernels are kept."""
    return str(wp.config.kernel_cache_dir)


def is_compiled(module: wp.Module, device: str) -> bool:
    """Whether a module, as it is now, is in this machine's cache."""
    name = _name(module, device)
    if os.path.isdir(os.path.join(directory(), name)):
        return True
    with _lock:
        reason = why_not_writable(directory())
        if reason is None:
            return False
        try:
            wp.config.kernel_cache_dir = _another(directory(), reason)
        except BackendUnavailable:
            return False  # `load_module` says so
    return os.path.isdir(os.path.join(directory(), name))


def load_module(module: wp.Module, device: str) -> bool:
    """Compile a module or load it; compile it again where what was kept of it is damaged.

    Returns
    -------
    replaced : bool
        Whether it was damaged.

    Raises
    ------
    BackendUnavailable
        Kernels can be kept nowhere, or are damaged and cannot be replaced.
    """
    there = is_compiled(module, device)
    try:
        if not there:
            wp.load_module(module, device=device)
        else:
            with without_lines(*_DAMAGED):
                wp.load_module(module, device=device)
        return False
    except Exception as error:
        if not there:
            reason = why_not_writable(directory())
            if reason is None:
                raise  # no fault of the place
            raise BackendUnavailable(_cannot(directory(), reason)) from error
        _replace(module, device)
        return True


def _replace(module: wp.Module, device: str) -> None:
    """Compile a module whose files do not load."""
    kept = os.path.join(directory(), _name(module, device))
    try:
        if os.path.islink(kept):  # of a cache that cannot be written
            os.unlink(kept)
        else:
            shutil.rmtree(kept)
        wp.load_module(module, device=device)
    except Exception as error:
        raise BackendUnavailable(
            f"compiled kernels in {kept} are damaged and cannot be replaced ({_short(error)}); delete that"
            f" directory, or {ELSEWHERE}"
        ) from error
    _log.warning("compiled kernels in %s were damaged and have been compiled again", kept)


def _another(wanted: str, why: OSError) -> str:
    """Make a place for kernels among temporary files, with what the one that was wanted holds."""
    try:
        place = own_directory()
        where = os.path.join(place, wp.config.version)
        os.makedirs(where, exist_ok=True)
    except OSError as error:
        raise BackendUnavailable(_cannot(wanted, why)) from error
    for name in os.listdir(wanted) if os.path.isdir(wanted) else ():
        link = os.path.join(where, name)
        if name.startswith("wp_") and not os.path.lexists(link):
            try:
                os.symlink(os.path.join(wanted, name), link, target_is_directory=True)
            except OSError:  # without links it is compiled once more
                break
    _log.warning(
        "%s cannot be written (%s): compiled kernels are kept in %s; to keep them, %s",
        wanted, _short(why), where, ELSEWHERE,
    )  # fmt: skip
    return where


def _cannot(place: str, why: OSError) -> str:
    return (
        f"compiled kernels cannot be kept in {place} ({_short(why)}), nor among temporary files; {ELSEWHERE}"
    )


def _short(error: BaseException) -> str:
    text = str(getattr(error, "strerror", None) or error)
    return " ".join(text.split())


def _name(module: wp.Module, device: str) -> str:
    return module.get_module_identifier(1 if device == "cpu" else None)  # the block size is part of the hash
