"""One trial: the tip moves down on a specimen at a steady speed while camera and force sensor sample.

Both run on one clock, the camera at every tenth sample of the force sensor. The tip starts a little above the
specimen, a random part of a frame away, and stops at the first sample above the greatest force.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import Float, Int, RangeError, UInt8, ndarray
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, TipTable
from palpate.sensors.tactip.pin_markers import SkinShape, head_on, markers
from palpate.sensors.tactip.tactip_camera import projected, rendered
from palpate.sensors.tactip.tactip_spec import TacTipSpec

LEAD_M = 1e-3  # above the specimen, where a trial starts
MAX_N = 5.2


@runtime_checkable
class TipOnSpecimen(Protocol):
    """A tip on a specimen, whatever its tilt."""

    @property
    def deepest_m(self) -> float:
        """The greatest approach it knows [m]."""

    def force_n(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Vertical force; 0 before first touch [N]."""

    def area_m2(self, force_n: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Of the contact [m^2]."""

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        """The skin's inside, the specimen's top leaning a little from where it should be."""


@dataclass(frozen=True)
class HeadOn:
    """A specimen under the tip's apex."""

    press: HeadOnPress
    radius_m: float

    @property
    def deepest_m(self) -> float:
        return float(self.press.approach_m[-1])

    def force_n(self, approach_m: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        return self.press.force_at(approach_m)

    def area_m2(self, force_n: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        return self.press.at("area_m2", force_n)

    def skin(self, approach_m: float, lean_rad: tuple[float, float]) -> SkinShape:
        force = float(self.press.force_at(np.array([approach_m]))[0])
        return head_on(self.press, self.radius_m, force, lean_rad)


@dataclass(frozen=True)
class Trial:
    """One press as the rig records it, and the truth behind it.

    Attributes:
        time_s: of the force sensor's samples [s].
        raw_n: what the force sensor said [N].
        desired_m, actual_m: position of the tip, asked for and as the encoder has it, from the start [m].
        frame_sample: which sample each frame belongs to.
        true_force_n: without noise or steps [N].
        true_area_m2: of the contact at every sample [m^2].
    """

    spec: TacTipSpec
    specimen: TipOnSpecimen
    time_s: Float[ndarray, " s"]
    raw_n: Float[ndarray, " s"]
    desired_m: Float[ndarray, " s"]
    actual_m: Float[ndarray, " s"]
    frame_sample: Int[ndarray, " f"]
    true_force_n: Float[ndarray, " s"]
    true_approach_m: Float[ndarray, " s"]
    shift_px: tuple[float, float]
    lean_rad: tuple[float, float]
    light: float
    seed: int

    @cached_property
    def true_area_m2(self) -> Float[ndarray, " s"]:
        return self.specimen.area_m2(self.true_force_n)

    def points_px(self, frame: int) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
        """True centres (x, y) and radii of the markers in one frame [px]; the middle pin first."""
        return pictured(
            self.spec,
            self.specimen.skin(
                max(0.0, float(self.true_approach_m[self.frame_sample[frame]])), self.lean_rad
            ),
            self.shift_px,
        )

    def frame(self, frame: int) -> UInt8[ndarray, "h w"]:
        """One image, the same at every call."""
        rng = np.random.default_rng([self.seed, frame])
        return rendered(*self.points_px(frame), self.spec.camera, rng, self.light)

    def frames(self) -> Iterator[UInt8[ndarray, "h w"]]:
        """All images, in order."""
        return (self.frame(i) for i in range(len(self.frame_sample)))


def trial(spec: TacTipSpec, specimen: TipOnSpecimen, seed: int) -> Trial:
    """One press of random seating.

    Args:
        spec: the sensor and its rig.
        specimen: what is pressed.
        seed: of everything random.

    Raises:
        RangeError: the specimen's table ends before the greatest force.
    """
    rng = np.random.default_rng(seed)
    seat, rate = spec.seating, spec.force.rate_hz
    every = round(rate / spec.camera.rate_hz)
    start = -(LEAD_M + rng.uniform(0, spec.speed_m_s * every / rate))
    time = np.arange(math.ceil((specimen.deepest_m - start) / spec.speed_m_s * rate) + 1) / rate
    approach = start + spec.speed_m_s * time
    approach = approach[approach <= specimen.deepest_m]
    force = specimen.force_n(approach)
    if force[-1] < MAX_N:
        raise RangeError(f"the table ends at {force[-1]:.3g} N; a trial goes to {MAX_N} N")
    n = int(np.searchsorted(force, MAX_N)) + 1
    time, approach, force = time[:n], approach[:n], force[:n]
    step = spec.force.resolution_n
    return Trial(
        spec,
        specimen,
        time,
        step * np.rint((force + spec.force.noise_n * rng.standard_normal(n)) / step),
        approach - start,
        approach - start + seat.position_m * rng.standard_normal(),
        np.arange(0, n, every),
        force,
        approach,
        tuple(seat.shift_px * rng.standard_normal(2)),
        tuple(seat.tilt_rad * rng.standard_normal(2)),
        1.0 + seat.light * rng.standard_normal(),
        seed,
    )


def pictured(
    spec: TacTipSpec, skin: SkinShape, shift_px: tuple[float, float] = (0.0, 0.0)
) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
    """Centres (x, y) and radii of the markers in the image [px]."""
    table, camera = spec.table, spec.camera
    seen, share = projected(markers(skin, spec.pins, table.radius_m - table.skin_m), camera, table.radius_m)
    scale = pixels_per_tangent(spec)
    middle = (camera.size_px - 1) / 2 + np.array(shift_px)
    return middle + scale * seen, scale * share * spec.pins.radius_m


def modulus_pa(table: TipTable, stiffness_n_m: float) -> float:
    """Young's modulus of the tables' cylinder of a stiffness [N/m], inf for a rigid plate [Pa]."""
    area_m2 = math.pi * table.specimen_radius_m**2
    return stiffness_n_m * table.specimen_height_m / area_m2


@lru_cache(maxsize=32)
def pixels_per_tangent(spec: TacTipSpec) -> float:
    """The camera's focal length [px]: the untouched field of pins fills its disc."""
    table, camera = spec.table, spec.camera
    untouched = head_on(table.press(math.inf), table.radius_m, 0.0, (0.0, 0.0))
    seen, _ = projected(markers(untouched, spec.pins, table.radius_m - table.skin_m), camera, table.radius_m)
    return float(camera.disc_px / np.hypot(*seen.T).max())
