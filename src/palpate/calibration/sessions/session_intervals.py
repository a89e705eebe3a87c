"""Intervals for a future session, from errors in held-out sessions.

Errors within a session are correlated, so the promise rests on the number of sessions K.

**Distribution-free**, where K (1 - c) >= c (nine sessions at c = 0.9): the r-th smallest of one score per
session, r = ceil(c (K + 1)), covers a new session with probability r / (K + 1) (R. Dunn, L. Wasserman and A.
Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), section 4, doi:10.1080/01621459.2022.2060112). The mean over all
drawings is computed in closed form; by Jensen's inequality it covers at least as often where larger errors
are rarer, and it is at least the rows' own weighted quantile. Beyond 200 sessions the weighted quantile at c
(K + 1) / K is used (Y. Lee, R. F. Barber and R. Willett, arXiv:2306.06342).

**Parametric**, for two sessions and more: errors are Gaussian about an offset that is Gaussian between
sessions. Each session is one observation of the mean squared error; the half-width is Student's t with K
degrees of freedom times its root. Nothing is guaranteed where offsets are not Gaussian.

The kept model has seen all sessions; one session more must change it little (jackknife: R. F. Barber et al.,
Ann. Statist. 49, 486 (2021), doi:10.1214/20-AOS1965).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, t as student

from palpate.calibration.coverage.conformal import fit_spread, parts_by_group, spread_terms
from palpate.calibration.coverage.grouped_rates import (
    is_distribution_free,
    new_group_quantile,
    weighted_quantile,
)
from palpate.core import Float, InputError, Values
from palpate.estimators.intervals import Intervals
from palpate.estimators.target_layout import Outputs, TargetLayout


def few_sessions_factor(sessions: int, coverage: float) -> float:
    """Return Student's over the Gaussian quantile: the cost of few sessions in width.

    Example:
        >>> [round(few_sessions_factor(count, 0.9), 2) for count in (2, 5, 8)]
        [1.78, 1.23, 1.13]
    """
    level = (1 + coverage) / 2
    return float(student.ppf(level, sessions) / norm.ppf(level))


def parametric_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float:
    """Return the score that one of a new group stays below, by the parametric rule; at least that factor
    times the quantile of the scores with equal weight per group.

    Args:
        groups: group of each row ``[n]``, of two or more.
        coverage: 0 to 1.
    """
    _, of = np.unique(groups, return_inverse=True)
    counts = np.bincount(of)
    squares = np.bincount(of, weights=scores**2) / counts
    gaussian = float(norm.ppf((1 + coverage) / 2) * np.sqrt(squares.mean()))
    return few_sessions_factor(len(counts), coverage) * max(
        gaussian, weighted_quantile(np.abs(scores), of, coverage)
    )


@dataclass(frozen=True, slots=True)
class SessionSpread:
    """Standard deviation of a target's errors between sessions (less the part by chance) and within [the
    target's unit].
    """

    between: float
    within: float

    @classmethod
    def of(cls, errors: Float[np.ndarray, " n"], groups: np.ndarray) -> SessionSpread:
        """From signed errors of held-out rows and the label of each row's session ``[n]``."""
        _, of = np.unique(groups, return_inverse=True)
        counts = np.bincount(of)
        means = np.bincount(of, weights=errors) / counts
        variances = np.bincount(of, weights=(errors - means[of]) ** 2) / np.maximum(counts - 1, 1)
        between = float(np.mean(means**2 - variances / counts))
        return cls(math.sqrt(max(between, 0.0)), math.sqrt(float(variances.mean())))


def intervals_of_sessions(
    predicted: Outputs,
    true: Values,
    sessions: np.ndarray,
    groups: np.ndarray,
    coverage: float,
    layout: TargetLayout | None = None,
) -> Intervals:
    """Return intervals that cover the truth at the rate `coverage` in a session not yet seen.

    Args:
        predicted: outputs ``[n o]`` of models that had not seen the row's session.
        true: labels ``[n t]``.
        sessions: session of each row ``[n]``, two or more.
        groups: group within the sessions ``[n]``, such as the press.
        layout: of the targets in the outputs; None where each is one.
    """
    names, of = np.unique(sessions, return_inverse=True)
    if len(names) < 2:
        raise InputError("intervals for a new session need two sessions or more that were held out")
    layout = layout or TargetLayout((None,) * true.shape[1])
    errors = layout.differences(layout.decoded(predicted), true)
    terms = spread_terms(predicted, np.abs(errors), groups)
    whole = fit_spread(predicted, np.abs(errors), terms)
    scores = np.empty_like(true)
    for rest, held in parts_by_group(of):
        # With one scale for all, which the quantile undoes: the others' would only add their scatter.
        spread = replace(fit_spread(predicted[rest], np.abs(errors[rest]), terms), typical=whole.typical)
        scores[held] = errors[held] / spread.at(predicted[held])
    free = is_distribution_free(len(names), coverage)
    quantile = [
        new_group_quantile(np.abs(column), of, coverage)
        if free
        else parametric_quantile(column, of, coverage)
        for column in scores.T
    ]
    return Intervals(whole, np.array(quantile), coverage, layout=layout)
