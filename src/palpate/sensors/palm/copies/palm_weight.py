"""Check of a palm's copy by a known weight, which sees what an untouched frame cannot.

An untouched skin between crossed polarisers is dark whatever its modulus E and stress-optic coefficient C
are. Under a known weight the picture tells depth and E C, the weight tells E, and both tell C; each is held
against what the calibration says, by what both are uncertain of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import InputError, Progress, UInt8, ndarray, silent
from palpate.estimators.unit_fit import WEIGHT_SHARE, changed_since, drifted, since_fit, weight_n
from palpate.sensors.palm.copies.palm_copy import CopyFit, PalmCopy, PicturedPress, designed_copy
from palpate.sensors.palm.copies.palm_copy_fit import fit_copy

STILL_M, SAID_MOVED = 0.1e-3, 3.0  # a weight at rest is seen to move by less: this and standard deviations
FLOOR = 0.01  # of E and C, by which no weight is trusted to be better: a share


@dataclass(frozen=True, slots=True)
class WeightCheck:
    """What a known weight says of a calibrated copy.

    Attributes:
        force_n: of the weight [N].
        read_n: that the picture tells by the calibration's C, whatever E is [N].
        modulus_change, coefficient_change: of E and C since the calibration, as shares.
        modulus_deviations, coefficient_deviations: the same in standard deviations.
    """

    force_n: float
    read_n: float
    modulus_change: float
    coefficient_change: float
    modulus_deviations: float
    coefficient_deviations: float

    @property
    def drifted(self) -> tuple[str, ...]:
        """Names of what has changed: "modulus", "coefficient"."""
        return drifted({"modulus": self.modulus_deviations, "coefficient": self.coefficient_deviations})


def check_weight(
    calibrated: PalmCopy, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"], mass_kg: float,
    progress: Progress = silent,
) -> tuple[WeightCheck, CopyFit]:  # fmt: skip
    """Lay an object of known mass on the skin, resting on the palm's ball, and compare.

    Args:
        calibrated: the copy.
        image: a frame of it at rest.
        reference: of the untouched skin.
        mass_kg: of all that rests on the skin, the ball as well [kg].
        progress: called with rounds of the estimate.

    Returns:
        What was found, and the copy as this weight alone has its E and C.
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
    read_n = found.presses[0].force_n * math.exp(float(change[1]))  # E C is seen, and C is taken as it was
    return WeightCheck(
        force_n, read_n, float(shares[0]), float(shares[1]), float(deviations[0]), float(deviations[1])
    ), found


def refuse_rolling(
    found: CopyFit, image: UInt8[ndarray, "h w 3"], later: UInt8[ndarray, "h w 3"],
    reference: UInt8[ndarray, "h w 3"], progress: Progress = silent,
) -> None:  # fmt: skip
    """Refuse a weight that lies elsewhere some seconds later: a push or a slope carries part of it.

    Args:
        found: the weight as `check_weight` found it.
        image, later: the picture that it was found in, and another of it.
        reference: of the untouched skin.
        progress: called with rounds of the estimate.
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
