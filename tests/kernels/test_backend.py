"""The registry of backends: lazy, and plain about what is wrong."""

import importlib
import logging
import re
import subprocess
import sys

import numpy as np
import pytest
from backends import BACKENDS, needs

import evqr_kernels
from evqr_kernels import (
    BackendUnavailable,
    SplatConfig,
    backend_names,
    get_backend,
    make_scratch,
    register_backend,
    registry,
    warp_backend,
)
from evqr_kernels.call import example
from evqr_kernels.extras import install_command
from evqr_kernels.operations import OPERATIONS
from evqr_kernels.registry import require_device

HEAVY = (
    "warp",
    "taichi",
    "torch",
    "jax",
    "evqr_kernels.warp_backend",
    "evqr_kernels.numpy_backend",
    "evqr_kernels.taichi_backend",
    "importlib.metadata",
    "urllib.request",
)


@pytest.fixture
def own_registry(monkeypatch):
    """A registry that forgets what a test does to it."""
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_loaded", dict(registry._loaded))


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


def test_auto_is_warp_and_logged(own_registry, caplog):
    registry._loaded.clear()
    with caplog.at_level(logging.INFO, logger="evqr_kernels.registry"):
        assert get_backend().name == get_backend("auto").name == "warp"
    assert caplog.messages == ["backend 'auto' is 'warp'"]


@pytest.mark.parametrize("name", BACKENDS)
def test_backend_is_complete_and_made_once(name):
    made = get_backend(name)
    assert made is get_backend(name)
    assert made.name == name
    assert [op for op in OPERATIONS if not callable(getattr(made, op, None))] == []


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


def test_unknown_name_lists_the_known(own_registry):
    with pytest.raises(ValueError, match="backend must be one of auto, numpy, warp, taichi, got 'cupy'"):
        get_backend("cupy")


def test_missing_module_names_cause_and_remedy(own_registry):
    register_backend("taichi", "a_module_that_is_not_there:load")
    with pytest.raises(
        BackendUnavailable, match=r"'taichi' cannot be loaded \(ModuleNotFoundError: No module"
    ) as info:
        get_backend("taichi")
    assert isinstance(info.value, ImportError)
    assert isinstance(info.value.__cause__, ModuleNotFoundError)
    assert info.value.name == "a_module_that_is_not_there"


def test_missing_dependency_names_the_extra(own_registry, tmp_path, monkeypatch):
    (tmp_path / "needy_backend.py").write_text("import a_library_that_is_not_there\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    register_backend("taichi", "needy_backend:load")
    with pytest.raises(BackendUnavailable, match=re.escape(install_command("taichi"))):
        get_backend("taichi")


@pytest.mark.parametrize("attribute", ["nothing", "__doc__"])
def test_a_target_that_is_nothing_to_call_is_named(own_registry, attribute):
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


def test_a_named_backend_never_falls_back(own_registry):
    register_backend("warp", "a_module_that_is_not_there:load")
    for name in ("warp", "auto"):
        with pytest.raises(BackendUnavailable):
            get_backend(name)


def test_registered_backend_is_loaded_when_asked_for(own_registry):
    register_backend("other", "evqr_kernels.numpy_backend:NumpyBackend")
    assert "other" in evqr_kernels.backend_names()
    assert get_backend("other") is get_backend("other")
    assert get_backend("other") is not get_backend("numpy")


@pytest.mark.parametrize("target", ["module", "module:", ":attribute", ""])
def test_bad_target(own_registry, target):
    with pytest.raises(ValueError, match="target must be 'module:attribute', got"):
        register_backend("other", target)


def test_auto_cannot_be_registered(own_registry):
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
        lambda: made.load("cuda:99", []),
    ):
        with pytest.raises(ValueError, match="got 'cuda:99'"):
            call()


SPLATS = [
    (op, {"cfg": SplatConfig(epsilon_px=0.5, radius_px=1.0), "P": parameters})
    for op in ("splat_events", "splat_events_adjoint")
    for parameters in (2, 6)
]


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize(
    "calls", [[("bin_events", {}), ("lag_operator", {"K": 5, "X": 640})], SPLATS], ids=["images", "splats"]
)
def test_nothing_is_left_to_compile_after_loading(name, calls):
    made = get_backend(name)
    device = made.devices()[0]
    made.load(device, calls)
    assert not made.needs_compile(device, calls)


def test_what_is_loaded_is_what_is_launched(monkeypatch):
    """The modules of a call are those of its kernels, whatever its sizes choose."""
    made, loaded = get_backend("warp"), []
    monkeypatch.setattr(warp_backend.wp, "load_module", lambda module, device: loaded.append(module.name))
    made.load("cpu", [])
    assert loaded == []
    made.load("cpu", [("lag_operator", {"X": 640})])
    assert {"evqr_kernels_lag_16_float32", "evqr_kernels_replay"} & set(loaded) >= {
        "evqr_kernels_lag_16_float32"
    }
    loaded.clear()
    made.load("cpu", [("lag_operator", {"X": 12, "K": 3})])
    assert "evqr_kernels_lag_4_float32" in loaded
    loaded.clear()
    made.load("cpu", SPLATS)
    assert sum("0.5_1" in name for name in loaded) == 4  # and what all adjoints share


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("op", OPERATIONS)
def test_any_operation_can_be_loaded_without_a_word_on_its_sizes(name, op):
    """Nothing is compiled here."""
    made = get_backend(name)
    if name == "numpy":
        made.load("cpu", [(op, {})])
        return
    package = importlib.import_module(f"evqr_kernels.{name}_backend")
    made.needs_compile(made.devices()[0], [(op, {})])
    assert package.kernels_of(example(made, made.devices()[0], op, {}))


def test_a_call_of_no_operation_is_refused():
    with pytest.raises(ValueError, match="op must be the name of an operation, got 'sort'"):
        get_backend("warp").load("cpu", [("sort", {})])
    with pytest.raises(ValueError, match="op must be the name of an operation, got 'sort'"):
        make_scratch(get_backend("warp"), "cpu", "sort")
    with pytest.raises(AttributeError, match="WarpBackend has no 'sort', which is no operation"):
        get_backend("warp").sort()


def test_scratch_is_of_the_backends_tile():
    made = get_backend("numpy")
    made_of = make_scratch(made, "cpu", "motion_correlation", B=2, Y=7, X=9, radius=3)
    assert [array.shape for array in made_of] == [(2, 7, 9), (2, 7, 7, 16), (2, 7, 4), (2,)]
    assert [array.dtype for array in made_of] == [np.int32, np.float32, np.float32, np.int32]
    with pytest.raises(TypeError, match="radius must be given: rows_out of motion_correlation depends on it"):
        make_scratch(made, "cpu", "motion_correlation", B=2, Y=7, X=9)


def test_an_empty_cache_needs_compiling(tmp_path):
    """In a cache of its own, since compiled kernels stay."""
    code = f"""
import warp as wp
wp.config.kernel_cache_dir = {str(tmp_path)!r}
from evqr_kernels import get_backend
print(get_backend("warp").needs_compile("cpu", [("bin_events", {{}})]))
"""
    assert run(code).stdout.strip() == "True"
