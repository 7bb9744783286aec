"""The page in a browser without a window: what it shows, and that nothing of it is refused or fails."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from lines import HOSTILE, line

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here; .ci/run installs one")


def shown(url, tmp_path, *options):
    """The document after scripts have run, and what the browser has to say."""
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
        "--enable-logging=stderr", "--virtual-time-budget=3000", *options, "--dump-dom", url,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=90)
    said = [text for text in done.stderr.splitlines() if "CONSOLE" in text]
    return done.stdout, said


@pytest.mark.parametrize("kind", ["empty", "busy", "failing"])
def test_the_page_shows_the_line(kind, tmp_path):
    pytest.importorskip("uvicorn", reason="extra 'line' is not installed")
    from evqr.page.serve import PageServer

    with PageServer(line(kind), port=0) as server:
        page, said = shown(server.url, tmp_path)
    assert not said
    assert {"empty": "not ready", "busy": ">ready<", "failing": "not ready"}[kind] in page
    if kind == "empty":
        assert "none yet" in page and "standard output alone" in page
        return
    assert HOSTILE not in page and HOSTILE.replace("<", "&lt;").replace(">", "&gt;") in page
    assert page.count('class="good" x=') >= 50 and "NO READ" in page and "no-reads/part-" in page
    assert ("Connection refused" in page) == (kind == "failing")
