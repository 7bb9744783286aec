"""Every operation runs on every backend but the specification, on every device, in both precisions."""

import os

import numpy as np
import pytest
from backends import COMPARED, needs

from evqr_kernels import get_backend

from .helpers import Runner

# Taichi shares every batch out between two threads, whatever the machine has: that is where races show.
os.environ.setdefault("TI_CPU_MAX_NUM_THREADS", "2")


def pytest_generate_tests(metafunc):
    if "placed" in metafunc.fixturenames:
        wanted = metafunc.config.getoption("device")
        all_places = [place for name in COMPARED for place in places(name, wanted)]
        metafunc.parametrize("placed", all_places, indirect=True)


def places(name, wanted):
    """A backend on each of the wanted devices that it has; Taichi has one a process, by default the CPU."""
    if needs(name):
        return [pytest.param((name, "cpu"), marks=needs(name), id=f"{name}-cpu")]
    devices = get_backend(name).devices()
    chosen = [device for device in wanted if device in devices] if wanted else devices
    if name == "taichi":
        chosen = chosen[:1]
    return [pytest.param((name, device), id=f"{name}-{device}") for device in chosen]


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
