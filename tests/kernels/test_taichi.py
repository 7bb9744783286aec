"""What Taichi adds to the rules for backends: one runtime a process, perhaps the user's, and Vulkan."""

import importlib.util
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from backends import needs

from evqr_kernels import SplatConfig, bin_events, get_backend

pytestmark = needs("taichi")
runtime = pytest.importorskip("evqr_kernels.taichi_backend.runtime", exc_type=ImportError)

from evqr_kernels import taichi_backend  # noqa: E402
from evqr_kernels.taichi_backend import splat, splat_adjoint  # noqa: E402
from evqr_kernels.taichi_backend.language import ti  # noqa: E402

KERNEL_TESTS = Path(__file__).parent


def run(code, **variables):
    command = [sys.executable, "-W", "error", "-c", code]
    # Taichi asks its makers once a week
    environment = {**os.environ, "TI_SKIP_VERSION_CHECK": "ON", **variables}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_splats_are_loaded_by_name(monkeypatch):
    made, cfg, compiled = get_backend("taichi"), SplatConfig(epsilon_px=0.71), []
    monkeypatch.setattr(made, "_loaded", {})
    monkeypatch.setattr(taichi_backend, "compile_kernel", compiled.append)
    device = made.devices()[0]
    on_cpu = device == "cpu"
    for parameters in (2, 6):
        given = {"cfg": cfg, "P": parameters}
        made.load(device, [("splat_events", given), ("splat_events_adjoint", given)])
        kernel = splat.make_splat_events(ti.f32, cfg, parameters, not on_cpu, on_cpu)
        adjoint = splat_adjoint.make_splat_events_adjoint(ti.f32, cfg, parameters)
        assert kernel in compiled and adjoint in compiled
    many = len(compiled)
    made.load(device, [("splat_events", given)])
    assert len(compiled) == many


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


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the system does not list threads")
def test_two_windows_are_done_by_two_threads():
    """Taichi gives a thread hundreds of a loop's indices, so that windows must not be as many as those."""
    code = """
import os
def ticks():
    threads = sorted(set(os.listdir("/proc/self/task")) - {str(os.getpid())})
    stats = (open(f"/proc/self/task/{thread}/stat").read() for thread in threads)
    return np.array([int(stat.rsplit(")", 1)[1].split()[11]) for stat in stats])
def splat(n):
    x = np.linspace(0, 99, 2 * n, dtype=np.float32)
    window_ptr = np.array([0, n, 2 * n], np.int32)
    splat_events(x, x, 0 * x, x, window_ptr, np.zeros((2, 2), np.float32), shape=(100, 100), backend="taichi")
splat(1)
before = ticks()
splat(2_000_000)
print(np.count_nonzero(ticks() - before > 2))
"""
    out = run("from evqr_kernels import splat_events\n" + START + code, TI_CPU_MAX_NUM_THREADS="2")
    assert int(out) == 2


def test_a_runtime_on_another_device_is_refused(vulkan):
    code = """
ti.init(arch=ti.vulkan, log_level=ti.ERROR)
backend = get_backend("taichi")
assert backend.devices() == ("vulkan",)
for refused in (lambda: backend.load("cpu", []), lambda: backend.empty((1,), np.float32, "cpu")):
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
    get_backend("taichi").load("cuda:7", [])
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


@pytest.fixture
def here():
    """The backend, and where it runs in this process: with ``--device vulkan`` there."""
    backend = get_backend("taichi")
    return backend, backend.devices()[0]


def test_batches_are_shared_between_threads(here):
    """What ``test_batches.py`` compares bit for bit has then run on several."""
    backend, device = here
    backend.synchronize(device)
    assert runtime.ti.cfg.cpu_max_num_threads >= 2


def test_arrays_of_too_many_elements_are_refused(here):
    backend, device = here
    with pytest.raises(ValueError, match=r"fewer than 2\^31 elements, got shape \(65536, 32768\)"):
        backend.empty((1 << 16, 1 << 15), np.float32, device)


def test_arrays_cut_out_of_others(here):
    """As input and as output: what lies around is neither read nor written."""
    backend, device = here
    whole = backend.from_host(np.full((2, 9, 13), np.nan, np.float32), device)
    around = backend.from_host(np.full((2, 4, 9), np.nan, np.float32), device)
    image = whole[:, 1:5, 2:8]
    values = np.arange(48, dtype=np.float32).reshape(2, 4, 6)
    backend.assign(image, values)
    rows = backend.empty((2, 4, 6), np.float32, device)
    backend.reduce_image(image, 2.0, rows, around[:, :2, 3:6])
    expected = np.full((2, 4, 9), np.nan, np.float32)
    expected[:, :2, 3:6] = values.reshape(2, 2, 2, 3, 2).sum(axis=(2, 4))
    np.testing.assert_array_equal(backend.to_host(around), expected)
    assert np.isnan(backend.to_host(whole)).sum() == whole.shape[0] * 9 * 13 - 48


def test_double_precision_where_there_is_none(here, monkeypatch):
    """As on Metal and on some of the GPUs with Vulkan: refused by name, before anything is launched."""
    backend, device = here
    monkeypatch.setattr(runtime, "has_float64", lambda device: False)
    one, window_ptr = np.ones(1), np.array([0, 1], np.int32)
    message = f"taichi refuses bin_events: {device} computes in float32 only, not in float64: "
    with pytest.raises(NotImplementedError, match=message + "give float32 arrays, or another device"):
        bin_events(one, one, one, window_ptr, shape=(1, 1), backend="taichi", device=device)
    assert backend.supports("bin_events", np.float32, device) is None


def specified(*options, **environment):
    """Compare operations with the specification in a process of its own; give whether a test passed."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
    command.append(str(KERNEL_TESTS / "test_specification.py"))
    environment = {**os.environ, **environment}
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False, env=environment)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return " passed" in done.stdout


def test_every_operation_on_vulkan(vulkan, request):
    """Against the specification, in its own process; ``--device vulkan`` runs all tests there."""
    if request.config.getoption("device"):
        pytest.skip("--device says where the tests run")
    assert specified("-k", "taichi-vulkan", "--device", "vulkan")


def test_every_operation_of_the_fork(request):
    """Quadrants, where it is installed, against the specification too."""
    if not importlib.util.find_spec("quadrants"):
        pytest.skip("quadrants is not installed")
    if request.config.getoption("device"):
        pytest.skip("--device says where the tests run")
    assert specified("-k", "taichi-cpu", EVQR_TAICHI="quadrants")


def test_a_recording_is_read_on_vulkan(vulkan):
    """Reading makes views of arrays, which Taichi's arrays on a GPU do not have of themselves."""
    code = """
from evqr import read_codes
from evqr.demo import demo_recording
with demo_recording() as path:
    print(*(reading.text for reading in read_codes(path, backend="taichi", device="vulkan").readings))
"""
    assert run(code) == "Read in passing, 8 px/ms\n"


def test_a_directory_that_cannot_be_written_is_replaced_by_another(monkeypatch, caplog, tmp_path):
    """Taichi itself would crash at its end."""
    (tmp_path / "file").touch()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    runtime.cache_dir.cache_clear()
    try:
        monkeypatch.setenv(runtime.PLACE, str(tmp_path / "kernels"))
        assert (runtime.cache_dir(), caplog.text) == (str(tmp_path / "kernels"), "")
        monkeypatch.setenv(runtime.PLACE, str(tmp_path / "file" / "kernels"))
        runtime.cache_dir.cache_clear()
        assert Path(runtime.cache_dir()).parent.parent == tmp_path
        assert "kernels cannot be written (Not a directory)" in caplog.text
    finally:
        runtime.cache_dir.cache_clear()
