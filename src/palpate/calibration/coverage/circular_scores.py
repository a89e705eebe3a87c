"""Errors of quantities that come round again, their mean, and the arc that they cover."""

from __future__ import annotations

import numpy as np

from palpate.core import Float, LabelError
from palpate.estimators.target_layout import FULL_TURN

Row = Float[np.ndarray, " n"]


def shortest(difference: Row, period: float | None) -> Row:
    """Return differences the shortest way round, in [-period/2, period/2); unchanged without a period."""
    return difference if period is None else (difference + period / 2) % period - period / 2


def mean_direction(values: Row, period: float) -> float:
    """Return the direction of the mean of points on the circle, in (-period/2, period/2]."""
    angle = 2 * np.pi * values / period
    return float(np.arctan2(np.sin(angle).mean(), np.cos(angle).mean()) * period / (2 * np.pi))


def mean_of(values: Row, period: float | None) -> float:
    """Return the mean of values, or the mean direction of periodic ones."""
    return float(values.mean()) if period is None else mean_direction(values, period)


def dispersion(values: Row, period: float) -> float:
    """Return the mean squared distance from the mean direction [unit²]; period² / 12 if uniform."""
    return float(np.mean(shortest(values - mean_direction(values, period), period) ** 2))


MIN_GAP = 1 / 20  # widest gap, relative to the period, of directions that cover an arc only
ALIKE, MIN_EVEN = 3 / 4, 2 / 3  # gaps near the widest that sum to this ratio of a turn are steps


def calibrated_arc(values: Row, period: float) -> tuple[float, float]:
    """Return the arc that directions cover, from the first upwards to the second.

    It is the complement of the widest gap, or the whole turn where that gap is narrow or the directions are
    evenly spaced. It begins in [-period/2, period/2).
    """
    turned = np.unique(np.mod(values, period))
    gaps = np.diff(turned, append=turned[0] + period)
    widest = int(np.argmax(gaps))
    if gaps[widest] < MIN_GAP * period or _evenly_spaced(gaps, period):
        return -period / 2, period / 2
    start = float(turned[(widest + 1) % len(turned)])
    end = start + period - float(gaps[widest])
    turns = period * np.floor(start / period + 0.5)
    return float(start - turns), float(end - turns)


def _evenly_spaced(gaps: Row, period: float) -> bool:
    alike = gaps[gaps >= ALIKE * gaps.max()]
    return len(alike) > 1 and bool(alike.sum() >= MIN_EVEN * period)


NEARLY = 0.95


def uninformative_width(widths: Row, arc: float, coverage: float) -> float:
    """Return the width from which an interval around a direction carries no information, in its unit.

    If the image carries no information, intervals have a mean width of the coverage's ratio of the arc. Then
    every width is uninformative.

    Args:
        widths: interval widths of held-out rows.
        arc: length of the calibrated arc.
    """
    least = coverage * arc
    return 0.0 if np.minimum(widths, arc).mean() >= NEARLY * least else least


MAX_TURNS = 1.5  # of labels: -180 to 180 and 0 to 360 in one column reach over one and a half


def refuse_no_angles(column: str, values: Row, symbol: str, period: float) -> None:
    """Refuse labels of a circular target that are no directions; mixed conventions such as -180 to 180 and 0
    to 360 pass.
    """
    turn = max(period, FULL_TURN.get(symbol, period))
    span = float(np.ptp(values))
    if span > MAX_TURNS * turn * (1 + 1e-9):
        raise LabelError(
            f"{column} runs from {values.min():.6g} to {values.max():.6g} {symbol}, over "
            f"{span / turn:.3g} turns of "
            f"{turn:.6g} {symbol}: that counts turns and is no direction; leave it out of --circular, "
            f"or write it "
            f"modulo {period:.6g}",
            code="counts-turns",
        )
    if np.ptp(shortest(values - values[0], period)) < 1e-9 * period:
        raise LabelError(
            f"{column} is the same direction everywhere, modulo {period:.6g} {symbol}: nothing to learn",
            code="constant",
        )
