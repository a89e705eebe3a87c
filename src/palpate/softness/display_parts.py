"""Parts of a rendering bench with their physical parameters: valve, chamber, sensors, arm, and finger.

Defaults are published values with their source, or assumptions marked as such; none was measured here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from palpate.core import RangeError

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
