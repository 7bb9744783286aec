"""The house: what stands on what.  Read from the source, so that an import inside a function counts too."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

FLOORS = (
    # from the ground up; what stands on one floor does not know what stands on those above it
    ("errors", "extras", "reason", "values", "clock", "symbology"),
    ("config", "sensor_profile"),
    ("events", "motion", "geometry", "symbol"),
    ("recording", "simulate", "workspace", "device"),
    ("fit",),
    ("search", "launched", "grade"),
    ("solver",),
    ("solvers", "work", "seen", "results"),
    ("stream",),
    ("offline",),
    ("many", "output", "demo", "line", "calibrate"),
    ("archive", "sinks", "live"),
    ("page",),
    ("service",),
    ("cli",),
    ("paper",),
    ("main",),
    ("__main__",),
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}

MOST_LINES = 600
"""Of a file: it holds one concept."""


def modules(package):
    """Dotted names of a package's modules, with their files."""
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


SOURCES = {name: path for package in ("evqr", "evqr_kernels") for name, path in modules(package)}


def imports(name, path):
    """Modules of this repository that a module imports, wherever in it."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found = [f"{module}.{alias.name}" for alias in node.names]
        else:
            continue
        for dotted in found:
            while dotted and dotted not in SOURCES:
                dotted = dotted.rpartition(".")[0]
            if dotted and dotted != name:
                yield dotted


IMPORTS = {name: sorted(set(imports(name, path))) for name, path in SOURCES.items()}


def room(name):
    """The first name below evqr; "" for the package itself, which only says where names are."""
    return name.split(".")[1] if "." in name else ""


def test_every_room_has_a_floor():
    assert {room(name) for name in SOURCES if name.startswith("evqr.")} == set(FLOOR)


@pytest.mark.parametrize("name", [name for name in SOURCES if name.startswith("evqr.")])
def test_nothing_imports_from_a_floor_above_its_own(name):
    above = [
        other
        for other in IMPORTS[name]
        if other.startswith("evqr.") and FLOOR[room(other)] > FLOOR[room(name)]
    ]
    assert not above, f"{name} imports {', '.join(above)}"


def test_the_kernels_import_nothing_of_the_reader():
    wrong = {name: to for name in IMPORTS for to in IMPORTS[name] if name.split(".")[0] == "evqr_kernels"}
    assert not {name: to for name, to in wrong.items() if to.split(".")[0] == "evqr"}


def test_nothing_of_the_product_imports_the_paper():
    users = {name for name in IMPORTS if any(to.startswith("evqr.paper") for to in IMPORTS[name])}
    assert {name for name in users if room(name) != "paper"} <= {"evqr.main"}


def in_or_behind_a_circle(graph):
    """What is left when those without imports, or with imports of such only, have gone, one after another."""
    left = dict(graph)
    while free := {name for name, needs in left.items() if not (needs - {name}) & left.keys()}:
        left = {name: needs for name, needs in left.items() if name not in free}
    return sorted(left)


def test_there_is_no_circle_of_modules():
    lazy = {"evqr", "evqr_kernels"}  # they say where names are, and import them when they are asked for
    assert not in_or_behind_a_circle(
        {name: set(IMPORTS[name]) - lazy for name in IMPORTS if name not in lazy}
    )


def test_there_is_no_circle_of_rooms():
    rooms = {name: set() for name in FLOOR}
    for name in IMPORTS:
        if name.startswith("evqr."):
            rooms[room(name)] |= {room(to) for to in IMPORTS[name] if to.startswith("evqr.")}
    assert not in_or_behind_a_circle(rooms)


def test_a_circle_would_be_seen():
    assert in_or_behind_a_circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["a", "b", "c"]


def test_no_file_holds_more_than_one_concept_could_need():
    files = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split() or [str(path.relative_to(ROOT)) for path in ROOT.rglob("*.py")]
    lengths = {file: len((ROOT / file).read_text(encoding="utf-8").splitlines()) for file in files}
    assert not {file: lines for file, lines in lengths.items() if lines > MOST_LINES}


def test_the_reader_loads_without_the_paper():
    script = (
        "import sys, evqr.offline, evqr.cli.commands; print([m for m in sys.modules if 'evqr.paper' in m])"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_the_reader_loads_nothing_that_takes_long_before_it_is_needed():
    slow = (
        "warp",
        "h5py",
        "segno",
        "zxingcpp",
        "ssl",
        "email.message",
        "importlib.metadata",
        "urllib.request",
    )
    script = f"import sys, numpy, evqr.offline; print([name for name in {slow} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
