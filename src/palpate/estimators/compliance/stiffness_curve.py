"""Stiffness from a press at fixed forces: a position on a curve through known references.

Measurements of a press form a vector y, which moves along y(s), a polynomial through the references' means,
over

    s = 1 / (1 + kappa / kappa_0),    0 for a rigid plate, towards 1 for softer specimens.

Trials scatter along few directions, and evenly by image noise. A press gets the nearest s by generalized
least squares in the space of the references' means and widest scatter. The interval holds the scatter and the
error of predicting each reference from the others.

Force of a press or a grasp: smoothed, cut to its loading part, and its slope.

The moving average is centered and adds no delay. Grippers often repeat their last width; `fresh` selects the
samples with a new measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy import stats
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from palpate.core import Bool, Float, InputError, Int, RangeError, ndarray

SCATTER = 4  # directions in which trials differ: two of lean, and what else there is
SOFTEST = 0.95  # greatest s that is looked at
TURNINGS = 13  # of kappa_0 that are tried
BENDS = (0.5, 2.0)  # of kappa_0: how else the curve might run between the references
MIN_TRIALS = 2
STEP = 1e-3  # of s, for slopes
MARGIN = 0.1  # of the references' span in s, by which an interval may reach beyond them

Vectors = Float[ndarray, "t d"]
Vector = Float[ndarray, " d"]


@dataclass(frozen=True)
class Softness:
    """Position on the curve of one press or of the mean of several.

    Attributes:
        kappa_n_m: Stiffness, low, and high [N/m].
        distance: Distance from the curve in standard deviations of a reference trial.
    """

    kappa_n_m: tuple[float, float, float]
    s: float
    distance: float


@dataclass(frozen=True)
class SmallSpace:
    """Subspace of the references' presses, and the scatter of their trials.

    Attributes:
        basis: Orthonormal directions.
        means: Mean of each reference, in the basis.
        scatter: Covariance of a trial about its reference's mean, in the basis.
        outside: RMS of a trial's component outside the basis.
        freedom: Trials less references.
    """

    middle: Vector
    basis: Float[ndarray, "q d"]
    means: Float[ndarray, "k q"]
    scatter: Float[ndarray, "q q"]
    outside: float
    freedom: int

    def novelty_score(self, press: Vector) -> float:
        """Return the RMS of a press outside the basis, in units of the references' trials."""
        off = press - self.middle
        finite = np.isfinite(off)
        residual = off[finite] - self.place(press) @ self.basis[:, finite]
        return float(np.sqrt(np.mean(residual**2)) / self.outside)

    def place(self, press: Vector) -> Float[ndarray, " q"]:
        """Return the coordinates of a press in the basis, from its known values."""
        if press.shape != self.middle.shape:
            raise InputError(
                f"{press.size} values; the curve is of {self.middle.size}", code="lengths-differ"
            )
        finite = np.isfinite(press - self.middle)
        if finite.sum() < 4 * len(self.basis):
            raise InputError(
                f"{int(finite.sum())} of {press.size} values are known; too many pins are lost",
                code="pins-lost",
            )
        place, *_ = np.linalg.lstsq(self.basis[:, finite].T, (press - self.middle)[finite], rcond=None)
        return np.asarray(place)


@dataclass(frozen=True)
class SoftnessCurve:
    """Curve in its `SmallSpace`.

    Attributes:
        kappa_n_m: Stiffness of the references, `inf` for a rigid plate [N/m].
        turning_n_m: kappa_0 [N/m].
        between: Error of log kappa when the other references predict each one; NaN for two.
    """

    kappa_n_m: Float[ndarray, " k"]
    turning_n_m: float
    middle: Vector
    basis: Float[ndarray, "q d"]
    means: Float[ndarray, "k q"]
    scatter: Float[ndarray, "q q"]
    outside: float
    freedom: int
    between: float = float("nan")

    def at(self, s: Float[ndarray, " n"], turning_n_m: float | None = None) -> Float[ndarray, "n q"]:
        """Return the curve at positions s, optionally as another kappa_0 bends it."""
        turning = turning_n_m or self.turning_n_m
        with np.errstate(divide="ignore"):
            kappa = self.turning_n_m * (1 / np.maximum(s, 0.0) - 1)
        return _powers(softness(kappa, turning), len(self.means)) @ self._fit(turning)

    def _fit(self, turning_n_m: float) -> Float[ndarray, "k q"]:
        """Return the coefficients of the polynomial through the references."""
        if turning_n_m not in self._fits:
            powers = _powers(softness(self.kappa_n_m, turning_n_m), len(self.means))
            self._fits[turning_n_m] = np.linalg.solve(powers, self.means)
        return self._fits[turning_n_m]

    @cached_property
    def _fits(self) -> dict[float, ndarray]:
        return {}

    def of(self, presses: Vectors, coverage: float = 0.9) -> Softness:
        """Return the stiffness of a specimen.

        Args:
            presses: One row for each trial; NaN for missing measurements.
            coverage: Coverage of the interval.
        """
        y = np.mean([self.place(press) for press in np.atleast_2d(presses)], axis=0)
        s = self.nearest(y)
        weight = np.linalg.inv(self.scatter)
        slope = self._slope(s)
        trials = 1 / len(np.atleast_2d(presses)) + len(self.means) / (self.freedom + len(self.means))
        spread = np.sqrt(trials / (slope @ weight @ slope))
        t = student_quantile(coverage, self.freedom)
        half = float(np.hypot(t * spread, self._bend(y, s)))
        off = y - self.at(np.array([s]))[0]
        kappa = (self._kappa(s), self._kappa(s + half), self._kappa(s - half))
        return Softness(kappa, s, float(np.sqrt(off @ weight @ off / len(off))))

    def _slope(self, s: float) -> Float[ndarray, " q"]:
        low, high = max(s - STEP, 0.0), s + STEP
        return np.diff(self.at(np.array([low, high])), axis=0)[0] / (high - low)

    def _bend(self, y: Float[ndarray, " q"], s: float) -> float:
        """Model error of s from the course of the curve between its references."""
        if np.isfinite(self.between):
            return self.between * s * (1 - s)
        return max(abs(self.nearest(y, bend * self.turning_n_m) - s) for bend in BENDS)

    def _kappa(self, s: float) -> float:
        return self.turning_n_m * (1 / min(s, 1.0) - 1) if s > 0 else float("inf")

    @property
    def range_n_m(self) -> tuple[float, float]:
        """Range of the references and `MARGIN` of their span in s; no upper end with a rigid plate [N/m]."""
        s = softness(self.kappa_n_m, self.turning_n_m)
        beyond = MARGIN * float(np.ptp(s))
        return self._kappa(float(s.max()) + beyond), self._kappa(float(s.min()) - beyond)

    @property
    def space(self) -> SmallSpace:
        return SmallSpace(self.middle, self.basis, self.means, self.scatter, self.outside, self.freedom)

    def novelty_score(self, press: Vector) -> float:
        return self.space.novelty_score(press)

    def place(self, press: Vector) -> Float[ndarray, " q"]:
        return self.space.place(press)

    def stiffness_n_m(self, y: Float[ndarray, " q"]) -> float:
        """Return the stiffness of a position in the basis [N/m]."""
        return self._kappa(self.nearest(y))

    def nearest(self, y: Float[ndarray, " q"], turning_n_m: float | None = None) -> float:
        weight = np.linalg.inv(self.scatter)
        grid = np.linspace(0.0, SOFTEST, 400)

        def far(s: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
            off = y - self.at(s, turning_n_m)
            return np.einsum("ni,ij,nj->n", off, weight, off)

        best = int(np.argmin(far(grid)))
        bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
        return float(minimize_scalar(lambda s: far(np.array([s]))[0], bounds=bounds, method="bounded").x)


@cache
def student_quantile(coverage: float, freedom: int) -> float:
    """Return the half-width of an interval in standard deviations with these degrees of freedom."""
    return float(stats.t.ppf((1 + coverage) / 2, freedom))


def softness(kappa_n_m: Float[ndarray, " k"], turning_n_m: float) -> Float[ndarray, " k"]:
    """Return s of stiffnesses."""
    return 1.0 / (1.0 + np.asarray(kappa_n_m, np.float64) / turning_n_m)


def fit_softness(kappa_n_m: Sequence[float], trials: Sequence[Float[ndarray, "_ d"]]) -> SoftnessCurve:
    """Fit the curve through two or more references.

    Args:
        kappa_n_m: Stiffness of each, `inf` for a rigid plate [N/m].
        trials: For each reference two or more trials, one a row.
    """
    kappa = np.asarray(kappa_n_m, np.float64)
    if len(kappa) != len(trials) or len(kappa) < 2 or not (kappa > 0).all():
        raise InputError(f"stiffnesses {list(kappa)}; two or more references above 0", code="stiffness-range")
    if len(np.unique(kappa)) < len(kappa):
        raise InputError("two references have one stiffness; join them", code="equal-references")
    space = fit_small_space(trials)
    known = (space.middle, space.basis, space.means, space.scatter, space.outside, space.freedom)
    return _turned(SoftnessCurve(kappa, float(kappa[np.isfinite(kappa)].min()), *known))


def scatter_directions(freedom: int) -> int:
    """Return the number of scatter directions that the degrees of freedom support."""
    return min(SCATTER, max(1, freedom // 3))


def fit_small_space(trials: Sequence[Float[ndarray, "_ d"]]) -> SmallSpace:
    """Return the subspace of references, each with two or more trials (rows)."""
    if min(map(len, trials)) < MIN_TRIALS:
        raise InputError(f"each reference needs {MIN_TRIALS} trials or more", code="too-few-trials")
    finite = np.isfinite(np.concatenate(trials)).all(axis=0)
    if finite.mean() < 0.5:
        raise InputError("half of the pins are not seen; check the light", code="pins-hidden")
    trials = [np.where(finite, trial, 0.0) for trial in trials]
    middle = np.concatenate(trials).mean(axis=0)
    means = np.stack([trial.mean(axis=0) for trial in trials])
    about = np.concatenate([trial - mean for trial, mean in zip(trials, means, strict=True)])
    freedom = len(about) - len(trials)
    wide = np.linalg.svd(about, full_matrices=False)[2][: scatter_directions(freedom)]
    basis = _orthonormal(np.concatenate([means - middle, wide]))
    residual = about - about @ basis.T @ basis
    inside = about @ basis.T
    noise = (residual**2).sum() / freedom / finite.sum()
    return SmallSpace(
        np.where(finite, middle, np.nan),
        np.where(finite, basis, 0.0),
        (means - middle) @ basis.T,
        inside.T @ inside / freedom + noise * np.eye(len(basis)),
        float(np.sqrt(noise)),
        freedom,
    )


def _turned(curve: SoftnessCurve) -> SoftnessCurve:
    """Set kappa_0 to the value by which the references best predict each other."""
    finite = np.sort(curve.kappa_n_m[np.isfinite(curve.kappa_n_m)])
    if len(curve.means) < 3:
        return curve
    tried = np.geomspace(finite[0] / 4, 4 * finite[-1], TURNINGS)
    worst = [_between(replace(curve, turning_n_m=float(turning))) for turning in tried]
    best = int(np.argmin(worst))
    around = worst[max(best - 1, 0) : best + 2]  # the best of many is better than it will prove
    return replace(curve, turning_n_m=float(tried[best]), between=max(around))


def left_out_n_m(curve: SoftnessCurve) -> dict[int, float]:
    """Return the stiffness of each reference between others, predicted by these [N/m]."""
    order = np.argsort(curve.kappa_n_m)
    found = {}
    for reference in order[1:-1]:
        others = np.delete(np.arange(len(order)), reference)
        fewer = replace(curve, kappa_n_m=curve.kappa_n_m[others], means=curve.means[others])
        s = max(fewer.nearest(curve.means[reference]), 1e-6)
        found[int(reference)] = curve.turning_n_m * (1 / s - 1)
    return found


def without(curve: SoftnessCurve, reference: int) -> SoftnessCurve:
    """Return the curve through all references but one, in the same small space."""
    others = np.delete(np.arange(len(curve.means)), reference)
    kappa = curve.kappa_n_m[others]
    fewer = replace(curve, kappa_n_m=kappa, means=curve.means[others], between=float("nan"))
    return _turned(replace(fewer, turning_n_m=float(kappa[np.isfinite(kappa)].min())))


def _between(curve: SoftnessCurve) -> float:
    """Greatest error of log kappa when the other references predict each one."""
    found = left_out_n_m(curve).items()
    return max(abs(float(np.log(kappa / curve.kappa_n_m[reference]))) for reference, kappa in found)


def _orthonormal(rows: Float[ndarray, "n d"]) -> Float[ndarray, "q d"]:
    """Orthonormal basis of the rows' span."""
    _, size, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[size > 1e-9 * size[0]])


def _powers(s: Float[ndarray, " k"], count: int) -> Float[ndarray, "k n"]:
    return np.vander(s, count, increasing=True)


TAPS = 5
CONTACT_N, MAX_N = 0.5, 5.0
SPIKE_WINDOW = 7  # samples
SPIKE_SPREADS = 6.0  # robust standard deviations from the median of its window
MIN_SPIKE_N = 0.25  # four steps of a 1/16 N sensor: less is no spike
STAYS = 3  # samples that must follow above the threshold, so that a spike is no contact
PLATEAU = 8  # equal greatest samples in a row: the sensor's range has ended

Samples = Float[ndarray, " s"]


def moving_average(force_n: Samples) -> Samples:
    """Return the centered mean of five samples, fewer at the ends [N]."""
    sums = np.concatenate([[0.0], np.cumsum(force_n)])
    i = np.arange(len(force_n))
    first = np.maximum(i - TAPS // 2, 0)
    last = np.minimum(i + TAPS // 2, len(force_n) - 1)
    return np.asarray((sums[last + 1] - sums[first]) / (last + 1 - first))


def spikes(force_n: Samples) -> Bool[ndarray, " s"]:
    """Return samples far from the median of their neighbors (Hampel's rule)."""
    middle = median_filter(force_n, SPIKE_WINDOW, mode="nearest")
    off = np.abs(force_n - middle)
    spread = 1.4826 * median_filter(off, SPIKE_WINDOW, mode="nearest")
    return off > np.maximum(SPIKE_SPREADS * spread, MIN_SPIKE_N)


def without_spikes(force_n: Samples) -> Samples:
    """Return the force with straight lines in place of spikes."""
    good = ~spikes(force_n)
    if not good.any():
        raise InputError("the force is nothing but spikes; look at the sensor's cable and its bias")
    i = np.arange(len(force_n))
    return np.interp(i, i[good], force_n[good])


def smoothed(force_n: Samples) -> Samples:
    """Return the force without spikes, averaged over five samples [N]."""
    return moving_average(without_spikes(np.asarray(force_n, np.float64)))


@dataclass(frozen=True)
class Loading:
    """Samples from contact onset to the greatest force; `saturated` if that is a plateau."""

    first: int
    last: int
    saturated: bool


def loading(force_n: Samples, contact_n: float = CONTACT_N) -> Loading:
    """Return the loading part of a smoothed force."""
    force = np.asarray(force_n, np.float64)
    if force.ndim != 1 or len(force) <= STAYS:
        raise InputError(f"{force.size} samples; a press has more than {STAYS}", code="too-few-values")
    if not np.isfinite(force).all():
        raise InputError(
            f"sample {int(np.argmin(np.isfinite(force)))} of the force is not finite", code="not-finite"
        )
    above = force >= contact_n
    stays = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(above, STAYS).all(axis=1))
    if not len(stays):
        raise InputError(
            f"the force never stays above {contact_n:g} N, its maximum is {force.max():g} N",
            code="no-contact",
        )
    first, last = int(stays[0]), int(np.argmax(force))
    if last - first < STAYS:
        raise InputError(
            f"the force rises to {force[last]:g} N within {last - first} samples; its loading part is "
            "missing",
            code="not-loading",
        )
    top = np.isclose(force, force[last], rtol=0, atol=1e-12)
    run = int(np.sum(np.cumprod(top[last:])))
    return Loading(first, last, run >= PLATEAU)


def within(force_n: Samples, part: Loading, low_n: float, high_n: float) -> Int[ndarray, " k"]:
    """Return samples of the loading part with a force between two limits [N]."""
    i = np.arange(part.first, part.last + 1)
    return i[(force_n[i] >= low_n) & (force_n[i] <= high_n)]


def rising(
    force_n: Samples, values: Float[ndarray, k * n], width_n: float
) -> tuple[Samples, Float[ndarray, b * n]]:
    """Return means over bins of force, in ascending force.

    Args:
        force_n: Force of each value [N].
        values: Values, such as areas.
        width_n: Bin width [N].

    Returns:
        Mean force and mean value of every bin that is not empty.
    """
    if not width_n > 0:
        raise RangeError(f"bins of {width_n} N; above 0, 0.1 N if in doubt")
    bins = np.floor(force_n / width_n).astype(np.int64)
    kinds, where = np.unique(bins, return_inverse=True)
    count = np.bincount(where, minlength=len(kinds))
    flat = np.reshape(values, (len(force_n), -1))
    means = np.stack([np.bincount(where, column, len(kinds)) for column in flat.T], axis=1) / count[:, None]
    return np.bincount(where, force_n, len(kinds)) / count, means.reshape(len(kinds), *values.shape[1:])
