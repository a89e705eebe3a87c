"""Parts of a rendering bench with their physical parameters: valve, chamber, sensors, arm, and finger.

Defaults are published values with their source, or assumptions marked as such; none was measured here.

Contact-area display: telescoping cylinders on a pressurized chamber that a finger pushes in.

A push d meets a disc of radius d R / H. Virtual work P dd = -p dV with V = pi R^2 H / 3 - pi d^3 R^2 / (3
H^2) gives P = p A. Rings raise the area in steps; a sleeve adds its spring, P = p A + k d.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, section 3.1.

Commanded motion of a pressing finger: cosine presses with tremor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.softness.characteristics import SoftObject

ATMOSPHERE_PA = 101_325.0
ANR_DENSITY_KG_M3 = 1.185  # of air at 20 degrees and 100 kPa, to which ISO 6358 refers flow
GAS_J_KG_K = 287.05  # of dry air
ROOM_K = 293.15


def check_parts(parts: object, *, zero: tuple[str, ...] = ()) -> None:
    """Refuse a figure that is not finite and above 0; those named may be 0."""
    for one in fields(parts):  # type: ignore[arg-type]
        value = getattr(parts, one.name)
        if isinstance(value, float) and not (
            math.isfinite(value) and (value > 0 or (value == 0 and one.name in zero))
        ):
            least = "0 or above" if one.name in zero else "above 0"
            raise RangeError(f"{type(parts).__name__}: {one.name} is {value:g}; give a finite value {least}")


@dataclass(frozen=True, slots=True)
class ProportionalValve:
    """Three-way proportional valve: supply, chamber, exhaust.

    Defaults: Festo MPYE-5-M5-010-B (100 l/min from 6 to 5 bar gauge, 125 Hz), that is 0.39 l/(s bar) with b =
    0.3 by ISO 6358; overlap as in O. Olaby et al. (6th JFPS Symposium on Fluid Power, 2005, 3D1-1).

    Attributes:
        conductance: sonic conductance C, fully open [m^3/(s Pa)].
        overlap: fraction of the stroke, to either side, in which the valve is closed.
    """

    conductance: float = 3.93e-9
    critical_ratio: float = 0.3
    bandwidth_hz: float = 125.0
    overlap: float = 0.02
    supply_pa: float = 130e3

    def __post_init__(self) -> None:
        check_parts(self, zero=("overlap",))
        if not (self.critical_ratio < 1 and self.overlap < 1):
            raise RangeError(
                f"a valve of critical ratio {self.critical_ratio:g} and overlap {self.overlap:g}; both are "
                "below 1"
            )


@dataclass(frozen=True, slots=True)
class Chamber:
    """Chamber, tube, and sleeve; values are assumptions.

    Attributes:
        dead_m3: volume of tube (0.3 m, 2.5 mm) and base [m^3].
        leak, safety: sonic conductance of leak and vent valve [m^3/(s Pa)].
        polytropic: exponent n of p V^n, 1 (isothermal) to 1.4.
    """

    dead_m3: float = 1.8e-6
    tube_lag_s: float = 0.9e-3
    leak: float = 4e-12
    safety: float = 2e-9
    safety_s: float = 5e-3
    polytropic: float = 1.2
    sleeve_n_m: float = 20.0
    friction_n: float = 0.02
    damping_n_s_m: float = 0.3
    tip_kg: float = 4e-3

    def __post_init__(self) -> None:
        check_parts(self, zero=("leak", "sleeve_n_m", "friction_n", "damping_n_s_m"))


@dataclass(frozen=True, slots=True)
class DisplaySensors:
    """Noise of Hall sensor (Allegro A1324 at 0.4 V/mm) and pressure sensor (assumption), with 16-bit
    converters.
    """

    hall_noise_m: float = 4e-6
    pressure_noise_pa: float = 40.0

    def __post_init__(self) -> None:
        check_parts(self, zero=("hall_noise_m", "pressure_noise_pa"))


@dataclass(frozen=True, slots=True)
class ArmMechanics:
    """Delta arm along the press axis: force and resolution of the Force Dimension delta.3, the rest
    assumptions.

    Attributes:
        brake_n_s_m: viscous damping with shorted motor windings [N s/m].
    """

    mass_kg: float = 0.30
    friction_n: float = 0.10
    damping_n_s_m: float = 1.0
    brake_n_s_m: float = 20.0
    force_n: float = 20.0
    lag_s: float = 0.5e-3
    resolution_m: float = 20e-6
    reach_m: float = 15e-3

    def __post_init__(self) -> None:
        check_parts(self, zero=("friction_n", "damping_n_s_m", "lag_s", "resolution_m"))


@dataclass(frozen=True, slots=True)
class FingerMechanics:
    """Pressing finger: pulp, mass, muscles, and tremor.

    Mass, stiffness, damping: A. Z. Hajian, R. D. Howe, J. Biomech. Eng. 119 (1997) 109,
    doi:10.1115/1.2796052. Pulp F = b (exp(m d) - 1): D. T. V. Pawluk, R. D. Howe, J. Biomech. Eng. 121 (1999)
    605, doi:10.1115/1.2800860; b (`pulp_n`) and m (`pulp_per_m`) are of that order. Physiological tremor is
    at 8 to 12 Hz.
    """

    mass_kg: float = 6e-3
    stiffness_n_m: float = 500.0
    damping_n_s_m: float = 4.0
    pulp_n: float = 0.2
    pulp_per_m: float = 1500.0
    pulp_damping_n_s_m: float = 1.0
    tremor_m: float = 0.05e-3
    tremor_hz: float = 10.0

    def __post_init__(self) -> None:
        check_parts(self, zero=("damping_n_s_m", "pulp_damping_n_s_m", "tremor_m"))


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


Times = Float[ndarray, " n"]


@runtime_checkable
class MeantMotion(Protocol):
    """Where a finger or a probe means to be, over time."""

    @property
    def gap_m(self) -> float:
        """Gap by which it hangs above the surface at first [m]."""

    def meant(self, time_s: Times, finger: FingerMechanics) -> tuple[Times, Times]:
        """Places where it means to be, and its speed [m], [m/s]."""


@dataclass(frozen=True, slots=True)
class FingerPresses:
    """Presses to a commanded depth past first touch, starting a gap above the surface."""

    depth_m: float
    frequency_hz: float = 1.0
    gap_m: float = 0.5e-3
    starts_s: float = 0.1
    count: float = math.inf

    def __post_init__(self) -> None:
        if not (0 < self.frequency_hz < 50 and self.gap_m >= 0 and 0 <= self.depth_m < math.inf):
            raise RangeError(
                f"presses of {self.depth_m * 1e3:g} mm at {self.frequency_hz:g} Hz from "
                f"{self.gap_m * 1e3:g} mm above; give a depth and a gap of 0 or more, and 0 to 50 Hz"
            )

    def meant(self, time_s: Times, finger: FingerMechanics) -> tuple[Times, Times]:
        """Where the finger means to be, and its speed [m], [m/s]."""
        since = time_s - self.starts_s
        on = (since > 0) & (since * self.frequency_hz < self.count)
        omega, span = 2 * math.pi * self.frequency_hz, self.depth_m + self.gap_m
        place = -self.gap_m + np.where(on, 0.5 * span * (1 - np.cos(omega * since)), 0.0)
        speed = np.where(on, 0.5 * span * omega * np.sin(omega * since), 0.0)
        shake = 2 * math.pi * finger.tremor_hz
        return (
            place + finger.tremor_m * np.sin(shake * time_s),
            speed + finger.tremor_m * shake * np.cos(shake * time_s),
        )


def depth_for(soft: SoftObject, force_n: float, finger: FingerMechanics) -> float:
    """Return the commanded depth [m] of a slow press to a force: object, pulp, and muscle compliance."""
    pulp = math.log1p(force_n / finger.pulp_n) / finger.pulp_per_m
    return float(soft.displacement.at_force(force_n)) + pulp + force_n / finger.stiffness_n_m
