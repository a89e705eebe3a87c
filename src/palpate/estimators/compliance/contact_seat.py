"""Where a contact sits: beside the apex all pins move to one side, in proportion to how far.

The mean motion of all pins at one force is compared with that of the references, between which it is
interpolated; its scatter over their trials, which is that of seating, is the unit. A contact that is only
higher or lower than another moves pins apart and leaves their mean where it is.
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
    """Mean motion of the pins of centred presses.

    Attributes:
        softness: of the references, rising, as `stiffness_curve.softness` has it.
        mean_px: of their trials, (x, y) [px].
        spread_px: standard deviation of a trial about its reference's mean, of one axis [px].
    """

    softness: Float[ndarray, " k"]
    mean_px: Float[ndarray, "k 2"]
    spread_px: float

    def off(
        self, sideways_px: Float[ndarray, 2], s: float, altered_px: Sequence[Float[ndarray, 2]] = ()
    ) -> float:
        """How far beside the references' seat, in standard deviations of their trials along one axis.

        Args:
            sideways_px: mean motion of the pins [px].
            s: softness of what is pressed.
            altered_px: what it would be under each nuisance of its standard size, by which it scatters as
                well: on an inclined top all pins move to one side, and a wrong force tells how far wrongly.
        """
        seat = [np.interp(s, self.softness, axis) for axis in self.mean_px.T]
        beside = (sideways_px - seat) / self.spread_px
        along = (np.reshape(altered_px, (-1, 2)) - sideways_px) / self.spread_px
        return float(np.sqrt(beside @ np.linalg.solve(np.eye(2) + along.T @ along, beside)))


def sideways_px(press: PinPress, layout_px: Float[ndarray, "p 2"]) -> Float[ndarray, 2]:
    """Mean motion of all pins at 4 N, (x, y) [px]."""
    mean = np.nanmean(motion_on_layout(press, layout_px), axis=1)
    return np.asarray(at_forces(press.force_n, mean, np.array([SEAT_N]))[0])


def fit_seat(softness: Float[ndarray, " k"], trials: Sequence[Float[ndarray, "_ 2"]]) -> Seat:
    """Fit to the mean motion of each reference's trials, two or more of each."""
    order = np.argsort(softness)
    mean = np.stack([one.mean(axis=0) for one in trials])
    about = np.concatenate([one - m for one, m in zip(trials, mean, strict=True)])
    freedom = 2 * (len(about) - len(trials))
    spread = float(np.sqrt((about**2).sum() / freedom))
    return Seat(np.asarray(softness)[order], mean[order], max(spread, MIN_PX))
