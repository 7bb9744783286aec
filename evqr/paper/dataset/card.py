"""The data set's card: what it is, how it was made, every parameter, what may be done with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version

from evqr.paper.dataset import frames, scenes
from evqr.paper.dataset.scenes import LEVEL, VERSION, SceneKind, SceneSpec

CARD = "README.md"


def card_of(specs: Sequence[SceneSpec]) -> str:
    """Write the card of a data set, in Markdown."""
    kinds = {spec.kind.name: spec.kind for spec in specs}
    first = specs[0].scene
    lines = [
        "# QR codes that pass an event camera",
        "",
        f"{len(specs)} simulated scenes like those of Nagata, Sekikawa, Hara, Suzuki, Aoki, *QR-code",
        "Reconstruction from Event Data via Optimization in Code Subspace* (WACV 2020), whose data set was",
        f"not published. Made by `evqr dataset make` of evqr {version('evqr')}; the same version makes the",
        "same files again.",
        "",
        "Licence: CC0-1.0. Nothing in it was recorded; there are no people, places or trade marks in it.",
        "",
        "## Files",
        "",
        "One HDF5 file a scene: `events/{t,x,y,p}` (t in us, p as 0 and 1), `truth` (text, modules with 1 =",
        "dark, poses H from modules to px, velocities in px/s, every 250 us), `frames/{t,image}` of a frame",
        "camera on the same scene. `manifest.json` lists them. To check: `sha256sum -c SHA256SUMS`.",
        "",
        "## Scenes",
        "",
        f"Version {VERSION}-{LEVEL}, {first.width}x{first.height} px, travel along the rows, all in view.",
        "",
        "| scene | angle | text | windows | seed |",
        "|---|---|---|---|---|",
        *(f"| {s.name} | {s.angle} | `{s.text}` | {s.windows} | {s.seed} |" for s in specs),
        "",
        "Parameters that are the same for all: "
        f"white {first.white}, black {first.black} of full light, blur {first.psf_px} px, texture and "
        "background by seed, light that falls off by up to a tenth.",
        "",
        *(line for kind in kinds.values() for line in _kind(kind)),
        "## How they were chosen",
        "",
        *(line for line in (scenes.__doc__ or "").strip().splitlines()[2:]),
        "",
        f"Frames: {frames.__doc__}"
        f" An exposure is the mean of instants that are {frames.STEP_PX:g} px of travel apart.",
        "",
    ]
    return "\n".join(lines)


def _kind(kind: SceneKind) -> list[str]:
    values = {
        "window_us": kind.window_us,
        "speed_px_ms": kind.speed_px_ms,
        "module_px": kind.module_px,
        **{f"sensor.{name}": value for name, value in asdict(kind.sensor).items()},
        **{f"camera.{name}": value for name, value in asdict(kind.camera).items()},
    }
    rows = [f"| {name} | {value} |" for name, value in values.items()]
    return [f"### {kind.name}", "", "| parameter | value |", "|---|---|", *rows, ""]
