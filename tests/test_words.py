"""One word for one thing: what has a better name now may not come back as an identifier."""

import ast
import re
from pathlib import Path

import pytest

import evqr

ROOT = Path(evqr.__file__).parents[1]

OLD = {
    "sighting": "Detection",
    "sightings": "detections",
    "unseen": "NotFound",
    "closer": "Refinement, refined",
    "look": "find, search",
    "looks": "passes",
    "looked": "searched",
    "lookup": "find",
    "tally": "Fusion",
    "gone": "lost",
    "told": "declared",
    "stage": "align, solve_modules",
}
"""Parts of identifiers, and what is said in their place."""

OLD_NAMES = {
    "Passes": "StreamScheduler",
    "_settle": "merge_with_earlier",
    "LookConfig": "FinderConfig",
    "StageOneConfig": "AlignConfig",
    "StageTwoConfig": "ModulesConfig",
}

IN_PERF = {"rival": "baseline", "rivals": "baselines", "wanted": "target"}

ALLOWED = {
    "stage_one_iterations", "stage_two_iterations",  # keys of records, which stay
    "StageClock", "stage", "stages",  # a stage of the reader, of any number
    "LookupError",  # Python's
}  # fmt: skip

FILES = [path for room in ("evqr", "perf") for path in sorted((ROOT / room).rglob("*.py"))]


def identifiers(tree):
    """Names that a module gives to things: of functions, classes, arguments, variables and attributes."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Name):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute):
            yield node.attr, node.lineno
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value.lineno
        elif isinstance(node, ast.alias):
            yield (node.asname or node.name).rpartition(".")[2], node.lineno


def parts(name):
    """Words that a name is made of, in small letters."""
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def old_words(tree, old):
    for name, line in identifiers(tree):
        if name in OLD_NAMES:
            yield f"line {line}: {name} is {OLD_NAMES[name]} now"
        for part in parts(name):
            if part in old and name not in ALLOWED:
                yield f"line {line}: {name}: {part} is {old[part]} now"


def identity_as_a_signal(tree):
    """``found is seen.found`` says what happened by which object came back; None may be asked for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and isinstance(node.left, ast.Name) and node.left.id == "found":
            for operator, other in zip(node.ops, node.comparators, strict=True):
                if isinstance(operator, (ast.Is, ast.IsNot)) and not isinstance(other, ast.Constant):
                    yield f"line {node.lineno}: {ast.unparse(node)} asks which object it is"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_old_word_is_an_identifier(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    in_perf = path.relative_to(ROOT).parts[0] == "perf"
    found = [*old_words(tree, {**OLD, **IN_PERF} if in_perf else OLD), *identity_as_a_signal(tree)]
    assert not found, "\n" + "\n".join(dict.fromkeys(found))


@pytest.mark.parametrize(
    ("code", "word"),
    [
        ("class Sighting: ...", "Detection"),
        ("def _look_closer(): ...", "Refinement"),
        ("a.looks[0]", "passes"),
        ("f(told=1)", "declared"),
        ("from x import Passes", "StreamScheduler"),
        ("if found is seen.found: ...", "asks which object"),
        ("cfg.stage_one", "align"),
    ],
)
def test_old_words_are_found(code, word):
    tree = ast.parse(code)
    assert any(word in fault for fault in [*old_words(tree, OLD), *identity_as_a_signal(tree)])


@pytest.mark.parametrize(
    "code", ["outlook = 1", "cfg.passes", "if found is None: ...", "stage_one_iterations = 3"]
)
def test_other_words_are_left_alone(code):
    tree = ast.parse(code)
    assert not [*old_words(tree, OLD), *identity_as_a_signal(tree)]
