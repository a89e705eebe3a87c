"""Published measure of touch, the scaled sum of a surface's sample shifts, and baselines.

    gamma = alpha sum_k |s_k - s_k,ref|,     alpha = 1/18000 per px,     F = 3.09 gamma - 1.14 N from 1 to 8 N

("NUSense: Shear Based Robust Optical Tactile Sensor", equation 3.3 and section 4.2). alpha depends on the
number of samples K, taken as 164 x 164, and on the image scale; the mean form, alpha K = 1.494 per px times
the mean shift, does not depend on K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.core import Field, Float, InputError, RangeError, ndarray
from palpate.estimators.surface_strain.strain_fields import StrainFields

PUBLISHED_ALPHA = 1 / 18_000  # per px
PUBLISHED_SAMPLES = 164 * 164  # K
PUBLISHED_SLOPE_N, PUBLISHED_OFFSET_N = 3.09, -1.14
PUBLISHED_RANGE_N = (1.0, 8.0)


@dataclass(frozen=True, slots=True)
class ShearMeasure:
    """Scaled sum of a surface's sample shifts.

    Attributes:
        alpha: Scale of the sum [1/unit].
        count: K, all samples, including those without marks.
        seen: Samples with marks around them.
        total: Sum of the shifts of those [unit].
    """

    alpha: float
    count: int
    seen: int
    total: float
    unit: Literal["px", "m"]

    @property
    def mean(self) -> float:
        return self.total / self.seen

    @property
    def mean_form(self) -> float:
        """Gamma of K samples with the mean shift of the seen ones."""
        return self.alpha * self.count * self.mean


def shear_measure(fields: StrainFields, alpha: float = PUBLISHED_ALPHA) -> ShearMeasure:
    """Return the published measure; its `alpha` holds for 164 x 164 samples in px of an undistorted image."""
    if not 0 < alpha < math.inf:
        raise InputError(f"alpha {alpha}; give a number above 0 (published: 1/18000)", code="alpha-range")
    if fields.unit != "px" and alpha == PUBLISHED_ALPHA:
        raise InputError("the published alpha is per px; give marks in px", code="unit-differs")
    seen = int(fields.basis.supported.sum())
    shifts = np.hypot(*fields.displacement)
    return ShearMeasure(alpha, fields.basis.count, seen, float(np.nansum(shifts)), fields.unit)


def published_force_n(gamma: float) -> float:
    """Return the force by the published line [N].

    Example:
        >>> round(published_force_n(0.6926), 3), round(published_force_n(2.9579), 3)
        (1.0, 8.0)
    """
    force, (low, high) = PUBLISHED_SLOPE_N * gamma + PUBLISHED_OFFSET_N, PUBLISHED_RANGE_N
    if not low - 0.01 <= force <= high + 0.01:
        raise RangeError(
            f"gamma {gamma:.4g} lies outside {published_gamma(low):.4g} to {published_gamma(high):.4g} (1 "
            "to 8 N)",
            code="gamma-range",
        )
    return force


def published_gamma(force_n: float) -> float:
    """Return gamma of a force by the published line."""
    return (force_n - PUBLISHED_OFFSET_N) / PUBLISHED_SLOPE_N


def shear_from_pressure(
    pressure_pa: Field,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
    blur_m: float,
    youngs_modulus_pa: float,
    thickness_m: float,
) -> Float[ndarray, "2 ny nx"]:
    """Return baseline (3.1): shear as the slope of the blurred pressure over G, times a thickness.

        gamma_j = t (3/E) d(sigma * phi)/dx_j,     3/E = 1/G of an incompressible skin.

    Args:
        pressure_pa: Pressure on the skin ``[ny nx]`` [Pa].
        x_m, y_m: Columns and rows, in even steps [m].
        blur_m: Standard deviation of the Gaussian phi [m].
        youngs_modulus_pa: Young's modulus of the skin [Pa].
        thickness_m: Thickness over which the shear acts [m].
    """
    steps = [np.diff(axis) for axis in (y_m, x_m)]
    if any(len(d) < 2 or not np.allclose(d, d[0], rtol=1e-6, atol=0) or d[0] <= 0 for d in steps):
        raise InputError("x_m and y_m are 3 or more places that rise in even steps [m]")
    if not (blur_m > 0 and youngs_modulus_pa > 0 and thickness_m > 0):
        raise InputError("the blur, the modulus and the thickness are positive; give them in m, Pa and m")
    dy, dx = (float(d[0]) for d in steps)
    blurred = gaussian_filter(pressure_pa, (blur_m / dy, blur_m / dx), mode="constant")
    by_y, by_x = np.gradient(blurred, dy, dx)
    return np.stack([by_x, by_y]) * (3 * thickness_m / youngs_modulus_pa)
