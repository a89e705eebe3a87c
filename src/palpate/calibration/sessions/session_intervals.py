"""Intervals for a session that is yet to come, from errors in sessions that were held out.

Rows of one session err together: its mounting, light and temperature are the same. So the promise "90 % of
the rows of a new session" rests on the number of sessions K, and not on the number of rows.

**Distribution-free**, where K (1 - c) >= c, which is nine sessions at c = 0.9. Draw one score from each of
the K sessions. They and one of a new session are exchangeable, so that the new one is above the r-th smallest
with probability 1 - r / (K + 1); r = ceil(c (K + 1)) keeps the promise, whatever the errors' distribution.
For nine sessions at 90 % that is r = ceil(0.9 * 10) = 9: the greatest of the nine. (R. Dunn, L. Wasserman and
A. Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), section 4, doi:10.1080/01621459.2022.2060112.) One drawing
would leave the interval to chance; its mean over all drawings is computed here instead, in closed form. By
Jensen's inequality the mean covers at least as often as single drawings do, wherever larger errors are rarer
than smaller ones. Where they are not, as where rows fail grossly now and then, it is held at the quantile
of the rows themselves, each session weighted alike.

The quantile of all rows, each session weighted alike, at the level c (K + 1) / K (Y. Lee, R. F. Barber and R.
Willett, arXiv:2306.06342) promises the same without that condition, but for nine sessions it is the one
greatest error of all rows: far too wide. It is used beyond 200 sessions, where both are one.

**Parametric**, for two sessions and more up to there: a session's errors are Gaussian about an offset that is
itself Gaussian between sessions. Each session counts as one observation of the mean squared error, so that
the half-width is t times its root, t of Student's distribution with K degrees of freedom. Where sessions do
not differ that is wider than needed, by t over the Gaussian quantile (1.78 for two sessions, 1.23 for five),
since two sessions that agree do not show that the third will. Nothing is guaranteed where offsets are not
Gaussian.

Scores are of models that had not seen the session; the model that is kept has seen them all, which is the
jackknife's premise: that one session more changes it little (R. F. Barber et al., Ann. Statist. 49, 486
(2021), doi:10.1214/20-AOS1965).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, t as student

from palpate.calibration.coverage.conformal import fit_spread, parts_by_group, spread_terms
from palpate.calibration.coverage.group_quantiles import (
    is_distribution_free,
    new_group_quantile,
    weighted_quantile,
)
from palpate.core import Float, InputError, Values
from palpate.estimators.intervals import Intervals
from palpate.estimators.target_layout import Outputs, TargetLayout


def few_sessions_factor(sessions: int, coverage: float) -> float:
    """Student's over the Gaussian quantile: what so few sessions cost in width.

    Example:
        >>> [round(few_sessions_factor(count, 0.9), 2) for count in (2, 5, 8)]
        [1.78, 1.23, 1.13]
    """
    level = (1 + coverage) / 2
    return float(student.ppf(level, sessions) / norm.ppf(level))


def parametric_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float:
    """Score that one of a new group stays below, by the rule for few groups; see the module.

    Never less than that factor times the quantile of the scores themselves, each group weighted alike.

    Args:
        scores: of each row, signed or not.
        groups: label of each row's group ``[n]``, of two groups or more.
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
    """How far a target's errors differ from session to session.

    Attributes:
        between: standard deviation of the sessions' mean errors about no error, less what chance within a
            session adds [the target's unit].
        within: standard deviation of errors within a session [the same].
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
    """Intervals that cover the truth at the rate `coverage` in a session not yet seen.

    How their width follows the estimate is fitted as in `conformal.fit_intervals`, for each session's scores
    from the other sessions.

    Args:
        predicted: outputs ``[n o]`` of models that had not seen the row's session.
        true: the labels ``[n t]``.
        sessions: label of each row's session ``[n]``, two or more.
        groups: label of each row's group within the sessions ``[n]``, such as its press.
        coverage: 0 to 1.
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
