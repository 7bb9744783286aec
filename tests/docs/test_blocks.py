"""Every code block of README, tutorials, how-to pages and settings runs, from the first of a page on.

Python blocks of a page share their names, as in one session.  Lines of ``sh`` blocks that begin with ``evqr``
go through the command line, in this process; other lines must be known to run elsewhere.  A ``text`` block
behind a block is what that prints: numbers may differ, words may not, and ``...`` stands for the rest of a
line.
"""

import contextlib
import io
import json
import os
import re
import shlex
import signal
import socket
import threading
import time
from pathlib import Path
from urllib.request import urlopen

import pytest

from evqr.demo import demo_recording
from evqr.main import run

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "docs" / "reference" / "settings.md"]
PAGES += sorted(path for room in ("tutorials", "how-to") for path in (ROOT / "docs" / room).glob("*.md"))

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXITS = re.compile(r"# exits with (\d+)")
UNTIL = "# until Ctrl-C"
PAGE_PORT, OPCUA_PORT = "8080", ":4840"

RECORDINGS = ("line3.raw", "line3.h5", "shift1.h5", "shift2.h5", "shift1/a.h5")
"""What README reads: all of them the demo's, since the name of a file says nothing."""

ELSEWHERE = (
    re.compile(r'python3 -m venv \.venv && \.venv/bin/pip install -q -e "\.\[[\w,]+\]"( && \.venv/bin/.*)?'),
    re.compile(r'(\.venv/bin/)?pip install (-e )?"(evqr|\.)(\[[\w,]+\])?"'),
    re.compile(r"\.venv/bin/evqr demo"),
    re.compile(r"podman .*"),
    re.compile(r"(python (perf/|-m evqr_kernels\.export )|nsys |ncu |perf |py-spy ).*"),
)
"""Lines that install, or run what was installed or built (`.ci/run` does that), and profilers."""


def blocks_of(page):
    return [(match[1], match[2]) for match in BLOCK.finditer(page.read_text(encoding="utf-8"))]


def commands(block):
    """Lines of a shell block, those that end with a backslash put together."""
    lines = block.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def arguments_of(line):
    """What a command gets; workers are for other tests."""
    return shlex.split(re.sub(r"--jobs \d+", "", line), comments=True)[1:]


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return str(listening.getsockname()[1])


def stop_once_a_part_is_not_read(port):
    """Look at the page of a service that is about to run, and end it as a supervisor would."""

    def look():
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            time.sleep(0.2)
            with contextlib.suppress(OSError), urlopen(f"http://127.0.0.1:{port}/api/state") as answer:
                if json.load(answer)["counts"].get("parts_not_read"):
                    break
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=look).start()


def run_shell(block, port):
    for line in commands(block):
        if any(each.fullmatch(line) for each in ELSEWHERE):
            continue
        assert line.startswith("evqr "), f"nothing runs {line!r}"
        told = EXITS.search(line)
        if line.endswith(UNTIL):
            stop_once_a_part_is_not_read(port)
        assert run(arguments_of(line)) == (int(told[1]) if told else 0), line


def words(text):
    """Lines without their numbers and spaces."""
    return [" ".join(re.sub(r"[-+]?\d[\d.,]*", "#", line).split()) for line in text.strip().splitlines()]


def is_said(expected, printed):
    """Whether the lines that are expected are among those printed, one behind the other."""
    patterns = [re.escape(line).replace(re.escape("..."), ".*") for line in words(expected)]
    lines = words(printed)
    return any(
        all(re.fullmatch(p, line) for p, line in zip(patterns, lines[at:], strict=False))
        for at in range(len(lines) - len(patterns) + 1)
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with demo_recording() as demo:
        for name in RECORDINGS if page.name == "README.md" else ():
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).write_bytes(demo.read_bytes())
    names, printed, port = {"__name__": "__main__"}, "", free_port()
    for language, block in blocks_of(page):
        block = block.replace(PAGE_PORT, port).replace(OPCUA_PORT, f":{port}")
        if language == "text":
            assert is_said(block, printed), f"{block}\n  is not among\n{printed}"
            continue
        assert language in ("python", "sh"), f"{page.name}: nothing runs {language}"
        with contextlib.redirect_stdout(io.StringIO()) as said:
            if language == "sh":
                run_shell(block, port)
            else:
                exec(compile(block, str(page), "exec"), names)
        printed = said.getvalue()


def test_what_is_said_is_compared_without_numbers():
    assert is_said("a  12.5 px (...)", "b 1\na 3 px (more, 4)\nc")
    assert not is_said("a 12 px", "a 12 mm")
    assert not is_said("a 1\nb 2", "a 1\nc\nb 2")


def test_pages_without_blocks_would_be_noticed():
    assert all(blocks_of(page) for page in PAGES)
