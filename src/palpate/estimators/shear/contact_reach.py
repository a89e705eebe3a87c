"""Whether a contact lies in the area of validated positions.

Near the rim, marks are missing on one side, the recovered pressure is biased inward, and the marks fit no
touch. Such a contact has no valid reading and is no evidence of a tear.
"""

from __future__ import annotations

import numpy as np

from palpate.core.refusal import NONE, Refusal
from palpate.estimators.shear.skin_marks import SkinMarks, TiledSkin
from palpate.estimators.shear.touch_places import TouchPlaces
from palpate.estimators.surface_strain import StrainFields, contact_peaks

RIM = 1.15  # pitches from the outermost marks: the area of NUSense is then 40 x 28 mm
MAX_OUTSIDE = 0.25  # fraction of the pressure outside of the outermost marks
CODE = "outside_calibrated_area"


def area_of(marks: SkinMarks, skin: object) -> tuple[list[float], list[float]]:
    """Least and greatest (x, y) of valid places [unit of the marks]."""
    rim = RIM * marks.pitch if isinstance(skin, TiledSkin) else 0.0
    at = marks.reference.places
    return (at.min(axis=0) + rim).tolist(), (at.max(axis=0) - rim).tolist()


def reach_of(fields: StrainFields, places: TouchPlaces, marks: SkinMarks, skin: object) -> Refusal:
    """Return the refusal of a frame with a contact outside of the area."""
    if not isinstance(skin, TiledSkin):
        return NONE
    low, high = (np.array(end) for end in area_of(marks, skin))
    at = [(c.x, c.y) for c in places.contacts] or [p[:2] for p in contact_peaks(fields, marks.pitch)[:1]]
    outside = any(((np.array(one) < low) | (np.array(one) > high)).any() for one in at)
    if not outside and not _presses_outside(places, marks):
        return NONE
    size = ", ".join(f"{1e3 * a:.0f} to {1e3 * b:.0f}" for a, b in zip(low, high, strict=True))
    return Refusal(
        CODE, f"the contact reaches outside of the calibrated area, ({size}) mm; press inside of it"
    )


def _presses_outside(places: TouchPlaces, marks: SkinMarks) -> bool:
    """Whether a large fraction of the recovered pressure lies outside of the outermost marks."""
    traction, at = places.traction, marks.reference.places
    if traction is None or not traction.pressure_pa.sum() > 0:
        return False
    nodes = traction.nodes_m
    outside = ((nodes < at.min(axis=0)) | (nodes > at.max(axis=0))).any(axis=1)
    return float(traction.pressure_pa[outside].sum()) > MAX_OUTSIDE * float(traction.pressure_pa.sum())
