"""Half-widths of the 95 % intervals of scores, to which a report rounds them."""

from __future__ import annotations

import math

from palpate.core import half_width_text, rounded
from palpate.estimators.model_card import ScoreCard

CONFIDENT = 1.96  # standard deviations on either side of a mean, for 95 %
MIN_SHARE_HALF_WIDTH = 1.0  # least written half-width of a percentage
MIN_R2_HALF_WIDTH = 1e-3  # least written half-width of R²


def mean_error_half_width(score: ScoreCard, groups: int) -> float:
    """Return the half-width of a mean absolute error's 95 % interval over groups."""
    spread = math.sqrt(max(score.rmse**2 - score.mae**2, 0.0))
    return CONFIDENT * spread / math.sqrt(max(min(groups, score.n), 1))


def explained_half_width(score: ScoreCard, groups: int) -> float:
    """Return the half-width of the 95 % interval of R² over groups, as a ratio of two normal variances."""
    n = max(min(groups, score.n), 1)
    return CONFIDENT * abs(1 - score.r2) * math.sqrt(4 / n)


def width_text(half_width: float, period: float | None = None, unit: str = "") -> str:
    """Return the half-width of an interval to two digits, or that it is the whole turn of a circular target.

    Example:
        >>> width_text(0.523), width_text(12.3, 360.0, "deg"), width_text(200.0, 360.0, "deg")
        ('±0.52', '±12 deg', 'the whole turn')
    """
    if period is not None and 2 * half_width >= period:
        return "the whole turn"
    return f"±{half_width_text(half_width)} {unit}".rstrip()


def percent(share: float, low: float, high: float) -> str:
    """Return a ratio in percent to the decimal place of its interval; 100 and 0 only where exact.

    Example:
        >>> percent(0.8963, 0.86, 0.92), percent(0.998, 0.16, 1.0), percent(1.0, 0.16, 1.0)
        ('89.6', '99.8', '100')
    """
    shown = rounded(100 * share, max(50 * (high - low), MIN_SHARE_HALF_WIDTH))
    if 0 < share < 1 and float(shown) in (0, 100):
        return f"{min(max(100 * share, 0.1), 99.9):.1f}"
    return shown
