"""Linear mixed model of trials grouped by session, sensor unit, or operator.

    y = X beta + sum over levels k of b_k(unit of the trial) + e,    b_k ~ N(0, theta_k),    e ~ N(0, theta_e)

Variances maximize the restricted likelihood (REML, Fisher scoring with theta >= 0). Intervals are Student's
with Satterthwaite's degrees of freedom, for a mean at most one less than the outermost units. A level of one
or two units is a fixed effect.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545, doi:10.1093/biomet/58.3.545; F. G.
Giesbrecht, J. C. Burns, Biometrics 41 (1985) 477, doi:10.2307/2530872; J. Seely, Y. El-Bassiouni, Annals of
Statistics 11 (1983) 197 (interval of the intraclass correlation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import linalg, optimize, stats

from palpate.core import Float, InputError, Int, ndarray

MIN_UNITS = 3  # of a level whose variance is estimated
MAX_LEVELS = 2
MAX_STEPS = 200
MIN_GAIN = 1e-10  # of the log likelihood by one more step, twice
MIN_WITHIN = 1e-6  # of the variance around the specimens' means: below, trials of a unit do not scatter
MIN_TOLD = 1e-9  # least eigenvalue of the information, its diagonal scaled to 1
SPECIMEN = "specimen"
WITHIN = "within"
DEGREES_OF_FREEDOM = "Satterthwaite's, of a mean at most one less than the outermost groups"

Values = Float[ndarray, " n"]
Matrix = Float[ndarray, "n p"]
Square = Float[ndarray, "n n"]


@dataclass(frozen=True)
class MeanEstimate:
    """A mean or difference with its interval and two-sided Student p."""

    value: float
    low: float
    high: float
    freedom: float
    p: float

    def moved(self, start: float, scale: float) -> MeanEstimate:
        """The same in another unit, of which the values are start + scale times these."""
        low, high = sorted(start + scale * x for x in (self.low, self.high))
        return MeanEstimate(start + scale * self.value, low, high, self.freedom, self.p)


@dataclass(frozen=True)
class SpecimenDifference:
    """Difference of two specimen means, second minus first, with `shared` outermost units."""

    first: str
    second: str
    difference: MeanEstimate
    shared: int


@dataclass(frozen=True)
class GroupedComparison:
    """Mixed model of one value per trial.

    Attributes:
        units: number of units of each level, outermost first.
        variance: variance of each level and ``within``; None if not identifiable.
        correlation: intraclass correlation up to each level; None if not identifiable.
        correlation_interval, no_group_p: exact interval, and F-test of no variance, of a single random level.
        converged: whether REML converged; otherwise the estimates are invalid.
    """

    units: dict[str, int]
    means: dict[str, MeanEstimate]
    pairs: tuple[SpecimenDifference, ...]
    variance: dict[str, float | None]
    correlation: dict[str, float | None]
    correlation_interval: tuple[float, float] | None
    no_group_p: float | None
    coverage: float
    converged: bool
    notes: tuple[str, ...]

    def pair(self, first: str, second: str) -> SpecimenDifference:
        """One of the pairs, in either order."""
        one = next(one for one in self.pairs if {one.first, one.second} == {first, second})
        if one.first == first:
            return one
        return SpecimenDifference(first, second, one.difference.moved(0.0, -1.0), one.shared)


def compare_grouped(
    values: Sequence[float],
    specimens: Sequence[str],
    groups: Mapping[str, Sequence[str]],
    *,
    coverage: float = 0.95,
) -> GroupedComparison:
    """Compare specimens by trials that come in groups.

    Args:
        groups: by level, outermost first, each trial's unit; the units of a second level count within those
            of the first. A second level ``specimen`` is a specimen's own seat in a session.

    Example:
        >>> values = [1.0, 1.1, 2.0, 2.1, 1.4, 1.5, 2.4, 2.6, 0.8, 0.7, 1.8, 1.7]
        >>> day = [day for day in "abc" for _ in range(4)]
        >>> found = compare_grouped(values, ["soft", "soft", "hard", "hard"] * 3, {"day": day})
        >>> round(found.pair("soft", "hard").difference.value, 2), round(found.correlation["day"], 2)
        (1.02, 0.96)
    """
    y = np.asarray(values, np.float64)
    levels = _levels(y, specimens, groups)
    refuse_confounded(specimens, groups)
    names = list(dict.fromkeys(specimens))
    X = (np.asarray(specimens)[:, None] == np.array(names)).astype(np.float64)
    fixed = {name for name, each in levels.items() if _is_fixed(each)}
    for name in fixed:
        X = np.hstack([X, _centred(levels[name])])
    if np.linalg.matrix_rank(X) < X.shape[1]:
        raise InputError(
            f"some specimens share no {' or '.join(fixed)} with the others, and two cannot tell how these "
            "differ; press every specimen in each"
        )
    random = {name: each for name, each in levels.items() if name not in fixed}
    V = [(each[:, None] == each).astype(np.float64) for each in random.values()] + [np.eye(len(y))]
    scale, middle = _spread(y, X), float(y.mean())
    z = (y - middle) / scale
    _refuse_untold(X, V, list(random))
    theta, converged = _reml(z, X, V)
    solved = _LeastSquaresAt.of(z, X, V, theta)
    rows = np.eye(X.shape[1])
    most = _freedom_between(levels, random)
    means = {n: solved.estimate(rows[i], coverage, most).moved(middle, scale) for i, n in enumerate(names)}
    pairs = tuple(
        SpecimenDifference(
            a,
            b,
            solved.estimate(rows[names.index(b)] - rows[names.index(a)], coverage).moved(0.0, scale),
            _shared(specimens, next(iter(levels.values())), a, b),
        )
        for a, b in combinations(names, 2)
    )
    told = dict(zip([*random, WITHIN], scale**2 * theta, strict=True))
    variance = {name: float(told[name]) if name in told else None for name in [*levels, WITHIN]}
    pivot = _VariancePivot.of(z, X, V[0]) if len(random) == 1 else None
    return GroupedComparison(
        units={name: len(np.unique(each)) for name, each in levels.items()},
        means=means,
        pairs=pairs,
        variance=variance,
        correlation=_correlations(variance),
        correlation_interval=None if pivot is None else pivot.interval(coverage),
        no_group_p=None if pivot is None else pivot.p(),
        coverage=coverage,
        converged=converged,
        notes=_notes(levels, fixed, variance, pairs, converged),
    )


def refuse_confounded(specimens: Sequence[str], groups: Mapping[str, Sequence[str]]) -> None:
    """Reject trials if no unit of the outermost level holds two specimens."""
    level, units = next(iter(groups.items()))
    held: dict[str, set[str]] = {}
    for unit, specimen in zip(units, specimens, strict=True):
        held.setdefault(unit, set()).add(specimen)
    if max(len(each) for each in held.values()) < 2:
        raise InputError(
            f"each {level} holds one specimen alone: whatever differs may be the specimen or the {level}. "
            f"Press two specimens or more in each {level}, best all of them, in turn",
            code="confounded",
        )


def _levels(
    y: Values, specimens: Sequence[str], groups: Mapping[str, Sequence[str]]
) -> dict[str, Int[ndarray, " n"]]:
    """Number of each trial's unit, of every level; units of a second level count within the first's."""
    if not 1 <= len(groups) <= MAX_LEVELS:
        raise InputError(
            f"{len(groups)} levels of groups; give one, or two with the outer one first", code="group-levels"
        )
    if len({len(y), len(specimens), *map(len, groups.values())}) > 1 or not np.isfinite(y).all():
        raise InputError(
            "every trial needs one finite value, one specimen and one unit of every level",
            code="trial-incomplete",
        )
    if len(set(specimens)) < 2:
        raise InputError(f"{len(set(specimens))} specimens; two or more can be compared")
    if WITHIN in groups:
        raise InputError(f"a level of groups cannot be called {WITHIN!r}; give its column another name")
    if next(iter(groups)) == SPECIMEN:
        raise InputError(
            "a specimen is what is compared; as a group it can only be the second, inner level",
            code="specimen-level",
        )
    numbers: dict[str, Int[ndarray, " n"]] = {}
    for i in range(len(groups)):
        units = list(zip(*list(groups.values())[: i + 1], strict=True))
        order = {unit: k for k, unit in enumerate(dict.fromkeys(units))}
        numbers[list(groups)[i]] = np.array([order[unit] for unit in units])
    outer, *inner = ((name, len(np.unique(each))) for name, each in numbers.items())
    if inner and inner[0][1] - outer[1] < MIN_UNITS - 1:
        raise InputError(
            f"{inner[0][1]} of {inner[0][0]} in {outer[1]} of {outer[0]}: their variances cannot be told "
            f"apart; record more of {inner[0][0]} in each, or group by one of the two alone",
            code="confounded",
        )
    return numbers


def _is_fixed(units: Int[ndarray, " n"]) -> bool:
    return len(np.unique(units)) < MIN_UNITS


def _centred(units: Int[ndarray, " n"]) -> Matrix:
    """Columns of a fixed level that leave a specimen's mean that over its units, each counted once."""
    each = (units[:, None] == np.unique(units)).astype(np.float64)
    return (each - 1 / each.shape[1])[:, 1:]


def _spread(y: Values, X: Matrix) -> float:
    """Root mean square around the fixed effects."""
    rest = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    freedom = len(y) - X.shape[1]
    spread = float(np.sqrt(rest @ rest / freedom)) if freedom > 0 else 0.0
    if spread <= 1e-12 * np.abs(y).max():
        raise InputError(
            "trials do not scatter about their specimens' means; there is no variance to tell",
            code="no-variance",
        )
    return spread


def _freedom_between(
    levels: Mapping[str, Int[ndarray, " n"]], random: Mapping[str, Int[ndarray, " n"]]
) -> float:
    """Units of the outermost level that has a variance, less those that hold them; infinite without one."""
    if not random:
        return np.inf
    counts = [len(np.unique(each)) for each in levels.values()]
    return float(counts[0] - 1 if len(random) == len(levels) else counts[1] - counts[0])


def _shared(specimens: Sequence[str], units: Int[ndarray, " n"], a: str, b: str) -> int:
    of = {name: {u for u, s in zip(units, specimens, strict=True) if s == name} for name in (a, b)}
    return len(of[a] & of[b])


def _refuse_untold(X: Matrix, V: Sequence[Square], levels: Sequence[str]) -> None:
    """Refuse a design whose information on the variances is singular."""
    info = _LeastSquaresAt.of(np.zeros(len(X)), X, V, np.ones(len(V))).information
    size = np.sqrt(np.maximum(np.diag(info), 1e-300))
    if np.linalg.eigvalsh(info / np.outer(size, size)).min() < MIN_TOLD:
        raise InputError(
            f"these trials do not tell the variances of {', '.join([*levels, WITHIN])} apart; several trials "
            f"of each specimen in each {levels[-1] if levels else 'group'} do",
            code="not-identifiable",
        )


@dataclass(frozen=True)
class _LeastSquaresAt:
    """Generalised least squares at given variances, and the restricted likelihood there."""

    beta: Float[ndarray, " p"]
    C: Float[ndarray, "p p"]
    spread_of: Matrix
    V: Sequence[Square]
    log_likelihood: float
    score: Float[ndarray, " k"]
    information: Float[ndarray, "k k"]

    @classmethod
    def of(cls, y: Values, X: Matrix, V: Sequence[Square], theta: Float[ndarray, " k"]) -> _LeastSquaresAt:
        whole = sum(t * v for t, v in zip(theta, V, strict=True))
        inverse = np.linalg.inv(whole)
        VX = inverse @ X
        A = X.T @ VX
        C = np.linalg.inv(A)
        P = inverse - VX @ C @ VX.T
        Py, PV = P @ y, [P @ v for v in V]
        dets = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(A)[1]
        return cls(
            beta=C @ (VX.T @ y),
            C=C,
            spread_of=VX @ C,
            V=V,
            log_likelihood=float(-(dets + y @ Py) / 2),
            score=np.array([(Py @ v @ Py - np.trace(pv)) / 2 for v, pv in zip(V, PV, strict=True)]),
            information=np.array([[np.sum(a * b.T) / 2 for a in PV] for b in PV]),
        )

    def estimate(self, L: Float[ndarray, " p"], coverage: float, most: float = np.inf) -> MeanEstimate:
        """L' beta with Student's interval, by Satterthwaite's degrees of freedom or at most so many."""
        a, variance = self.spread_of @ L, float(L @ self.C @ L)
        g = np.array([a @ v @ a for v in self.V])
        freedom = min(most, 2 * variance**2 / float(g @ np.linalg.solve(self.information, g)))
        value, error = float(L @ self.beta), float(np.sqrt(variance))
        half = float(stats.t.ppf((1 + coverage) / 2, freedom)) * error
        p = float(2 * stats.t.sf(abs(value) / error, freedom))
        return MeanEstimate(value, value - half, value + half, freedom, p)


def _reml(y: Values, X: Matrix, V: Sequence[Square]) -> tuple[Float[ndarray, " k"], bool]:
    """Variances of the greatest restricted likelihood, the last at least `MIN_WITHIN`; whether found."""
    least = np.zeros(len(V))
    least[-1] = MIN_WITHIN
    theta = np.full(len(V), 1 / len(V))
    here = _LeastSquaresAt.of(y, X, V, theta)
    for _ in range(MAX_STEPS):
        free = (theta > least) | (here.score > 0)
        step = np.zeros(len(V))
        step[free] = np.linalg.solve(here.information[np.ix_(free, free)], here.score[free])
        if here.score @ step < MIN_GAIN:
            return theta, True
        length = 1.0
        while True:
            there = _LeastSquaresAt.of(y, X, V, trial := np.maximum(theta + length * step, least))
            if there.log_likelihood > here.log_likelihood:
                break
            length /= 2
            if length < MIN_GAIN:
                return theta, False
        theta, here = trial, there
    return theta, False


@dataclass(frozen=True)
class _VariancePivot:
    """Exact F pivot of lambda, the ratio of a level's variance to that within.

    In the space that units add to the fixed effects, t_i ~ N(0, theta_e (1 + lambda d_i)).
    """

    d: Float[ndarray, " r"]
    t: Float[ndarray, " r"]
    square: float
    e: int

    @classmethod
    def of(cls, y: Values, X: Matrix, V: Square) -> _VariancePivot:
        fixed = linalg.orth(X)
        added = linalg.orth(V - fixed @ (fixed.T @ V), rcond=1e-9)
        d, axes = np.linalg.eigh(added.T @ V @ added)
        both = np.hstack([fixed, added])
        rest = y - both @ (both.T @ y)
        e = len(y) - both.shape[1]
        return cls(d, axes.T @ added.T @ y, float(rest @ rest) / e, e)

    def _at(self, ratio: float) -> float:
        return float(np.sum(self.t**2 / (1 + ratio * self.d))) / len(self.d) / self.square

    def p(self) -> float:
        """The F-test of lambda = 0."""
        return float(stats.f.sf(self._at(0.0), len(self.d), self.e))

    def interval(self, coverage: float) -> tuple[float, float]:
        """Ends of lambda / (1 + lambda)."""
        tails = (1 + coverage) / 2, (1 - coverage) / 2
        low, high = (self._correlation_at(float(stats.f.ppf(q, len(self.d), self.e))) for q in tails)
        return low, high

    def _correlation_at(self, quantile: float) -> float:
        if self._at(0.0) <= quantile:
            return 0.0
        return float(optimize.brentq(lambda rho: self._at(rho / (1 - rho)) - quantile, 0.0, 1 - 1e-12))


def _correlations(variance: Mapping[str, float | None]) -> dict[str, float | None]:
    """Share of the variance up to each level; of none where a variance cannot be told."""
    levels = [name for name in variance if name != WITHIN]
    total = sum(one or 0.0 for one in variance.values())
    shares: dict[str, float | None] = {}
    for i, name in enumerate(levels):
        up_to = [variance[one] for one in levels[: i + 1]]
        shares[name] = None if None in up_to else sum(one or 0.0 for one in up_to) / total
    return shares


def _notes(
    levels: Mapping[str, Int[ndarray, " n"]],
    fixed: set[str],
    variance: Mapping[str, float | None],
    pairs: Sequence[SpecimenDifference],
    converged: bool,
) -> tuple[str, ...]:
    notes = [
        f"{(count := len(np.unique(levels[name])))} of {name}: the variance between them cannot be told "
        f"({MIN_UNITS} or more are needed); means and differences hold for "
        f"{'this one' if count == 1 else 'these'} alone"
        for name in fixed
    ]
    notes += [
        f"the variance between units of {name} is found to be 0, the least there is: they scatter no more "
        "than trials within them. It may still be above 0, and the degrees of freedom allow for it"
        for name in levels
        if variance[name] == 0
    ]
    apart = [f"{one.first} and {one.second}" for one in pairs if one.shared == 0]
    outer = next(iter(levels))
    if apart:
        notes.append(
            f"no {outer} holds both {', '.join(apart)}: what {outer} differ by is in their difference"
        )
    if not converged:
        notes.append("the search for the variances has not ended; take no number of this model")
    return tuple(notes)
