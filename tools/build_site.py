#!/usr/bin/env python3
"""Build the site from docs/ into site/, and fail at any warning.

usage: build_site.py

Zensical's own --strict fails at links that lead nowhere; a docstring that does not fit its function is told
and passed over, so whatever is told beside the usual lines fails here.  Nothing of a page may come from
elsewhere.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

USUAL = re.compile(r"Build started|No issues found|Build finished in [\d.]+m?s|\s*")

REMOTE = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?(?:https?:)?//[^"'\s>]+"""
    r"""|<link\b(?=[^>]*\brel=["']?(?:stylesheet|preconnect|preload|icon))[^>]*\bhref=["']?(?:https?:)?//[^"'\s>]+"""
    r"""|url\(\s*["']?(?:https?:)?//[^)]+|@import\s+["'](?:https?:)?//[^"']+""",
    re.IGNORECASE,
)
"""What a browser would fetch from elsewhere to show a page; links to follow are no such thing."""


def unusual(told: str) -> list[str]:
    """Return lines that are no part of a build without warnings."""
    return [line for line in re.sub(r"\x1b\[[0-9;]*m", "", told).splitlines() if not USUAL.fullmatch(line)]


def remote(text: str) -> list[str]:
    """Return what a page or a style sheet fetches from elsewhere."""
    return [match[0] for match in REMOTE.finditer(text)]


def main() -> int:
    """Build it."""
    command = [Path(sys.executable).with_name("zensical"), "build", "--strict", "--clean"]
    done = subprocess.run(
        command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    sys.stdout.write(done.stdout)
    faults = unusual(done.stdout)
    pages = [path for path in (ROOT / "site").rglob("*") if path.suffix in (".html", ".css")]
    for path in pages:
        for what in remote(path.read_text(encoding="utf-8")):
            faults.append(f"{path.relative_to(ROOT)} fetches {what}")
            print(faults[-1])
    print(f"site/: {len(pages)} pages and style sheets")
    return 1 if done.returncode or faults or not pages else 0


if __name__ == "__main__":
    sys.exit(main())
