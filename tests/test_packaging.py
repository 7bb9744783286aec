"""What importing costs, and what the package promises to whoever imports it."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata, resources

import pytest

import evqr

# Backends, decoders and file libraries: none may be loaded by an import of the packages.
HEAVY = (
    "warp taichi torch jax zxingcpp segno eventcv hdf5plugin h5py matplotlib distributed click tqdm"
).split()


def python(code: str) -> str:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


@pytest.mark.parametrize("package", ["evqr", "evqr_kernels", "evqr.results", "evqr.errors"])
def test_import_loads_no_backend(package):
    loaded = python(f"import sys, {package}; print(*sys.modules)").split()
    assert package in loaded
    assert not {name.partition(".")[0] for name in loaded} & set(HEAVY)


def test_every_public_name_can_be_had():
    for name in evqr.__all__:
        assert getattr(evqr, name) is not None, name
        assert name in dir(evqr)
    with pytest.raises(AttributeError, match="no attribute 'read_cods'"):
        _ = evqr.read_cods


def test_lazy_names_are_the_ones_the_type_checker_sees():
    """The imports under TYPE_CHECKING and the table that serves them at run time name the same things."""
    import ast
    import inspect

    tree = ast.parse(inspect.getsource(evqr))
    (checked,) = (
        node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    seen = {
        alias.name: node.module
        for node in checked.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(seen) == sorted(evqr.__all__)
    assert {name: module for name, module in seen.items() if name != "simulate"} == evqr._HOME_OF


def test_version_is_that_of_the_distribution():
    assert evqr.__version__ == metadata.version("evqr")


def test_the_kernels_need_numpy_and_warp_alone():
    """What finds any other package is gone."""
    code = """
import importlib.abc, sys
class Nothing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition('.')[0] not in {*sys.stdlib_module_names, 'numpy', 'warp', 'evqr_kernels'}:
            raise ModuleNotFoundError(f'no module named {name!r} here', name=name)
sys.meta_path.insert(0, Nothing())
import numpy as np
import evqr_kernels
one, ptr = np.ones(3, np.float32), np.array([0, 3], np.int32)
image = evqr_kernels.bin_events(one, one, one, ptr, shape=(3, 3), backend='warp')
assert (image == evqr_kernels.bin_events(one, one, one, ptr, shape=(3, 3), backend='numpy')).all()
print(evqr_kernels.__version__, image.sum())
"""
    assert python(code).split()[-2:] == [metadata.version("evqr"), "3.0"]


@pytest.mark.parametrize("package", ["evqr", "evqr_kernels"])
def test_packages_are_typed(package):
    assert (resources.files(package) / "py.typed").is_file()


def test_demo_recording_is_small():
    assert 10_000 < len((resources.files("evqr") / "data" / "demo.h5").read_bytes()) < 400_000
