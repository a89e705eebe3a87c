"""Plans of the thesis's experiments (chapter 4), as fields of a plan's file.

A plan turns round at a force or at the depth that the pad is known to, whichever comes first. Where the
thesis names no number, such as the speed of a calibration, the usual one of its hysteresis is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SPEED_MM_S = 0.5  # the thesis's hysteresis, section 4.4
MIDDLE: Mapping[str, Any] = {"kind": "listed", "at_mm": [[0.0, 0.0]]}
COLUMNS, ROWS, APART_MM = 6, 4, (6.4, 7.0)
ANGLES_DEG = tuple(range(0, 180, 15))
EDGE_MM = 25
FIRM_TAPS: Mapping[str, Any] = {"taps": 8, "tap_N": 4.0}
"""Of flat and long tips: taps of the usual 0.5 N are too short on them to set the clocks by."""
_SWEPT: Mapping[str, Any] = {
    "kind": "swept",
    "speed_mm_s": SPEED_MM_S,
    "depth_mm": 2.0,
    "threshold_N": 0.1,
    "seek_mm": 2.0,
    "reference_frames": 12,
    "places": MIDDLE,
}


def _grid() -> Mapping[str, Any]:
    """The 24 places: 6 x 4, 6.4 mm apart along x and 7 mm along y."""
    return {
        "kind": "listed",
        "at_mm": [
            [round((i - (COLUMNS - 1) / 2) * APART_MM[0], 3), round((j - (ROWS - 1) / 2) * APART_MM[1], 3)]
            for j in range(ROWS)
            for i in range(COLUMNS)
        ],
    }


def _swept(name: str, until_n: float, **fields: Any) -> dict[str, Any]:
    return {**_SWEPT, "name": name, "until_N": until_n, **fields}


DEFAULT_PLAN: Mapping[str, Any] = {
    "kind": "stepped",
    "name": "nusense",
    "places": _grid(),
    "indenters": ["round"],
    "cycles": 1,
    "depth_mm": 1.6,
    "step_mm": 0.2,
    "frames": 2,
    "threshold_N": 0.1,
    "reference_frames": 12,
}
"""Depth, force and place together, for a calibration of all of them."""

PLANS: Mapping[str, Mapping[str, Any]] = {
    "nusense-force": _swept("nusense-force", 8.0, indenters=["flat", "round"], cycles=5, **FIRM_TAPS),
    "nusense-places": _swept("nusense-places", 6.0, indenters=["round"], places=_grid(), cycles=3),
    "nusense-hysteresis": _swept("nusense-hysteresis", 8.0, indenters=["round"], cycles=3),
    "nusense-cycles": _swept("nusense-cycles", 8.0, indenters=["round"], cycles=70),
    "nusense-edges": _swept(
        "nusense-edges",
        8.0,
        indenters=[f"edge:{EDGE_MM}:{turn}" for turn in ANGLES_DEG],
        cycles=1,
        **FIRM_TAPS,
    ),
    "nusense-damage": _swept("nusense-damage", 4.0, indenters=["round"], cycles=4),
}
"""Sections 4.2 to 4.7: force, places, hysteresis, 70 cycles, edges at all angles, 1 to 4 N on each pad."""
