#!/usr/bin/env python3
"""Make docs/images/demo.png: the picture of `evqr demo`, in few colours, so that it is small.

usage: demo_picture.py

Make it anew when the drawing or the demo changes.  Needs the extra plot, which brings Pillow.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from evqr.main import run

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "demo.png"
COLOURS = 256


def main() -> int:
    """Draw it, and keep it small."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder) / "demo.png"
        if run(["demo", "--picture", str(drawn)]) != 0:
            return 1
        PICTURE.parent.mkdir(exist_ok=True)
        with Image.open(drawn) as picture:
            few = picture.convert("RGB").quantize(
                COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
            )
            few.save(PICTURE, optimize=True)
    print(f"{PICTURE.name}: {PICTURE.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
