"""What asks for the package of an extra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from evqr.errors import MissingExtra


@contextmanager
def needs_extra(doing: str, package: str, extra: str) -> Iterator[None]:
    """Say what to install where the import inside fails."""
    try:
        yield
    except ImportError as error:
        from evqr_kernels.extras import install_command

        raise MissingExtra(f"{doing} needs {package}: {install_command(extra)}") from error
