"""Shape of the contact in the pins of one press: ring, ellipse, growth of cells, flattening.

The last frame is compared with the no-contact pins. Flattening is the stretch of the middle over that of a
rigid plate with the same ring: 1 on a rigid plate, less on soft objects.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from palpate.core import InputError, RangeError
from palpate.estimators.compliance.contact_area import (
    Field,
    RigidPlateStretch,
    cell_growth,
    ring_ellipse,
    ring_px,
)
from palpate.estimators.compliance.pin_press import PinPress

NO_RING = "the ring where pins move outwards most lies at no pins; press farther, or the pins are too short"
NO_RIGID = "the calibration has no rigid plate among its references"


def field_of(press: PinPress, frame: int = -1) -> Field:
    """Return the motion of the pins that are seen in a frame of a press."""
    seen = np.isfinite(press.untouched_px).all(axis=1) & np.isfinite(press.moved_px[frame]).all(axis=1)
    return Field(press.untouched_px[seen], press.moved_px[frame][seen])


def mean_stretch(field: Field) -> float:
    """Return the stretch of the middle, the mean over directions."""
    return float(np.trace(field.stretch()) / 2)


def rigid_plate_stretch(presses: Iterable[PinPress]) -> RigidPlateStretch | None:
    """Return stretch over ring of presses on a rigid plate; None with too few rings."""
    fields = [field_of(press, i) for press in presses for i in range(len(press.force_n))]
    rings, stretches = (np.array([of(one) for one in fields]) for of in (ring_px, mean_stretch))
    try:
        return RigidPlateStretch.fitted(rings, stretches)
    except InputError:  # short pins show no ring: everything else can still be calibrated
        return None


def contact_shape(press: PinPress, rigid: RigidPlateStretch | None) -> dict[str, Any]:
    """Return the shape in plain numbers, or why there is none."""
    field = field_of(press)
    ring = ring_px(field)
    growth = cell_growth(field)
    inner = growth[np.isfinite(growth)]
    return {
        "ring_px": float(ring) if np.isfinite(ring) else None,
        "ellipse": _ellipse(field),
        "cell_growth": {"mean": float(inner.mean()) if len(inner) else None, "cells": len(inner)},
        "flattening": _flattening(press, rigid),
    }


def _ellipse(field: Field) -> dict[str, Any]:
    try:
        found = ring_ellipse(field)
    except InputError as e:
        return {"why_not": str(e)}
    return {
        "centre_px": list(found.centre_px),
        "half_axes_px": list(found.axes_px),
        "angle_deg": (float(np.rad2deg(found.angle_rad)) + 90) % 180 - 90,
        "visible_share": found.visible_share,
    }


def _flattening(press: PinPress, rigid: RigidPlateStretch | None) -> dict[str, Any]:
    if rigid is None:
        return {"why_not": NO_RIGID}
    why = NO_RING
    for frame in reversed(range(len(press.force_n))):
        field = field_of(press, frame)
        ring = ring_px(field)
        if not np.isfinite(ring):
            continue
        try:
            ratio = rigid.ratio(ring, mean_stretch(field))
        except RangeError as e:
            why = str(e)
        else:
            return {"over_rigid": ratio, "force_N": float(press.force_n[frame])}
    return {"why_not": why}
