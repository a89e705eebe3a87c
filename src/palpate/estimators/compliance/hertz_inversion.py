"""Modulus and radius of a touched object from force over displacement and force over contact area.

For a Hertz contact (`hertz_pairs`) P^(2/3) = c (d - d0) and A = k P^(2/3) give, for finger and object in
series,

    R = c k / pi,    E = 3/4 c^(3/2) / sqrt(R)

from which the finger's own values are subtracted. Results are marked invalid if the object accounts for less
than a fifth of the approach, because every error is then magnified more than fivefold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core import Float, InputError, ndarray
from palpate.mechanics.half_space.hertz_pairs import Body

MIN_SHARE = 0.2
DRAWS = 4000
MIN_SAMPLES = 5
FARTHEST = 20.0  # e-folds that a drawn slope is off at most: Student's tails of two presses have no end
OF_MODULUS, OF_RADIUS = 0.13, 0.25  # relative standard deviations per misfit of the finger
TOO_STIFF = (
    "the object yields {:.0%} of the approach; below {:.0%} its own part cannot be told from the finger's"
)

Samples = Float[ndarray, " _"]


@dataclass(frozen=True)
class PressCurves:
    """Loading samples of one press: force [N], approach from any origin [m], contact area [m^2]."""

    force_n: Samples
    approach_m: Samples
    area_m2: Samples


@dataclass(frozen=True)
class Finger:
    """Finger that touches, with relative standard deviations and its misfit to a Hertz body.

    Attributes:
        body: Its modulus over 1 - nu^2 and its radius.
        misfit: Relative difference of its modulus between lower and upper forces; 0 for a Hertz body.
    """

    body: Body
    modulus_spread: float = 0.0
    radius_spread: float = 0.0
    misfit: float = 0.0


@dataclass(frozen=True)
class TouchedObject:
    """Object by both cues.

    Attributes:
        modulus_pa, radius_m: Estimate, low, and high; the radius of a flat is infinite.
        share: Ratio of the approach that the object yields.
    """

    modulus_pa: tuple[float, float, float]
    radius_m: tuple[float, float, float]
    share: float
    coverage: float
    valid: bool
    why: str


def fit_finger(rigid: Sequence[PressCurves]) -> Finger:
    """Fit the Hertz pair that acts as the finger does in presses on a rigid plate.

    A tip whose skin is stiffer than its gel is no Hertz body. On virtual tips, the reciprocal modulus of an
    object in series has an RMS error of 0.13 times the misfit, which is counted as a standard deviation; the
    radius a quarter.
    """
    if not rigid:
        raise InputError("no press on a rigid plate; give one or more")
    c, k = np.array([_slopes(press) for press in rigid]).T
    E, R = _both(c.mean(), k.mean())
    of_c, of_k = _spread(rigid, c, k)
    misfit = float(np.mean([_misfit(press) for press in rigid]))
    return Finger(
        Body(float(E), float(R)),
        float(np.hypot(np.hypot(of_c, 0.5 * of_k), OF_MODULUS * misfit)),  # E goes with c / sqrt(k)
        float(np.hypot(np.hypot(of_c, of_k), OF_RADIUS * misfit)),
        misfit,
    )


def _misfit(press: PressCurves) -> float:
    """Relative difference of the moduli of the lower and the upper half of the forces."""
    low = press.force_n <= np.median(press.force_n)
    if min(low.sum(), (~low).sum()) < MIN_SAMPLES:
        return 0.0
    halves = [
        _both(*_slopes(PressCurves(press.force_n[half], press.approach_m[half], press.area_m2[half])))[0]
        for half in (low, ~low)
    ]
    return 1.0 - min(halves) / max(halves)


def invert_hertz(
    presses: Sequence[PressCurves], finger: Finger, rng: np.random.Generator, coverage: float = 0.9
) -> TouchedObject:
    """Invert Hertz contact for the object of one or several presses.

    Intervals come from draws of the slopes and of the finger: Student draws of the scatter between presses,
    or for a single press the scatter of its samples.
    """
    if not presses:
        raise InputError("no press; give one or more", code="no-presses")
    c, k = np.array([_slopes(press) for press in presses]).T
    spread = _spread(presses, c, k)
    several, shape = len(presses) > 1, (2, DRAWS)
    drawn = rng.standard_t(len(presses) - 1, shape) if several else rng.standard_normal(shape)
    off = np.clip(spread[:, None] * drawn, -FARTHEST, FARTHEST)
    draws = np.exp(np.log([c.mean(), k.mean()])[:, None] + off)
    E_f = finger.body.modulus_pa * np.exp(finger.modulus_spread * rng.standard_normal(DRAWS))
    R_f = finger.body.radius_m * np.exp(finger.radius_spread * rng.standard_normal(DRAWS))
    E, R = _both(c.mean(), k.mean())
    softness, curvature = 1 / E - 1 / finger.body.modulus_pa, 1 / R - 1 / finger.body.radius_m
    drawn_E, drawn_R = _both(*draws)
    tails = np.array([(1 - coverage) / 2, (1 + coverage) / 2])
    share = softness * E
    return TouchedObject(
        _inverse(softness, np.quantile(1 / drawn_E - 1 / E_f, tails)),
        _inverse(curvature, np.quantile(1 / drawn_R - 1 / R_f, tails)),
        float(share),
        coverage,
        bool(share >= MIN_SHARE),
        "" if share >= MIN_SHARE else TOO_STIFF.format(share, MIN_SHARE),
    )


def _both(c: Any, k: Any) -> tuple[Any, Any]:
    R = c * k / np.pi
    return 0.75 * c**1.5 / np.sqrt(R), R


def _slopes(press: PressCurves) -> tuple[float, float]:
    force, approach, area = (
        np.asarray(x, np.float64) for x in (press.force_n, press.approach_m, press.area_m2)
    )
    if not (force.shape == approach.shape == area.shape) or force.ndim != 1 or len(force) < MIN_SAMPLES:
        raise InputError(
            f"{force.size} forces, {approach.size} approaches, {area.size} areas; give {MIN_SAMPLES}",
            code="too-few-values",
        )
    if not (np.isfinite([force, approach, area]).all() and force.min() > 0 and area.min() > 0):
        raise InputError("forces and areas must be finite and above 0", code="not-positive")
    p = force ** (2 / 3)
    if np.ptp(approach) == 0 or np.ptp(force) == 0:
        raise InputError("neither force nor approach changes; give the loading", code="not-loading")
    c = float(_line(press)[0][0])
    if not c > 0:
        raise InputError("force falls as the approach grows; turn the sign of one of them", code="force-sign")
    return c, float(np.mean(area / p))


def _line(press: PressCurves) -> tuple[Samples, Float[ndarray, "2 2"]]:
    """P^(2/3) over the approach, and its covariance; weighted for even noise of the force."""
    return np.polyfit(press.approach_m, press.force_n ** (2 / 3), 1, w=np.cbrt(press.force_n), cov=True)


def _spread(presses: Sequence[PressCurves], c: Samples, k: Samples) -> Samples:
    """Relative standard errors of the mean slopes."""
    if len(presses) > 1:
        return np.array([x.std(ddof=1) / x.mean() / np.sqrt(len(x)) for x in (c, k)])
    (press,) = presses
    _, cov = _line(press)
    ratio = press.area_m2 / press.force_n ** (2 / 3)
    return np.array([np.sqrt(cov[0, 0]) / c[0], ratio.std(ddof=1) / np.sqrt(len(ratio)) / k[0]])


def _inverse(value: float, tails: Samples) -> tuple[float, float, float]:
    """Estimate, low, and high of the reciprocal; infinite if not positive."""
    mid, high, low = (1 / x if x > 0 else np.inf for x in (value, *tails))
    return float(mid), float(low), float(high)
