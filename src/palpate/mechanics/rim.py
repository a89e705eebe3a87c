"""What moving a centred press towards the disc's rim leaves out, from presses solved off the centre.

The press tables are of a ball in the middle of its disc. Nearer to the free rim the disc gives way more, and
pushes the ball sideways. Both were solved in three dimensions by `tools/off_centre.py`, without friction, at
finite strain, for the tables' discs; `tables/off_centre.json` holds the forces. Lengths are in ball radii R.
"""

from __future__ import annotations

import json
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from palpate.core.errors import RangeError

OFF_CENTRE = resources.files("palpate.mechanics") / "tables" / "off_centre.json"
SLACK = 1e-3  # a place named in whole millimetres may lie a hair beyond
_FINE = 61  # offsets at which the smooth curve through the solved ones is kept


class RimEffect(NamedTuple):
    """A press off the centre over the same press in the centre.

    Attributes:
        force_ratio: its force over the centred one's.
        side_ratio: the force with which the disc pushes the ball outwards, over the centred press's
            normal force.
    """

    force_ratio: float
    side_ratio: float


def rim_effect(offset: float, depth: float, thickness: float) -> RimEffect:
    """What a centred press table misses at a place.

    Args:
        offset: of the ball from the disc's axis, to 4.427 R (22.1 mm under a ball of 5 mm) [R].
        depth: 0 to 1 R.
        thickness: of the disc: 2 or 4 R.

    Raises:
        RangeError: beyond what was solved.

    Example:
        >>> round(rim_effect(4.2, 1.0, 2.0).force_ratio, 3)
        0.927
    """
    known = _solved()
    if thickness not in known:
        raise RangeError(
            f"no press off the centre of a disc {thickness:g} R thick was solved; 2 R and 4 R were"
        )
    greatest = known[thickness].grid[0][-1], known[thickness].grid[1][-1]
    if not (0 <= offset <= greatest[0] * (1 + SLACK) and 0 <= depth <= greatest[1] * (1 + SLACK)):
        raise RangeError(
            f"{offset:g} R from the axis and {depth:g} R deep lies outside 0 to {greatest[0]:g} R and 0 to "
            f"{greatest[1]:g} R, where presses were solved"
        )
    at = min(offset, greatest[0]), min(depth, greatest[1])
    return RimEffect(*(float(value) for value in known[thickness](at)))


@lru_cache(maxsize=1)
def _solved() -> dict[float, RegularGridInterpolator]:
    """For each thickness, both ratios over offset and depth; at no depth as at the least one solved."""
    rows = json.loads(OFF_CENTRE.read_text(encoding="utf-8"))["presses"]
    return {
        h: _curves([row for row in rows if row["thickness"] == h]) for h in {row["thickness"] for row in rows}
    }


def _curves(rows: list[dict[str, float]]) -> RegularGridInterpolator:
    offsets, depths = (np.array(sorted({row[part] for row in rows})) for part in ("offset", "depth"))
    held = {(row["offset"], row["depth"]): [row["force"], row["side_force"]] for row in rows}
    force, side = np.moveaxis(np.array([[held[c, d] for d in depths] for c in offsets]), -1, 0)
    ratios = np.stack([force / force[0], -side / force[0]], axis=-1)
    fine = np.linspace(offsets[0], offsets[-1], _FINE)
    smooth = PchipInterpolator(offsets, ratios)(fine)
    return RegularGridInterpolator(
        (fine, np.append(0.0, depths)), np.concatenate([smooth[:, :1], smooth], axis=1)
    )
