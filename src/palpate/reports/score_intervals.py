"""Half-widths of the 95 % intervals of scores, to which a report rounds them."""

from __future__ import annotations

import math

from palpate.core import half_width_text, rounded
from palpate.estimators.model_card import ScoreCard

CONFIDENT = 1.96  # standard deviations on either side of a mean, for 95 %
MIN_SHARE_HALF_WIDTH = 1.0
"""Half-width of a share in percent that is written at least: one decimal is enough of any rate."""
MIN_R2_HALF_WIDTH = 1e-3
"""Half-width of R² that is written at least: a fourth decimal of it tells nobody anything."""


def mean_error_half_width(score: ScoreCard, groups: int) -> float:
    """Half-width of a mean absolute error's 95 % interval, groups counted as groups.

    Errors of one group are taken for one: of n groups the mean has the n-th root of the spread of |error|,
    whose square is the mean square less the square of the mean.
    """
    spread = math.sqrt(max(score.rmse**2 - score.mae**2, 0.0))
    return CONFIDENT * spread / math.sqrt(max(min(groups, score.n), 1))


def explained_half_width(score: ScoreCard, groups: int) -> float:
    """Half-width of the 95 % interval of R², groups counted as groups.

    1 - R² is a ratio of two variances, each of which varies by the root of 2/n of itself where errors and
    truths are normal.
    """
    n = max(min(groups, score.n), 1)
    return CONFIDENT * abs(1 - score.r2) * math.sqrt(4 / n)


def width_text(half_width: float, period: float | None = None, unit: str = "") -> str:
    """Half-width of an interval to its own two digits, or that it is the whole turn of a circular target.

    Example:
        >>> width_text(0.523), width_text(12.3, 360.0, "deg"), width_text(200.0, 360.0, "deg")
        ('±0.52', '±12 deg', 'the whole turn')
    """
    if period is not None and 2 * half_width >= period:
        return "the whole turn"
    return f"±{half_width_text(half_width)} {unit}".rstrip()


def percent(share: float, low: float, high: float) -> str:
    """A share, to the place of its own interval, in percent and without the sign.

    Only all is written as 100, and only none as 0.

    Example:
        >>> percent(0.8963, 0.86, 0.92), percent(0.998, 0.16, 1.0), percent(1.0, 0.16, 1.0)
        ('89.6', '99.8', '100')
    """
    shown = rounded(100 * share, max(50 * (high - low), MIN_SHARE_HALF_WIDTH))
    if 0 < share < 1 and float(shown) in (0, 100):
        return f"{min(max(100 * share, 0.1), 99.9):.1f}"
    return shown
