"""Draw the palm's figures anew, from what palpate computes now.

    python tools/figures.py                 # all of docs/images/palm-*.png, some two minutes of one core
    python tools/figures.py --only stress   # some

What a camera would see is drawn without its noise: it would hide little and pack badly.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent))

from drawn import DPI, pictures, plots

from palpate.reports.calibration_figures import STYLE

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
STEP = 3  # grey levels of 255
MAX_BYTES = 250_000
FIGURES: dict[str, Callable[[], Figure]] = {
    "frame": pictures.frame,
    "depths": pictures.depths,
    "places": pictures.places,
    "mirror": pictures.mirror,
    "paths": pictures.paths,
    "materials": pictures.materials,
    "indenters": pictures.indenters,
    "worn": pictures.worn_and_lit,
    "stress": plots.stress,
    "rim": plots.rim,
    "single-slice": plots.single_slice,
    "off-centre": plots.off_centre,
    "forces": plots.forces,
}


def packed(figure: Figure) -> bytes:
    """An opaque PNG in steps of a few grey levels, which halve it and are not seen."""
    full, small = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", dpi=DPI)
    levels = np.round(np.asarray(Image.open(full).convert("RGB")) / STEP) * STEP
    Image.fromarray(levels.astype(np.uint8)).save(small, format="png", optimize=True)
    return small.getvalue()


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=list(FIGURES), action="append")
    args, failed = parser.parse_args(), False
    for name in args.only or FIGURES:
        with mpl.rc_context(STYLE):
            png = packed(FIGURES[name]())
        path = IMAGES / f"palm-{name}.png"
        path.write_bytes(png)
        print(f"{path.name}: {len(png) / 1e3:.0f} kB", flush=True)
        failed |= len(png) > MAX_BYTES
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
