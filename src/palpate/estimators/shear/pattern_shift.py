"""How the pattern under a contact has turned about the normal and shifted along the skin.

Under a press straight down the pattern's middle rests; lateral load and torque move and turn it. Where the
skin's layers are known, both are of the traction that explains the marks. Where they are not, they are those
of the ring's form, less what a camera beside the contact sees of the pattern's sinking, X w / D.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from palpate.estimators.shear.skin_marks import TiledSkin
from palpate.estimators.shear.touch_places import TouchPlaces
from palpate.estimators.surface_strain import RecoveredTraction, ShearRing, StrainFields

MIN_SHIFT_ERROR = 3.0  # times the marks' noise: standard error of a shift even where no friction is assumed
MIN_TURN_ERROR = 2.0  # the same of a rotation, over the pitch
SINKING_ERROR = 0.25  # of the sinking as the ring tells it, standard error
MODEL_ERROR = 0.1  # of shift and rotation as traction tells them, standard error


class PatternShift(NamedTuple):
    """Motion of the pattern under a contact, with standard errors.

    Attributes:
        turn, turn_error: about the normal, from x towards y [rad].
        along, along_error: (x, y) [unit of the marks].
    """

    turn: float
    turn_error: float
    along: tuple[float, float]
    along_error: tuple[float, float]


NOT_TOLD = PatternShift(math.nan, math.nan, (math.nan, math.nan), (math.nan, math.nan))


def pattern_shift(fields: StrainFields, places: TouchPlaces, pitch: float, skin: object) -> PatternShift:
    """Motion of the pattern under the first contact; not a number where neither form tells it.

    Args:
        fields: of the frame.
        places: its contacts, one or more.
        pitch: distance of marks [unit].
        skin: its description.
    """
    if places.traction is not None and places.explained and len(places.contacts) == 1:
        return _by_traction(fields, places.traction, pitch)
    ring = places.contacts[0].ring
    return NOT_TOLD if ring is None else _by_ring(ring, skin)


def _by_traction(fields: StrainFields, traction: RecoveredTraction, pitch: float) -> PatternShift:
    noise = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    x, y, turn = traction.moved
    least = (MIN_SHIFT_ERROR * noise, MIN_SHIFT_ERROR * noise, MIN_TURN_ERROR * noise / pitch)
    ex, ey, et = (
        math.sqrt(error**2 + (MODEL_ERROR * value) ** 2 + floor**2)
        for error, value, floor in zip(traction.moved_error, traction.moved, least, strict=True)
    )
    return PatternShift(turn, et, (x, y), (ex, ey))


def _by_ring(ring: ShearRing, skin: object) -> PatternShift:
    per_place = skin.sinking * ring.outward / skin.camera_m if isinstance(skin, TiledSkin) else 0.0
    along, errors = [], []
    for at, seen, error in zip((ring.x, ring.y), ring.along, ring.along_error, strict=True):
        along.append(seen - at * per_place)
        errors.append(math.hypot(error, SINKING_ERROR * at * per_place))
    return PatternShift(
        ring.around / ring.radius,
        ring.around_error / ring.radius,
        (along[0], along[1]),
        (errors[0], errors[1]),
    )
