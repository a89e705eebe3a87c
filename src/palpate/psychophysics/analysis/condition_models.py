"""Conditions compared over participants: logistic models of correct answers, and an exact test.

`marginal_log_odds` is a generalized estimating equation with independent working correlation and the sandwich
covariance of participants. `fit_mixed_logistic` has a random intercept per participant (adaptive
Gauss-Hermite) and a log-F(1, 1) penalty; it assumes one effect for all people, so that its p is too small
where effects differ. `sign_flip_p` is exact for few participants. Intervals are Student's, participants less
one.

References: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13, doi:10.1093/biomet/73.1.13; L. A. Mancl,
T. A. DeRouen, Biometrics 57 (2001) 126, doi:10.1111/j.0006-341X.2001.00126.x; S. Greenland, M. A. Mansournia,
Statist. Med. 34 (2015) 3133, doi:10.1002/sim.6537; Q. Liu, D. A. Pierce, Biometrika 81 (1994) 624,
doi:10.1093/biomet/81.3.624.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import optimize, special, stats

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.psychophysics.trial_statistics import corrected_by_holm

NODES = 31  # of Gauss and Hermite, for each participant
MAX_STEPS = 100  # of Newton, to a participant's likeliest intercept
MAX_INTERCEPT_SD = 8.0  # logits
MAX_FLIPPED = 16  # participants of whom all signs are counted
SIGN_DRAWS = 20_000
STEP = 1e-4  # over which a slope is differenced, logits


@dataclass(frozen=True)
class ConditionCounts:
    """Correct answers `right` out of `n`, one row per participant and one column per condition."""

    conditions: tuple[str, ...]
    participants: tuple[str, ...]
    right: Float[ndarray, "s c"]
    n: Float[ndarray, "s c"]

    def __post_init__(self) -> None:
        shape = (len(self.participants), len(self.conditions))
        if self.right.shape != shape or self.n.shape != shape:
            raise InputError(f"counts of {self.right.shape} and {self.n.shape}; {shape} are needed")
        if (self.right < 0).any() or (self.right > self.n).any():
            raise RangeError("more right answers than there are, or fewer than none")


@dataclass(frozen=True, slots=True)
class LogOddsDifference:
    """Difference of two conditions' log odds, second minus first [logit], with its 95 % interval."""

    first: str
    second: str
    value: float
    low: float
    high: float
    p: float
    holm_p: float


@dataclass(frozen=True)
class MixedLogistic:
    """Logistic model with a random intercept per participant and one effect for all; use
    only if `converged`.
    """

    conditions: tuple[str, ...]
    log_odds: Float[ndarray, " c"]
    covariance: Float[ndarray, "c c"]
    intercept_sd: float
    log_likelihood: float
    pairs: tuple[LogOddsDifference, ...]
    converged: bool


def marginal_log_odds(counts: ConditionCounts) -> tuple[LogOddsDifference, ...]:
    """Estimate differences by a generalized estimating equation; omit conditions all correct or all wrong."""
    _several(counts)
    k, m = counts.right.sum(axis=0), counts.n.sum(axis=0)
    told = (k > 0) & (k < m)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = k / m
        pull = (counts.right - counts.n * p) / (m * p * (1 - p))
        log_odds = special.logit(p)
    s = len(pull)
    pull = np.where(told, pull, 0.0)
    covariance = pull.T @ pull * s / (s - 1)
    return _pairs(counts.conditions, log_odds, covariance, s - 1, told)


def fit_mixed_logistic(counts: ConditionCounts) -> MixedLogistic:
    """Conditions with a random intercept of each participant, by greatest penalised likelihood."""
    _several(counts)

    def off(unknowns: ndarray) -> tuple[float, ndarray]:
        beta, sd = unknowns[:-1], float(unknowns[-1])
        value, slope = _log_likelihood(counts, beta, sd)
        penalty = float(np.sum(0.5 * beta - np.logaddexp(0.0, beta)))
        return -value - penalty, -slope - np.append(0.5 - special.expit(beta), 0.0)

    k, m = counts.right.sum(axis=0), counts.n.sum(axis=0)
    start = np.append(special.logit((k + 0.5) / (m + 1)), 0.5)
    bounds = [(-15.0, 15.0)] * len(k) + [(0.0, MAX_INTERCEPT_SD)]
    found = optimize.minimize(off, start, jac=True, method="L-BFGS-B", bounds=bounds)
    beta, sd = found.x[:-1], float(found.x[-1])
    free = len(found.x) - (sd < 10 * STEP)  # a scatter found to be 0 has no curvature there
    steps = STEP * np.eye(len(found.x))[:free]
    curvature = np.array([(off(found.x + e)[1] - off(found.x - e)[1])[:free] / (2 * STEP) for e in steps])
    covariance = np.linalg.inv((curvature + curvature.T) / 2)[: len(beta), : len(beta)]
    told = np.ones(len(beta), bool)
    pairs = _pairs(counts.conditions, beta, covariance, len(counts.participants) - 1, told)
    best = mixed_log_likelihood(counts, beta, sd)
    return MixedLogistic(counts.conditions, beta, covariance, sd, best, pairs, bool(found.success))


def mixed_log_likelihood(counts: ConditionCounts, log_odds: Float[ndarray, " c"], sd: float) -> float:
    """Return the log likelihood for `log_odds` and intercept SD `sd` [logit], without
    binomial coefficients.
    """
    return _log_likelihood(counts, log_odds, sd)[0]


def _log_likelihood(counts: ConditionCounts, log_odds: ndarray, sd: float) -> tuple[float, ndarray]:
    """Log likelihood, and its slope over the log odds and the scatter."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    middle, size = _likeliest_intercepts(counts, log_odds, sd)
    u = middle[:, None] + size[:, None] * nodes  # intercepts over their scatter, a row a participant
    eta = log_odds + sd * u[:, :, None]
    right, wrong = counts.right[:, None, :], (counts.n - counts.right)[:, None, :]
    each = -(right * np.logaddexp(0.0, -eta) + wrong * np.logaddexp(0.0, eta)).sum(axis=2)
    each += np.log(weights / weights.sum()) + nodes**2 / 2 - u**2 / 2 + np.log(size)[:, None]
    of_person = special.logsumexp(each, axis=1)
    share = np.exp(each - of_person[:, None])
    over = right - counts.n[:, None, :] * special.expit(eta)
    slope = np.einsum("sq,sqc->c", share, over)
    return float(of_person.sum()), np.append(slope, np.einsum("sq,sqc,sq->", share, over, u))


def _likeliest_intercepts(counts: ConditionCounts, log_odds: ndarray, sd: float) -> tuple[ndarray, ndarray]:
    """Mode and standard error of each participant's intercept, in units of the scatter, by bounded Newton
    steps.
    """
    u = np.zeros(len(counts.n))
    for _ in range(MAX_STEPS):
        p = special.expit(log_odds + sd * u[:, None])
        pull = sd * (counts.right - counts.n * p).sum(axis=1) - u
        curvature = 1 + sd**2 * (counts.n * p * (1 - p)).sum(axis=1)
        reach = 1 / max(sd, 1e-3)
        step = np.clip(pull / curvature, -reach, reach)
        u = u + step
        if np.abs(step).max() < 1e-9:
            break
    p = special.expit(log_odds + sd * u[:, None])
    return u, 1 / np.sqrt(1 + sd**2 * (counts.n * p * (1 - p)).sum(axis=1))


def sign_flip_p(differences: Sequence[float] | ndarray, rng: np.random.Generator | None = None) -> float:
    """Return the two-sided p of a sign-flip test; exact for up to sixteen participants, else sampled by
    `rng`.
    """
    d = np.asarray(differences, np.float64)
    if not len(d) or not np.isfinite(d).all():
        raise InputError("a test of differences needs one finite difference of each participant")
    if len(d) <= MAX_FLIPPED:
        signs = 1 - 2 * ((np.arange(2 ** len(d))[:, None] >> np.arange(len(d))) & 1)
        return float((np.abs(signs @ d) >= abs(d.sum()) - 1e-9).mean())
    signs = (rng or np.random.default_rng(0)).choice([-1, 1], size=(SIGN_DRAWS, len(d)))
    return float((1 + (np.abs(signs @ d) >= abs(d.sum()) - 1e-9).sum()) / (SIGN_DRAWS + 1))


@dataclass(frozen=True, slots=True)
class ShareDifference:
    """Difference of two conditions' proportions correct, second minus first, within participants.

    Attributes:
        low, high: Student's 95 % interval; None if all differences are equal.
        least_p: smallest p that this number of participants can give.
    """

    first: str
    second: str
    participants: int
    value: float
    low: float | None
    high: float | None
    p: float
    holm_p: float
    least_p: float


def share_differences(counts: ConditionCounts) -> tuple[ShareDifference, ...]:
    """Differences of every two conditions, each participant against himself."""
    _several(counts)
    found = []
    for i, j in combinations(range(len(counts.conditions)), 2):
        both = (counts.n[:, i] > 0) & (counts.n[:, j] > 0)
        if both.sum() < 2:
            continue
        d = counts.right[both, j] / counts.n[both, j] - counts.right[both, i] / counts.n[both, i]
        reach = float(stats.t.ppf(0.975, len(d) - 1) * d.std(ddof=1) / math.sqrt(len(d)))
        found.append((i, j, d, reach, sign_flip_p(d)))
    holm = corrected_by_holm([one[-1] for one in found])
    return tuple(
        ShareDifference(
            counts.conditions[i], counts.conditions[j], len(d), float(d.mean()),
            float(d.mean() - reach) if reach else None, float(d.mean() + reach) if reach else None,
            p, corrected, 2.0 ** (1 - len(d)),
        )
        for (i, j, d, reach, p), corrected in zip(found, holm, strict=True)
    )  # fmt: skip


def _several(counts: ConditionCounts) -> None:
    if len(counts.participants) < 2:
        raise InputError(
            f"{len(counts.participants)} participant; how conditions differ over people is told by two or "
            "more, best ten"
        )


def _pairs(
    names: Sequence[str], value: ndarray, covariance: ndarray, freedom: int, told: ndarray
) -> tuple[LogOddsDifference, ...]:
    at = [(i, j) for i, j in combinations(range(len(names)), 2) if told[i] and told[j]]
    rows = []
    for i, j in at:
        change = float(value[j] - value[i])
        error = math.sqrt(max(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j], 0.0))
        reach = float(stats.t.ppf(0.975, freedom)) * error
        p = float(2 * stats.t.sf(abs(change) / error, freedom)) if error else float(change == 0)
        rows.append((names[i], names[j], change, change - reach, change + reach, p))
    holm = corrected_by_holm([row[-1] for row in rows])
    return tuple(LogOddsDifference(*row, corrected) for row, corrected in zip(rows, holm, strict=True))


def counts_of(rows: Mapping[tuple[str, str], tuple[int, int]]) -> ConditionCounts:
    """Counts from right answers and all, by participant and condition."""
    people = tuple(dict.fromkeys(one for one, _ in rows))
    names = tuple(dict.fromkeys(name for _, name in rows))
    table = np.array([[rows.get((one, name), (0, 0)) for name in names] for one in people], np.float64)
    table = table.reshape(len(people), len(names), 2)
    return ConditionCounts(names, people, table[..., 0], table[..., 1])
