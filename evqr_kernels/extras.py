"""The command that installs an extra, from a clone or from an index, as this copy of evqr was."""

from __future__ import annotations

import functools
import json
import shutil
import sys
from pathlib import Path

DISTRIBUTION = "evqr"


@functools.cache
def install_command(extra: str = "") -> str:
    """Give the command that installs the packages of an extra into the Python that is running.

    Parameters
    ----------
    extra : str
        Its name, such as "taichi"; "" for what is needed in any case.

    Returns
    -------
    command : str
        For a shell.
    """
    # here: they take several times as long to import as all of evqr_kernels
    from importlib import metadata
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    extras = f"[{extra}]" if extra else ""
    try:
        origin = json.loads(metadata.distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except (metadata.PackageNotFoundError, ValueError, OSError):
        origin = {}
    url = str(origin.get("url", ""))
    if "dir_info" in origin:
        editable = "-e " if origin["dir_info"].get("editable") else ""
        what = f'{editable}"{url2pathname(urlsplit(url).path)}{extras}"'
    elif "vcs_info" in origin:
        what = f'"{DISTRIBUTION}{extras} @ {origin["vcs_info"].get("vcs", "git")}+{url}"'
    else:
        what = f'"{DISTRIBUTION}{extras}"'
    return f"{_pip()} install {what}"


def _pip() -> str:
    """Give pip of this Python: the one on the path may be another's."""
    found = shutil.which("pip")
    if found is not None and Path(found).parent == Path(sys.executable).parent:
        return "pip"
    executable = f'"{sys.executable}"' if " " in sys.executable else sys.executable
    return f"{executable} -m pip"
