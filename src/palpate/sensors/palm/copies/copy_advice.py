"""Uncertainty of E and C after a unit's presses: dominant term, and most informative further press."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Progress, ndarray, silent
from palpate.estimators.unit_fit import covariance_with
from palpate.sensors.palm.copies.copy_estimate import MIN_DEPTH_M
from palpate.sensors.palm.copies.copy_force import deepest_m, log_force
from palpate.sensors.palm.copies.copy_slopes import picture_slopes
from palpate.sensors.palm.copies.palm_copy import LOCAL, PIXEL_SD, TERMS, PalmCopy
from palpate.sensors.palm.copies.press_picture import BLOCK_PX, away_from_edges

ALLOWED = {"modulus": 0.05, "coefficient": 0.03}  # relative half width of a 90 % interval
COVERED = 1.645
FORCE_SHARE, PLACE_SD_M = 0.01, 30e-6  # accuracy of a further press
SHALLOW, DEEP = 0.2, 0.8  # depths of candidate presses over the maximum
AWAY = 0.5  # distance of candidate presses from the axis over the radius


class UnsureConstant(NamedTuple):
    """A constant with a wide interval.

    Attributes:
        constant: "modulus" or "coefficient".
        half_share: Half width of its 90 % interval, relative.
        fault: Term that it is most correlated with.
        owed: Fraction of its variance that would vanish if that term were known.
        x_m, y_m, depth_m, force_n: Most informative further press.
        then_share: Half width with that press, relative.
    """

    constant: str
    half_share: float
    fault: str
    owed: float
    x_m: float
    y_m: float
    depth_m: float
    force_n: float
    then_share: float


def unsure_constants(copy: PalmCopy, progress: Progress = silent) -> tuple[UnsureConstant, ...]:
    """Return the constants of E and C whose 90 % half interval exceeds 5 % and 3 %."""
    directions = {"modulus": _direction(1.0, 0.0), "coefficient": _direction(-1.0, 1.0)}
    half = {name: COVERED * _spread(copy.covariance, one) for name, one in directions.items()}
    wide = {name: one for name, one in directions.items() if half[name] > ALLOWED[name]}
    if not wide:
        return ()
    thought = _presses(copy)
    after = []
    for i, local in enumerate(thought):
        progress("thinking of presses", i, len(thought))
        after.append(told_by(copy, local))
    return tuple(_unsure(copy, name, one, thought, after) for name, one in wide.items())


def told_by(copy: PalmCopy, local: Float[ndarray, " 8"]) -> Float[ndarray, "t t"]:
    """Return the covariance of a unit's terms after one more press of known force and position."""
    n = len(TERMS)
    few = replace(copy, spec=replace(copy.spec, rays_per_pixel=(1, 1)))  # rays, which do for advice
    J = picture_slopes(few, local, None, away_from_edges(copy, local))
    _, slopes = log_force(copy, local)
    H = J.T @ J / (PIXEL_SD * BLOCK_PX) ** 2 + np.outer(slopes, slopes) / FORCE_SHARE**2
    own = [1 / PLACE_SD_M**2, 1 / PLACE_SD_M**2, 0.0, *(1 / one**2 for one in copy.local_spreads)]
    H[n:, n:] += np.diag(own)
    return covariance_with(copy.covariance, H)


def _unsure(
    copy: PalmCopy, name: str, towards: ndarray, thought: list[ndarray], after: list[ndarray]
) -> UnsureConstant:
    variance = _spread(copy.covariance, towards) ** 2
    owed = (copy.covariance @ towards) ** 2 / np.diag(copy.covariance) / variance
    fault = 2 + int(np.argmax(owed[2:]))
    spreads = [_spread(one, towards) for one in after]
    best = int(np.argmin(spreads))
    local = thought[best]
    force_n = math.exp(log_force(copy, local)[0])
    return UnsureConstant(
        name, COVERED * math.sqrt(variance), TERMS[fault], float(owed[fault]), float(local[0]),
        float(local[1]), math.exp(local[2]), force_n, COVERED * spreads[best],
    )  # fmt: skip


def _presses(copy: PalmCopy) -> list[ndarray]:
    """Candidate presses: shallow and deep, in the middle and away from it."""
    away, deepest = AWAY * copy.spec.radius_m, deepest_m(copy.spec)
    found = []
    for x, y in ((0.0, 0.0), (away, 0.0), (0.0, away)):
        for share in (SHALLOW, DEEP):
            local = np.zeros(len(LOCAL))
            local[:3] = x, y, math.log(max(share * deepest, MIN_DEPTH_M))
            found.append(local)
    return found


def _direction(modulus: float, product: float) -> Float[ndarray, " t"]:
    towards = np.zeros(len(TERMS))
    towards[:2] = modulus, product
    return towards


def _spread(covariance: ndarray, towards: ndarray) -> float:
    return math.sqrt(float(towards @ covariance @ towards))
