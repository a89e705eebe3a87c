"""One copy of the TacTip: by which terms it differs from its design, and how far presses tell them.

On a flat rigid plate a picture of the pins depends on depth, on how the plate is seated, on the ratio of the
moduli of skin and gel, and on pins and camera: on both moduli together it does not. The force is in
proportion to them. So a picture alone tells depth and shape, and known forces tell the stiffness.

All of it is one estimate, as of the palm: terms of the copy with a prior, what is unknown of each press, pins
as they were found, and known forces and positions where there are any. A calibration, a reading and a check
by a known weight differ in what is known beforehand, and in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Int, RangeError, ndarray
from palpate.estimators.unit_fit import correlated_pairs, term_rows
from palpate.mechanics.axisymmetric.tip_family import tip_between
from palpate.sensors.tactip.tactip_spec import TacTipSpec
from palpate.sensors.tactip.tip_view import TipOptics

COPY_TERMS = (
    "stiffness", "ratio", "lever_mm", "camera_mm", "distortion", "edge_rad", "axis_x_mm", "axis_y_mm",
    "seat_x_rad", "seat_y_rad",
)  # fmt: skip
"""Logarithm of the force at `STATED_MM` of depth over the design's, and of the skin's modulus over the gel's;
length of the pins; height of the pinhole above the apex; the lens's distortion at the outermost ring of pins,
and the polar angle of that ring's roots; where the dome's axis stands beside the camera's; and how the usual
plate leans, as the turn of the contact about the dome's centre."""

STATED_MM = 3.0  # depth at which the stiffness is stated

SPREADS = {
    "stiffness": 0.25, "ratio": 0.6, "lever_mm": 0.3, "camera_mm": 3.0, "distortion": 0.04, "edge_rad": 0.015,
    "axis_x_mm": 0.5, "axis_y_mm": 0.5, "seat_x_rad": 0.015, "seat_y_rad": 0.015,
}  # fmt: skip
"""By how much copies differ from their design, as standard deviations. Assumed."""

TermVector = Float[ndarray, " t"]
TermCovariance = Float[ndarray, "t t"]


@dataclass(frozen=True, eq=False)
class TipCopy:
    """A copy of the TacTip.

    Attributes:
        spec: the TacTip as designed.
        terms: see `COPY_TERMS`.
        covariance: of them.
        rest_px: its untouched pins, (x, y) from their middle; None where none was seen yet [px].
        cells: of these pins on their lattice.
        limit_off: greatest misfit of a picture over the pins' motion that still is this copy's.
    """

    spec: TacTipSpec
    terms: TermVector
    covariance: TermCovariance
    rest_px: Float[ndarray, "p 2"] | None = None
    cells: Int[ndarray, "p 2"] | None = None
    limit_off: float = 0.12

    @property
    def optics(self) -> TipOptics:
        """Lever, camera and lens."""
        return TipOptics(*self.terms[2:6].tolist())

    @property
    def stiffness_share(self) -> float:
        """Standard deviation of the force at a depth of 3 mm, as a share."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def stated_force_n(self) -> float:
        """Force at a depth of 3 mm [N]."""
        return design_force_n(self.spec, STATED_MM) * math.exp(self.terms[0])

    @property
    def moduli_pa(self) -> tuple[float, float]:
        """Young's moduli of skin and gel, if dome and skin's thickness are the tables' [Pa]."""
        tip = tip_between(float(self.terms[1]))
        scale = self.stated_force_n / float(tip.press.force_at(np.array([1e-3 * STATED_MM]))[0])
        return scale * tip.skin_pa, scale * tip.gel_pa

    @property
    def told(self) -> dict[str, dict[str, float]]:
        """Each term and its standard deviation."""
        return term_rows(COPY_TERMS, self.terms, self.covariance)

    @property
    def tied(self) -> tuple[tuple[str, str], ...]:
        """Pairs of terms that cannot be told apart."""
        return correlated_pairs(COPY_TERMS, self.covariance)


def design_force_n(spec: TacTipSpec, depth_mm: float) -> float:
    """Force of the design's tip on a rigid plate [N]."""
    return float(spec.table.press(math.inf).force_at(np.array([1e-3 * depth_mm]))[0])


def designed_tip(spec: TacTipSpec, spreads: Mapping[str, float] = SPREADS) -> TipCopy:
    """What is known of a copy before it was pressed: its design, and how far copies differ.

    Args:
        spec: the design.
        spreads: standard deviations of `COPY_TERMS`, in their units.
    """
    sd = np.array([spreads[name] for name in COPY_TERMS])
    if not (np.isfinite(sd).all() and (sd > 0).all()):
        raise RangeError(f"spreads {dict(spreads)}; give finite ones above 0", code="not-positive")
    table, pins = spec.table, spec.pins
    along = np.arange(pins.rings)  # one side of the outermost ring
    away = pins.pitch_m * np.sqrt(pins.rings**2 - pins.rings * along + along**2)
    edge_rad = float(np.arcsin(away / spec.inner_radius_m).mean())
    terms = [
        0.0, math.log(table.skin_pa / table.gel_pa), 1e3 * pins.length_m, 1e3 * spec.camera.height_m, 0.0,
        edge_rad, 0.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip
    return TipCopy(spec, np.array(terms), np.diag(sd**2))
