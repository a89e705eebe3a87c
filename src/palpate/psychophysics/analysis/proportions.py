"""Intervals of proportions: Wald, Wilson, Clopper-Pearson, Newcombe, and over participants.

The first four assume independent answers; answers of one participant are not, so use `cluster_interval`.
Wald's interval (doi:10.1109/TOH.2010.2, eq. 7) has no width at 0 of N and N of N.

References: E. B. Wilson, JASA 22 (1927) 209, doi:10.1080/01621459.1927.10502953; C. J. Clopper,
E. S. Pearson, Biometrika 26 (1934) 404, doi:10.1093/biomet/26.4.404; R. G. Newcombe, Statist. Med. 17 (1998)
873, doi:10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I (method 10); T. C. Hesterberg,
Am. Stat. 69 (2015) 371, doi:10.1080/00031305.2015.1089789 (expanded percentiles).

Power and sample size by simulation of the planned study, tested by `sign_flip_p`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special, stats

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.psychophysics.analysis.condition_models import sign_flip_p

BOOTSTRAP_DRAWS = 4_000
MIN_CLUSTERS = 2
MAX_LOG_ODDS = 12.0  # of a mean share
MEANS, CORRELATIONS = 401, 40  # nodes of the beta-binomial posterior

Ends = tuple[float, float]


def wald_half_width(mean: float, n: int, coverage: float = 0.95) -> float:
    """Return half of Wald's interval, z sqrt(m (1 - m) / N); `mean` need not be a multiple of 1 / n."""
    if not 0 <= mean <= 1 or n < 1:
        raise RangeError(f"a share of {mean:g} of {n} answers; 0 to 1 of one answer or more are allowed")
    return _z(coverage) * math.sqrt(mean * (1 - mean) / n)


def wald_full_width(mean: float, n: int, coverage: float = 0.95) -> float:
    """Width of Wald's interval from end to end, twice `wald_half_width`; some reports print this."""
    return 2 * wald_half_width(mean, n, coverage)


def wald_interval(right: int, n: int, coverage: float = 0.95) -> Ends:
    """Wald's interval, its ends as the formula gives them, also outside 0 to 1."""
    mean, half = right / _checked(right, n), wald_half_width(right / n, n, coverage)
    return mean - half, mean + half


def wilson_interval(right: int, n: int, coverage: float = 0.95) -> Ends:
    """Wilson's score interval.

    Example:
        >>> [round(end, 4) for end in wilson_interval(30, 30)]
        [0.8865, 1.0]
    """
    p, z = right / _checked(right, n), _z(coverage)
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return (0.0 if right == 0 else middle - half), (1.0 if right == n else middle + half)


def clopper_pearson_interval(right: int, n: int, coverage: float = 0.95) -> Ends:
    """Clopper and Pearson's exact interval: covers at its rate or more."""
    _checked(right, n)
    tail = (1 - coverage) / 2
    low = 0.0 if right == 0 else float(stats.beta.ppf(tail, right, n - right + 1))
    high = 1.0 if right == n else float(stats.beta.isf(tail, right + 1, n - right))
    return low, high


def newcombe_interval(first: tuple[int, int], second: tuple[int, int], coverage: float = 0.95) -> Ends:
    """Return the interval of a difference of independent proportions (correct, total), second minus first."""
    (p, (p_low, p_high)), (q, (q_low, q_high)) = (
        (right / _checked(right, n), wilson_interval(right, n, coverage)) for right, n in (first, second)
    )
    change = q - p
    return change - math.hypot(q - q_low, p_high - p), change + math.hypot(q_high - q, p - p_low)


def cluster_interval(
    right: Sequence[int] | ndarray,
    n: Sequence[int] | ndarray,
    rng: np.random.Generator,
    *,
    coverage: float = 0.95,
    draws: int = BOOTSTRAP_DRAWS,
) -> Ends:
    """Return an interval of a proportion over participants, given `right` of `n` answers of each.

    It is the union of three: a bootstrap of participants with expanded percentiles, `beta_binomial_interval`,
    and Wilson's interval of all answers. The bootstrap alone undercovers for few participants with a long
    tail.
    """
    k, m = (np.asarray(each, np.float64) for each in (right, n))
    k, m = k[m > 0], m[m > 0]
    if len(m) < MIN_CLUSTERS:
        raise InputError(
            f"{len(m)} participant with answers; how participants differ is told by two or more, best ten"
        )
    for a, b in zip(k, m, strict=True):
        _checked(int(a), int(b))
    ends = [wilson_interval(int(k.sum()), int(m.sum()), coverage), beta_binomial_interval(k, m, coverage)]
    if 0 < k.sum() < m.sum():
        at = rng.integers(len(m), size=(draws, len(m)))
        ends.append(expanded_percentiles(k[at].sum(axis=1) / m[at].sum(axis=1), len(m), coverage))
    lows, highs = zip(*ends, strict=True)
    return min(lows), max(highs)


def beta_binomial_interval(
    right: Float[ndarray, " s"], n: Float[ndarray, " s"], coverage: float = 0.95
) -> Ends:
    """Return the posterior interval of the mean proportion in a beta-binomial model of participants.

    Priors: Jeffreys for the mean, uniform for the intraclass correlation. Equal tails; 0 or 1 if all answers
    agree.
    """
    each, times = np.unique(np.column_stack([right, n]).astype(np.float64), axis=0, return_counts=True)
    k, m = each.T[:, :, None, None]
    logit = np.linspace(-MAX_LOG_ODDS, MAX_LOG_ODDS, MEANS)
    alike = (np.arange(CORRELATIONS) + 0.5) / CORRELATIONS
    mean, size = special.expit(logit), (1 / alike - 1)[:, None]
    a, b = mean * size, (1 - mean) * size
    likelihood = np.tensordot(times, special.betaln(a + k, b + m - k) - special.betaln(a, b), 1)
    log_weight = likelihood + 0.5 * np.log(mean * (1 - mean))  # Jeffreys' over the logit
    weight = np.exp(log_weight - log_weight.max()).sum(axis=0)
    area = np.concatenate([[0.0], np.cumsum(weight[1:] + weight[:-1])])
    tail = (1 - coverage) / 2
    low, high = special.expit(np.interp([tail, 1 - tail], area / area[-1], logit))
    return (0.0 if k.sum() == 0 else float(low)), (1.0 if k.sum() == m.sum() else float(high))


def expanded_percentiles(means: Float[ndarray, " draws"], units: int, coverage: float) -> Ends:
    """Percentiles of bootstrap draws, set apart for few units as Student's t is from the Gaussian."""
    reach = math.sqrt(units / (units - 1)) * float(stats.t.ppf((1 + coverage) / 2, units - 1))
    tail = 100 * float(stats.norm.sf(reach))
    low, high = np.percentile(means, [tail, 100 - tail])
    return float(low), float(high)


def _checked(right: int, n: int) -> int:
    if n < 1 or not 0 <= right <= n:
        raise RangeError(f"{right} right answers of {n}; 0 to all of one answer or more are allowed")
    return n


def _z(coverage: float) -> float:
    if not 0 < coverage < 1:
        raise RangeError(
            f"a coverage of {coverage:g}; above 0 and below 1 are allowed, 0.95 is usual", code="coverage"
        )
    return float(stats.norm.ppf((1 + coverage) / 2))


STUDIES = 400
MAX_PARTICIPANTS = 200
FLIPS = 999
NODES_OF_MEAN = 41


@dataclass(frozen=True, slots=True)
class PlannedStudy:
    """Planned study of two conditions.

    Attributes:
        first, second: population proportions correct, 0 to 1 exclusive.
        answers: answers of each participant in each condition.
        effect_sd: standard deviation of participants' effects [logit]; 0 underestimates the sample size.
    """

    first: float
    second: float
    answers: int
    intercept_sd: float = 0.5
    effect_sd: float = 0.0
    significance: float = 0.05

    def __post_init__(self) -> None:
        if not (0 < self.first < 1 and 0 < self.second < 1):
            raise RangeError(f"shares of {self.first:g} and {self.second:g}; above 0 and below 1 are allowed")
        if self.answers < 1 or min(self.intercept_sd, self.effect_sd) < 0 or not 0 < self.significance < 1:
            raise RangeError(
                "a study has one answer or more a condition, scatters of 0 logits or more, and a "
                "significance between 0 and 1",
                code="study-design",
            )


@dataclass(frozen=True, slots=True)
class StudyPower:
    """Power of a planned study, with the 95 % interval of the simulation."""

    participants: int
    power: float
    low: float
    high: float


def simulated_power(
    study: PlannedStudy, participants: int, rng: np.random.Generator, studies: int = STUDIES
) -> StudyPower:
    """Power with so many participants."""
    if not 2 <= participants <= MAX_PARTICIPANTS:
        raise RangeError(f"{participants} participants; 2 to {MAX_PARTICIPANTS} are allowed")
    sd = math.hypot(study.intercept_sd, study.effect_sd / 2)  # of one condition's log odds over participants
    shifts = [_conditional_logit(share, sd) for share in (study.first, study.second)]
    b = study.intercept_sd * rng.standard_normal((studies, participants))
    half = study.effect_sd / 2 * rng.standard_normal((studies, participants))
    one, other = (
        rng.binomial(study.answers, special.expit(shift + b + own))
        for shift, own in zip(shifts, (-half, half), strict=True)
    )
    p = _flipped(((other - one) / study.answers), rng)
    found = int((p < study.significance).sum())
    return StudyPower(participants, found / studies, *wilson_interval(found, studies))


def participants_needed(
    study: PlannedStudy, rng: np.random.Generator, power: float = 0.8, studies: int = STUDIES
) -> StudyPower:
    """Fewest participants that reach a power, as far as so many simulated studies tell."""
    low, high = 2, 4
    while simulated_power(study, high, rng, studies).power < power:
        low, high = high, 2 * high
        if high > MAX_PARTICIPANTS:
            raise RangeError(
                f"shares of {study.first:g} and {study.second:g} are not told apart with a power of "
                f"{power:g} by {MAX_PARTICIPANTS} participants of {study.answers} answers; plan more each",
                code="sample-size",
            )
    while high - low > 1:
        middle = (low + high) // 2
        enough = simulated_power(study, middle, rng, studies).power >= power
        low, high = (low, middle) if enough else (middle, high)
    return simulated_power(study, high, rng, studies)


def _conditional_logit(share: float, sd: float) -> float:
    """Log odds of an average participant with which the population's share is as asked."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_MEAN)
    weights = weights / weights.sum()
    return float(
        optimize.brentq(lambda a: float(weights @ special.expit(a + sd * nodes)) - share, -60.0, 60.0)
    )


def _flipped(d: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Significance of each row by its signs: all of them for few participants, else drawn."""
    n = d.shape[1]
    if n <= 10:
        return np.array([sign_flip_p(row) for row in d])
    signs = rng.choice(np.array([-1.0, 1.0]), size=(FLIPS, n))
    as_far = np.abs(d @ signs.T) >= np.abs(d.sum(axis=1))[:, None] - 1e-9
    return np.asarray((1 + as_far.sum(axis=1)) / (FLIPS + 1))
