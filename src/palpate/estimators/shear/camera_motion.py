"""Motion of the camera against the skin: a shift, rotation, or zoom of the whole pattern.

Touch moves the marks near the contact. A camera or lens that moves also moves the marks far from it, by an
affine motion. The root mean square of that motion over the far marks is the test statistic.

The detection limit is the noise of one mark's shift, at least the scatter of the far marks, plus a fraction
of the motion that touch makes: layers carry some of it to the far marks. The statistic averages some 75
marks, so noise alone reaches a fifth of the limit. Motion below the limit is part of the interval of gamma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palpate.core import Float, ndarray
from palpate.core.refusal import NONE, Refusal
from palpate.estimators.shear.touch_places import TouchPlaces
from palpate.estimators.surface_strain import StrainFields, contact_peaks

FAR = 75.0  # percentile of the distance to the nearest contact from which a mark is far
OF_TOUCH = 0.4  # of the mean shift by touch: limit where the layers are not known
OF_TRACTION = 0.05  # the same where the recovered traction is subtracted
CODE = "camera_moved"


def motion_limit(fields: StrainFields, pitch: float, places: TouchPlaces | None = None) -> float:
    """Greatest camera motion that is not reported, root mean square over the far marks [unit of the marks].

    The noise of one mark is at least the scatter of the far marks about the affine motion: where tiles are
    missing, single marks jump, and the recovered traction does not explain the motion of others.

    Args:
        fields: of the frame.
        pitch: distance of marks [unit].
        places: contacts, where they are known; their traction is subtracted.
    """
    stated = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    scatter = _far_motion(fields, _unexplained(fields, places), pitch).scatter
    by_touch = _far_motion(fields, fields.moved, pitch).mean_rest
    known = places is not None and places.traction is not None
    return max(stated, scatter) + (OF_TRACTION if known else OF_TOUCH) * by_touch


def camera_motion(
    fields: StrainFields, pitch: float, px_per_unit: float, places: TouchPlaces | None = None
) -> Refusal:
    """Refusal of a frame in which the whole pattern has moved.

    Args:
        fields: of the frame.
        pitch: distance of marks [unit].
        px_per_unit: scale of the frame.
        places: contacts, where they are known; their traction is subtracted.
    """
    motion = _far_motion(fields, _unexplained(fields, places), pitch).affine
    limit = motion_limit(fields, pitch, places)
    if motion <= limit:
        return NONE
    return Refusal(
        CODE,
        f"the whole pattern has moved by {px_per_unit * motion:.2f} px, and {px_per_unit * limit:.2f} px are "
        "allowed; fix the camera and take a new reference",
    )


def _unexplained(fields: StrainFields, places: TouchPlaces | None) -> Float[ndarray, "n 2"]:
    """Motion that the recovered traction does not explain; all of it where there is no traction."""
    traction = None if places is None else places.traction
    return fields.moved if traction is None else traction.unexplained_m


class FarMotion(NamedTuple):
    """Affine motion of the marks far from contact.

    Attributes:
        affine: root mean square of the affine motion over the far marks [unit].
        scatter: root mean square of their motion about it [unit].
        mean_rest: mean shift of all marks relative to it [unit].
    """

    affine: float
    scatter: float
    mean_rest: float


def _far_motion(fields: StrainFields, moved: Float[ndarray, "n 2"], pitch: float) -> FarMotion:
    at, peaks = fields.rest, contact_peaks(fields, pitch)
    far = np.ones(len(at), bool)
    if peaks:
        away = np.min([np.hypot(*(at - (p.x, p.y)).T) for p in peaks], axis=0)
        far = away >= np.percentile(away, FAR)
    basis = np.column_stack([np.ones(len(at)), at / max(float(np.abs(at).max()), 1e-12)])
    affine = basis @ np.linalg.lstsq(basis[far], moved[far], rcond=None)[0]
    rest = np.hypot(*(moved - affine).T)
    return FarMotion(
        math.sqrt(float((affine[far] ** 2).sum(axis=1).mean())),
        math.sqrt(float((rest[far] ** 2).mean())),
        float(rest.mean()),
    )
