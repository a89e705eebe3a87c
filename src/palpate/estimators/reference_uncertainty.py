"""Uncertainty of the reference instrument in the interval of a reading.

Systematic errors such as a force sensor's scale are in no held-out error. They add in quadrature (JCGM
100:2008, GUM, eq. 10) on each side of the estimate, side = sqrt(side_model² + (k u)²), with k of the normal
distribution at the interval's coverage, or of the chi distribution for a joint region (`joint_reach`).

Rules by which a single reading is refused: beyond the calibrated range, or too wide to tell anything.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TypeVar

import numpy as np

from palpate.core.reading import NONE, ReasonCode, Refusal
from palpate.estimators.model_card import RangeCard, TargetCard

Place = TypeVar("Place", float, np.ndarray)


def reference_half_width(standard_uncertainty: float, coverage: float) -> float:
    """Return the half-width k u of the interval from a standard uncertainty alone.

    Example:
        >>> round(reference_half_width(0.02, 0.9), 4)
        0.0329
    """
    return standard_uncertainty * NormalDist().inv_cdf((1 + coverage) / 2)


def with_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Return the ends of the interval for the true quantity, from those for the instrument's value."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    return value - np.hypot(value - low, half), value + np.hypot(high - value, half)


def without_reference(target: TargetCard, value: Place, low: Place, high: Place) -> tuple[Place, Place]:
    """Return the ends of the interval for the instrument's value: the inverse of `with_reference`."""
    if target.measured_by is None or target.measured_by.half_width == 0:
        return low, high
    half = target.measured_by.half_width
    below, above = (np.sqrt(np.maximum(side**2 - half**2, 0)) for side in (value - low, high - value))
    return value - below, value + above


def doubt(target: TargetCard, value: float, low: float, high: float) -> Refusal:
    """Return the reason not to trust a value; false if there is none.

    Refused are targets that are not read, estimates or intervals (without the instrument's uncertainty)
    further beyond the calibrated range than the card allows, and intervals as wide as the range.
    """
    if target.is_never_valid:
        return Refusal(ReasonCode.NOT_LEARNED, _not_read(target))
    ends = with_reference(target, value, low, high)
    if untold(target, *ends):
        return Refusal(ReasonCode.UNDETERMINED, _tells_nothing(target, ends[1] - ends[0]))
    if target.circular is not None:
        return _outside(_outside_arc(target, value, (high - low) / 2, target.circular.period))
    if target.over_range is None:
        return _outside(_wholly_outside(target, value, (high - low) / 2))
    return _extrapolated(target, target.over_range, value, low, high)


def _outside(why: str) -> Refusal:
    return Refusal(ReasonCode.OUTSIDE_RANGE, why) if why else NONE


def untold(target: TargetCard, low: float, high: float) -> bool:
    """Whether a target is not read, or its interval is as wide as the range."""
    if target.is_never_valid:
        return True
    return target.untold_width is not None and bool(high - low >= target.untold_width)


def _extrapolated(target: TargetCard, over: RangeCard, value: float, low: float, high: float) -> Refusal:
    """Reason if the estimate, or else the interval, is too far beyond the range."""
    what = f"{target.quantity} {value:.3g} {target.unit}"
    sides = ((target.least - value, target.least - low), (value - target.greatest, high - target.greatest))
    for (estimate, end), usual, usual_end in zip(sides, over.beyond, over.reach, strict=True):
        if estimate > usual:
            return _outside(_beyond(target, f"{what} lies", estimate, usual))
        if end > usual_end:
            why = _beyond(target, f"the interval of {what} reaches", end, usual_end)
            return Refusal(ReasonCode.INTERVAL_OUTSIDE_RANGE, why)
    return NONE


def _beyond(target: TargetCard, what: str, far: float, usual: float) -> str:
    return (
        f"{what} {far:.2g} {target.unit} beyond the calibrated range {_range(target)}; up to {usual:.2g} "
        f"{target.unit} is usual for frames within it"
    )


def _outside_arc(target: TargetCard, value: float, half_width: float, period: float) -> str:
    middle, half = (target.least + target.greatest) / 2, (target.greatest - target.least) / 2
    away = abs((value - middle + period / 2) % period - period / 2) - half
    if away <= half_width or math.isnan(value):
        return ""
    return (
        f"{target.quantity} {value:.3g} {target.unit} lies {away:.2g} {target.unit} outside the calibrated "
        f"arc {_range(target)}, by more than its interval's half-width"
    )


def _not_read(target: TargetCard) -> str:
    score, why = target.score, too_unsure(target)
    if score.says_nothing:
        off = f"its error, {score.mae:.3g} {target.unit} on average, is no better than always saying the mean"
        why = f"{off} ({score.mean_mae:.3g} {target.unit})"
    return f"this calibration does not read {target.quantity.replace('_', ' ')}: {why}"


def too_unsure(target: TargetCard) -> str:
    """Return why a target is not read by the width of its intervals, or ""."""
    if not target.is_as_unsure_as_its_range:
        return ""
    wide = f"its intervals are {_wide(target, 2 * target.score.half_width)} on average"
    return f"{wide}, {_as_random(target)}" if target.untold_width == 0 else f"{wide}, and {_whole(target)}"


# ratio of the arc from which intervals are as wide as guesses need for 90 %: 0.9 less chance
ABOUT = 0.85


def _as_random(target: TargetCard) -> str:
    """Reason why a circular target is uninformative as calibrated."""
    circular = target.circular
    if circular is None or 2 * target.score.half_width < ABOUT * (target.greatest - target.least):
        return "but on rows held out of the calibration they, or its errors, were those of random guesses"
    return (
        f"as wide as directions drawn at random need; if errors pile up at {circular.period / 2:.4g} "
        f"{target.unit}, calibrate with --circular {target.column}={circular.period / 2:.4g}"
    )


def _whole(target: TargetCard) -> str:
    """Width that an interval is compared with: the range, the turn, or as the card states."""
    if target.circular is None:
        return f"the calibrated range {_range(target)} is no wider"
    stated = target.circular.untold_width
    if stated is None:
        return f"the whole turn is {target.circular.period:.3g} {target.unit}"
    share = 100 * stated / (target.greatest - target.least)
    return (
        f"{stated:.3g} {target.unit} are {share:.3g} % of the calibrated arc {_range(target)}, whatever the "
        "frame shows"
    )


def _tells_nothing(target: TargetCard, width: float) -> str:
    wide = f"its interval is {_wide(target, width)}"
    return f"this frame does not tell {target.quantity}: {wide}, and {_whole(target)}"


def _wide(target: TargetCard, width: float) -> str:
    """Width in words, at most the whole turn."""
    turn = target.circular.period if target.circular is not None else width
    return f"{min(width, turn):.3g} {target.unit} wide"


def _range(target: TargetCard) -> str:
    return f"{target.least:.3g} to {target.greatest:.3g} {target.unit}"


def _wholly_outside(target: TargetCard, value: float, half: float) -> str:
    """Reason if the whole interval is beyond the range (cards without other rules)."""
    if target.least - half <= value <= target.greatest + half:
        return ""
    return (
        f"{target.quantity} {value:.3g} {target.unit} lies beyond the calibrated range "
        f"{target.least:.3g} to {target.greatest:.3g} {target.unit}"
    )
