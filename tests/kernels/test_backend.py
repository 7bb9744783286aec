"""The registry of backends: lazy, and plain about what is wrong."""

import logging
import subprocess
import sys

import numpy as np
import pytest
from backends import BACKENDS, needs

import evqr_kernels
from evqr_kernels import (
    BackendUnavailable,
    KernelSet,
    SplatConfig,
    backend,
    backend_names,
    get_backend,
    register_backend,
    warp_backend,
)
from evqr_kernels.backend import OPS, require_device

HEAVY = (
    "warp",
    "taichi",
    "torch",
    "jax",
    "evqr_kernels.warp_backend",
    "evqr_kernels.numpy_backend",
    "evqr_kernels.taichi_backend",
)


@pytest.fixture
def registry(monkeypatch):
    """A registry that forgets what a test does to it."""
    monkeypatch.setattr(backend, "_targets", dict(backend._targets))
    monkeypatch.setattr(backend, "_loaded", dict(backend._loaded))


def run(code, **options):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, **options)


def test_import_loads_no_backend():
    done = run(f"import sys, evqr_kernels; print([name for name in {HEAVY} if name in sys.modules])")
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", BACKENDS)
def test_backends_load_in_silence(name):
    """Neither a greeting nor a warning of a machine without a GPU, nor a line a module."""
    code = f"""
import numpy as np, evqr_kernels
backend = evqr_kernels.get_backend({name!r})
one = np.zeros(1, np.float32)
evqr_kernels.bin_events(one, one, one, np.array([0, 1], np.int32), shape=(1, 1), backend={name!r})
"""
    done = run(code)
    assert done.stdout == ""
    assert done.stderr == ""


def test_what_native_code_prints_is_passed_on():
    code = """
import os
from evqr_kernels.native_output import without_lines
with without_lines(b"NVIDIA CUDA driver"):
    os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. None\\nsomething else\\n")
os.write(2, b"after\\n")
"""
    assert run(code).stderr == "something else\nafter\n"


def test_auto_is_warp_and_logged(registry, caplog):
    backend._loaded.clear()
    with caplog.at_level(logging.INFO, logger="evqr_kernels.backend"):
        assert get_backend().name == get_backend("auto").name == "warp"
    assert caplog.messages == ["backend 'auto' is 'warp'"]


@pytest.mark.parametrize("name", BACKENDS)
def test_backend_is_complete_and_made_once(name):
    made = get_backend(name)
    assert made is get_backend(name)
    assert made.name == name
    assert [op for op in OPS if not callable(getattr(made, op, None))] == []


def test_the_cpu_comes_first():
    """In a process of its own: Taichi names the one device that it runs on."""
    done = run(f"""
from evqr_kernels import get_backend
print(*(get_backend(name).devices()[0] for name in {[name for name in backend_names() if not needs(name)]}))
""")
    assert set(done.stdout.split()) == {"cpu"}


@pytest.mark.parametrize("name", BACKENDS)
def test_arrays_on_the_cpu_are_the_same_memory(name):
    made = get_backend(name)
    if "cpu" not in made.devices():
        pytest.skip(f"{name} runs on {made.devices()[0]} in this process")
    for dtype in (np.float32, np.float64, np.int32):
        host = np.arange(6, dtype=dtype).reshape(2, 3)
        there = made.from_host(host, "cpu")
        assert np.shares_memory(made.to_host(there), host)
        assert made.to_host(made.empty((2, 0, 3), dtype, "cpu")).shape == (2, 0, 3)
        with pytest.raises(ValueError, match="array must be contiguous, it is not copied"):
            made.from_host(host[:, ::2], "cpu")


def test_unknown_name_lists_the_known(registry):
    with pytest.raises(ValueError, match="backend must be one of auto, numpy, warp, taichi, got 'cupy'"):
        get_backend("cupy")


def test_missing_module_names_cause_and_remedy(registry):
    register_backend("taichi", "a_module_that_is_not_there:load")
    with pytest.raises(
        BackendUnavailable, match=r"'taichi' cannot be loaded \(ModuleNotFoundError: No module"
    ) as info:
        get_backend("taichi")
    assert isinstance(info.value, ImportError)
    assert isinstance(info.value.__cause__, ModuleNotFoundError)
    assert info.value.name == "a_module_that_is_not_there"


def test_missing_dependency_names_the_extra(registry, tmp_path, monkeypatch):
    (tmp_path / "needy_backend.py").write_text("import a_library_that_is_not_there\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    register_backend("taichi", "needy_backend:load")
    with pytest.raises(BackendUnavailable, match=r'pip install "evqr\[taichi\]"'):
        get_backend("taichi")


@pytest.mark.parametrize("attribute", ["nothing", "__doc__"])
def test_a_target_that_is_nothing_to_call_is_named(registry, attribute):
    target = f"evqr_kernels.numpy_backend:{attribute}"
    register_backend("other", target)
    with pytest.raises(
        BackendUnavailable, match=f"'other' cannot be loaded .*'{target}' names nothing to call"
    ):
        get_backend("other")


def test_a_backend_may_ask_for_another(tmp_path):
    """In a process of its own, which could wait for itself forever."""
    (tmp_path / "on_top.py").write_text(
        "from evqr_kernels import get_backend\ndef load(): return get_backend('numpy')\n"
    )
    code = f"""
import sys
from evqr_kernels import get_backend, register_backend
sys.path.append({str(tmp_path)!r})
register_backend("on_top", "on_top:load")
print(get_backend("on_top").name)
"""
    assert run(code, timeout=30).stdout == "numpy\n"


def test_a_named_backend_never_falls_back(registry):
    register_backend("warp", "a_module_that_is_not_there:load")
    for name in ("warp", "auto"):
        with pytest.raises(BackendUnavailable):
            get_backend(name)


def test_registered_backend_is_loaded_when_asked_for(registry):
    register_backend("other", "evqr_kernels.numpy_backend:NumpyBackend")
    assert "other" in evqr_kernels.backend_names()
    assert get_backend("other") is get_backend("other")
    assert get_backend("other") is not get_backend("numpy")


@pytest.mark.parametrize("target", ["module", "module:", ":attribute", ""])
def test_bad_target(registry, target):
    with pytest.raises(ValueError, match="target must be 'module:attribute', got"):
        register_backend("other", target)


def test_auto_cannot_be_registered(registry):
    with pytest.raises(ValueError, match="name must not be 'auto'"):
        register_backend("auto", "module:attribute")


@pytest.mark.parametrize("name", BACKENDS)
def test_absent_device_lists_those_there_are(name):
    made = get_backend(name)
    there = ", ".join(made.devices())
    with pytest.raises(ValueError, match=rf"device of {name} must be one of {there}, got 'cuda:99'"):
        require_device(made, "cuda:99")
    assert "cuda:99" in made.supports("bin_events", np.float32, "cuda:99")
    assert "no operation 'sort'" in made.supports("sort", np.float32, "cpu")


@pytest.mark.parametrize("name", BACKENDS[1:])
def test_an_absent_device_is_refused(name):
    made = get_backend(name)
    for call in (
        lambda: made.empty((1,), np.float32, "cuda:99"),
        lambda: made.from_host(np.zeros(1, np.float32), "cuda:99"),
        lambda: made.load("cuda:99"),
    ):
        with pytest.raises(ValueError, match="got 'cuda:99'"):
            call()


@pytest.mark.parametrize("name", BACKENDS)
def test_nothing_is_left_to_compile_after_loading(name):
    made = get_backend(name)
    device = made.devices()[0]
    made.load(device)
    assert not made.needs_compile(device)


def test_splats_are_loaded_by_name(monkeypatch):
    """Theirs, and their adjoints', are the modules that are loaded beside those of reading a code."""
    made, cfg = get_backend("warp"), SplatConfig(epsilon_px=0.71)
    loaded = []
    monkeypatch.setattr(warp_backend.wp, "load_module", lambda module, device: loaded.append(module))
    made.load("cpu")
    always = set(loaded)
    made.load("cpu", KernelSet(splats=(cfg,)))
    modules = {kernel.module for kernel in warp_backend.splat_kernels(cfg, warp_backend.wp.get_device("cpu"))}
    assert sum("splat" in module.name for module in modules) == 4
    assert modules <= set(loaded) and not {m for m in modules if "splat" in m.name} & always


@pytest.mark.parametrize("name", BACKENDS[1:])
def test_nothing_is_compiled_for_a_splat_after_loading(name):
    kernels = KernelSet(splats=(SplatConfig(epsilon_px=0.5, radius_px=1.0),))
    made = get_backend(name)
    device = made.devices()[0]
    made.load(device, kernels)
    assert not made.needs_compile(device, kernels)


def test_an_empty_cache_needs_compiling(tmp_path):
    """In a cache of its own, since compiled kernels stay."""
    code = f"""
import warp as wp
wp.config.kernel_cache_dir = {str(tmp_path)!r}
from evqr_kernels import get_backend
print(get_backend("warp").needs_compile())
"""
    assert run(code).stdout.strip() == "True"
