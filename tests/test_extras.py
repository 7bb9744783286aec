"""Commands in messages install what is missing, however this copy of evqr came to be here."""

import json
from importlib import metadata

import pytest

from evqr_kernels import extras


class Distribution:
    def __init__(self, origin):
        self._origin = origin

    def read_text(self, name):
        assert name == "direct_url.json"
        return self._origin and json.dumps(self._origin)


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        (None, '"evqr[plot]"'),
        ({"url": "file:///home/me/evqr", "dir_info": {"editable": True}}, '-e "/home/me/evqr[plot]"'),
        ({"url": "file:///home/a%20b/evqr", "dir_info": {}}, '"/home/a b/evqr[plot]"'),
        (
            {"url": "https://example.org/evqr.git", "vcs_info": {"vcs": "git", "commit_id": "1"}},
            '"evqr[plot] @ git+https://example.org/evqr.git"',
        ),
        ({"url": "https://example.org/evqr.whl", "archive_info": {}}, '"evqr[plot]"'),
    ],
    ids=["index", "clone", "folder", "git", "archive"],
)
def test_the_command_is_of_the_same_origin(monkeypatch, origin, command):
    monkeypatch.setattr(metadata, "distribution", lambda name: Distribution(origin))
    monkeypatch.setattr(extras, "_pip", lambda: "pip")
    extras.install_command.cache_clear()
    assert extras.install_command("plot") == f"pip install {command}"
    extras.install_command.cache_clear()


def test_pip_is_that_of_the_python_that_runs(monkeypatch):
    monkeypatch.setattr(extras.sys, "executable", "/venv/bin/python")
    monkeypatch.setattr(extras.shutil, "which", lambda name: "/venv/bin/pip")
    assert extras._pip() == "pip"
    monkeypatch.setattr(extras.shutil, "which", lambda name: "/usr/bin/pip")
    assert extras._pip() == "/venv/bin/python -m pip"
    monkeypatch.setattr(extras.sys, "executable", "/my venv/bin/python")
    assert extras._pip() == '"/my venv/bin/python" -m pip'
