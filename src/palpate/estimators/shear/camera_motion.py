"""Motion of the camera relative to the skin: shift, rotation, or zoom of the whole pattern.

Touch moves marks near the contact; a camera that moves also moves those far from it, affinely. The RMS of
that motion is compared with the noise of one mark (at least the scatter of far marks) plus a ratio of touch
motion that layers carry there. Motion below the limit is part of gamma's interval.
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
    """Return the greatest RMS camera motion over the far marks that is not reported [unit of the marks].

    Args:
        fields: Strain fields of the frame.
        pitch: Distance of marks [unit].
        places: Contacts whose recovered traction is subtracted.
    """
    stated = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    scatter = _far_motion(fields, _unexplained(fields, places), pitch).scatter
    by_touch = _far_motion(fields, fields.moved, pitch).mean_rest
    known = places is not None and places.traction is not None
    return max(stated, scatter) + (OF_TRACTION if known else OF_TOUCH) * by_touch


def camera_motion(
    fields: StrainFields, pitch: float, px_per_unit: float, places: TouchPlaces | None = None
) -> Refusal:
    """Return the refusal of a frame whose whole pattern has moved; arguments as of `motion_limit`."""
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
    """Motion that the recovered traction does not explain."""
    traction = None if places is None else places.traction
    return fields.moved if traction is None else traction.unexplained_m


class FarMotion(NamedTuple):
    """RMS affine motion of far marks, their scatter, and the mean shift of all relative to it [unit]."""

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
