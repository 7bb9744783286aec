"""One dialect of docstrings, NumPy's, that a generator can parse: known sections, every name told of.

All docstrings of evqr are read, from the source.  Those of what `evqr` and `evqr.simulate` export, with their
public methods, must be complete; of others a line is enough, but what has a section has all of it, and every
field of a record is described, unless it is private.
"""

import ast
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

import evqr

ROOT = Path(evqr.__file__).parent

SECTIONS = (
    "Parameters",
    "Attributes",
    "Returns",
    "Yields",
    "Raises",
    "See Also",
    "Notes",
    "References",
    "Examples",
)
ENTRIES = ("Parameters", "Attributes", "Returns", "Yields", "Raises")

ARRAY = re.compile(r"\(.*\) (bool|u?int\d*|float\d*|intp|number)\b.*|array-like.*")
UNITS = {
    "_us": "us",
    "_ms": "ms",
    "_px": "px",
    "_px_per_s": "px/s",
    "_px_ms": "px/ms",
    "_s": "s",
    "_deg": "deg",
}
"""Endings of names, and the unit in brackets that they ask for."""

EXPORTED = {
    (module, name)
    for place in (evqr, evqr.simulate)
    for name in place.__all__
    if (module := getattr(getattr(place, name), "__module__", None))
}
"""Module that defines it, and name, of all that users import."""


@dataclass
class Entry:
    kind: str
    text: str


def sections_of(doc):
    """Text of each section, by heading; what stands before the first is under ""."""
    parts = re.split(r"^(\S[^\n]*)\n-{3,}\n", doc, flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries_of(doc, section):
    """What a section says of each name; faults where it cannot be parsed."""
    found, faults = {}, []
    text = sections_of(doc).get(section)
    if text is None:
        return found, faults
    for block in re.split(r"^(?=\S)", text, flags=re.MULTILINE):
        if not block.strip():
            continue
        head, _, body = block.partition("\n")
        names, _, kind = head.partition(" : ")
        if not re.fullmatch(r"[*\w.`]+(, [*\w.`]+)*( \[[^\]]+\])?", names) and (
            section not in ("Returns", "Yields")
        ):
            faults.append(f"{section}: {head!r} is no entry")
        if re.search(r"\S {2,}\S", head):
            faults.append(f"{section}: {head!r} has its text on the same line")
        if not body.strip():
            faults.append(f"{section}: nothing is said of {head!r}")
        elif not re.match(r" {4}\S", body):
            faults.append(f"{section}: the text of {head!r} is not indented by four")
        for name in names.split(", ") if section not in ("Returns", "Yields") else [names]:
            found[name] = Entry(kind.strip(), " ".join(body.split()))
    return found, faults


def parameters_of(node):
    """Annotation by name, without self and cls."""
    arguments = node.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    found = {each.arg: each.annotation for each in every}
    found |= {f"*{arguments.vararg.arg}": None} if arguments.vararg else {}
    found |= {f"**{arguments.kwarg.arg}": None} if arguments.kwarg else {}
    return {name: kind for name, kind in found.items() if name not in ("self", "cls")}


def decorators(node):
    return {ast.unparse(each).partition("(")[0] for each in node.decorator_list}


def fields_of(node):
    """Annotation of each public field in the body of a class."""
    return {
        each.target.id: each.annotation
        for each in node.body
        if isinstance(each, ast.AnnAssign)
        and isinstance(each.target, ast.Name)
        and not each.target.id.startswith("_")
        and "ClassVar" not in ast.unparse(each.annotation)
    }


def is_record(node):
    return bool(decorators(node) & {"dataclass", "dataclasses.dataclass"}) or any(
        ast.unparse(base) == "NamedTuple" for base in node.bases
    )


def kind_faults(name, entry, annotation):
    if not entry.kind:
        return [f"{name}: no type"]
    faults = []
    if annotation is not None and "NDArray" in ast.unparse(annotation):
        if not ast.unparse(annotation).startswith(("NDArray", "'NDArray")):
            pass  # a tuple or a list of arrays is told in words
        elif not ARRAY.fullmatch(entry.kind):
            faults.append(f"{name}: {entry.kind!r} is not a shape and a dtype")
    ending = max((end for end in UNITS if name.endswith(end)), key=len, default=None)
    if (
        ending
        and f"[{UNITS[ending]}" not in entry.kind
        and not entry.kind.startswith(("bool", "as in ", "as for "))
    ):
        faults.append(f"{name}: {entry.kind!r} has no unit [{UNITS[ending]}]")
    return faults


def common_faults(doc):
    faults = [f"unknown section {name!r}" for name in sections_of(doc) if name and name not in SECTIONS]
    order = [SECTIONS.index(name) for name in sections_of(doc) if name in SECTIONS]
    if order != sorted(order):
        faults.append("sections are not in order")
    for section in ENTRIES:
        faults += entries_of(doc, section)[1]
    for name in entries_of(doc, "Raises")[0]:
        if not re.fullmatch(
            r"\w*(Error|Exception|Extra|Unavailable|Interrupt|StopIteration|StreamChoice)", name
        ):
            faults.append(f"Raises: {name!r} is no error")
    return faults


def described(doc, section, wanted, *, others=False):
    """Faults of a section that describes named things."""
    entries, _ = entries_of(doc, section)
    faults = [f"{section}: {name} is not described" for name in wanted if name not in entries]
    if not others:
        faults += [f"{section}: there is no {name}" for name in entries if name not in wanted]
    for name, entry in entries.items():
        faults += kind_faults(name, entry, wanted.get(name))
    return faults


def raised_in(node):
    """Errors that a function raises itself, by name."""
    found = set()
    for each in ast.walk(node):
        if isinstance(each, ast.Raise) and isinstance(each.exc, ast.Call):
            name = ast.unparse(each.exc.func)
            if re.fullmatch(r"\w*(Error|Extra)", name):
                found.add(name)
    return found


def function_faults(node, doc, complete):
    faults, sections = common_faults(doc), sections_of(doc)
    if "Attributes" in sections:
        faults.append("a function has no attributes")
    wanted = parameters_of(node)
    if "Parameters" in sections or (complete and wanted):
        faults += described(doc, "Parameters", wanted)
    if complete:
        gives = node.returns is not None and ast.unparse(node.returns) not in ("None", "NoReturn")
        if gives and not {"Returns", "Yields"} & sections.keys():
            faults.append("nothing is said of what it gives")
        silent = raised_in(node) - entries_of(doc, "Raises")[0].keys()
        faults += [f"Raises: {name} is not described" for name in sorted(silent)]
    return faults


def class_faults(node, doc):
    faults, sections = common_faults(doc), sections_of(doc)
    own = fields_of(node)
    if is_record(node) and own and ("Attributes" in sections or not node.name.startswith("_")):
        faults += described(doc, "Attributes", own, others=True)
    elif "Attributes" in sections:
        for name, entry in entries_of(doc, "Attributes")[0].items():
            faults += kind_faults(name, entry, None)
    if "Parameters" in sections:
        makes = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"]
        if not makes:
            faults.append("a class without __init__ has no parameters: fields are attributes")
        else:
            faults += described(doc, "Parameters", parameters_of(makes[0]))
    return faults


def documented(tree, exported, place=""):
    """Each docstring of a module: its place, the node, and whether it must be complete."""
    for node in tree.body:
        if isinstance(node, (ast.If, ast.Try)):
            continue
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and ast.get_docstring(node):
            api = (place or f"{node.name}.").split(".")[0] in exported
            public = not node.name.startswith("_")
            yield f"{place}{node.name}", node, api and public
        if isinstance(node, ast.ClassDef):
            yield from documented(node, exported, f"{place}{node.name}.")


def faults_of(node, complete=False):
    doc = ast.get_docstring(node)
    if isinstance(node, ast.ClassDef):
        return class_faults(node, doc)
    if decorators(node) & {"property", "cached_property"}:
        return common_faults(doc)
    return function_faults(node, doc, complete)


def exported_by(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return {name for of, name in EXPORTED if of == module}


FILES = sorted(ROOT.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_docstrings(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    faults = [
        f"{place}: {fault}"
        for place, node, complete in documented(tree, exported_by(path))
        for fault in faults_of(node, complete)
    ]
    assert not faults, "\n" + "\n".join(faults)


GOOD = '''
def read(source: str, t_us: int, *, q: NDArray[np.float32]) -> int:
    """Read it.

    Parameters
    ----------
    source : str
        A path.
    t_us : int [us]
        When.
    q : (V, U) float32
        Modules.

    Returns
    -------
    count : int
        How many.

    Raises
    ------
    ValueError
        There is none.
    """
    raise ValueError("no")
'''


def test_a_good_docstring_has_no_faults():
    assert not faults_of(ast.parse(GOOD).body[0], complete=True)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("    source : str\n        A path.\n", "", "source is not described"),
        ("source : str\n", "sauce : str\n", "there is no sauce"),
        ("source : str\n        A path.", "source   a path", "has its text on the same line"),
        ("        A path.\n", "", "nothing is said of 'source : str'"),
        ("        A path.", "      A path.", "is not indented by four"),
        ("source : str", "source", "source: no type"),
        ("int [us]", "int", "t_us: 'int' has no unit [us]"),
        ("(V, U) float32", "float32", "is not a shape and a dtype"),
        ("Raises\n    ------", "Raising\n    -------", "unknown section 'Raising'"),
        ("ValueError\n        There", "Nothing\n        There", "'Nothing' is no error"),
        ("    ValueError\n        There is none.\n", "", "ValueError is not described"),
        (
            "Returns\n    -------\n    count : int\n        How many.\n",
            "",
            "nothing is said of what it gives",
        ),
        ("Returns\n    -------", "Attributes\n    ----------", "a function has no attributes"),
    ],
)
def test_faults_are_found(old, new, fault):
    assert old in GOOD
    found = faults_of(ast.parse(GOOD.replace(old, new)).body[0], complete=True)
    assert any(fault in each for each in found), found


RECORD = '''
@dataclass
class A:
    """An A.

    Attributes
    ----------
    a : int
        One.
    """

    a: int
    b: int
'''


def test_a_field_without_a_word_is_found():
    (_, node, _), *_ = documented(ast.parse(RECORD), {"A"})
    assert faults_of(node) == ["Attributes: b is not described"]
