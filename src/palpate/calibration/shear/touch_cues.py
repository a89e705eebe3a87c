"""Cues of normal force in the motion of a pattern's marks.

Every cue is a sum of shifts, so that it doubles with the displacement; an image tells no more of a skin whose
stiffness is not known.

    gamma  = alpha K mean |s - s_ref|                    the published measure, alpha and K explicit
    moment = integral (X - X_c) . U exp(-|X - X_c|^2 / 2 r^2) dA     for three reaches r [m^4]

The moment over the whole plane goes with the force whatever the pressure's shape: it is the slope of the
layers' response to a wave of load where the wave is long. A window keeps the edge of the pattern and the
noise of far marks out; three windows tell tips apart, which a single cue cannot.

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
    """Cues of one frame.

    Attributes:
        gamma: published measure, mean form.
        near, middle, far: moments within 2.5, 5 and 10 mm of the contact [1e-9 m^4]; NaN without one.
        x_m, y_m: the contact's place from the camera's axis [m]; NaN without one.
        contacts: how many there are.
        radius_m: of the ring where the skin moves outward most [m]; NaN without one.
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
    """Cues of frames against the untouched pattern.

    Args:
        reference: marks of the untouched pattern [px of the camera's image].
        lens: of the camera.
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
        """Cues of a frame's marks.

        Raises:
            InputError, RangeError: marks of another unit, or too few in common with the reference.
        """
        return self.cues_of(self.fields(points))

    def cues_of(self, fields: StrainFields) -> TouchCues:
        """Cues of strain that is at hand."""
        gamma = self._alpha_m * fields.basis.count * mean_shift(fields)
        rings = find_rings(fields)
        if not rings:
            nan = math.nan
            return TouchCues(gamma, nan, nan, nan, nan, nan, 0, nan)
        centre = np.array([rings[0].x, rings[0].y])
        near, middle, far = (1e9 * outward_moment(fields, centre, reach) for reach in REACHES_M)
        return TouchCues(gamma, near, middle, far, rings[0].x, rings[0].y, len(rings), rings[0].radius)


def bridged(fields: StrainFields) -> tuple[Float[ndarray, "2 nv nu"], Bool[ndarray, "nv nu"]]:
    """Shift of the samples [unit], bridged where marks are lost amid others, and which samples count.

    Marks under a deep press are the first to be lost, so that leaving their samples out would bias a sum.
    """
    basis = fields.basis
    return basis.sampled(basis.net(fields.moved)), binary_fill_holes(basis.supported)


def mean_shift(fields: StrainFields) -> float:
    """Mean length of the samples' shift [unit]."""
    shift, counted = bridged(fields)
    return float(np.hypot(*shift)[counted].mean())


def outward_moment(fields: StrainFields, centre_m: Float[ndarray, " 2"], reach_m: float) -> float:
    """Integral of the outward shift times the distance, in a Gaussian window about a place [m^4].

    Args:
        fields: of marks in m.
        centre_m: the window's middle [m].
        reach_m: its standard deviation [m].

    Raises:
        InputError: fields in px.
        RangeError: a reach that is not positive.
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
