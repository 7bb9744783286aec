"""Pages say what the code says: nothing is missing, nothing is stale, every link leads somewhere."""

import importlib
import inspect
import json
import re
import sys
from pathlib import Path

import pytest
from sample_results import LINE, WINDOW, no_read_result, read_result

import evqr
import evqr_kernels
from evqr import errors
from evqr.output.records import result_records
from evqr.reason import Reason

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = [*PAGES, *sorted(ROOT.glob("*.md"))]

LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")


def text_of(name):
    return (DOCS / name).read_text(encoding="utf-8")


def rows(text):
    """Cells of the rows of all tables, without their heads."""
    for line in text.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) > 1 and not set("".join(cells)) <= set("-"):
            yield cells


def tools():
    """The modules that make pages."""
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        return importlib.import_module("pages"), importlib.import_module("build_site")
    finally:
        sys.path.remove(str(ROOT / "tools"))


MADE, SITE = tools()


@pytest.mark.parametrize("name", sorted(MADE.pages()))
def test_what_is_made_of_code_is_what_the_code_says(name):
    assert text_of(name) == MADE.pages()[name], "run python tools/pages.py"


@pytest.mark.parametrize("module", [evqr, evqr.simulate, evqr_kernels], ids=lambda module: module.__name__)
def test_every_public_name_is_documented_once(module):
    told = "\n".join(text_of(f"reference/{name}.md") for name in ("python", "simulator", "kernels"))
    directives = re.findall(
        rf"^::: {re.escape(module.__name__)}\.(\w+)$(?!\n    options)", told, re.MULTILINE
    )
    elsewhere = {*evqr.config.__all__, "simulate"} if module is evqr else set()
    assert sorted(directives) == sorted(set(module.__all__) - elsewhere)


def test_every_setting_is_on_its_page():
    named = re.findall(r"^## (\w+)$", text_of("reference/settings.md"), re.MULTILINE)
    assert sorted(named) == sorted({*evqr.config.__all__, "Symbology"} - {"Settings"})


def test_every_reason_says_what_to_do():
    told = {cells[0]: cells[1:] for cells in rows(text_of("reference/errors.md").split("## Reasons")[1])}
    assert {f"`{reason}`" for reason in Reason} == set(told) - {"code"}
    for reason in Reason:
        text, advice = told[f"`{reason}`"]
        assert text == reason.text and len(advice) > 20, reason


def test_every_error_says_what_to_do():
    page = text_of("reference/errors.md").split("## Reasons")[0]
    told = {cells[0].strip("`"): cells for cells in rows(page) if cells[0].startswith("`")}
    ours = {
        name: value for name, value in vars(errors).items()
        if inspect.isclass(value) and issubclass(value, Exception)
    }  # fmt: skip
    kernels = {"KernelError", "BackendUnavailable", "OperationRefused"}
    assert set(told) == set(ours) | kernels
    for name, value in ours.items():
        assert told[name][1] == f"`{value.reason}`", name
        assert len(told[name][3]) > 20, name
    assert all(len(told[name][2]) > 20 for name in kernels)


def test_every_exit_status_is_told():
    from evqr.cli import options

    page = text_of("reference/errors.md").split("## Errors")[0]
    statuses = {value for name, value in vars(options).items() if name.isupper() and isinstance(value, int)}
    assert {int(cells[0]) for cells in rows(page) if cells[0].isdigit()} == statuses


@pytest.mark.parametrize(
    ("heading", "record"),
    [
        ("A reading", result_records(read_result())[0]),
        ("Nothing read, and errors", result_records(no_read_result())[0]),
        ("A window", WINDOW.to_dict()),
        ("A window", WINDOW.to_dict()["codes"][0]),
        *(("Records of a line", record.to_dict()) for record in LINE),
    ],
)
def test_every_key_of_a_record_is_told(heading, record):
    section = text_of("reference/records.md").split(f"## {heading}\n")[1].split("\n## ")[0]
    told = {key for cells in rows(section) for key in re.findall(r"`(\w+)`", cells[0])}
    assert set(record) <= told, set(record) - told
    assert json.dumps(record)


def test_every_extra_is_told():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    told = {
        name for cells in rows(text_of("reference/install.md")) for name in re.findall(r"`(\w+)`", cells[0])
    }
    assert told == set(project["optional-dependencies"])
    command = re.compile(r'install (?:-q )?(?:-e )?"(?:evqr|\.)\[([\w,]+)\]"')
    named = [names for path in TEXTS for names in command.findall(path.read_text(encoding="utf-8"))]
    asked = {name for names in named for name in names.split(",")}
    assert asked and asked <= set(project["optional-dependencies"])


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_to_a_file_leads_there(page):
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        path = link.partition("#")[0]
        if path and "://" not in link:
            assert (page.parent / path).exists(), f"{page.name}: {link}"


def test_every_page_is_in_the_menu():
    project = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    menu = re.findall(r"[\w/.-]+\.md", json.dumps(project["nav"]))
    assert sorted(menu) == sorted(str(path.relative_to(DOCS).as_posix()) for path in PAGES)
    assert project["theme"]["font"] is False


def test_readme_is_short_and_its_picture_small():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 120
    assert (DOCS / "images" / "demo.png").stat().st_size < 150_000


def test_the_changelog_has_the_form_it_says():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    parts = re.findall(r"^### (.*)$", text, re.MULTILINE)
    assert set(parts) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert len(parts) == len(set(parts)) * len(re.findall(r"^## ", text, re.MULTILINE))
    assert re.findall(r"<!-- --8<-- \[(\w+):entries\] -->", text) == ["start", "end"]


def test_the_citation_is_of_this_version():
    assert f"\nversion: {evqr.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_workflow_names_steps_of_ci_run():
    steps = re.search(r"^STEPS=\((.*)\)$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    assert steps
    known = {*steps[1].split(), "wheels"}
    workflow = (ROOT / ".github" / "workflows" / "checks.yml").read_text(encoding="utf-8")
    named = [
        name for line in re.findall(r"bash \.ci/run (.*)$", workflow, re.MULTILINE) for name in line.split()
    ]
    assert set(named) == known - {"scores"}  # which are for recordings beside the clone


def test_warnings_of_a_build_are_seen():
    good = "Build started\n\x1b[32mNo issues found\x1b[0m\nBuild finished in 5.02s\n"
    assert not SITE.unusual(good)
    assert SITE.unusual(good + "griffe: evqr/many.py:44: Parameter 'a' does not appear\n")


@pytest.mark.parametrize(
    "text",
    [
        '<script src="https://cdn.example/a.js"></script>',
        '<link rel="stylesheet" href="//fonts.example/b.css">',
        "<link href=https://fonts.example rel=preconnect crossorigin>",
        "a { background: url(https://cdn.example/c.png) }",
        '@import "https://cdn.example/d.css";',
    ],
)
def test_what_is_fetched_from_elsewhere_is_seen(text):
    assert SITE.remote(text)
    assert not SITE.remote('<a href="https://example.org">x</a><script src="assets/a.js"></script>')


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_of_a_table_have_as_many_cells_as_its_head(page):
    for table in re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8"), re.MULTILINE):
        counts = [len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()]
        assert len(set(counts)) == 1, f"{page.name}: {table.splitlines()[counts.index(max(counts))]}"
