"""Run the commands of docs/how-to/measure-softness.md, print what they say, and draw its two pictures anew.

    python tools/softness_page.py        # half a minute of one core

The page shows what is printed; README.md shows the stiffness of the press.
"""

from __future__ import annotations

import tempfile
from contextlib import chdir
from pathlib import Path

from PIL import Image
from typer.main import get_command

from palpate.cli import app

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
COMMANDS = (
    "render tactip experiment",
    "compliance calibrate experiment --out tip.npz",
    "compliance experiment/new/01.tif --force experiment/new/01.csv --calibration tip.npz --out press",
    "compliance compare experiment --calibration tip.npz --out compared",
)
PICTURES = {"press/press.png": "compliance-press.png", "compared/comparison.png": "compliance-compare.png"}
COLOURS = 256  # of a plot, without a photograph


def main() -> None:
    """The command line."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for command in COMMANDS:
            print(f"\npalpate {command}\n", flush=True)
            get_command(app).main(command.split(), standalone_mode=False)
        for made, shown in PICTURES.items():
            with Image.open(made) as picture:
                picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
                    IMAGES / shown, optimize=True
                )


if __name__ == "__main__":
    main()
