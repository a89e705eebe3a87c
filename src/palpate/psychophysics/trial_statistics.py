"""Rank tests between groups with one value per trial, and straight-line fits.

Samples of one trial are not independent; pooling them is pseudo-replication and must be requested.

References: O. J. Dunn, Technometrics 6 (1964) 241, doi:10.1080/00401706.1964.10490181; H. W. Lilliefors,
JASA 62 (1967) 399, doi:10.1080/01621459.1967.10482916; S. Holm, Scand. J. Statist. 6 (1979) 65.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from palpate.core import Float, InputError, Int, ndarray

MIN_FOR_LILLIEFORS = 4
LILLIEFORS_DRAWS, LILLIEFORS_SEED = 9_999, 1967
LILLIEFORS_VALUES = 10_000_000  # drawn at a time
MAX_COUNTED = (
    8  # values of the smaller of two groups whose orders are all counted, as scipy does without ties
)
MAX_COUNTED_IN_ALL = 500  # of both, where there are ties
POOLED = (
    "{samples} samples of {trials} trials are pooled: those of one trial are not independent, so p-values "
    "are far too small (pseudo-replication); compare one value a trial"
)

Values = Float[ndarray, " _"]
Groups = Mapping[str, Sequence[Any]]  # of every group its trials: a number each, or an array of samples


@dataclass(frozen=True)
class Pair:
    """Tests between two groups.

    Attributes:
        rank_sum_p: two-sided Wilcoxon rank-sum p, exact for small groups, at least `least_p`.
        holm_p: Dunn's p with Holm correction over all pairs.
    """

    first: str
    second: str
    rank_sum_p: float
    least_p: float
    dunn_p: float
    holm_p: float


@dataclass(frozen=True)
class Comparison:
    """Results of the tests.

    Attributes:
        lilliefors_p: normality of each group; NaN for fewer than 4 values.
        standard_normal_p: Kolmogorov-Smirnov test against N(0, 1), the default of some packages.
    """

    n: dict[str, int]
    lilliefors_p: dict[str, float]
    standard_normal_p: dict[str, float]
    kruskal_h: float
    kruskal_p: float
    pairs: tuple[Pair, ...]
    warnings: tuple[str, ...]

    def pair(self, first: str, second: str) -> Pair:
        """One of the pairs, in either order."""
        return next(p for p in self.pairs if {p.first, p.second} == {first, second})


def compare(groups: Groups, *, pooled: bool = False) -> Comparison:
    """Compare groups of trials, each trial a value or its samples; `pooled` counts every sample, with a
    warning.

    Example:
        >>> groups = {"soft": [[1.0], [1.2], [1.1]], "hard": [[2.0], [2.2], [2.1]]}
        >>> round(compare(groups).pair("soft", "hard").rank_sum_p, 3)
        0.1
    """
    values = {name: _values(name, trials, pooled) for name, trials in groups.items()}
    if len(values) < 2:
        raise InputError(f"{len(values)} groups; two or more can be compared", code="too-few-groups")
    same = np.ptp(np.concatenate(list(values.values()))) == 0
    h, p = (0.0, 1.0) if same else stats.kruskal(*values.values())
    plain = _dunn(values)
    holm = _holm(plain)
    pairs = tuple(
        Pair(
            a,
            b,
            _rank_sum_p(values[a], values[b]),
            _least(len(values[a]), len(values[b])),
            plain[a, b],
            holm[a, b],
        )
        for a, b in combinations(values, 2)
    )
    return Comparison(
        {name: len(v) for name, v in values.items()},
        {name: _lilliefors(v) for name, v in values.items()},
        {name: float(stats.kstest(v, "norm").pvalue) for name, v in values.items()},
        float(h),
        float(p),
        pairs,
        _warnings(groups, pooled),
    )


def mean_interval(
    values: Sequence[float], coverage: float = 0.95, *, known_sd: float = 0.0
) -> tuple[float, float]:
    """Return Student's interval of a mean.

    Args:
        known_sd: SD of an error shared by all values; then Welch-Satterthwaite (JCGM 100:2008, G.4.1).
    """
    x = np.asarray(values, np.float64)
    if len(x) < 2 or not np.isfinite(x).all():
        raise InputError(
            f"an interval of the mean needs two finite values or more, got {x.tolist()}",
            code="too-few-values",
        )
    mean, own = float(x.mean()), float(x.std(ddof=1)) / math.sqrt(len(x))
    together = math.hypot(own, known_sd)
    if together == 0:
        return mean, mean
    freedom = (len(x) - 1) * (together / own) ** 4 if own else np.inf
    half = float(stats.t.ppf((1 + coverage) / 2, freedom)) * together
    return mean - half, mean + half


def corrected_by_holm(p: Sequence[float]) -> list[float]:
    """Holm's correction of several p-values, in their order."""
    corrected = _holm({(str(i), ""): one for i, one in enumerate(p)})
    return [corrected[str(i), ""] for i in range(len(p))]


def _values(name: str, trials: Sequence[Any], pooled: bool) -> Values:
    samples = [np.atleast_1d(np.asarray(trial, np.float64)) for trial in trials]
    if not all(len(trial) and np.isfinite(trial).all() for trial in samples):
        raise InputError(f"{name} has a trial without values, or one that is not finite; leave it out")
    values = np.concatenate(samples) if pooled else np.array([trial.mean() for trial in samples])
    if len(values) < 2:
        raise InputError(
            f"{name} has {len(values)} values; tests need two trials or more", code="too-few-values"
        )
    return values


def _rank_sum_p(a: Values, b: Values) -> float:
    """Two-sided p of Wilcoxon's rank-sum test: twice the smaller tail over all orders, 1 at most."""
    few, many = sorted((a, b), key=len)
    values = np.concatenate([few, many])
    if len(np.unique(values)) < len(values) <= MAX_COUNTED_IN_ALL and len(few) <= MAX_COUNTED:
        ranks = np.rint(2 * stats.rankdata(values)).astype(int)  # twice the mean ranks are whole
        ways, found = _rank_sums(ranks, len(few)), ranks[: len(few)].sum()
        p = min(1.0, 2 * min(ways[: found + 1].sum(), ways[found:].sum()) / ways.sum())
    else:
        p = stats.mannwhitneyu(a, b, alternative="two-sided").pvalue
    return max(float(p), _least(len(a), len(b)))  # the normal law knows no least


def _rank_sums(ranks: Int[ndarray, " n"], count: int) -> Float[ndarray, " sums"]:
    """Number of ways to choose so many of the ranks, by the sum of those chosen."""
    ways = np.zeros((count + 1, np.sort(ranks)[-count:].sum() + 1))
    ways[0, 0] = 1
    for rank in ranks:
        ways[1:, rank:] += ways[:-1, :-rank]
    return np.asarray(ways[count])


def _dunn(values: Mapping[str, Values]) -> dict[tuple[str, str], float]:
    """Dunn's two-sided p of every pair, uncorrected; ties lessen the variance of ranks, to 0 in the end."""
    ranks = stats.rankdata(np.concatenate(list(values.values())))
    n = len(ranks)
    _, tied = np.unique(ranks, return_counts=True)
    if len(tied) == 1:
        return dict.fromkeys(combinations(values, 2), 1.0)
    variance = n * (n + 1) / 12 - float(np.sum(tied**3.0 - tied)) / (12 * (n - 1))
    parts = np.split(ranks, np.cumsum([len(v) for v in values.values()])[:-1])
    mean = {name: float(part.mean()) for name, part in zip(values, parts, strict=True)}
    apart = {
        (a, b): abs(mean[a] - mean[b]) / math.sqrt(variance * (1 / len(values[a]) + 1 / len(values[b])))
        for a, b in combinations(values, 2)
    }
    return {pair: float(2 * stats.norm.sf(z)) for pair, z in apart.items()}


def _holm(plain: Mapping[tuple[str, str], float]) -> dict[tuple[str, str], float]:
    """Holm's correction: the k-th smallest of m times m - k + 1, never below the one before, 1 at most."""
    corrected, before = {}, 0.0
    for k, pair in enumerate(sorted(plain, key=lambda pair: plain[pair])):
        before = max(before, min(1.0, (len(plain) - k) * plain[pair]))
        corrected[pair] = before
    return corrected


def _lilliefors(values: Values) -> float:
    """Kolmogorov and Smirnov's test against the normal law of the sample's own mean and spread."""
    if len(values) < MIN_FOR_LILLIEFORS or np.ptp(values) == 0:
        return float("nan")
    rng = np.random.default_rng(LILLIEFORS_SEED)
    draws = min(LILLIEFORS_DRAWS, max(999, LILLIEFORS_VALUES // len(values)))
    test = stats.goodness_of_fit(stats.norm, values, statistic="ks", n_mc_samples=draws, rng=rng)
    return float(test.pvalue)


def _least(n: int, m: int) -> float:
    """Two-sided p of complete separation: two of all orders of n + m values."""
    return min(1.0, 2 / math.comb(n + m, n))


def _warnings(groups: Groups, pooled: bool) -> tuple[str, ...]:
    trials = sum(len(each) for each in groups.values())
    samples = sum(np.size(trial) for each in groups.values() for trial in each)
    return (POOLED.format(samples=samples, trials=trials),) if pooled and samples > trials else ()


@dataclass(frozen=True)
class Line:
    """y = slope x + start, with the slope's 95 % interval and the residual SD (n - 2 degrees of freedom)."""

    slope: float
    start: float
    slope_low: float
    slope_high: float
    adjusted_r2: float
    n: int
    mean_x: float
    sxx: float
    residual: float

    def at(self, x: float, coverage: float = 0.9) -> tuple[float, float, float]:
        """The line at x, and the interval that holds a new point so often; infinite for two points."""
        y = self.slope * x + self.start
        if self.n < 3:
            return y, -np.inf, np.inf
        spread = self.residual * math.sqrt(1 + 1 / self.n + (x - self.mean_x) ** 2 / self.sxx)
        half = float(stats.t.ppf((1 + coverage) / 2, self.n - 2)) * spread
        return y, y - half, y + half


def fit_line(x: Values, y: Values) -> Line:
    """Fit a line by least squares; adjusted R^2 is NaN if y is constant."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if x.shape != y.shape or x.ndim != 1 or len(x) < 2 or np.ptp(x) == 0:
        raise InputError(f"a line needs two points or more at different x; got {len(x)} and {len(y)} values")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("a line is through finite points; leave out those that are not")
    n, sxx = len(x), float(np.sum((x - x.mean()) ** 2))
    if np.ptp(y) == 0:
        unknown = 0.0 if n > 2 else float("nan")
        return Line(0.0, float(y[0]), unknown, unknown, float("nan"), n, float(x.mean()), sxx, 0.0)
    fit = stats.linregress(x, y)
    half = float(stats.t.ppf(0.975, n - 2) * fit.stderr) if n > 2 else float("nan")
    adjusted = 1 - (1 - fit.rvalue**2) * (n - 1) / (n - 2) if n > 2 else float("nan")
    return Line(
        slope=float(fit.slope),
        start=float(fit.intercept),
        slope_low=float(fit.slope - half),
        slope_high=float(fit.slope + half),
        adjusted_r2=float(adjusted),
        n=n,
        mean_x=float(x.mean()),
        sxx=sxx,
        residual=float(fit.stderr) * math.sqrt(sxx),
    )
