"""The documentation of the operations: complete, and true where the code tells."""

import dataclasses
import importlib
import inspect
import re
from dataclasses import dataclass

import pytest

import evqr_kernels
from evqr_kernels import OPERATIONS, backend, differentiable, interop, operation, ops, registry

from .test_batches import ATOMIC

SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "See Also", "Notes")
ARRAY = re.compile(r"\(.+\) (float \[.+\]|int32|uint16|uint32)")
KINDS = {"Floats": r"float", "Ints": r"\bint32$", "Pixels": "uint16$", "Stamps": "uint32$"}
SCALAR = {"float": re.compile(r"float \[.+\]"), "int": re.compile(r"int( \[.+\])?")}


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
        if annotation.startswith(tuple(KINDS)):
            wanted = ARRAY
            if not re.search(KINDS[annotation.split()[0]], entry.kind):
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


def refused(of):
    """Settings and inputs whose values are looked at."""
    checked = [setting for setting in of.settings if setting.least is not None]
    return [argument.name for argument in (*checked, *(array for array in of.inputs if array.index))]


def faults(function, doc):
    """What is missing in the documentation of an operation, or wrong."""
    found = parameter_faults(function, doc) + result_faults(function, doc)
    raised = entries(doc, "Raises")
    if not raised.keys() & {"ValueError", "TypeError"}:
        found.append("no errors")
    refusals = " ".join(entry.text for entry in raised.values())
    for name in refused(OPERATIONS[function.__name__]):
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
        rule = differentiable.Rule(op, ())
        if not rule.differentiable:
            assert "Not differentiable." in sections(doc)["Returns"]
            continue
        differentiable_in = re.search(r"Differentiable in (.*)", sections(doc)["Returns"])[1].split(";")[0]
        assert set(re.findall(r"``(\w+)``", differentiable_in)) == {*rule.varied, *rule.added}
        (adjoint,) = re.findall(r"`evqr_kernels\.(\w+)`", sections(doc)["Notes"])
        assert adjoint in ops.__all__


CLASSES = [
    evqr_kernels.KernelBackend,
    evqr_kernels.Columns,
    differentiable.Rule,
    *(kind for _, kind in inspect.getmembers(operation, inspect.isclass) if dataclasses.is_dataclass(kind)),
]
FUNCTIONS = [
    *(getattr(evqr_kernels, name) for name in evqr_kernels.__all__ if name not in ops.__all__),
    registry.require_device,
    interop.host_view,
    interop.warp_view,
    *(getattr(backend.KernelBackend, name) for name in vars(backend.KernelBackend) if name[0] != "_"),
]
FUNCTIONS = [function for function in FUNCTIONS if inspect.isfunction(function)]
RAISES = ("empty", "from_host", "needs_compile", "load")  # of a protocol there is no code that tells


def entry_faults(doc, section, names):
    """What is missing or too much in a section that describes names, each with a kind and a sentence."""
    found = entries(doc, section)
    faults = [f"{name}: not in {section}" for name in names if name not in found]
    faults += [f"{name}: in {section}, and not there" for name in found if name not in names]
    return faults + [
        f"{name}: without a kind or a sentence" for name, e in found.items() if not e.kind or not e.text
    ]


def function_faults(function, doc):
    """As of operations, for whatever else is public."""
    signature = inspect.signature(function)
    names = [name.lstrip("*") for name in signature.parameters if name not in ("self",)]
    documented = doc.replace("**sizes", "sizes")
    found = entry_faults(documented, "Parameters", names)
    returned = entries(doc, "Returns")
    if (str(signature.return_annotation) == "None") == bool(returned):
        found.append("what it returns")
    found += [
        f"{name}: without a kind or a sentence" for name, e in returned.items() if not e.kind or not e.text
    ]
    raises = "raise " in inspect.getsource(function) or function.__name__ in RAISES
    if raises and not entries(doc, "Raises"):
        found.append("no errors")
    return found


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__qualname__)
def test_function(function):
    assert not function_faults(function, inspect.getdoc(function))


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_class(kind):
    """Its fields are its attributes, in their order, and public methods say what they do."""
    if dataclasses.is_dataclass(kind):
        inherited = {f.name for base in kind.__mro__[1:-1] for f in dataclasses.fields(base)}
        names = [field.name for field in dataclasses.fields(kind) if field.name not in inherited]
        assert list(entries(inspect.getdoc(kind), "Attributes")) == names
    else:
        names = list(kind.__annotations__)
    assert not entry_faults(inspect.getdoc(kind), "Attributes", names)
    methods = [value for name, value in vars(kind).items() if name[0] != "_" and inspect.isroutine(value)]
    assert all(inspect.getdoc(method) for method in methods)


def test_every_public_name_is_documented():
    """Operations, functions and classes are looked at above; what is left are errors and the table."""
    known = {function.__name__ for function in FUNCTIONS} | {kind.__name__ for kind in CLASSES}
    rest = set(evqr_kernels.__all__) - known - set(ops.__all__) - {"OPERATIONS"}
    assert all(issubclass(getattr(evqr_kernels, name), evqr_kernels.KernelError) for name in rest)
    assert all(getattr(evqr_kernels, name).__doc__ for name in rest)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("    op : str", "    operation : str", "op: not in Parameters"),
        ("    op : str", "    operation : str", "operation: in Parameters, and not there"),
        ("op : str", "op", "op: without a kind"),
        ("Returns\n", "Results\n", "what it returns"),
        ("Raises\n", "Raised\n", "no errors"),
    ],
)
def test_faults_of_functions_are_found(old, new, fault):
    doc = evqr_kernels.make_scratch.__doc__
    assert old in doc
    faults = function_faults(evqr_kernels.make_scratch, inspect.cleandoc(doc.replace(old, new)))
    assert any(fault in found for found in faults)
