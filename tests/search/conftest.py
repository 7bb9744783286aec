"""What tests of the search have in common."""

import pytest

from evqr.workspace import Workspace
from evqr_kernels.backend import get_backend


@pytest.fixture(scope="session")
def workspace():
    """One for all tests: its buffers are made once."""
    backend = get_backend("warp")
    backend.load("cpu")
    return Workspace(backend, "cpu")
