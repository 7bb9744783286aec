"""The documentation of the operations: complete, and true where the code tells."""

import importlib
import inspect
import re
from dataclasses import dataclass

import pytest

import evqr_kernels
from evqr_kernels import SplatConfig, differentiable, ops

from .test_batches import ATOMIC

SECTIONS = ("Parameters", "Returns", "Raises", "See Also", "Notes")
ARRAY = re.compile(r"\(.+\) (float \[.+\]|int32)")
SCALAR = {"float": re.compile(r"float \[.+\]"), "int": re.compile(r"int( \[.+\])?")}
CHECKED = re.compile(r'checks\.(?:at_least|index)\("(\w+)"')


@dataclass
class Entry:
    kind: str
    text: str


def sections(doc):
    """Text of each section of a docstring."""
    parts = re.split(rf"^({'|'.join(SECTIONS)})\n-+\n", inspect.cleandoc(doc), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def entries(doc, section):
    """Give what a section of a docstring says of each name."""
    found = {}
    parts = re.split(r"^(\S.*)\n", sections(doc).get(section, ""), flags=re.MULTILINE)
    for head, text in zip(parts[1::2], parts[2::2], strict=True):
        names, _, kind = head.partition(" : ")
        for name in names.split(", "):
            found[name] = Entry(kind, " ".join(text.split()))
    return found


def resolved(name, entry):
    """Follow "As in `operation`" to the operation that describes the parameter."""
    while not entry.kind and (other := re.match(r"As in `(\w+)`", entry.text)):
        entry = entries(getattr(evqr_kernels, other[1]).__doc__, "Parameters").get(name, Entry("", ""))
    return entry


def parameter_faults(function, doc):
    documented, parameters = entries(doc, "Parameters"), inspect.signature(function).parameters
    faults = [f"{name}: not documented" for name in parameters.keys() - documented.keys()]
    faults += [f"{name}: no parameter" for name in documented.keys() - parameters.keys()]
    for name, entry in documented.items():
        entry = resolved(name, entry)
        annotation = getattr(parameters.get(name), "annotation", "")
        wanted = SCALAR.get(annotation, re.compile("[^ ].*"))
        if annotation.startswith(("Floats", "Ints")):
            wanted = ARRAY
            if entry.kind.endswith("int32") != annotation.startswith("Ints"):
                faults.append(f"{name}: wrong dtype in {entry.kind!r}")
        if not wanted.fullmatch(entry.kind) or not entry.text:
            faults.append(f"{name}: {entry.kind!r} is not all of shape, dtype and unit, or nothing is said")
    return faults


def result_faults(function, doc):
    documented = entries(doc, "Returns")
    annotated = re.findall("Floats|Ints", str(inspect.signature(function).return_annotation))
    described = ["Ints" if entry.kind.endswith("int32") else "Floats" for entry in documented.values()]
    faults = [] if described == annotated else [f"returns {annotated}, documents {described}"]
    return faults + [
        f"{name}: {entry.kind!r} is not all of shape, dtype and unit, or nothing is said"
        for name, entry in documented.items()
        if not ARRAY.fullmatch(entry.kind) or not entry.text
    ]


def faults(function, doc):
    """What is missing in the documentation of an operation, or wrong."""
    found = parameter_faults(function, doc) + result_faults(function, doc)
    raised = entries(doc, "Raises")
    if not raised.keys() & {"ValueError", "TypeError"}:
        found.append("no errors")
    refusals = " ".join(entry.text for entry in raised.values())
    for name in CHECKED.findall(inspect.getsource(function)):
        if not re.search(rf"\b{name}\b", refusals):
            found.append(f"{name}: checked, and not among the errors")
    notes = sections(doc).get("Notes", "")
    if not re.search(r"^Cost: (.|\n(?!\n))*[Ss]cratch", notes, re.MULTILINE):
        found.append("no cost, scratch included")
    how = "atomics" if function.__name__ in ATOMIC else "bit for bit"
    if not re.search(rf"^Determinism: {how}\b", notes, re.MULTILINE):
        found.append(f"determinism is not {how}")
    return found


@pytest.mark.parametrize("op", ops.__all__)
def test_operation(op):
    function = getattr(ops, op)
    assert not faults(function, function.__doc__)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("    weight : ", "    mass : ", "weight: not documented"),
        ("    weight : ", "    mass : ", "mass: no parameter"),
        ("(E,) float [px]", "float [px]", "x: 'float [px]' is not all"),
        ("(E,) float [weight]", "(E,) float", "weight: '(E,) float' is not all"),
        ("(B + 1,) int32", "(B + 1,) float [1]", "window_ptr: wrong dtype"),
        ("reduction : float [px]", "reduction : float", "reduction: 'float' is not all"),
        ("    image : (B, Y, X) float [weight]\n", "    (B, Y, X)\n", "'' is not all"),
        ("Raises\n    ------", "Raised\n    ------", "no errors"),
        ("or ``reduction`` is", "or it is", "reduction: checked, and not among the errors"),
        ("Cost:", "Price:", "no cost"),
        ("; no scratch", "", "no cost"),
        ("Determinism: atomics", "Determinism: bit for bit", "determinism is not atomics"),
    ],
)
def test_faults_are_found(old, new, fault):
    doc = ops.bin_events.__doc__
    assert old in doc
    assert any(fault in found for found in faults(ops.bin_events, doc.replace(old, new)))


def rule_of(op):
    """What the frameworks are told of an operation, with some settings."""
    rule = getattr(differentiable, op)
    settings = {"shape": (2, 3), "cfg": SplatConfig(), "sigma": 0.0}
    return rule(**{name: settings[name] for name in inspect.signature(rule).parameters})


@pytest.mark.parametrize("framework", ["torch", "jax"])
def test_functions_of_a_framework(framework):
    """They say what differs: the rest is said of the operation of the same name."""
    pytest.importorskip(framework)
    module = importlib.import_module(f"evqr_kernels.{framework}")
    for op in module.__all__:
        function = getattr(module, op)
        doc = function.__doc__
        documented = entries(doc, "Parameters")
        assert documented.keys() == inspect.signature(function).parameters.keys()
        there = entries(getattr(ops, op).__doc__, "Parameters").keys()
        assert {name for name, entry in documented.items() if entry.text == "As there."} <= there
        assert all(ARRAY.fullmatch(entry.kind) for entry in entries(doc, "Returns").values())
        differentiable_in = re.search(r"Differentiable in (.*)", sections(doc)["Returns"])[1].split(";")[0]
        rule = rule_of(op)
        assert set(re.findall(r"``(\w+)``", differentiable_in)) == {*rule.varied, rule.added} - {None}
        (adjoint,) = re.findall(r"`evqr_kernels\.(\w+)`", sections(doc)["Notes"])
        assert adjoint in ops.__all__
