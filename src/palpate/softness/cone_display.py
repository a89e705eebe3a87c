"""Contact-area display: telescoping cylinders on a pressurized chamber that a finger pushes in.

A push d meets a disc of radius d R / H. Virtual work P dd = -p dV with V = pi R^2 H / 3 - pi d^3 R^2 / (3
H^2) gives P = p A. Rings raise the area in steps; a sleeve adds its spring, P = p A + k d.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, section 3.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray

Array = Float[ndarray, "*n"]


@dataclass(frozen=True, slots=True)
class ConeDisplay:
    """Shape of a display; `rings` is 0 for an ideal cone, `sleeve_n_m` the sleeve's stiffness."""

    height_m: float = 10e-3
    radius_m: float = 6.5e-3
    rings: int = 0
    sleeve_n_m: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.height_m < math.inf and 0 < self.radius_m < math.inf):
            raise RangeError(
                f"a display {self.height_m * 1e3:g} mm high with a radius of {self.radius_m * 1e3:g} mm; "
                "both have to be finite and above 0 mm"
            )
        if not 0 <= self.sleeve_n_m < math.inf:
            raise RangeError(f"a sleeve of {self.sleeve_n_m / 1e3:g} N/mm; give 0 or more")
        if self.rings < 0:
            raise InputError(f"{self.rings} rings; give 0 for a cone, or 1 and more")

    @property
    def greatest_m2(self) -> float:
        """Area of the base [m^2]."""
        return math.pi * self.radius_m**2

    def area_m2(self, pushed_m: float | Array) -> Array:
        """Contact area at a displacement of the tip, of 0 to the height [m^2]."""
        share = self._share(pushed_m)
        return np.asarray(self.greatest_m2 * (share if not self.rings else self._stair(share)) ** 2)

    def volume_m3(self, pushed_m: float | Array) -> Array:
        """Volume of the chamber's cone [m^3]: so much that its fall is the area times the way."""
        share = self._share(pushed_m)
        whole = self.greatest_m2 * self.height_m
        if not self.rings:
            return np.asarray(whole * (1 - share**3) / 3)
        n = self.rings
        begun = np.arange(n) / n  # of each ring's way
        grown = (2 * np.arange(n) + 1) / n**2  # by which each ring's area exceeds that of the one before
        way = np.clip(1.0 - begun, 0.0, None) - np.clip(share[..., None] - begun, 0.0, None)
        return np.asarray(whole * (way * grown).sum(axis=-1))

    def pushed_m(self, area_m2: float | Array) -> Array:
        """Displacement at which the cone has an area: (H / R) sqrt(A / pi) [m]; of rings as of their cone."""
        area = np.asarray(area_m2, float)
        if np.any((area < 0) | (area > self.greatest_m2 * (1 + 1e-12)) | np.isnan(area)):
            raise RangeError(
                f"the display's area is from 0 to {self.greatest_m2 * 1e6:.4g} mm², and another was asked for"
            )
        return np.asarray(self.height_m / self.radius_m * np.sqrt(area / math.pi))

    def _share(self, pushed_m: float | Array) -> Array:
        pushed = np.asarray(pushed_m, float)
        if np.any((pushed < 0) | (pushed > self.height_m * (1 + 1e-12)) | np.isnan(pushed)):
            raise RangeError(
                f"the tip can be pushed in by 0 to {self.height_m * 1e3:g} mm, and another way was asked for",
                code="way",
            )
        return np.asarray(pushed / self.height_m)

    def _stair(self, share: Array) -> Array:
        """Radius of the widest ring that is met, over that of the base; 0 before any touch."""
        met = np.minimum(np.floor(share * self.rings) + 1, self.rings) / self.rings
        return np.asarray(np.where(share > 0, met, 0.0))
