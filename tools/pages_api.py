"""The pages of the API: lists by subject, of names with the first line of their documentation.

Below each list stand the directives that the site's generator (mkdocstrings) puts the documentation in the
place of.
"""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import dataclass
from typing import Any

import evqr
import evqr_kernels
from evqr_kernels import ops


@dataclass(frozen=True)
class Page:
    """A page: its title, what is said first, and the module whose names it tells of."""

    title: str
    introduction: str
    module: str
    general: tuple[tuple[str, str], ...] = ()
    """Sections before the lists, each with the module whose own documentation stands there."""


SUBJECTS = {
    "Reading": ("evqr.offline", "evqr.many"),
    "Results": ("evqr.results",),
    "Lines": ("evqr.line",),
    "What a code says": ("evqr.symbol.payload", "evqr.symbol.messages", "evqr.symbol.gs1"),
    "Recordings": ("evqr.recording",),
    "Pictures": ("evqr.output",),
    "Errors and reasons": ("evqr.errors", "evqr.reason"),
    "Settings": ("evqr.config",),
    "Stages, one by one": ("evqr",),
    "Symbols": ("evqr.symbol.space", "evqr.symbology"),
}
"""Where the names of a subject come from: the longest of these beginnings counts."""

GROUPS = {
    "Events and images": ("events", "grids", "images"),
    "Planar codes": ("codes", "normal", "render"),
}
"""The operations for everyone, then those for readers of codes: modules of `evqr_kernels.ops`."""

API_PAGES = {
    "python": Page(
        title="evqr in Python",
        introduction="""\
What `import evqr` gives. `help(evqr.read_codes)`, say, prints the same without the site. Importing loads no
backend, no decoder and no file library; each comes when it is first used. Results are frozen values with
read-only arrays: they compare, hash, pickle and print, and have `to_dict()` and `to_json()`. Settings have a
[page of their own](settings.md), errors and reasons [too](errors.md), and what names, shapes and units mean
is on [Conventions](conventions.md). `evqr.simulate` is [the simulator](simulator.md).""",
        module="evqr",
    ),
    "simulator": Page(
        title="The simulator",
        introduction="""\
`evqr.simulate` draws a textured object with printed codes, moves it past an event camera, and gives the
events with their truth, as `from evqr.simulate import simulate`, say. `evqr simulate` is the
[command](commands.md#evqr-simulate).""",
        module="evqr.simulate",
    ),
    "kernels": Page(
        title="The kernels",
        introduction="""\
`evqr_kernels` knows nothing of codes: arrays in, arrays out, a slow plain NumPy specification beside fast
backends in Warp and Taichi. Its functions check their arguments and may allocate; the methods of
`get_backend(...)` with the same names write to buffers that you own, unchecked. Those that have an adjoint
are differentiable functions in `evqr_kernels.torch` and `evqr_kernels.jax` too (extras `torch`, `jax`).
Operations on events and images, for everyone, come first, those on planar codes after them. A
tutorial is [A front end of your own](../tutorials/front-end.md). `help(evqr_kernels.ops)`, say, prints what
stands here without the site.""",
        module="evqr_kernels",
        general=(
            ("The package, and what of it stays", "evqr_kernels"),
            ("What holds for every operation", "evqr_kernels.ops"),
            ("In PyTorch", "evqr_kernels.torch"),
            ("In JAX", "evqr_kernels.jax"),
        ),
    ),
}

WITHOUT_MEMBERS = ("    options:", "      members: false", "      show_root_heading: false")

CONSTANTS = {
    "PRESETS": "Sensors by name: clean, slow, fast, hard.",
    "PRESET_SPEEDS_PX_MS": "Speed in the image that goes with each of them [px/ms].",
    "OPERATIONS": "The table of all operations: arguments, shapes, checks, adjoints, by name.",
    "TimeUnit": "Name of a unit of time stamps: s, ms, us or ns.",
}
"""What is no class and no function has no docstring to take a line from."""


def names_of(page: Page) -> dict[str, list[str]]:
    """Names by subject, in the order of the alphabet."""
    module = importlib.import_module(page.module)
    if page.module == "evqr":
        subjects: dict[str, list[str]] = {subject: [] for subject in SUBJECTS}
        for home, names in evqr._HOME.items():
            beginnings = [(len(each), subject) for subject, places in SUBJECTS.items() for each in places
                          if f"{home}.".startswith(f"{each}.")]  # fmt: skip
            subjects[max(beginnings)[1]] += names
        return {subject: sorted(names) for subject, names in subjects.items()}
    found: dict[str, list[str]] = {}
    operations = list(ops.__all__) if module is evqr_kernels else []
    for group, rooms in GROUPS.items() if operations else ():
        for room in (importlib.import_module(f"evqr_kernels.ops.{name}") for name in rooms):
            subject = (room.__doc__ or "").split("\n")[0].removeprefix("Checked functions ").rstrip(".")
            found[f"{group}: {subject.removeprefix('that ')}"] = list(room.__all__)
    rest = "Backends and what they are asked" if operations else "Scenes, sensors, simulations"
    found[rest] = sorted(set(module.__all__) - set(operations))
    return found


def api_page(page: Page) -> str:
    """Write a page."""
    module = importlib.import_module(page.module)
    lines = [f"# {page.title}", "", page.introduction]
    for heading, documented in page.general:
        lines += ["", f"## {heading}", "", f"::: {documented}", *WITHOUT_MEMBERS]
    for subject, names in names_of(page).items():
        lines += ["", f"## {subject}", "", "| name | what |", "|---|---|"]
        for name in names:
            there = f"settings.md#{name.lower()}" if subject == "Settings" else f"#{page.module}.{name}"
            lines.append(f"| [`{name}`]({there}) | {summary_of(name, getattr(module, name))} |")
        lines += [f"\n::: {page.module}.{name}" for name in names if subject != "Settings"]
    return "\n".join(lines)


def summary_of(name: str, value: Any) -> str:
    """First paragraph of its documentation, on one line."""
    if not (inspect.isclass(value) or inspect.isfunction(value)):
        return CONSTANTS[name]
    paragraph = (inspect.getdoc(value) or "").split("\n\n")[0]
    return re.sub(r"\s+", " ", paragraph).replace("``", "`").replace("|", "\\|")
