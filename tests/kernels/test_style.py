"""The rules for kernels, read from the syntax trees."""

import ast
import re
from pathlib import Path

import pytest

import evqr_kernels

PACKAGE = Path(evqr_kernels.__file__).parent
FILES = sorted(PACKAGE.glob("*_backend/*.py"))
MOST_PARAMETERS = 14
LONGER = {"align_poses": 15, "align_blocks": 15, "sum_equations": 24}
"""Kernels with more: some read a part of an image, another adds all arrays of two systems."""
MOST_LINES = 600


def decorated(tree, name):
    """Functions decorated with ``wp.<name>`` or ``ti.<name>``, called or not."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            for decorator in node.decorator_list:
                target = decorator.func if isinstance(decorator, ast.Call) else decorator
                if ast.unparse(target) in (f"wp.{name}", f"ti.{name}"):
                    yield node


def written_arrays(statement):
    """Names of arrays that a statement assigns an element of, or adds to atomically."""
    if isinstance(statement, ast.Call) and ast.unparse(statement.func) == "wp.atomic_add":
        yield ast.unparse(statement.args[0])
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    for target in targets:
        if isinstance(target, ast.Subscript):
            yield ast.unparse(target.value)


KERNELS = [
    pytest.param(kernel, id=f"{file.parent.name}-{kernel.name}")
    for file in FILES
    for kernel in decorated(ast.parse(file.read_text()), "kernel")
]


def test_kernels_are_found():
    names = {parameter.values[0].name for parameter in KERNELS}
    assert {"splat_events", "correlate_basis", "solve_windows", "render_code"} <= names


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_signature(kernel):
    arguments = kernel.args
    assert not arguments.defaults and not arguments.kw_defaults, "no defaults"
    assert not arguments.vararg and not arguments.kwarg and not arguments.kwonlyargs
    assert all(argument.annotation for argument in arguments.args), "every parameter is typed"
    assert len(arguments.args) <= LONGER.get(kernel.name, MOST_PARAMETERS)
    is_output = [argument.arg.endswith(("_out", "_inout")) for argument in arguments.args]
    assert any(is_output), "an output ends in _out or _inout"


@pytest.mark.parametrize("kernel", KERNELS)
def test_outputs_come_last(kernel):
    names = [argument.arg for argument in kernel.args.args]
    written = {name for statement in ast.walk(kernel) for name in written_arrays(statement)}
    assert all(name.endswith(("_out", "_inout")) for name in written & set(names)), "what is written says so"
    first_output = next(k for k, name in enumerate(names) if name.endswith(("_out", "_inout")))
    inputs_after = [name for name in names[first_output:] if not name.endswith(("_out", "_inout"))]
    assert not inputs_after, "outputs last"


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}-{file.name}")
def test_file(file):
    text = file.read_text()
    assert len(text.splitlines()) <= MOST_LINES
    assert ast.get_docstring(ast.parse(text))
    if file.parent.name != "numpy_backend":
        assert "from __future__ import annotations" not in text, (
            "kernel annotations are read when they are defined"
        )


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}-{file.name}")
def test_launchers_only_launch(file):
    """No allocation, host read-back or wait outside the files that own buffers."""
    if file.name in ("__init__.py", "arrays.py"):
        return
    calls = {
        ast.unparse(node.func) for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Call)
    }
    banned = {"wp.empty", "wp.zeros", "wp.full", "wp.synchronize", "wp.synchronize_device", "print"}
    banned |= {"wp.clone", "wp.copy", "ti.ndarray", "ti.field", "ti.sync"}
    assert not calls & banned
    methods = (".numpy", ".to_numpy", ".from_numpy", ".assign", ".fill_", ".contiguous")
    assert not [call for call in calls if call.endswith(methods)]


SYMBOLOGY = re.compile(r"\b(QR|finder|symbolog\w*|[Ss]tage (one|two)|Aztec|payload)\b", re.ASCII)


@pytest.mark.parametrize(
    "file", sorted(PACKAGE.rglob("*.py")), ids=lambda file: str(file.relative_to(PACKAGE))
)
def test_the_package_knows_no_symbology(file):
    """Kernels are for planar codes of any kind, and for whoever launches them."""
    assert not SYMBOLOGY.findall(file.read_text())
