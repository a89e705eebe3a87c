"""Presses of known force held out of a copy's fit: by how much they miss, over what was said of them.

An estimate's covariance knows what its model knows. What the model leaves out shows when each press is read
as if it were new, its force and place unknown, by a copy that the other presses made: since all is one least
squares, this is the same fit without that press's known force and place, and one solution of its linear
equations. The ratio of squared errors to their stated variances widens what new presses are read to be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, ndarray
from palpate.sensors.palm.copies.palm_copy import Widening

AS_STATED = 4.0  # errors in number, of the size that was stated, that are assumed beside those seen
MIN_PRESSES = 2  # presses, below which nothing is held out

Square = Float[ndarray, "u u"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownRow:
    """Something known of a press: slopes over all unknowns, by how much it is off, and its weight."""

    slopes: Float[ndarray, " u"]
    off: float
    weight: float
    press: int
    is_force: bool


def standardised(
    hessian: Square, spread: Square, known: Sequence[KnownRow], depth_at: Sequence[int]
) -> dict[str, list[float]]:
    """Errors of every held-out press, over the standard deviations stated of them.

    Args:
        hessian: of half the cost, at the fit of all.
        spread: what errors of pixels add to it, in the same unknowns: scores' own matrix.
        known: of all presses.
        depth_at: each press's unknown of its logarithm of the depth.
    """
    found: dict[str, list[float]] = {"place": [], "depth": [], "force": []}
    whole = _covariance(hessian, spread)
    for i, depth in enumerate(depth_at):
        rows = [one for one in known if one.press == i]
        if not rows:
            continue
        H = hessian - sum(one.weight * np.outer(one.slopes, one.slopes) for one in rows)
        g = -sum(one.weight * one.off * one.slopes for one in rows)
        covariance, step = _covariance(H, spread), np.linalg.solve(H, g)
        for one in rows:
            off = one.off - one.slopes @ step
            variance = one.slopes @ covariance @ one.slopes + 1 / one.weight
            found["force" if one.is_force else "place"].append(off / math.sqrt(variance))
        if any(one.is_force for one in rows):  # against the depth at which the known force is
            variance = max(covariance[depth, depth] - whole[depth, depth], 0.1 * covariance[depth, depth])
            found["depth"].append(step[depth] / math.sqrt(variance))
    return found


def widening_of(errors: dict[str, list[float]], presses: int) -> Widening:
    """Factors by which intervals have to be wider, from standardised errors of held-out presses; 1 or more.

    What errs alike in all presses does not show in them, so that small errors make no interval narrower.
    """
    if presses < MIN_PRESSES:
        return Widening()

    def factor(name: str) -> float:
        seen = np.array(errors[name])
        return max(math.sqrt((AS_STATED + float(seen @ seen)) / (AS_STATED + len(seen))), 1.0)

    return Widening(factor("place"), factor("depth"), factor("force"), presses)


def _covariance(hessian: Square, spread: Square) -> Square:
    bread = np.linalg.inv(hessian)
    return np.asarray(bread + bread @ spread @ bread)
