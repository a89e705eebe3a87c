"""The headline of several studies of the palm, of one seed each, as a table for the documentation.

    palpate reproduce palm --scale small --part headline --seed 1 --out s1     # and 2, 3
    python reproductions/studies/palm_table.py s1 s2 s3

Each cell is the mean over the seeds, with the least and the greatest.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from palpate_reproductions.palm.palm_published import MAE, NAMES

TARGETS = ("force_N", "place_mm", "depth_mm")
FIELDS = ("grid", "new")


def cell(values: list[float]) -> str:
    """Mean, least and greatest."""
    if not values:
        return "–"
    return f"{np.mean(values):.3g} ({min(values):.3g} to {max(values):.3g})"


def table(folders: list[Path]) -> str:
    """Markdown, a row a model."""
    head = ["model"]
    for said in ("F_z [N]", "place [mm]", "depth [mm]"):
        head += [f"{said} printed", "held-out places", "off the grid"]
    lines = [" | ".join(head), " | ".join(["---"] * len(head))]
    for model, name in NAMES.items():
        found = [json.loads((f / "results" / f"headline-{model}.json").read_text())["found"] for f in folders]
        cells = [name]
        for target in TARGETS:
            printed = MAE.get((model, target))
            cells.append(f"{printed.value:g}" if printed else "–")
            cells += [cell([one[at][target]["mae"] for one in found if target in one[at]]) for at in FIELDS]
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    print(table(parser.parse_args().folders))


if __name__ == "__main__":
    main()
