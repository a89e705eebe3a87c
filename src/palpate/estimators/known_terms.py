"""What presses tell of the terms of one copy: values with spreads, untold ones, pairs that go together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Float, RangeError, ndarray

UNTOLD = 0.8  # of its prior spread, from which a term is not told
TIED = 0.95  # correlation from which two terms cannot be told apart

GRAVITY_M_S2 = 9.80665  # standard; over the Earth it varies by 0.5 %
WEIGHT_SHARE = 0.005
SAID = 2.6  # standard deviations from which a change is said: 1 in 100 by chance

Covariance = Float[ndarray, "t t"]


def weight_n(mass_kg: float) -> float:
    """Weight of a mass that is laid on a sensor [N], known to `WEIGHT_SHARE`.

    Raises:
        RangeError: a mass that is not above 0.
    """
    if not (math.isfinite(mass_kg) and mass_kg > 0):
        raise RangeError(f"a mass of {1e3 * mass_kg:g} g; it has to be finite and above 0 g")
    return mass_kg * GRAVITY_M_S2


def term_rows(
    names: Sequence[str], values: Float[ndarray, " t"], covariance: Covariance
) -> dict[str, dict[str, float]]:
    """Each term's value and standard deviation, by its name."""
    spreads = np.sqrt(np.diag(covariance))
    return {
        name: {"value": float(value), "standard_deviation": float(spread)}
        for name, value, spread in zip(names, values, spreads, strict=True)
    }


def untold_terms(names: Sequence[str], before: Covariance, after: Covariance) -> tuple[str, ...]:
    """Terms of which hardly more is known than before."""
    was, now = np.sqrt(np.diag(before)), np.sqrt(np.diag(after))
    return tuple(name for name, b, a in zip(names, was, now, strict=True) if a > UNTOLD * b)


def correlated_pairs(names: Sequence[str], covariance: Covariance) -> tuple[tuple[str, str], ...]:
    """Pairs of terms that cannot be told apart: one may go up with the other."""
    sd = np.sqrt(np.diag(covariance))
    high = np.abs(np.triu(covariance / np.outer(sd, sd), 1)) > TIED
    return tuple((names[i], names[j]) for i, j in np.argwhere(high))


def changed_since(
    change: Float[ndarray, " t"], freedom: Covariance, before: Covariance, now: Covariance
) -> tuple[Float[ndarray, " t"], Float[ndarray, " t"]]:
    """How far terms have changed, where an estimate was made as if they could have, and standard deviations.

    With terms before N(m, C) and a change N(0, D), what is seen now is told beside the prior N(m, C + D); the
    change's part of what has moved from m is D (C + D)^-1.

    Args:
        change: of the most probable terms, now less before.
        freedom: D.
        before: C.
        now: covariance of the terms now.
    """
    share = freedom @ np.linalg.inv(before + freedom)
    spread = freedom - share @ freedom + share @ now @ share.T
    return share @ change, np.sqrt(np.maximum(np.diag(spread), 0.0))
