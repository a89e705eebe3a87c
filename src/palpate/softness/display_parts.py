"""Parts of a rendering bench, as its physics takes them: valve, chamber, sensors, arm, and a pressing finger.

Figures are those of parts that can be bought, or of people, with their source; what no source states is an
assumption and says so. None was measured by this project.
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
    """Three ways of a proportional directional valve: supply, chamber, exhaust.

    The defaults are those that the maker states of the Festo MPYE-5-M5-010-B: 100 l/min from 6 to 5 bar of
    gauge pressure, 125 Hz at full stroke. Flow follows ISO 6358: that nominal flow with b = 0.3 is a sonic
    conductance of 0.39 l/(s bar). Overlap is of the order that O. Olaby et al. measured on one (6th JFPS
    Symposium on Fluid Power, 2005, 3D1-1).

    Attributes:
        conductance: sonic, fully open, C [m^3/(s Pa)].
        overlap: share of the stroke, to either side, in which no way is open.
        supply_pa: gauge pressure at its inlet [Pa].
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
    """Chamber under the cone, its tube and its sleeve: assumptions about a bench of the source's size.

    Attributes:
        dead_m3: volume that no push displaces: tube of 0.3 m and 2.5 mm, and what lies under the cone [m^3].
        tube_lag_s: after which flow from the valve arrives: 0.3 m at the speed of sound [s].
        leak: sonic conductance to the air, past the cylinders [m^3/(s Pa)].
        safety: sonic conductance of the switching valve between valve and chamber, which without current lets
            the chamber out and shuts the other off [m^3/(s Pa)].
        polytropic: exponent n of p V^n, between 1, isothermal, and 1.4.
        damping_n_s_m: of the tip against the base [N s/m].
        tip_kg: mass that moves with the tip [kg].
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
    """Hall sensor and pressure sensor, as they come through a converter of 16 bits.

    A linear Hall sensor such as the Allegro A1324 states a bandwidth of 17 kHz; with a magnet that gives
    0.4 V a millimetre, a noise of 1 to 2 mV is some micrometres. The pressure sensor's is an assumption.
    """

    hall_noise_m: float = 4e-6
    pressure_noise_pa: float = 40.0

    def __post_init__(self) -> None:
        check_parts(self, zero=("hall_noise_m", "pressure_noise_pa"))


@dataclass(frozen=True, slots=True)
class ArmMechanics:
    """A delta arm along the axis of the press.

    Greatest force and resolution are what Force Dimension states of the delta.3 (20 N, 0.02 mm); moving mass,
    friction and the motors' lag are assumptions.

    Attributes:
        mass_kg: that moves, with the display on it [kg].
        brake_n_s_m: viscous while it brakes, its motors' windings joined [N s/m].
        lag_s: from a force asked to a force given [s].
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
    """A finger that presses: its pulp, its mass, the muscles that hold it where it means to be, and tremor.

    Mass, stiffness and damping lie in the ranges that A. Z. Hajian and R. D. Howe measured of the index
    finger (J. Biomech. Eng. 119 (1997) 109, doi:10.1115/1.2796052). The pulp stiffens exponentially, as
    D. T. V. Pawluk and R. D. Howe found (J. Biomech. Eng. 121 (1999) 605, doi:10.1115/1.2800860); its two
    constants here are of that order, and an assumption. Physiological tremor lies at 8 to 12 Hz.

    Attributes:
        pulp_n: b of F = b (exp(m d) - 1) [N].
        tremor_m: amplitude of the place where it is meant to be [m].
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
