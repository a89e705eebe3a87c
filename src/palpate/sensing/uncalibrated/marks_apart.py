"""Motion of marks against each other, apart from that which is common to all.

A touch moves marks of a skin apart; a camera or a mount that moved moves them all alike. What is common is a
shift and a turn. What is left has, without a touch, the noise with which marks are found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Float, ndarray
from palpate.sensing.uncalibrated.mark_motion import MarkMotion

MIN_FOUND = 0.6  # of the marks, with fewer nothing is told
MIN_NOISE_PX = 0.03  # along each axis: of marks that lie otherwise on the pixels than in the untouched frames


class MarksApart:
    """Tells whether marks have moved apart by more than the noise with which they are found.

    Args:
        untouched: motion of the marks in frames of the untouched sensor, two or more.

    Attributes:
        limit_px: largest motion apart that noise explains [px].
    """

    def __init__(self, untouched: Sequence[MarkMotion], rate: float) -> None:
        apart = [one.apart()[1] for one in untouched if len(one.at_px)]
        count = max((len(one) for one in apart), default=1)
        square = float(np.mean(np.concatenate(apart) ** 2)) if apart else 0.0
        # Each of `count` motions is a Rayleigh variable, whose tail is exp(-r^2 / 2 sigma^2).
        self.limit_px = max(math.sqrt(square), MIN_NOISE_PX) * math.sqrt(2 * math.log(count / rate))

    def told(self, marks: MarkMotion) -> tuple[Float[ndarray, 2], float] | None:
        """Common shift, and the largest motion apart over its limit; None where too few marks are found."""
        found = len(marks.at_px)
        if found < MIN_FOUND * (found + marks.lost):
            return None
        shift, apart = marks.apart()
        return shift, float(np.hypot(*apart.T).max()) / self.limit_px
