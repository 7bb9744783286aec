#!/usr/bin/env python3
"""Write the pages of docs/ that are made of code: commands, settings, the lists of the API.

usage: pages.py [--check]

They are kept in the repository, so that they can be read without the site; a test compares them with what
this prints.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pages_api import API_PAGES, api_page
from pages_commands import commands_page
from pages_settings import settings_page

DOCS = Path(__file__).parents[1] / "docs"
MADE = "<!-- Made by tools/pages.py: change the code that it tells of, then run that. -->"


def pages() -> dict[str, str]:
    """Text of each page that is made, by its path below docs/."""
    made = {
        "reference/commands.md": commands_page(),
        "reference/settings.md": settings_page(),
        **{f"reference/{name}.md": api_page(page) for name, page in API_PAGES.items()},
    }
    return {name: f"{MADE}\n\n{text.strip()}\n" for name, text in made.items()}


def main() -> int:
    """Write them, or with --check name those that are not as they would be written."""
    stale = {
        name: text
        for name, text in pages().items()
        if not (DOCS / name).is_file() or (DOCS / name).read_text(encoding="utf-8") != text
    }
    if sys.argv[1:] == ["--check"]:
        for name in stale:
            print(f"docs/{name} is not what the code says: run python tools/pages.py")
        return 1 if stale else 0
    for name, text in stale.items():
        (DOCS / name).write_text(text, encoding="utf-8", newline="\n")
        print(f"docs/{name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
