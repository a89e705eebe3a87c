"""Commanded motion of a pressing finger: cosine presses with tremor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.softness.characteristics import SoftObject
from palpate.softness.display_parts import FingerMechanics

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
