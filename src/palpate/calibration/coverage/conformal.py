"""Conformal intervals: estimate ± expected spread times a quantile of scaled held-out errors.

Cross-conformal prediction: Vovk, Ann. Math. Artif. Intell. 74:9 (2015), doi:10.1007/s10472-013-9368-4; scaled
scores: Papadopoulos et al., ECML 2002, doi:10.1007/3-540-36755-1_29. Folds keep groups whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from palpate.calibration.coverage.grouped_rates import group_sizes, weighted_quantile
from palpate.calibration.coverage.range_fit import fit_range_intervals
from palpate.core import Float, InputError, RangeError, Values
from palpate.estimators.intervals import ErrorSpread, Intervals, design
from palpate.estimators.networks.model_interface import Scaler
from palpate.estimators.target_layout import Outputs, TargetLayout

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
