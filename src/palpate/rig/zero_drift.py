"""Drift of a force sensor's zero over a press: how far it moved, and how far it may.

Every force of a press counts from the zero taken before it. A zero taken after it, in the air again, says by
how much those forces may be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import NS_PER_S, Wrench
from palpate.devices import ForceBias

ERRORS = 5.0  # standard errors of the two zeros' difference
SHARE = 0.005  # of the limit of force
QUIET = 3.0  # times the noise of before, beneath which samples about a slope are no noisier than they were


def moved_n(before: ForceBias, after: ForceBias) -> float:
    """Largest movement of the zero along x, y or z [N]."""
    return max(abs(b - a) for a, b in zip(before.force_n, after.force_n, strict=True))


def allowed_n(before: ForceBias, after: ForceBias, samples: int, force_limit_n: float) -> float:
    """Movement of the zero that a press may have: five errors of the two zeros, or 0.5 % of the limit [N].

    Args:
        before, after: the zeros and their noise.
        samples: of each zero.
        force_limit_n: greatest force that the rig allows [N].
    """
    error_n = math.hypot(before.noise_n, after.noise_n) / math.sqrt(max(samples, 1))
    return max(ERRORS * error_n, SHARE * force_limit_n)


def slope_n_s(samples: Sequence[Wrench], before: ForceBias) -> float:
    """Slope of a force that drifts along a line while its zero is taken; 0 where it does not [N/s].

    It drifts where the samples about their line are about as quiet as they were, and the line rises by more
    than their noise.
    """
    good = [one for one in samples if not one.fault]
    if len(good) < 3:
        return 0.0
    times_s = np.array([one.time_ns - good[0].time_ns for one in good]) / NS_PER_S
    normal_n = np.array([before.force(one)[2] for one in good])
    if not np.ptp(times_s) > 0:
        return 0.0
    slope, level = np.polyfit(times_s, normal_n, 1)
    spread_n = float(np.std(normal_n - level - slope * times_s, ddof=2))
    rise_n = abs(float(slope)) * float(np.ptp(times_s))
    drifts = spread_n <= QUIET * before.noise_n and rise_n > ERRORS * before.noise_n
    return float(slope) if drifts else 0.0
