"""What tests of the search have in common."""

import pytest

from evqr.launched import LAUNCHED
from evqr.workspace import Workspace
from evqr_kernels.registry import get_backend


@pytest.fixture(scope="session")
def workspace():
    """One for all tests: its buffers are made once."""
    backend = get_backend("warp")
    backend.load("cpu", LAUNCHED)
    return Workspace(backend, "cpu")
