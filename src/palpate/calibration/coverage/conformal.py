"""Conformal intervals: estimate ± expected spread times a quantile of scaled held-out errors.

Cross-conformal prediction: Vovk, Ann. Math. Artif. Intell. 74:9 (2015), doi:10.1007/s10472-013-9368-4; scaled
scores: Papadopoulos et al., ECML 2002, doi:10.1007/3-540-36755-1_29. Folds keep groups whole.

Intervals that keep their rate over the whole range, from held-out errors.

Tenths of the range are joined until each cell has `MIN_GROUPS` groups. Where one width covers too few rows of
a cell, its band is the inner 90 % of scaled errors, rescaled by the cell's conformal quantile (V. Vovk, Ann.
Math. Artif. Intell. 74:9 (2015), doi:10.1007/s10472-013-9368-4; Y. Romano, E. Patterson and E. Candès,
NeurIPS 2019).

Joint regions of several targets: one ellipsoid that covers all of them at the stated rate, by the second
moments of scaled errors and the conformal quantile of their Mahalanobis distances.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.calibration.coverage.grouped_rates import (
    group_sizes,
    grouped_coverage_interval,
    weighted_quantile,
)
from palpate.core import Float, InputError, Int, RangeError, Values
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.intervals import (
    ErrorCells,
    ErrorSpread,
    Intervals,
    RangeIntervals,
    Row,
    component_names,
    design,
    mahalanobis,
)
from palpate.estimators.model_card import VectorCard
from palpate.estimators.networks.model_interface import Scaler

TENTHS = 10
MIN_GROUPS = 25  # per cell; its kept rate scatters by sqrt(0.9 · 0.1 / groups), 6 % with 25
MIN_ROWS = 60  # per cell, so that three or more lie beyond each quantile of a band
MAX_LEVEL = 1.0


def fit_range_intervals(
    estimate: Row, true: Row, spread: Row, quantile: float, groups: np.ndarray, coverage: float
) -> RangeIntervals | None:
    """Return bands of one target in the cells where one width covers too seldom; None where no cell needs
    one.

    Args:
        estimate, true: held-out estimates and labels, in the target's unit.
        spread: expected size of each row's error, fitted without its group.
        quantile: half-width of the interval of one width, in units of the spread.
    """
    ends = float(true.min()), float(true.max())
    by_truth, by_estimate = (cell_limits(values, groups, *ends) for values in (true, estimate))
    if not len(by_truth):
        return None
    half, error, parts = quantile * spread, (true - estimate) / spread, group_parts(groups)
    none = ErrorCells(np.empty(0), np.zeros(1), np.zeros(1))
    low, high = estimate - half, estimate + half
    first = _bands(by_truth, true, error, groups, parts, coverage, (low <= true) & (true <= high))
    low, high = RangeIntervals(first, none).ends(estimate, spread, half)
    second = _bands(by_estimate, estimate, error, groups, parts, coverage, (low <= true) & (true <= high))
    if not first.half.any() and not second.half.any():
        return None
    return RangeIntervals(first, second)


def cell_limits(values: Row, groups: np.ndarray, least: float, greatest: float) -> Float[np.ndarray, " k"]:
    """Return the limits between tenths of the range that leave each cell enough groups."""
    kept: list[float] = []
    start = -np.inf
    for limit in np.linspace(least, greatest, TENTHS + 1)[1:-1]:
        if _holds_enough(values, groups, start, limit):
            kept.append(float(limit))
            start = limit
    while kept and not _holds_enough(values, groups, kept[-1], np.inf):
        kept.pop()
    return np.array(kept)


def group_parts(groups: np.ndarray) -> Int[np.ndarray, " n"]:
    """Return the number of each row's part, at most five, groups kept whole."""
    # Here, since whoever reads an interval needs no scikit-learn.
    from sklearn.model_selection import GroupKFold

    part = np.zeros(len(groups), np.int64)
    count = min(5, len(np.unique(groups)))
    for k, (_, held) in enumerate(GroupKFold(count).split(part, groups=groups) if count > 1 else ()):
        part[held] = k
    return part


def grouped_quantile(scores: Row, groups: np.ndarray, coverage: float) -> float:
    """Return the score below which a row of a new group lies with probability `coverage`.

    Groups have equal weight; the level is coverage (G + 1) / G of G groups (R. Dunn, L. Wasserman and A.
    Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), doi:10.1080/01621459.2022.2060112).
    """
    n, sizes, index = len(scores), *group_sizes(groups)
    g = len(sizes)
    level = min(coverage * (g + 1) / g, MAX_LEVEL)
    if (sizes != sizes[0]).any():
        return weighted_quantile(scores, index, level)
    rank = min(int(np.ceil(n * level - 1e-9)), n)
    return float(np.sort(scores)[rank - 1])


def _holds_enough(values: Row, groups: np.ndarray, start: float, end: float) -> bool:
    rows = (values >= start) & (values < end)
    return int(rows.sum()) >= MIN_ROWS and len(np.unique(groups[rows])) >= MIN_GROUPS


def _bands(
    limits: Float[np.ndarray, " k"],
    values: Row,
    error: Row,
    groups: np.ndarray,
    parts: Int[np.ndarray, " n"],
    coverage: float,
    held: np.ndarray,
) -> ErrorCells:
    """Bands of the errors in the cells of some values; rows that are `held` need none."""
    cells = np.searchsorted(limits, values, side="right")
    centre, half = np.zeros((2, len(limits) + 1))
    for cell in range(len(limits) + 1):
        rows = cells == cell
        middle, reach = _middle(error[rows], coverage)
        scores = _scores(error[rows], parts[rows], coverage)
        factor = grouped_quantile(np.where(held[rows], 0.0, scores), groups[rows], coverage)
        centre[cell], half[cell] = middle, factor * reach
    return ErrorCells(limits, centre, half)


def _scores(error: Row, parts: Int[np.ndarray, " n"], coverage: float) -> Row:
    scores = np.empty_like(error)
    for part in np.unique(parts):
        held = parts == part
        middle, reach = _middle(error[~held] if not held.all() else error, coverage)
        scores[held] = np.abs(error[held] - middle) / reach
    return scores


def _middle(error: Row, coverage: float) -> tuple[float, float]:
    """Middle and half the length of the range that holds the inner share `coverage` of the errors."""
    low, high = np.quantile(error, [(1 - coverage) / 2, (1 + coverage) / 2])
    return float(low + high) / 2, max(float(high - low) / 2, float(np.finfo(np.float32).tiny))


ROWS_PER_COEFFICIENT = 20
MIN_RATIO = 1e-6  # of an error to what is typical: a logarithm is taken of it
GROUPS_FOR_SPREAD = 20  # groups from which the width may follow the estimate, if it predicts other groups
MANY_GROUPS = 50  # groups from which it always does


def conformal_quantile(scores: Float[np.ndarray, " n"], coverage: float) -> float:
    """Return the score of rank ceil((n + 1) coverage), below which a new one is with this probability."""
    if not 0 < coverage <= 1:
        raise RangeError(
            f"coverage is {coverage}; it is a rate above 0 and at most 1, such as 0.9", code="coverage-range"
        )
    n = len(scores)
    if n == 0:
        raise InputError(
            "no held-out scores to set an interval by; give the calibration at least two folds",
            code="few-groups",
        )
    rank = min(int(np.ceil((n + 1) * coverage)), n)
    return float(np.sort(scores)[rank - 1])


def pooled_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float:
    """Return the score that a row of a new group stays below, each group with the same weight.

    The level is raised by one of the effective number of rows (Kish), so that few long groups do not set it.
    """
    sizes, index = group_sizes(groups)
    if (sizes == sizes[0]).all():
        return conformal_quantile(scores, coverage)
    weights = 1.0 / sizes[index]
    worth = float(weights.sum() ** 2 / (weights @ weights))
    return weighted_quantile(scores, index, min(coverage * (worth + 1) / worth, 1.0))


def fit_intervals(
    predicted: Outputs, true: Values, groups: np.ndarray, coverage: float, layout: TargetLayout | None = None
) -> Intervals:
    """Fit intervals to held-out predictions.

    The spread is a quadratic, linear, or constant function of the outputs (`spread_terms`). A row's own group
    has no part in its spread. With enough groups, a target that is not periodic keeps its rate over its
    range.

    Args:
        predicted: held-out outputs of the model ``[n o]``.
        true: labels ``[n t]``.
        groups: group of each row ``[n]``.
        coverage: rate, 0 to 1.
        layout: of the targets in the outputs; None where each is one.
    """
    layout = layout or TargetLayout((None,) * true.shape[1])
    estimates = layout.decoded(predicted)
    errors = np.abs(layout.differences(estimates, true))
    terms = spread_terms(predicted, errors, groups)
    expected = _spread_by_others(predicted, errors, groups, terms)
    scores = errors / expected
    quantile = np.array([pooled_quantile(column, groups, coverage) for column in scores.T])
    by_range = tuple(
        fit_range_intervals(estimates[:, j], true[:, j], expected[:, j], quantile[j], groups, coverage)
        if period is None
        else None
        for j, period in enumerate(layout.periods)
    )
    spread = fit_spread(predicted, errors, terms)
    return Intervals(spread, quantile, coverage, by_range, layout)


def spread_of_others(predicted: Outputs, errors: Values, groups: np.ndarray) -> Values:
    """Return the expected size of each row's errors ``[n t]``, from the errors of other groups."""
    return _spread_by_others(predicted, errors, groups, spread_terms(predicted, errors, groups))


def _spread_by_others(
    predicted: Outputs, errors: Values, groups: np.ndarray, terms: tuple[int, ...]
) -> Values:
    expected = np.empty_like(errors)
    one, typical = np.array(terms) == 1, fit_spread(predicted, errors, terms).typical
    one &= len(np.unique(groups)) >= GROUPS_FOR_SPREAD
    for others, held in parts_by_group(groups):
        spread = fit_spread(predicted[others], errors[others], terms)
        # One width is undone by the quantile: that of the others' errors would only add its own scatter. With
        # few groups that scatter makes up for a quantile whose rank is raised by a row and not by a group.
        spread = replace(spread, typical=np.where(one, typical, spread.typical))
        expected[held] = spread.at(predicted[held])
    return expected


def parts_by_group(groups: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Return rows to fit by and rows to score, groups kept whole; a single group is both."""
    every, count = np.arange(len(groups)), len(np.unique(groups))
    if count < 2:
        return iter([(every, every)])
    # Here, since whoever reads an interval needs no scikit-learn.
    from sklearn.model_selection import GroupKFold

    return GroupKFold(min(5, count)).split(every, groups=groups)


def spread_terms(predicted: Outputs, errors: Values, groups: np.ndarray) -> tuple[int, ...]:
    """Return the number of terms of `design` in each target's spread: 1, the linear ones, or all."""
    (n, t), targets, count = predicted.shape, errors.shape[1], len(np.unique(groups))
    wanted = [terms for terms in (1 + t + t * (t + 1) // 2, 1 + t) if n >= ROWS_PER_COEFFICIENT * terms]
    if not wanted or count < GROUPS_FOR_SPREAD:
        return (1,) * targets
    if count >= MANY_GROUPS:
        return (wanted[0],) * targets
    one = _deviances(predicted, errors, groups, 1)
    gains = np.stack([one - _deviances(predicted, errors, groups, terms) for terms in wanted])
    mean, error = gains.mean(axis=1), gains.std(axis=1, ddof=1) / np.sqrt(count)
    best = np.where(mean > error, mean, 0.0)
    return tuple(
        wanted[k] if gain > 0 else 1 for k, gain in zip(best.argmax(axis=0), best.max(axis=0), strict=True)
    )


def _deviances(
    predicted: Outputs, errors: Values, groups: np.ndarray, terms: int
) -> Float[np.ndarray, "g t"]:
    rows = np.empty(errors.shape)
    for others, held in parts_by_group(groups):
        spread = fit_spread(predicted[others], errors[others], (terms,) * errors.shape[1])
        ratio = np.maximum(errors[held] / spread.at(predicted[held]), MIN_RATIO)
        rows[held] = 2 * (ratio - 1 - np.log(ratio))
    return np.stack([rows[groups == one].mean(axis=0) for one in np.unique(groups)])


def fit_spread(predicted: Outputs, errors: Values, terms: tuple[int, ...]) -> ErrorSpread:
    """Fit the size of errors ``[n t]`` as a function of the outputs ``[n o]``, by terms of `design`."""
    from sklearn.linear_model import GammaRegressor  # as above

    scaler = Scaler.of(predicted)
    typical = np.maximum(errors.mean(axis=0), np.finfo(np.float32).tiny)
    columns = design(scaler.scaled(predicted))
    coefficients = np.zeros((errors.shape[1], columns.shape[1]))
    for j, (ratio, count) in enumerate(zip((errors / typical).T, terms, strict=True)):
        if count > 1:
            model = GammaRegressor(alpha=1e-2, max_iter=1000)
            fitted = model.fit(columns[:, 1:count], np.maximum(ratio, MIN_RATIO))
            coefficients[j, :count] = [fitted.intercept_, *fitted.coef_]
    return ErrorSpread(scaler.mean, scaler.scale, typical, coefficients)


RIDGE = 1e-6  # added to a correlation's diagonal, for components with equal errors
MIN_TRACE = float(np.finfo(np.float32).tiny)  # of errors that are all zero


def vector_cards(
    vectors: Mapping[str, Sequence[str]],
    columns: Sequence[str],
    intervals: Intervals,
    outputs: Outputs,
    true: Values,
    groups: np.ndarray,
) -> tuple[VectorCard, ...]:
    """Return joint regions of vectors, from held-out outputs.

    Args:
        vectors: name of each, quantity_unit, and its targets.
        columns: all targets, in the order of the labels.
        intervals: of the single targets.
        outputs, true: of the model ``[n o]``, and labels ``[n t]``.
    """
    errors = intervals.errors(outputs, true)
    scaled = errors / spread_of_others(outputs, np.abs(errors), groups)
    cards = []
    for name, parts in vectors.items():
        at = [list(columns).index(part) for part in parts]
        correlation, scores = _fitted(scaled[:, at], groups)
        radius = grouped_quantile(scores, groups, intervals.coverage)
        inside = scores <= radius
        low, high = grouped_coverage_interval(inside, groups)
        cards.append(
            VectorCard(
                column=name,
                columns=tuple(parts),
                components=component_names(name, parts),
                correlation=tuple(tuple(map(float, row)) for row in correlation),
                radius=max(radius, float(np.finfo(np.float32).tiny)),
                n=len(true),
                covered=float(inside.mean()),
                low=low,
                high=high,
            )
        )
    return tuple(cards)


def joint_score(
    vector: VectorCard, columns: Sequence[str], errors: Values, spread: Values, groups: np.ndarray
) -> dict[str, Any]:
    """Return rows, covered ratio, and its 95 % interval of a vector's region; label uncertainty is not
    included.

    Args:
        columns: all targets, in the order of the labels.
        errors: estimates less labels ``[n t]``, in the targets' units.
        spread: expected sizes of the errors ``[n t]``.
    """
    at = [list(columns).index(part) for part in vector.columns]
    scaled = errors[:, at] / spread[:, at]
    inside = mahalanobis(scaled, np.array(vector.correlation)) <= vector.radius
    low, high = grouped_coverage_interval(inside, groups)
    return {"n": len(inside), "covered": float(inside.mean()), "low": low, "high": high}


def _fitted(
    scaled: Float[np.ndarray, "n k"], groups: np.ndarray
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " n"]]:
    parts, scores = group_parts(groups), np.empty(len(scaled))
    for part in np.unique(parts):
        held = parts == part
        scores[held] = mahalanobis(scaled[held], _moments(scaled[~held] if not held.all() else scaled))
    return _moments(scaled), scores


def _moments(scaled: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    moments = scaled.T @ scaled / len(scaled)
    return moments + RIDGE * max(float(np.trace(moments)), MIN_TRACE) * np.eye(len(moments))
