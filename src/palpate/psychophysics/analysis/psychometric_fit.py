"""Fits of psychometric functions: maximum likelihood, and a grid posterior with its intervals.

Priors: threshold uniform from one range of the levels below them to one above; log spread uniform from a
twentieth of the smallest step to five ranges; free lapse rate Beta(1, 30). Values are posterior medians.
`PosteriorRange.bounded` is False where only the prior bounds a parameter. The deviance is judged against that
of data simulated from the fitted function.

Reference: H. H. Schütt, S. Harmeling, J. H. Macke, F. A. Wichmann, Vision Res. 122 (2016) 105,
doi:10.1016/j.visres.2016.02.002; of the deviance Wichmann and Hill, doi:10.3758/BF03194544.

Psychometric functions: the probability of an answer over the level of a stimulus.

    P(level) = guess + (1 - guess - lapse) F(F⁻¹(1/2) + (F⁻¹(3/4) - F⁻¹(1/2)) (x - threshold) / spread)

x is the level or its natural logarithm; F is a cumulative Gaussian, a logistic, or 1 - exp(-exp(z)) (Weibull
over logarithmic levels). `spread` is the just noticeable difference; over logarithmic levels exp(spread) - 1
is a Weber fraction.

Reference: F. A. Wichmann, N. J. Hill, Percept. Psychophys. 63 (2001) 1293, doi:10.3758/BF03194544.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy import optimize, special, stats

from palpate.core import Float, InputError, Int, RangeError, ndarray

LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


class SigmoidShape(StrEnum):
    """Which sigmoid: cumulative Gaussian, logistic, or Weibull's, the last over logarithmic levels alone."""

    GAUSSIAN = "gaussian"
    LOGISTIC = "logistic"
    WEIBULL = "weibull"

    def rise(self, z: Any) -> ndarray:
        """F(z), from 0 to 1."""
        z = np.asarray(z, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(special.ndtr(z))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.expit(z))
        return np.asarray(-np.expm1(-np.exp(np.minimum(z, 50.0))))

    def slope(self, z: Any) -> ndarray:
        """dF/dz."""
        z = np.asarray(z, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(np.exp(-0.5 * z**2 - LOG_SQRT_2PI))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.expit(z) * special.expit(-z))
        z = np.minimum(z, 50.0)
        return np.asarray(np.exp(z - np.exp(z)))

    def inverse(self, share: Any) -> ndarray:
        """Place z at which F is a share."""
        share = np.asarray(share, np.float64)
        if self is SigmoidShape.GAUSSIAN:
            return np.asarray(special.ndtri(share))
        if self is SigmoidShape.LOGISTIC:
            return np.asarray(special.logit(share))
        return np.asarray(np.log(-np.log1p(-share)))

    @property
    def middle(self) -> float:
        """Place z at which F is 1/2."""
        return float(self.inverse(0.5))

    @property
    def reach(self) -> float:
        """How much further in z F is 3/4."""
        return float(self.inverse(0.75)) - self.middle


@dataclass(frozen=True, slots=True)
class PsychometricFunction:
    """Psychometric function; call it for the probability at levels.

    Attributes:
        threshold: level at which F is 1/2.
        spread: distance from there to F = 3/4 [unit of the level, or its natural logarithm].
        guess, lapse: probability far below, and 1 minus that far above.
    """

    shape: SigmoidShape
    threshold: float
    spread: float
    guess: float = 0.0
    lapse: float = 0.0
    logarithmic: bool = False

    def __post_init__(self) -> None:
        checked_rates(self.guess, self.lapse)
        if not self.spread > 0:
            raise RangeError(
                f"a spread of {self.spread:g}; above 0 is needed, in the level's unit", code="spread"
            )
        if self.shape is SigmoidShape.WEIBULL and not self.logarithmic:
            raise InputError("Weibull's function is one of logarithmic levels; ask for logarithmic=True")
        as_counted(np.array([self.threshold]), logarithmic=self.logarithmic)

    def __call__(self, level: Any) -> ndarray:
        """Probability of the answer at levels [the threshold's unit]."""
        x = as_counted(np.asarray(level, np.float64), logarithmic=self.logarithmic)
        t = math.log(self.threshold) if self.logarithmic else self.threshold
        z = self.shape.middle + self.shape.reach * (x - t) / self.spread
        return np.asarray(self.guess + (1 - self.guess - self.lapse) * self.shape.rise(z))


def checked_rates(guess: float, lapse: float) -> None:
    """Refuse rates of guesses and lapses that leave no rise."""
    if guess < 0 or lapse < 0 or guess + lapse >= 1:
        raise RangeError(
            f"guesses of {guess:g} and lapses of {lapse:g}; each is 0 or more, and together they are below 1",
            code="guess-and-lapse",
        )


def as_counted(levels: ndarray, *, logarithmic: bool) -> ndarray:
    """Levels as they count: themselves, or their natural logarithm."""
    if not np.isfinite(levels).all() or (logarithmic and (levels <= 0).any()):
        what = "above 0 and finite" if logarithmic else "finite"
        raise RangeError(
            f"levels from {np.min(levels):g} to {np.max(levels):g}; all have to be {what}", code="levels"
        )
    return np.asarray(np.log(levels)) if logarithmic else levels


MAX_LAPSE = 0.3
LAPSE_PRIOR = (1.0, 30.0)
SEEDS = np.array([-8.0, -4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0, 8.0])  # nodes about the likeliest, in errors
RESOLVED = 1 / 6  # of a box, which the coarse nodes have then in steps that are a posterior's own
MAX_NARROWINGS = 12
COARSE, FINE = (49, 49, 10), (41, 41, 9)
KEPT_OF_PEAK = 1e-6  # of the coarse posterior: where the fine grid lies
CORE_OF_PEAK = 0.01  # where its nodes are even
BOUNDED_OF_PEAK = 0.03  # a marginal that ends above this share of its peak is not bounded there
DEVIANCE_DRAWS = 400
MAX_STEPS = 60
MIN_PROBABILITY = 1e-12

Counts = Int[ndarray, " levels"]
Levels = Float[ndarray, " levels"]


@dataclass(frozen=True, slots=True)
class PosteriorRange:
    """Posterior median and interval; `bounded` (below, above) is False where only the prior bounds it."""

    value: float
    low: float
    high: float
    bounded: tuple[bool, bool]


@dataclass(frozen=True, slots=True)
class PsychometricFit:
    """Fitted psychometric function at the posterior medians.

    Attributes:
        lapse: None if given.
        deviance: deviance of the non-decreasing maximum-likelihood function.
        deviance_p: fraction of simulated data that fit as badly.
        notes: warnings by code.
    """

    function: PsychometricFunction
    threshold: PosteriorRange
    spread: PosteriorRange
    lapse: PosteriorRange | None
    deviance: float
    deviance_p: float
    answers: int
    coverage: float
    notes: Mapping[str, str]


def fit_psychometric(
    levels: Sequence[float] | ndarray,
    given: Sequence[int] | ndarray,
    n: Sequence[int] | ndarray,
    shape: SigmoidShape = SigmoidShape.GAUSSIAN,
    *,
    guess: float = 0.0,
    lapse: float | None = 0.0,
    guess_is_lapse: bool = False,
    logarithmic: bool = False,
    coverage: float = 0.95,
    deviance_draws: int = DEVIANCE_DRAWS,
    rng: np.random.Generator | None = None,
) -> PsychometricFit:
    """Estimate the posterior of a rising psychometric function.

    Args:
        given, n: number of positive answers, and of all, at each level.
        lapse: lapse rate; None to estimate it.
        guess_is_lapse: whether the lapse rate applies to both ends.
        logarithmic: use the logarithm of levels; always true for Weibull.
        deviance_draws: simulated data sets that judge the deviance; 0 for none (p is NaN).

    Example:
        >>> found = fit_psychometric([1, 2, 3, 4, 5], [1, 6, 15, 26, 30], [30] * 5, deviance_draws=0)
        >>> round(found.threshold.value, 1), all(found.spread.bounded)
        (2.9, True)
    """
    logarithmic = logarithmic or shape is SigmoidShape.WEIBULL
    x, k, m = _checked(levels, given, n, logarithmic=logarithmic)
    checked_rates(guess, lapse or 0.0)
    if not 0 < coverage < 1:
        raise RangeError(f"a coverage of {coverage:g}; above 0 and below 1 are allowed, 0.95 is usual")
    axes, weight = _posterior(x, k, m, shape, guess, lapse, guess_is_lapse)
    t, s, slips = (_summary(axis, weight, i, coverage) for i, axis in enumerate(axes))
    rate = slips.value if lapse is None else lapse
    below = rate if guess_is_lapse else guess
    threshold = _moved(t, np.exp) if logarithmic else t
    spread = _moved(s, np.exp)
    deviance, p = _judged(x, k, m, shape, below, rate, deviance_draws, rng or np.random.default_rng(0))
    return PsychometricFit(
        function=PsychometricFunction(shape, threshold.value, spread.value, below, rate, logarithmic),
        threshold=threshold,
        spread=spread,
        lapse=slips if lapse is None else None,
        deviance=deviance,
        deviance_p=p,
        answers=int(m.sum()),
        coverage=coverage,
        notes=_notes(x, k, m, threshold, spread),
    )


def _checked(
    levels: Sequence[float] | ndarray,
    given: Sequence[int] | ndarray,
    n: Sequence[int] | ndarray,
    *,
    logarithmic: bool,
) -> tuple[Levels, Counts, Counts]:
    if len({len(levels), len(given), len(n)}) > 1:
        raise InputError(
            f"{len(levels)} levels, {len(given)} counts and {len(n)} totals; one each is needed",
            code="lengths-differ",
        )
    x = as_counted(np.asarray(levels, np.float64), logarithmic=logarithmic)
    k, m = np.asarray(given, np.int64), np.asarray(n, np.int64)
    if (k < 0).any() or (k > m).any():
        raise InputError("counts of answers must be 0 to their totals", code="counts")
    x, k, m = x[m > 0], k[m > 0], m[m > 0]
    if len(np.unique(x)) < 2:
        raise InputError(
            f"{len(np.unique(x))} levels with answers; a function over levels needs two or more",
            code="too-few-levels",
        )
    return x, k, m


def _probability(
    z: ndarray, shape: SigmoidShape, guess: float | ndarray, lapse: float | ndarray
) -> tuple[ndarray, ndarray]:
    """Probability at predictors, kept off 0 and 1, and its derivative by the predictor."""
    rise = 1 - guess - lapse
    p = np.clip(guess + rise * shape.rise(z), MIN_PROBABILITY, 1 - MIN_PROBABILITY)
    return p, rise * shape.slope(z)


def _log_likelihood(p: ndarray, k: ndarray, m: ndarray) -> ndarray:
    return np.asarray((k * np.log(p) + (m - k) * np.log1p(-p)).sum(axis=-1))


def _separated(x: Levels, k: Counts, m: Counts) -> bool:
    """Whether a step, rising or falling, tells all answers apart."""
    yes, no = x[k > 0], x[k < m]
    if not len(yes) or not len(no):
        return True
    return bool(yes.min() >= no.max() or yes.max() <= no.min())


def _falls(x: Levels, k: Counts, m: Counts) -> bool:
    """Whether answers fall over levels, beyond one standard deviation of chance."""
    share = k.sum() / m.sum()
    u = x - (m * x).sum() / m.sum()
    return bool((k * u).sum() < -math.sqrt(share * (1 - share) * (m * u**2).sum()) < 0)


def _inverse(x: Levels, weight: Levels) -> Float[ndarray, "2 2"]:
    s0, s1, s2 = weight.sum(), (weight * x).sum(), (weight * x**2).sum()
    determinant = s0 * s2 - s1**2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.array([[s2, -s1], [-s1, s0]]) / determinant


def _scored(
    x: Levels, k: Float[ndarray, "sets levels"], m: Counts, shape: SigmoidShape, guess: float, lapse: float
) -> tuple[Float[ndarray, " sets"], Float[ndarray, " sets"]]:
    """Predictors a + b x of greatest likelihood of many data sets, by Fisher's scoring with halved steps."""
    middle, size = float(x.mean()), float(np.ptp(x))
    u = (x - middle) / size
    share = (k + 0.5) / (m + 1.0)
    z = shape.inverse(np.clip((share - guess) / (1 - guess - lapse), 0.02, 0.98))
    b = (z @ (u - u.mean())) / ((u - u.mean()) ** 2).sum()
    a = z.mean(axis=1) - b * u.mean()
    best = _log_likelihood(_probability(a[:, None] + b[:, None] * u, shape, guess, lapse)[0], k, m)
    for _ in range(MAX_STEPS):
        p, dp = _probability(a[:, None] + b[:, None] * u, shape, guess, lapse)
        residual, weight = (k - m * p) * dp / (p * (1 - p)), m * dp**2 / (p * (1 - p)) + 1e-12
        g0, g1 = residual.sum(axis=1), residual @ u
        s0, s1, s2 = weight.sum(axis=1), weight @ u, weight @ u**2
        determinant = np.maximum(s0 * s2 - s1**2, 1e-30)
        da, db = (s2 * g0 - s1 * g1) / determinant, (s0 * g1 - s1 * g0) / determinant
        reach = np.maximum(4.0, np.hypot(a, b))  # a far level makes b large: steps that may double reach it
        scale = np.minimum(1.0, reach / np.maximum(np.hypot(da, db), 1e-300))
        moved = np.zeros(len(a), bool)
        for _ in range(12):
            a_new, b_new = a + scale * da, b + scale * db
            new = _log_likelihood(
                _probability(a_new[:, None] + b_new[:, None] * u, shape, guess, lapse)[0], k, m
            )
            better = ~moved & (new >= best)
            a, b = np.where(better, a_new, a), np.where(better, b_new, b)
            gain = np.where(better, new - best, 0.0)
            best = np.where(better, new, best)
            moved |= better
            if moved.all():
                break
            scale = np.where(moved, scale, scale / 2)
        if not (moved & (gain > 1e-12)).any() and np.abs(scale * da).max() + np.abs(scale * db).max() < 1e-9:
            break
    return a - b * middle / size, b / size


def _deviance(p: ndarray, k: ndarray, m: ndarray) -> ndarray:
    full = special.xlogy(k, k / m) + special.xlogy(m - k, 1 - k / m)
    return np.asarray(2 * (full.sum(axis=-1) - _log_likelihood(p, k, m)))


def _judged(
    x: Levels, k: Counts, m: Counts, shape: SigmoidShape, guess: float, lapse: float, draws: int,
    rng: np.random.Generator,
) -> tuple[float, float]:  # fmt: skip
    """Deviance of the function of greatest likelihood, and the share of drawn data with as much."""

    def off(counts: ndarray) -> tuple[ndarray, ndarray]:
        a, b = _scored(x, counts.astype(float), m, shape, guess, lapse)
        p, _ = _probability(a[:, None] + b[:, None] * x, shape, guess, lapse)
        level = np.clip(
            counts.sum(axis=1) / m.sum(), max(guess, MIN_PROBABILITY), 1 - lapse - MIN_PROBABILITY
        )
        p = np.where((b > 0)[:, None], p, level[:, None])  # of falling answers the best that does not fall
        return p, _deviance(p, counts, m)

    p, found = off(k[None])
    if not draws:
        return float(found[0]), math.nan
    _, drawn = off(rng.binomial(m, p[0], size=(draws, len(m))))
    return float(found[0]), float((1 + (drawn >= found[0] - 1e-9).sum()) / (draws + 1))


def _posterior(
    x: Levels, k: Counts, m: Counts, shape: SigmoidShape, guess: float, lapse: float | None, both: bool
) -> tuple[list[ndarray], ndarray]:
    """Axes of threshold, log spread and lapse, and the posterior's mass at each node of their grid."""
    size, step = float(np.ptp(x)), float(np.diff(np.unique(x)).min())
    box = [
        (x.min() - size, x.max() + size),
        (math.log(step / 20), math.log(5 * size)),
        (0.0, MAX_LAPSE) if lapse is None else (lapse, lapse),
    ]

    def weights(axes: list[ndarray]) -> ndarray:
        t, s, slips = np.meshgrid(*axes, indexing="ij", sparse=True)
        below = slips if both else guess
        log_weight = np.zeros([len(axis) for axis in axes])
        for x_i, k_i, m_i in zip(x, k, m, strict=True):
            z = shape.middle + shape.reach * (x_i - t) * np.exp(-s)
            p, _ = _probability(z, shape, below, slips)
            log_weight += k_i * np.log(p) + (m_i - k_i) * np.log1p(-p)
        if lapse is None:
            log_weight += stats.beta.logpdf(np.maximum(slips, 1e-9), *LAPSE_PRIOR)
        return np.asarray(np.exp(log_weight - log_weight.max()))

    seeds = _likely_nodes(x, k, m, shape, guess, lapse, both)
    for _ in range(MAX_NARROWINGS):
        axes = [
            np.union1d(_axis(*ends, count), near[(near > ends[0]) & (near < ends[1])])
            for ends, count, near in zip(box, COARSE, seeds, strict=True)
        ]
        weight = weights(axes)
        wide, box = box, [_kept(axis, weight, i) for i, axis in enumerate(axes)]
        if all(new[1] - new[0] >= RESOLVED * (old[1] - old[0]) for new, old in zip(box, wide, strict=True)):
            break
    cores = [_kept(axis, weight, i, CORE_OF_PEAK) for i, axis in enumerate(axes)]
    axes = [_stretched(*args) for args in zip(box, cores, FINE, strict=True)]
    cells = [np.gradient(axis) if len(axis) > 1 else np.ones(1) for axis in axes]
    return axes, weights(axes) * cells[0][:, None, None] * cells[1][:, None] * cells[2]


def _axis(low: float, high: float, count: int) -> ndarray:
    return np.linspace(low, high, count) if high > low else np.array([low])


def _stretched(box: tuple[float, float], core: tuple[float, float], count: int) -> ndarray:
    """Even nodes in the core, and steps outside that grow up to the ends of the box."""
    inside = _axis(*core, count)
    step = (core[1] - core[0]) / (count - 1)
    tails = [
        end + sign * np.geomspace(step, sign * (last - end), count // 3)
        for end, last, sign in ((core[0], box[0], -1), (core[1], box[1], 1))
        if 0 < step < sign * (last - end)
    ]
    return np.unique(np.concatenate([inside, *tails]))


def _likely_nodes(
    x: Levels, k: Counts, m: Counts, shape: SigmoidShape, guess: float, lapse: float | None, both: bool
) -> list[ndarray]:
    """Thresholds, log spreads and lapses about those of greatest likelihood, by their standard errors."""

    def line(rate: float) -> tuple[float, float, float, ndarray]:
        below = rate if both else guess
        a, b = (float(each[0]) for each in _scored(x, k[None].astype(float), m, shape, below, rate))
        p, dp = _probability(a + b * x, shape, below, rate)
        prior = float(stats.beta.logpdf(max(rate, 1e-9), *LAPSE_PRIOR)) if lapse is None else 0.0
        return a, b, float(_log_likelihood(p, k, m)) + prior, _inverse(x, m * dp**2 / (p * (1 - p)))

    rates = np.array([] if lapse is None else [lapse])
    if lapse is None:
        found = optimize.minimize_scalar(
            lambda rate: -line(rate)[2], bounds=(0.0, MAX_LAPSE), method="bounded", options={"xatol": 1e-5}
        )
        h = 0.2 * math.sqrt((found.x + 1e-4) / float(m.sum()))
        bend = (2 * line(found.x)[2] - line(found.x + h)[2] - line(max(found.x - h, 0.0))[2]) / h**2
        error = min(1 / math.sqrt(max(bend, 1e-9)), MAX_LAPSE)
        rates = np.clip(found.x + SEEDS * error, 0.0, MAX_LAPSE)
    a, b, _, covariance = line(float(np.median(rates)))
    if not b > 0 or not np.isfinite(covariance).all():
        return [np.array([])] * 3
    t = (shape.middle - a) / b
    t_error = math.sqrt(max(covariance[0, 0] + 2 * t * covariance[0, 1] + t**2 * covariance[1, 1], 0.0)) / b
    s_error = math.sqrt(max(covariance[1, 1], 0.0)) / b
    return [t + SEEDS * t_error, math.log(shape.reach / b) + SEEDS * s_error, rates]


def _marginal(weight: ndarray, i: int) -> ndarray:
    return np.asarray(weight.sum(axis=tuple(j for j in range(weight.ndim) if j != i)))


def _kept(axis: ndarray, weight: ndarray, i: int, of_peak: float = KEPT_OF_PEAK) -> tuple[float, float]:
    """Stretch of an axis outside which the marginal is nothing, a step wider at both ends."""
    marginal = _marginal(weight, i)
    inside = np.flatnonzero(marginal > of_peak * marginal.max())
    return float(axis[max(inside[0] - 1, 0)]), float(axis[min(inside[-1] + 1, len(axis) - 1)])


def _summary(axis: ndarray, weight: ndarray, i: int, coverage: float) -> PosteriorRange:
    """Median and equal tails of one axis, by the trapezium rule."""
    if len(axis) == 1:
        return PosteriorRange(float(axis[0]), float(axis[0]), float(axis[0]), (True, True))
    density = _marginal(weight, i) / np.gradient(axis)
    area = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) * np.diff(axis))])
    value, low, high = np.interp([0.5, (1 - coverage) / 2, (1 + coverage) / 2], area / area[-1], axis)
    ends = density[[0, -1]] < BOUNDED_OF_PEAK * density.max()
    return PosteriorRange(float(value), float(low), float(high), (bool(ends[0]), bool(ends[1])))


def _moved(one: PosteriorRange, by: np.ufunc) -> PosteriorRange:
    return PosteriorRange(float(by(one.value)), float(by(one.low)), float(by(one.high)), one.bounded)


def _notes(
    x: Levels, k: Counts, m: Counts, threshold: PosteriorRange, spread: PosteriorRange
) -> dict[str, str]:
    notes = {}
    if k.sum() in (0, m.sum()):
        notes["all-equal"] = "all answers are the same: they tell no threshold and no spread, only a side"
    elif _separated(x, k, m):
        notes["separated"] = "a step tells all answers apart: the spread has an upper bound alone"
    if _falls(x, k, m):
        notes["falling"] = (
            "answers fall as levels rise: no rising function describes them; is the sign of softer right?"
        )
    unbounded = {
        f"{name}-unbounded-{side}": f"the {name} is not bounded {side} by these answers: the interval ends "
        "where the prior does"
        for name, one in (("threshold", threshold), ("spread", spread))
        for side, held in zip(("below", "above"), one.bounded, strict=True)
        if not held
    }
    return notes | unbounded
