"""Mounting misalignment of a contact: away from the apex all pins move to one side.

The mean motion of all pins is compared with that of the references at equal softness, in units of the scatter
between their trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, ndarray
from palpate.estimators.compliance.pin_press import PinPress, at_forces, motion_on_layout

SEAT_N = 4.0
MIN_PX = 0.05  # scatter below which centres cannot be told apart from their own noise


@dataclass(frozen=True)
class Seat:
    """Mean motion of the pins in centered presses.

    Attributes:
        softness: Softness of the references, ascending (`stiffness_curve.softness`).
        mean_px: Mean over their trials, (x, y) [px].
        spread_px: Standard deviation of a trial along one axis [px].
    """

    softness: Float[ndarray, " k"]
    mean_px: Float[ndarray, "k 2"]
    spread_px: float

    def off(
        self, sideways_px: Float[ndarray, 2], s: float, altered_px: Sequence[Float[ndarray, 2]] = ()
    ) -> float:
        """Return the misalignment in standard deviations of the reference trials along one axis.

        Args:
            sideways_px: Mean motion of the pins [px].
            s: Softness of the specimen.
            altered_px: Mean motion under each nuisance of one standard deviation.
        """
        seat = [np.interp(s, self.softness, axis) for axis in self.mean_px.T]
        beside = (sideways_px - seat) / self.spread_px
        along = (np.reshape(altered_px, (-1, 2)) - sideways_px) / self.spread_px
        return float(np.sqrt(beside @ np.linalg.solve(np.eye(2) + along.T @ along, beside)))


def sideways_px(press: PinPress, layout_px: Float[ndarray, "p 2"]) -> Float[ndarray, 2]:
    """Return the mean motion of all pins at 4 N, (x, y) [px]."""
    mean = np.nanmean(motion_on_layout(press, layout_px), axis=1)
    return np.asarray(at_forces(press.force_n, mean, np.array([SEAT_N]))[0])


def fit_seat(softness: Float[ndarray, " k"], trials: Sequence[Float[ndarray, "_ 2"]]) -> Seat:
    """Fit to the mean motion of two or more trials of each reference."""
    order = np.argsort(softness)
    mean = np.stack([one.mean(axis=0) for one in trials])
    about = np.concatenate([one - m for one, m in zip(trials, mean, strict=True)])
    freedom = 2 * (len(about) - len(trials))
    spread = float(np.sqrt((about**2).sum() / freedom))
    return Seat(np.asarray(softness)[order], mean[order], max(spread, MIN_PX))
