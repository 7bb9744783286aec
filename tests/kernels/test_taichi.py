"""What Taichi adds to the rules for backends: one runtime a process, perhaps the user's, and Vulkan."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from backends import needs

from evqr_kernels import get_backend

pytestmark = needs("taichi")

KERNEL_TESTS = Path(__file__).parent


def run(code):
    command = [sys.executable, "-W", "error", "-c", code]
    environment = {**os.environ, "TI_SKIP_VERSION_CHECK": "ON"}  # Taichi asks its makers once a week
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


@cache
def machine_has(device):
    return device in run("from evqr_kernels import get_backend; print(get_backend('taichi').devices())")


@pytest.fixture
def vulkan():
    if not machine_has("vulkan"):
        pytest.skip("no Vulkan driver: install one, Mesa's lavapipe for the CPU, say")


START = """
import numpy as np
from evqr_kernels import bin_events, get_backend
from evqr_kernels.taichi_backend.language import ti
def count(device="cpu", n=3):
    one = np.ones(n, np.float32)
    window_ptr = np.array([0, n], np.int32)
    return float(bin_events(one, one, one, window_ptr, shape=(4, 4), backend="taichi", device=device).sum())
"""


def test_a_runtime_of_the_user_is_used_as_it_is():
    code = """
ti.init(arch=ti.cpu, cpu_max_num_threads=1, log_level=ti.ERROR)
field = ti.ndarray(ti.f32, 3)
field.fill(7.0)
backend = get_backend("taichi")
assert backend.devices() == ("cpu",)
assert count() == 3.0
assert field.to_numpy().tolist() == [7.0] * 3
assert ti.cfg.cpu_max_num_threads == 1
"""
    run(START + code)


def test_a_runtime_on_another_device_is_refused(vulkan):
    code = """
ti.init(arch=ti.vulkan, log_level=ti.ERROR)
backend = get_backend("taichi")
assert backend.devices() == ("vulkan",)
for refused in (lambda: backend.load("cpu"), lambda: backend.empty((1,), np.float32, "cpu")):
    try:
        refused()
    except ValueError as error:
        print(error)
print(count("vulkan"))
"""
    out = run(START + code).splitlines()
    message = "device must be 'vulkan', where this process's Taichi runs, got 'cpu'"
    message += ": Taichi has one device a process"
    assert out[-3:] == [message, message, "3.0"]


def test_a_device_that_the_machine_lacks_is_refused():
    code = """
try:
    get_backend("taichi").load("cuda:7")
except ValueError as error:
    print(error)
assert ti.cfg is None
"""
    out = run(START + code)
    assert out.startswith("device of taichi must be one of cpu")
    assert out.endswith("got 'cuda:7'\n")


def test_any_thread_may_start_it_and_any_other_compile():
    code = """
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(1) as pool:
    pool.submit(get_backend("taichi").synchronize, "cpu").result()
    assert pool.submit(get_backend("taichi").empty, (2,), np.float32, "cpu").result().shape == (2,)
assert count() == 3.0
with ThreadPoolExecutor(4) as pool:
    assert list(pool.map(lambda n: count(n=n), range(1, 40))) == [float(n) for n in range(1, 40)]
"""
    run(START + code)


def test_the_fork_is_asked_for_by_name():
    code = """
import os
os.environ["EVQR_TAICHI"] = "tai-chi"
from evqr_kernels import BackendUnavailable, get_backend
try:
    get_backend("taichi")
except BackendUnavailable as error:
    print(error)
"""
    assert "EVQR_TAICHI must be taichi or quadrants, got 'tai-chi'" in run(code)


def test_arrays_of_too_many_elements_are_refused():
    with pytest.raises(ValueError, match=r"fewer than 2\^31 elements, got shape \(65536, 32768\)"):
        get_backend("taichi").empty((1 << 16, 1 << 15), np.float32, "cpu")


def test_arrays_cut_out_of_others(spec):
    """As input and as output: what lies around is neither read nor written."""
    backend = get_backend("taichi")
    whole = backend.from_host(np.full((2, 9, 13), np.nan, np.float32), "cpu")
    image, out = (
        whole[:, 1:5, 2:8],
        backend.from_host(np.full((2, 4, 9), np.nan, np.float32), "cpu")[..., 3:6],
    )
    values = np.arange(48, dtype=np.float32).reshape(2, 4, 6)
    backend.assign(image, values)
    rows = backend.empty((2, 4, 6), np.float32, "cpu")
    backend.reduce_image(image, 2.0, rows, out[:, :2])
    np.testing.assert_array_equal(out[:, :2], values.reshape(2, 2, 2, 3, 2).sum(axis=(2, 4)))
    assert np.isnan(out[:, 2:]).all() and np.isnan(out.base[..., :3]).all()
    assert np.isnan(whole).sum() == whole.size - 48


def test_every_operation_on_vulkan(vulkan):
    """Against the specification, in its own process; ``--device vulkan`` runs the other tests there."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--device", "vulkan"]
    command += ["-k", "taichi-vulkan", str(KERNEL_TESTS / "test_specification.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert " passed" in done.stdout


def test_a_recording_is_read_on_vulkan(vulkan):
    """Reading makes views of arrays, which Taichi's arrays on a GPU do not have of themselves."""
    code = """
from evqr import read_codes
from evqr.demo import demo_recording
with demo_recording() as path:
    print(*(reading.text for reading in read_codes(path, backend="taichi", device="vulkan").readings))
"""
    assert run(code) == "Read in passing, 8 px/ms\n"
