"""Contact area from accumulated divergence, and its spread rate over force.

With mean divergence D_j, dA/dt = A D gives A_i = A_0 exp(sum D_j). dA/dF is a secant or a regression slope
over bins of force. `paper` keeps the report's equations (10) to (12), whose sum grows with the number of
steps.

Reference: Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile Optical Sensing and
Optical Flow Computation, IEEE Robotics and Automation Letters; R. Cipolla, A. Blake, Image divergence and
deformation from closed curves, Int. J. Robotics Research 16 (1997) 77, doi:10.1177/027836499701600106.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.estimators.compliance.press_force import rising

Way = Literal["regression", "secant", "paper"]

BIN_N = 0.1
MIN_BINS = 3
PAPER_COUNTS_FRAMES = (
    "equation (12) adds one slope a frame: its value grows with the number of frames, so with the frame "
    "rate, with slowness and with softness itself; compare presses of equal frames and speed only"
)
LITERAL = (
    "equation (8) as printed adds divergence over all {pixels} pixels, which counts the area twice; its "
    "exponential in (11) reaches e^{exponent:.0f}{beyond}; take 'paper', which has the mean divergence"
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


def refuse_literal(force_n: Steps, mean_divergence: Steps, pixels: int) -> NoReturn:
    """Refuse equations (8) and (11) as printed, with the exponent that they would reach."""
    exponent = float(np.abs(pixels * np.cumsum(mean_divergence) * force_n).max())
    beyond = ", beyond double precision" if exponent > MAX_EXPONENT else ""
    raise InputError(
        LITERAL.format(pixels=pixels, exponent=exponent, beyond=beyond), code="equation-overflow"
    )
