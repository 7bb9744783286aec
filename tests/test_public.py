"""What is public: every type that a public function takes or gives can be imported, from one place."""

import ast
import dataclasses
import inspect
import sys

import pytest
from test_architecture import SOURCES

import evqr
import evqr_kernels

PLACES = (evqr, evqr.simulate, evqr_kernels)
"""What users import from; the rest of the modules are how it is done."""

NOT_TYPES = {"T", "S", "K", "V"}


def public_of(module):
    """What a module exports that has annotations: its functions and classes."""
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.isfunction(value) or inspect.isclass(value):
            yield f"{module.__name__}.{name}", value


def functions_of(cls):
    """Public methods and properties of a class, and what makes it; those of its bases that are evqr's too."""
    for base in inspect.getmro(cls):
        if base.__module__.split(".")[0] not in ("evqr", "evqr_kernels"):
            continue
        for name, value in vars(base).items():
            if name.startswith("_") and name not in ("__init__", "__call__"):
                continue
            if isinstance(value, property):
                value = value.fget
            value = inspect.unwrap(getattr(value, "func", getattr(value, "__func__", value)))
            if inspect.isfunction(value) and not (name == "__init__" and dataclasses.is_dataclass(base)):
                yield name, value


def annotations_of(value):
    """Annotations in the source of a function, or of all that is public of a class, each with its place."""
    if inspect.isfunction(value):
        yield from ((f"({name})", text) for name, text in value.__annotations__.items())
        return
    for base in inspect.getmro(value):
        if base.__module__.split(".")[0] in ("evqr", "evqr_kernels"):
            fields = inspect.get_annotations(base).items()
            yield from ((f".{name}", text) for name, text in fields if not name.startswith("_"))
    for name, function in functions_of(value):
        yield from ((f".{name}({of})", text) for of, text in function.__annotations__.items())


def types_in(annotation):
    """Names in an annotation."""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", repr(annotation))
    for node in ast.walk(ast.parse(text, mode="eval")):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            try:
                yield from types_in(node.value)  # a type in quotes, or the member of a Literal
            except SyntaxError:
                pass


def own_types():
    """Names of the classes and of the aliases for types that evqr and its kernels define."""
    names = set()
    for path in SOURCES.values():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                names.add(node.name)
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            for target in targets:
                if isinstance(target, ast.Name) and target.id.lstrip("_")[:1].isupper():
                    names.add(target.id)
    return {name for name in names if not name.isupper()}


def is_own(value):
    """Whether it is of these packages; what is imported for type checks only is not there to be asked."""
    return value is None or getattr(value, "__module__", "evqr").split(".")[0] in ("evqr", "evqr_kernels")


PUBLIC = {name for module in PLACES for name in module.__all__}
OWN = own_types()
INTERNAL = {
    "Lag", "Count", "Positive", "NotNegative", "Share", "Samples", "Range", "Ascending",  # ranges of settings
    "NotEmpty",
    "Array", "Floats", "Ints",  # arrays of any kind, see evqr_kernels.ops
    "Asked", "Source",  # what `open_recording` makes a `Recording` of
    "_S",
}  # fmt: skip


@pytest.mark.parametrize(
    "value", [pytest.param(value, id=name) for module in PLACES for name, value in public_of(module)]
)
def test_every_type_of_a_public_name_is_public(value):
    there = vars(sys.modules[value.__module__])
    missing = {
        f"{place}: {name}"
        for place, annotation in annotations_of(value)
        for name in types_in(annotation)
        if name in OWN and name not in PUBLIC and name not in INTERNAL and is_own(there.get(name))
    }
    assert not missing, sorted(missing)


def test_a_type_that_is_not_public_is_found():
    def function(window: "Window") -> "list[_Search]": ...  # noqa: F821

    (found,) = [set(types_in(text)) for _, text in list(annotations_of(function))[:1]]
    assert found == {"Window"} and "Window" in OWN
    assert "StageClock" in OWN and "StageClock" not in PUBLIC


def test_there_is_one_place_for_each_name():
    """No name is exported twice, and a public class says that it is of the module that holds it."""
    names = [name for module in PLACES for name in module.__all__]
    twice = {name for name in names if names.count(name) > 1}
    assert twice <= {"simulate"}  # the module, and the function in it


def test_dir_shows_public_names_only():
    assert dir(evqr) == sorted([*evqr.__all__, "__version__"])
    assert not any(name.startswith("_") for name in dir(evqr) if name != "__version__")


@pytest.mark.parametrize("name", [name for name in evqr.__all__ if name != "simulate"])
def test_star_import_and_help_find_it(name):
    value = getattr(evqr, name)
    assert inspect.getmodule(value) is not None or name == "TimeUnit"


def test_every_error_of_the_package_is_an_evqr_error():
    """What `evqr` defines to be raised is public and has one base; misuse is TypeError or ValueError."""
    raised = set()
    for name, path in SOURCES.items():
        if name.startswith("evqr."):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    bases = {ast.unparse(base) for base in node.bases}
                    if any(base.endswith(("Error", "Exception", "Extra")) for base in bases):
                        raised.add(node.name)
    assert raised <= set(evqr.__all__)
    for name in raised:
        assert issubclass(getattr(evqr, name), evqr.EvqrError)
