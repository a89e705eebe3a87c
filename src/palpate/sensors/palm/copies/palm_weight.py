"""Check of a palm unit by a known weight; an untouched membrane does not show E and C.

The image under the weight gives depth and E C, the weight gives E, and both give C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import InputError, Progress, UInt8, ndarray, silent
from palpate.estimators.unit_fit import WEIGHT_SHARE, changed_since, drifted, since_fit, weight_n
from palpate.sensors.palm.copies.palm_copy import CopyFit, PalmCopy, PicturedPress, designed_copy
from palpate.sensors.palm.copies.palm_copy_fit import fit_copy

STILL_M, SAID_MOVED = 0.1e-3, 3.0  # maximum motion of a weight at rest, plus standard deviations
FLOOR = 0.01  # minimum relative uncertainty of E and C


@dataclass(frozen=True, slots=True)
class WeightCheck:
    """Result of a weight check of a calibrated unit.

    Attributes:
        force_n: Weight [N].
        read_n: Force read from the image with the calibrated C [N].
        modulus_change, coefficient_change: Relative changes since the calibration.
        modulus_deviations, coefficient_deviations: Changes in standard deviations.
    """

    force_n: float
    read_n: float
    modulus_change: float
    coefficient_change: float
    modulus_deviations: float
    coefficient_deviations: float

    @property
    def drifted(self) -> tuple[str, ...]:
        """Names of the changed constants."""
        return drifted({"modulus": self.modulus_deviations, "coefficient": self.coefficient_deviations})


def check_weight(
    calibrated: PalmCopy, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"], mass_kg: float,
    progress: Progress = silent,
) -> tuple[WeightCheck, CopyFit]:  # fmt: skip
    """Compare a calibrated unit with an object of known mass that rests on the palm's ball.

    Args:
        calibrated: Unit.
        image, reference: Frames under the weight at rest and untouched.
        mass_kg: Total mass on the membrane including the ball [kg].
        progress: Callback for the rounds.

    Returns:
        Check, and the unit whose E and C follow from this weight alone.
    """
    force_n = weight_n(mass_kg)
    design = designed_copy(calibrated.spec)
    now, freedom = since_fit(calibrated.covariance, design.covariance, 2)
    unchanged = fit_copy(calibrated, [PicturedPress(image, reference)], progress)
    weighed = [PicturedPress(image, reference, force_n, WEIGHT_SHARE)]
    known = replace(calibrated, covariance=now + freedom)
    found = fit_copy(known, weighed, progress, near=unchanged)
    away, spread = changed_since(found.copy.terms - calibrated.terms, freedom, now, found.copy.covariance)
    towards = np.array([[1.0, 0.0], [-1.0, 1.0]])  # ln E, ln C
    change, spread = towards @ away[:2], towards @ spread[:2, :2] @ towards.T
    deviations = change / np.sqrt(np.diag(spread) + FLOOR**2)
    shares = np.expm1(change)
    read_n = found.presses[0].force_n * math.exp(float(change[1]))  # E C is visible, C is the calibrated one
    return WeightCheck(
        force_n, read_n, float(shares[0]), float(shares[1]), float(deviations[0]), float(deviations[1])
    ), found


def refuse_rolling(
    found: CopyFit, image: UInt8[ndarray, "h w 3"], later: UInt8[ndarray, "h w 3"],
    reference: UInt8[ndarray, "h w 3"], progress: Progress = silent,
) -> None:  # fmt: skip
    """Reject a weight that has moved some seconds later, since a push or slope carries part of it.

    Args:
        found: Unit from `check_weight`.
        image, later: First and later frame of the weight.
        reference: Untouched frame.
        progress: Callback for the rounds.
    """
    if np.array_equal(image, later):
        raise InputError("both pictures of the weight are the same; take the later one some seconds after")
    first = found.presses[0]
    then = fit_copy(found.copy, [PicturedPress(later, reference)], progress).presses[0]
    for name in ("x", "y"):
        moved = getattr(then, f"{name}_m") - getattr(first, f"{name}_m")
        spread = math.hypot(getattr(first, f"{name}_sd_m"), getattr(then, f"{name}_sd_m"))
        if abs(moved) > STILL_M + SAID_MOVED * spread:
            raise InputError(
                f"the weight has moved by {1e3 * moved:+.2f} mm along {name} between both pictures, and "
                f"{1e3 * (STILL_M + SAID_MOVED * spread):.2f} mm are allowed: let it come to rest on a level "
                "skin, and take both pictures anew"
            )
