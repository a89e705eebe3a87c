"""Interval of a force from held-out errors: half(F) = q u(F).

u follows the errors' quantile over the range in parts of 40 presses or more; q is the quantile of |error| / u
for unseen presses with equal weights, its rank raised by one press (R. Dunn, L. Wasserman and A. Ramdas, J.
Am. Stat. Assoc. 118, 2491 (2023), doi:10.1080/01621459.2022.2060112).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from palpate.calibration.coverage.conformal import pooled_quantile
from palpate.core import Bool, Float, InputError, Int, ndarray

FOLDS = 10
MIN_PRESSES = 10
PRESSES_PER_KNOT = 40
MAX_KNOTS = 20
FLOOR = 0.25  # of the mean error over the range: a stretch that happened to do well is not trusted below

Series = Float[ndarray, " n"]


@dataclass(frozen=True)
class ForceInterval:
    """Half-width of the interval [N] at forces `at_n` [N], linear between and constant beyond."""

    at_n: Float[ndarray, " k"]
    half_n: Float[ndarray, " k"]
    coverage: float

    def half(self, force_n: float) -> float:
        """Half-width at an estimate [N]."""
        return float(np.interp(force_n, self.at_n, self.half_n))


def fit_interval(estimate_n: Series, force_n: Series, press: ndarray, coverage: float) -> ForceInterval:
    """Fit an interval to estimates of held-out presses.

    Args:
        estimate_n, force_n: of frames [N].
        press: press of each frame.
        coverage: 0.5 to 0.99.
    """
    presses = len(np.unique(press))
    if presses < MIN_PRESSES:
        raise InputError(f"{presses} presses; an interval needs {MIN_PRESSES} or more that were held out")
    if not 0.5 <= coverage <= 0.99:
        raise InputError(f"a coverage of {coverage}; give 0.5 to 0.99")
    error = np.abs(estimate_n - force_n)
    at, size = _error_size(estimate_n, error, press, coverage)
    score = np.empty_like(error)
    for out in press_folds(press):
        kept = ~out
        score[out] = error[out] / np.interp(
            estimate_n[out], *_error_size(estimate_n[kept], error[kept], press[kept], coverage)
        )
    raised = min(coverage * (presses + 1) / presses, 0.999)
    return ForceInterval(at, pooled_quantile(score, press, raised) * size, coverage)


def _error_size(
    estimate_n: Series, error_n: Series, press: ndarray, coverage: float
) -> tuple[Float[ndarray, " k"], Float[ndarray, " k"]]:
    """Forces, and u at them [N]."""
    knots = max(1, min(MAX_KNOTS, len(np.unique(press)) // PRESSES_PER_KNOT))
    edges = np.quantile(estimate_n, np.linspace(0, 1, knots + 1))
    part = np.clip(np.searchsorted(edges, estimate_n, side="right") - 1, 0, knots - 1)
    at = np.array([estimate_n[part == k].mean() for k in range(knots)])
    size = np.array([np.quantile(error_n[part == k], coverage) for k in range(knots)])
    return at, np.maximum(_smoothed(size), max(FLOOR * float(error_n.mean()), 1e-9))


def _smoothed(values: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
    """Mean with the neighbours, which count half; both ends as they are, where errors change fastest."""
    smooth = values.copy()
    smooth[1:-1] = (values[:-2] + 2 * values[1:-1] + values[2:]) / 4
    return smooth


def press_folds(press: ndarray, folds: int = FOLDS, seed: int = 0) -> Iterator[Bool[ndarray, " n"]]:
    """Yield the held-out frames of each fold, presses kept whole."""
    names, which = np.unique(press, return_inverse=True)
    of_press: Int[ndarray, " p"] = np.random.default_rng(seed).permutation(len(names)) % folds
    for fold in range(min(folds, len(names))):
        yield of_press[which] == fold


def held_out(fit: Callable[[Bool[ndarray, " n"]], Series], press: ndarray) -> Series:
    """Return estimates of all frames [N], each by a fit to other presses.

    Args:
        fit: estimates of all frames, by a fit to those that it is given.
        press: press of each frame.
    """
    estimate = np.full(len(press), np.nan)
    for out in press_folds(press):
        estimate[out] = fit(~out)[out]
    return estimate
