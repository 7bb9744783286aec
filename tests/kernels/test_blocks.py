"""Blocks of threads that lack a barrier are wrong, where barriers are tested: on Vulkan's driver for CPUs."""

import subprocess
import sys

import pytest
from backends import needs

from .test_taichi import machine_has

pytestmark = needs("taichi")


def test_a_kernel_that_lacks_a_barrier_is_wrong(request):
    """Of one kernel, in the smallest blocks; the whole script is for a CI's step."""
    if request.config.getoption("device") or not machine_has("vulkan"):
        pytest.skip("no Vulkan driver: install one, Mesa's lavapipe for the CPU, say")
    command = [sys.executable, "-m", "tests.kernels.blocks_on_vulkan", "--op", "solve_code", "--lanes", "32"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("without barrier") == 6
