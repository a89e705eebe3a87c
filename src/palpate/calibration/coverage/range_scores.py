"""Coverage in tenths of a target's range with groups counted, and the limits of a range.

A range's limit is how far beyond it frames within it are read: the farthest of 97 % of the outermost tenth of
held-out frames, 97 % of those in the outermost tenth of the range, and 99 % of all.

Errors of quantities that come round again, their mean, and the arc that they cover.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from scipy.special import betainc

from palpate.calibration.coverage.conformal import TENTHS, grouped_quantile
from palpate.calibration.coverage.grouped_rates import (
    cautious_correlation,
    effective_rows,
    is_distribution_free,
    within_group_correlation,
)
from palpate.core import LabelError, Values
from palpate.estimators.class_sets import FULL_TURN, ClassCoverageCard, Outputs
from palpate.estimators.intervals import ErrorCells, Intervals, Row
from palpate.estimators.model_card import Card, CellsCard, RangeCard, TargetCard, TenthCard
from palpate.estimators.reference_uncertainty import too_unsure

MARGIN = 0.05  # allowed shortfall of a tenth's rate: 85 % where 90 % is promised
SIGNIFICANCE = 0.05  # probability of naming any tenth whose rate is as allowed (Holm)


def range_scores(
    along: Row, error: Row, inside: np.ndarray, groups: np.ndarray, ends: tuple[float, float], coverage: float
) -> tuple[TenthCard, ...]:
    """Score the tenths of a range that have rows.

    Args:
        along: value that assigns a row to a tenth: its truth, or its estimate.
        ends: calibrated range; rows beyond count to the outermost tenths.
    """
    limits = np.linspace(*ends, TENTHS + 1)
    at = np.searchsorted(limits[1:-1], along, side="right")
    # A tenth has too few groups to tell how alike their rows are: all tenths tell it together.
    alike = within_group_correlation(inside, np.unique(groups, return_inverse=True)[1] * TENTHS + at)
    return tuple(
        TenthCard(
            start=float(limits[k]),
            end=float(limits[k + 1]),
            n=int(rows.sum()),
            groups=len(np.unique(groups[rows])),
            covered=int(inside[rows].sum()),
            bias=float(error[rows].mean()),
            p=chance_of_so_few(inside[rows], groups[rows], coverage - MARGIN, alike),
        )
        for k in range(TENTHS)
        if (rows := at == k).any()
    )


def chance_of_so_few(
    inside: np.ndarray, groups: np.ndarray, rate: float, correlation: float | None = None
) -> float:
    """Return the binomial probability of as few hits by the effective number of rows.

    Args:
        inside: hits.
        rate: assumed rate.
        correlation: within groups; None takes these rows' own.
    """
    alike = cautious_correlation(inside, groups) if correlation is None else correlation
    effective = effective_rows(groups, alike)
    k = float(inside.mean()) * effective
    # P(X <= k) of a binomial, which the incomplete beta function continues to numbers that are not whole.
    return 1.0 if inside.all() else float(betainc(effective - k, k + 1, 1 - rate))


Part = TypeVar("Part", TenthCard, ClassCoverageCard)


def failing(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return parts that cover significantly too seldom by Holm's procedure (Scand. J. Stat. 6, 65 (1979))."""
    found: list[Part] = []
    for rank, part in enumerate(sorted(parts, key=lambda one: one.p)):
        if part.p > SIGNIFICANCE / (len(parts) - rank):
            break
        found.append(part)
    return tuple(part for part in parts if part in found)


def range_sentences(parts: Sequence[TenthCard], unit: str, coverage: float) -> tuple[str, ...]:
    """Return sentences on the parts of a range that do not keep the promise.

    Example:
        >>> above = TenthCard(start=12.0, end=18.5, n=20, groups=20, covered=8, bias=-3.0, p=1e-4)
        >>> range_sentences((above,), "N", 0.9)
        ('above 12 N it reads 3 N low; 8 of 20 covered where 90 % was promised',)
    """
    return tuple(
        f"{_where(part, parts, unit)} it reads {_lean(part, unit)}; {part.covered} of {part.n} covered where "
        f"{100 * coverage:g} % was promised"
        for part in failing(parts)
    )


def _where(part: TenthCard, parts: Sequence[TenthCard], unit: str) -> str:
    if part.end == max(one.end for one in parts):
        return f"above {part.start:.3g} {unit}"
    if part.start == min(one.start for one in parts):
        return f"below {part.end:.3g} {unit}"
    return f"from {part.start:.3g} to {part.end:.3g} {unit}"


def _lean(part: TenthCard, unit: str) -> str:
    return f"{abs(part.bias):.2g} {unit} {'low' if part.bias < 0 else 'high'}"


NEARLY_A_TURN = 350 / 360


def card_findings(card: Card) -> tuple[str, ...]:
    """Return the findings on the ranges of a certificate's targets."""
    return tuple(sentence for target in card.targets for sentence in target_findings(target, card.coverage))


def target_findings(target: TargetCard, coverage: float) -> tuple[str, ...]:
    """Return sentences on one target: tenths that cover too seldom, intervals as wide as the range, and
    angles that were trained on as plain numbers.
    """
    name = target.quantity.replace("_", " ")
    tenths = () if target.over_range is None else target.over_range.tenths
    found = [f"{name}: {sentence}" for sentence in range_sentences(tenths, target.unit, coverage)]
    if why := too_unsure(target):
        found.append(f"{name} is not read: {why}")
    turn, span = FULL_TURN.get(target.unit), target.greatest - target.least
    if turn is not None and target.circular is None and span >= NEARLY_A_TURN * turn:
        found.append(
            f"{name} covers {span:.4g} {target.unit}, a whole turn, as a plain number: where the turn "
            f"closes, "
            f"readings are off by up to a turn; calibrate with --circular {target.column}"
        )
    return tuple(found)


USUAL_AT_THE_END, USUAL = 0.97, 0.99
OUTER_SHARE, MIN_OUTER_ROWS = 0.1, 20


def usual_reach(
    true: Row, low: Row, high: Row, groups: np.ndarray, ends: tuple[float, float]
) -> tuple[float, float]:
    """Return how far below and above a range values of rows within it usually lie, 0 or more.

    Args:
        true: labels of held-out rows.
        low, high: values compared with the least and with the greatest label: the estimate twice, or the
            interval's ends.
        ends: of the calibrated range.
    """
    length = ends[1] - ends[0]
    below = _usual(true - ends[0], ends[0] - low, length, groups)
    above = _usual(ends[1] - true, high - ends[1], length, groups)
    return below, above


def _usual(within: Row, beyond: Row, length: float, groups: np.ndarray) -> float:
    """Distance beyond one end at which values usually lie.

    Args:
        within: distance of each label within that end.
        beyond: distance of its value beyond it; negative where within.
        length: of the range.
    """
    count = min(max(int(OUTER_SHARE * len(within)), MIN_OUTER_ROWS), len(within))
    tenths = np.argsort(within, kind="stable")[:count], np.flatnonzero(within <= OUTER_SHARE * length)
    found = [0.0, grouped_quantile(beyond, groups, USUAL)]
    found += [grouped_quantile(beyond[rows], groups[rows], USUAL_AT_THE_END) for rows in tenths if len(rows)]
    if not all(is_distribution_free(len(np.unique(groups[rows])), USUAL_AT_THE_END) for rows in tenths):
        found.append(grouped_quantile(within + beyond, groups, USUAL_AT_THE_END))
    return max(found)


def range_cards(
    intervals: Intervals,
    outputs: Outputs,
    true: Values,
    groups: np.ndarray,
    ranges: Sequence[tuple[float, float]],
) -> Sequence[RangeCard | None]:
    """Return each target's card over its range, from held-out outputs; None for a circular one.

    Args:
        outputs, true: of the model ``[n o]``, and labels ``[n t]``.
        ranges: least and greatest label of each target in all training rows.
    """
    layout = intervals.layout
    estimate = outputs if layout is None else layout.decoded(outputs)
    low, high = intervals.ends(outputs)
    inside = intervals.hold(outputs, true)
    return [
        None
        if layout is not None and layout.periods[j] is not None
        else RangeCard(
            by_truth=_cells_card(intervals, j, "by_truth"),
            by_estimate=_cells_card(intervals, j, "by_estimate"),
            beyond=usual_reach(true[:, j], estimate[:, j], estimate[:, j], groups, ranges[j]),
            reach=usual_reach(true[:, j], low[:, j], high[:, j], groups, ranges[j]),
            tenths=range_scores(
                true[:, j], estimate[:, j] - true[:, j], inside[:, j], groups, ranges[j], intervals.coverage
            ),
        )
        for j in range(true.shape[1])
    ]


def _cells_card(intervals: Intervals, j: int, which: str) -> CellsCard | None:
    one = intervals.by_range[j] if intervals.by_range else None
    if one is None:
        return None
    cells: ErrorCells = getattr(one, which)
    plain = {name: tuple(map(float, getattr(cells, name))) for name in ("limits", "centre", "half")}
    return CellsCard(**plain)


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
