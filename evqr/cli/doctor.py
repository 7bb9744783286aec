"""The command `evqr doctor`: what there is on this machine, and whether it reads the demo."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import metadata
from importlib.util import find_spec
from typing import Any

import click

from evqr.cli import options
from evqr.cli.options import BAD, OK, backend_options, examples
from evqr.errors import EvqrError
from evqr.values import json_line

NEEDED = ("numpy", "warp-lang", "h5py", "zxing-cpp", "segno")

EXTRAS = {
    "formats": ("aedat", "eventcv", "evt3", "rosbags", "hdf5plugin"),
    "plot": ("matplotlib",),
    "gs1": ("biip",),
    "taichi": ("taichi",),
    "torch": ("torch",),
    "jax": ("jax",),
    "distributed": ("distributed",),
    "line": ("paho", "httpx", "starlette", "uvicorn", "prometheus_client"),
    "opcua": ("asyncua",),
    "live": ("neuromorphic_drivers", "dv_processing"),
}
"""Extras, and the modules that they bring."""


@click.command(epilog=examples("evqr doctor", "evqr doctor --json"))
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@backend_options
def doctor(as_json: bool, backend: str, device: str, threads: int | None) -> int:
    """Tell what evqr finds on this machine, and read the recording that comes with it.

    Versions, backend and devices, where compiled kernels are kept, cores and threads, extras with the command
    that installs those that are missing, cameras that are plugged in.

    Exit status: 0 when the recording is read, 2 when it is not.
    """
    found: dict[str, Any] = {}
    well = True
    for name, value in _findings(backend, device, threads):
        found[name] = value
        well = name != "demo" or bool(value["read"])
        if not as_json:
            for line in _lines(name, value):
                click.echo(line)
    if as_json:
        click.echo(json_line(found))
    return OK if well else BAD


def _findings(backend: str, device: str, threads: int | None) -> Iterator[tuple[str, Any]]:
    """Look at one thing after another, those first that cannot fail."""
    yield "evqr", metadata.version("evqr")
    yield "python", f"{platform.python_version()} ({sys.executable})"
    yield "platform", platform.platform()
    yield "packages", {name: _version(name) for name in NEEDED}
    yield "threads", {"cores": _cores(), "used": threads or 1}
    try:
        yield "temporary_files", tempfile.gettempdir()
    except OSError as error:
        yield "temporary_files", f"none ({error.strerror or error})"
    yield "extras", {extra: _extra(extra, modules) for extra, modules in EXTRAS.items()}
    yield "cameras", _cameras()
    try:
        yield from _computing(backend, device)
        yield "demo", _demo(backend, device, threads)
    except EvqrError as error:
        yield "demo", {"read": False, "reason": str(error)}


def _computing(backend: str, device: str) -> Iterator[tuple[str, Any]]:
    from evqr.device import cache_of, kernels_on

    kernels = kernels_on(backend, device)
    yield "backend", {"name": kernels.name, "devices": list(kernels.devices()), "device": device}
    options.prepare(backend, device)
    place = cache_of(kernels)
    if place:
        variable = "TI_OFFLINE_CACHE_FILE_PATH" if kernels.name == "taichi" else "WARP_CACHE_PATH"
        megabytes = round(_size(place) / 1e6, 1)
        yield "kernels", {"directory": place, "megabytes": megabytes, "variable": variable}


def _demo(backend: str, device: str, threads: int | None) -> dict[str, Any]:
    from evqr.demo import demo_recording
    from evqr.offline import read_codes

    began = time.perf_counter()
    with demo_recording() as path:
        result = read_codes(path, backend=backend, device=device, threads=threads)
    elapsed = round(1e3 * (time.perf_counter() - began), 1)
    texts = [reading.text for reading in result.readings]
    return {"read": bool(texts), "texts": texts, "reason": result.reason, "milliseconds": elapsed}


def _cameras() -> str:
    from evqr.live.cameras import describe_cameras

    return describe_cameras()


def _extra(extra: str, modules: tuple[str, ...]) -> dict[str, Any]:
    from evqr_kernels.extras import install_command

    missing = [module for module in modules if find_spec(module) is None]
    return {"missing": missing, "install": install_command(extra) if missing else ""}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "missing"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _size(folder: str) -> int:
    sizes = (
        os.path.getsize(os.path.join(place, name))
        for place, _, names in os.walk(folder)
        for name in names
        if os.path.exists(os.path.join(place, name))
    )
    return sum(sizes)


def _lines(name: str, value: Any) -> Iterator[str]:
    """Say a finding in lines for people."""
    label = f"{name.replace('_', ' '):16}"
    if name == "packages":
        yield f"{label}{', '.join(f'{package} {version}' for package, version in value.items())}"
    elif name == "threads":
        yield f"{label}{value['used']} of {value['cores']} cores; --threads N for more"
    elif name == "extras":
        for extra, state in value.items():
            missing = f"{', '.join(state['missing'])} not installed: {state['install']}"
            yield f"{label}{extra}: {missing if state['missing'] else 'installed'}"
            label = " " * 16
    elif name == "backend":
        yield f"{label}{value['name']} on {value['device']}; devices: {', '.join(value['devices'])}"
    elif name == "kernels":
        yield f"{label}compiled ones are kept in {value['directory']} ({value['megabytes']} MB)"
        yield " " * 16 + f"{value['variable']} names another directory; it may be deleted"
    elif name == "demo":
        read = f"read in {value['milliseconds']} ms: {', '.join(value['texts'])}" if value["read"] else ""
        yield label + (read or f"NOT READ: {value['reason']}")
    else:
        yield f"{label}{value}"
