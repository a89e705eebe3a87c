"""Cues of normal force in the motion of a pattern's marks.

    gamma  = alpha K mean |s - s_ref|                    the published measure, alpha and K explicit
    moment = integral (X - X_c) . U exp(-|X - X_c|^2 / 2 r^2) dA     for three reaches r [m^4]

The moment over the whole plane is proportional to the force for any pressure distribution. A window excludes
the pattern's edge and far noise; three windows distinguish tips.

Source: "NUSense: Shear Based Robust Optical Tactile Sensor", equation 3.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_fill_holes

from palpate.core import Bool, Float, InputError, Lens, RangeError, ndarray
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import StrainFields, StrainMeter, find_rings, on_plane

PUBLISHED_ALPHA_PX = 1 / 18_000  # per px of an undistorted image
SIDE_SAMPLES = 164  # along both sides: K = 164 x 164
REACHES_M = (2.5e-3, 5e-3, 10e-3)
DEGREE = 3
EVERY = 4  # samples along both sides, of which one goes into a moment


class TouchCues(NamedTuple):
    """Cues of one frame; NaN without a contact.

    Attributes:
        gamma: published measure, mean form.
        near, middle, far: moments within 2.5, 5, and 10 mm of the contact [1e-9 m^4].
        x_m, y_m: contact position from the camera's axis [m].
        radius_m: of the ring of greatest outward motion [m].
    """

    gamma: float
    near: float
    middle: float
    far: float
    x_m: float
    y_m: float
    contacts: int
    radius_m: float


class CueMeter:
    """Cues of frames against the no-contact pattern.

    Args:
        reference: marks of the no-contact pattern [px of the camera's image].
        camera_m: distance of the camera from the pattern [m].
        alpha: of the published measure [1/px of the undistorted image].
        samples: along each side of the surface; K is its square.
    """

    def __init__(
        self,
        reference: ControlPoints,
        lens: Lens,
        camera_m: float,
        alpha: float = PUBLISHED_ALPHA_PX,
        samples: int = SIDE_SAMPLES,
    ) -> None:
        if not 0 < alpha < math.inf:
            raise InputError(f"a scale alpha of {alpha} per px; give a positive number, published is 1/18000")
        self._lens, self._camera_m = lens, camera_m
        self._alpha_m = alpha * lens.flat().focal_px[0] / camera_m
        self._meter = StrainMeter(on_plane(reference, lens, camera_m), DEGREE, (samples, samples))

    def fields(self, points: ControlPoints) -> StrainFields:
        """Strain of a frame's marks, in m from the camera's axis."""
        return self._meter.fields(on_plane(points, self._lens, self._camera_m))

    def cues(self, points: ControlPoints) -> TouchCues:
        return self.cues_of(self.fields(points))

    def cues_of(self, fields: StrainFields) -> TouchCues:
        gamma = self._alpha_m * fields.basis.count * mean_shift(fields)
        rings = find_rings(fields)
        if not rings:
            nan = math.nan
            return TouchCues(gamma, nan, nan, nan, nan, nan, 0, nan)
        centre = np.array([rings[0].x, rings[0].y])
        near, middle, far = (1e9 * outward_moment(fields, centre, reach) for reach in REACHES_M)
        return TouchCues(gamma, near, middle, far, rings[0].x, rings[0].y, len(rings), rings[0].radius)


def bridged(fields: StrainFields) -> tuple[Float[ndarray, "2 nv nu"], Bool[ndarray, "nv nu"]]:
    """Return the shift of the samples [unit], interpolated amid lost marks, and which count."""
    basis = fields.basis
    return basis.sampled(basis.net(fields.moved)), binary_fill_holes(basis.supported)


def mean_shift(fields: StrainFields) -> float:
    """Return the mean length of the samples' shift [unit]."""
    shift, counted = bridged(fields)
    return float(np.hypot(*shift)[counted].mean())


def outward_moment(fields: StrainFields, centre_m: Float[ndarray, " 2"], reach_m: float) -> float:
    """Integrate the outward shift times the distance, in a Gaussian window about a position [m^4].

    Args:
        fields: of marks in m.
        centre_m, reach_m: middle and standard deviation of the window [m].
    """
    if fields.unit != "m":
        raise InputError("a moment needs marks in m; take those of an image to the pattern with on_plane")
    if not 0 < reach_m < math.inf:
        raise RangeError(f"a reach of {reach_m} m; give a positive number of m")
    parts = (fields.at, *bridged(fields), fields.to_axes)
    at, shift, counted, J = (part[..., ::EVERY, ::EVERY] for part in parts)
    away = at - centre_m[:, None, None]
    window = np.exp(-0.5 * (away**2).sum(axis=0) / reach_m**2)
    area = 1 / np.abs(J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0])  # of the square of parameters, 0 to 1
    area = np.where(np.isfinite(area), area, np.nanmean(area))
    steps = np.diff(fields.basis.u[::EVERY]).mean() * np.diff(fields.basis.v[::EVERY]).mean()
    return float(((away * shift).sum(axis=0) * window * area)[counted].sum() * steps)
