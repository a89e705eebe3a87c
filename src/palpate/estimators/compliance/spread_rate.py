"""Contact area from accumulated divergence, and its spread rate over force.

With mean divergence D_j, dA/dt = A D gives A_i = A_0 exp(sum D_j). dA/dF is a secant or a regression slope
over bins of force. `paper` keeps the report's equations (10) to (12), whose sum grows with the number of
steps.

Reference: Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile Optical Sensing and
Optical Flow Computation, IEEE Robotics and Automation Letters; R. Cipolla, A. Blake, Image divergence and
deformation from closed curves, Int. J. Robotics Research 16 (1997) 77, doi:10.1177/027836499701600106.

Calibration of the spread rate dA/dF, and of the area at one force, from areas against known values.

Areas of one press have correlated errors, so slopes of left-out trials are compared with true ones directly:
log of the true rate is a polynomial in log of the rate by areas. Its scatter, growing along the line, and the
error of predicting each reference from the others give the interval.

Published route from frames and force to a spread rate: flow, divergence, accumulated area.

A_0 is the circle through the pins, not a contact, so areas are relative to it and only contrasts between
presses of one sensor are meaningful. Divergence is averaged over that circle (equation (8) averages over the
image).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from palpate.core import Bool, Float, InputError, Int, PalpateError, RangeError, Shaped, ndarray
from palpate.estimators.compliance.contact_area import pin_field
from palpate.estimators.compliance.stiffness_curve import (
    CONTACT_N,
    MAX_N,
    loading,
    rising,
    smoothed,
    student_quantile,
    within,
)
from palpate.estimators.flow.horn_schunck import course

Way = Literal["regression", "secant", "paper"]

BIN_N = 0.1
MIN_BINS = 3
PAPER_COUNTS_FRAMES = (
    "equation (12) adds one slope a frame: its value grows with the number of frames, so with the frame "
    "rate, with slowness and with softness itself; compare presses of equal frames and speed only"
)
MAX_EXPONENT = 700.0  # of e in double precision

Steps = Float[ndarray, " _"]  # one a frame


@dataclass(frozen=True)
class SpreadRate:
    """Spread rate dA/dF [m^2/N] (in `paper` the report's sum) over a number of bins or frames."""

    way: Way
    rate_m2_n: float
    steps: int
    warning: str = ""


def area_m2(first_m2: float, mean_divergence: Steps) -> Steps:
    """Return A_i = A_0 exp(sum of D_j up to i) [m^2]."""
    total = np.cumsum(mean_divergence)
    if not first_m2 > 0:
        raise RangeError(f"a first area of {first_m2} m2; above 0", code="area")
    if total.size and not np.abs(total).max() < MAX_EXPONENT:
        raise RangeError(
            f"accumulated divergence of {np.abs(total).max():g}; use the mean over pixels",
            code="divergence-range",
        )
    return np.asarray(first_m2 * np.exp(total))


def spread(force_n: Steps, area: Steps, way: Way = "regression") -> SpreadRate:
    """Return dA/dF by a line through 0.1 N bins ("regression") or between the first and last ("secant")."""
    force_n, area = np.asarray(force_n, np.float64), np.asarray(area, np.float64)
    if force_n.shape != area.shape or force_n.ndim != 1:
        raise InputError(f"{force_n.size} forces and {area.size} areas; give as many", code="lengths-differ")
    if not (np.isfinite(force_n).all() and np.isfinite(area).all()):
        raise InputError("forces and areas must be finite", code="not-finite")
    at, mean = rising(force_n, area, BIN_N)
    if len(at) < MIN_BINS:
        raise InputError(
            f"the forces fill {len(at)} bins of {BIN_N:g} N; {MIN_BINS} are needed", code="too-few-forces"
        )
    if way == "regression":
        return SpreadRate(way, float(np.polyfit(at, mean, 1)[0]), len(at))
    if way == "secant":
        return SpreadRate(way, float((mean[-1] - mean[0]) / (at[-1] - at[0])), len(at))
    raise InputError(
        f"no way {way!r} of areas; there are regression and secant, and `paper_spread` beside them"
    )


def paper_spread(force_n: Steps, mean_divergence: Steps, first_m2: float) -> SpreadRate:
    """Return equations (9), (11), and (12) with the mean divergence for (8) and F_0 = 0."""
    force_n, D = np.asarray(force_n, np.float64), np.asarray(mean_divergence, np.float64)
    if force_n.shape != D.shape or force_n.ndim != 1 or not len(D):
        raise InputError(f"{force_n.size} forces and {D.size} divergences; give one of each a frame")
    exponent = np.cumsum(D) * force_n
    if not np.abs(exponent).max() < MAX_EXPONENT:
        raise RangeError(f"equation (11) would take e to {np.abs(exponent).max():.3g}")
    A = np.concatenate([[first_m2], first_m2 * np.exp(exponent)])
    rate = summed_slopes(np.concatenate([[0.0], force_n]), A)
    return SpreadRate("paper", rate, len(D), PAPER_COUNTS_FRAMES)


def summed_slopes(force_n: Steps, area: Steps) -> float:
    """Return equation (12): the sum of dA/dF over steps in which force changes [m^2/N]."""
    changes = np.diff(force_n) != 0
    return float((np.diff(area)[changes] / np.diff(force_n)[changes]).sum())


MAX_DEGREE = 2
MAX_GROWTH = 1.5  # e-folds of the spread for each standard deviation of the references' rates
MAX_Z = 2.0  # standard deviations from the references' middle: farther the spread grows no more
MARGIN = 0.25  # of the logarithmic span of the references, by which an interval may reach beyond them
RECTANGULAR = np.sqrt(3.0)  # of a bound over the standard deviation of what lies anywhere within it

Values = Float[ndarray, " _"]


@dataclass(frozen=True)
class RateFit:
    """Log of the true rate as a polynomial of the standardized log rate by areas.

    Attributes:
        middle, scale: Standardization of the log rate by areas.
        coefficients: Polynomial coefficients, the constant first.
        covariance: Covariance of the coefficients in units of the squared spread.
        spread: Standard deviation of one trial at the middle.
        freedom: Trials less coefficients.
        between: RMS error of predicting references from the others, used as a bound.
        growth: Slope of log spread along the standardized rate.
        means: Mean true rate of each reference.
    """

    middle: float
    scale: float
    coefficients: Float[ndarray, " c"]
    covariance: Float[ndarray, "c c"]
    spread: float
    freedom: int
    between: float
    growth: float
    means: Float[ndarray, " k"]

    @property
    def known(self) -> tuple[float, float]:
        """Range of valid intervals: the references and `MARGIN` of their span."""
        low, high = np.log([self.means.min(), self.means.max()])
        beyond = MARGIN * (high - low)
        return float(np.exp(low - beyond)), float(np.exp(high + beyond))

    def of(self, rates_m2_n: Float[ndarray, " t"], coverage: float = 0.9) -> tuple[float, float, float]:
        """Return the true rate with its interval from trials' rates by areas on one specimen [m^2/N]."""
        z = (float(np.mean(np.log(rates_m2_n))) - self.middle) / self.scale
        powers = z ** np.arange(len(self.coefficients))
        log_rate = float(powers @ self.coefficients)
        own = self.spread * np.exp(self.growth * float(np.clip(z, -MAX_Z, MAX_Z)))
        spread = own * np.sqrt(1 / len(rates_m2_n) + powers @ self.covariance @ powers)
        half = float(student_quantile(coverage, self.freedom) * np.hypot(spread, self.between / RECTANGULAR))
        return float(np.exp(log_rate)), float(np.exp(log_rate - half)), float(np.exp(log_rate + half))


def fit_rate(by_areas: Sequence[float], true: Sequence[float], reference: Sequence[int]) -> RateFit:
    """Fit to trials of three or more references.

    Args:
        by_areas: Rate of each trial from areas fitted without it [m^2/N].
        true: True rate [m^2/N].
        reference: Index of each trial's reference.
    """
    x, y = np.asarray(by_areas, np.float64), np.asarray(true, np.float64)
    kinds = len(set(reference))
    if kinds < 3 or len(x) < kinds + 3:
        raise InputError(f"{len(x)} trials of {kinds} references with a known rate; six of three are needed")
    if not ((x > 0).all() and (y > 0).all()):
        raise InputError("a contact that shrinks as the force grows; look at the areas in the tables")
    x, y, which = np.log(x), np.log(y), np.asarray(reference)
    means = np.array([np.exp(y[which == kind].mean()) for kind in sorted(set(reference))])
    middle, scale = float(x.mean()), float(x.std() + 1e-12)
    z = (x - middle) / scale
    fit, covariance = _solved(z, y, min(MAX_DEGREE, kinds - 2))
    freedom = len(x) - len(fit) - 1  # one more for the growth
    off = y - _powers(z, len(fit)) @ fit
    growth = _growth(z, off)
    spread = float(np.sqrt(np.sum((off * np.exp(-growth * z)) ** 2) / freedom))
    return RateFit(middle, scale, fit, covariance, spread, freedom, _between(z, y, which), growth, means)


def _growth(z: Values, off: Values) -> float:
    """Maximum likelihood growth of log spread along z for Gaussian errors of zero mean."""
    if not off.any():
        return 0.0
    found = minimize_scalar(
        lambda b: np.log(np.mean((off * np.exp(-b * z)) ** 2)),
        bounds=(-MAX_GROWTH, MAX_GROWTH),
        method="bounded",
    )
    return float(found.x)


def _between(z: Values, y: Values, which: Int[ndarray, " t"]) -> float:
    """RMS error of log rate when the other references predict each one between them."""
    kinds = sorted(set(which), key=lambda kind: float(z[which == kind].mean()))
    off = []
    for kind in kinds[1:-1]:
        own = which == kind
        fit, _ = _solved(z[~own], y[~own], min(MAX_DEGREE, len(kinds) - 2))
        off.append(float(np.mean(_powers(z[own], len(fit)) @ fit - y[own])))
    return float(np.sqrt(np.mean(np.square(off))))


def _solved(z: Values, y: Values, degree: int) -> tuple[Values, Float[ndarray, "c c"]]:
    X = _powers(z, degree + 1)
    fit, *_ = np.linalg.lstsq(X, y, rcond=None)
    return fit, np.linalg.inv(X.T @ X)


def _powers(z: Values, count: int) -> Float[ndarray, "t c"]:
    return np.vander(z, count, increasing=True)


WAYS: tuple[Way, ...] = ("regression", "secant", "paper")


@dataclass(frozen=True)
class AsReported:
    """Results of the published route, one value for each frame of the loading part.

    Attributes:
        force_n: Force [N].
        divergence: Mean divergence of the step to the frame [1/frame].
        area: A_i over A_0.
    """

    force_n: Float[ndarray, " f"]
    divergence: Float[ndarray, " f"]
    area: Float[ndarray, " f"]

    @cached_property
    def spreads(self) -> dict[str, SpreadRate]:
        """Spread rates by regression, secant, and the paper's sum that the press allows [1/N]."""
        spreads: dict[str, SpreadRate] = {}
        for way in WAYS if len(self.force_n) > 1 else ():
            try:
                if way == "paper":
                    spreads[way] = paper_spread(self.force_n, self.divergence, 1.0)
                else:
                    spreads[way] = spread(self.force_n, self.area, way)
            except PalpateError:  # e.g. too few frames for a line; the others may still stand
                continue
        return spreads

    @property
    def summed(self) -> Float[ndarray, " f"]:
        """Equation (12) up to every frame, with F_0 = 0, without steps of equal force [1/N]."""
        A = np.exp(np.cumsum(self.divergence) * self.force_n)
        step = np.diff(self.force_n, prepend=0.0)
        slopes = np.divide(np.diff(A, prepend=1.0), step, out=np.zeros_like(step), where=step != 0)
        return np.cumsum(slopes)

    def above(self, force_n: float) -> AsReported:
        """Return the same for frames above a force (2.5 N in section V of the report)."""
        rows = self.force_n >= force_n
        return AsReported(self.force_n[rows], self.divergence[rows], self.area[rows])


def circle_through_pins(
    untouched_px: Float[ndarray, "p 2"], height: int, width: int, cells: Int[ndarray, "p 2"] | None = None
) -> Bool[ndarray, "h w"]:
    """Return the largest circle through the pins about the middle one, A_0 of Algorithm 1, as a mask.

    Args:
        untouched_px: Pins of the reference frame [px].
        height, width: Size of the image [px].
        cells: Lattice cell of each pin, to locate middle and edge if pins are hidden.
    """
    if cells is not None:
        field = pin_field(untouched_px, cells)
        middle, reach = field.middle, field.farthest
    else:
        places = untouched_px[np.isfinite(untouched_px).all(axis=1)]
        middle = places[np.argmin(np.hypot(*(places - places.mean(axis=0)).T))]
        reach = np.hypot(*(places - middle).T).max()
    y, x = np.mgrid[:height, :width]
    return np.asarray(np.hypot(x - middle[0], y - middle[1]) <= reach)


def as_reported(
    frames: Iterable[Shaped[ndarray, ...]],
    force_n: Float[ndarray, " s"],
    frame_sample: Int[ndarray, " f"],
    *,
    region: Bool[ndarray, "h w"] | None = None,
) -> AsReported:
    """Run the published route on a press (see `follow_press`), averaging over `region` or the image."""
    smooth = smoothed(force_n)
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, within(smooth, loading(smooth), CONTACT_N, MAX_N)))
    first, last = int(max(used[0] - 1, 0)) if len(used) else 0, int(used[-1]) if len(used) else 0
    steps = course(islice(iter(frames), first, last + 1), region=region)
    divergence = np.array([step.divergence for step in steps])[-len(used) :]
    if len(divergence) < len(used) or not len(used):
        raise InputError(
            f"{len(divergence)} steps for {len(used)} frames under {CONTACT_N:g} to {MAX_N:g} N; begin "
            "before contact",
            code="frames-differ",
        )
    return AsReported(smooth[at[used]], divergence, area_m2(1.0, divergence))
