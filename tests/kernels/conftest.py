"""Every operation runs on every backend but the specification, on every device, in both precisions."""

import numpy as np
import pytest

from evqr_kernels import get_backend

from .helpers import Runner

BACKENDS = ("warp",)
"""Backends other than the specification."""


def pytest_generate_tests(metafunc):
    if "placed" in metafunc.fixturenames:
        wanted = metafunc.config.getoption("device")
        places = [(name, device) for name in BACKENDS for device in wanted or get_backend(name).devices()]
        metafunc.parametrize("placed", places, ids="-".join, indirect=True)


@pytest.fixture(params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request):
    return request.param


@pytest.fixture
def placed(request):
    """A compared backend on a device: calls operations on NumPy arrays, gives NumPy arrays."""
    name, device = request.param
    return Runner(get_backend(name), device)


@pytest.fixture(scope="session")
def spec():
    """The specification."""
    return Runner(get_backend("numpy"), "cpu")


@pytest.fixture
def rng():
    return np.random.default_rng(20)
