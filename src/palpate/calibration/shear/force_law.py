"""Law from cues of a pattern's motion to normal force, with the skin's memory where frames have a history.

The elastic force is linear in the cues,

    L = sum_c c (a_c + a_cx x^2 + a_cy y^2) + b,

where the position (x, y) stands for what the pattern's edge cuts off. The cues are gamma in the laws
"published" and "placed", the three moments in "any-tip". A viscoelastic skin adds branches with times T_i:

    F = L + sum_i s_i m_i,     m_i(t) = integral exp(-(t - t') / T_i) dL(t').

Interval of a force from held-out errors: half(F) = q u(F).

u follows the errors' quantile over the range in parts of 40 presses or more; q is the quantile of |error| / u
for unseen presses with equal weights, its rank raised by one press (R. Dunn, L. Wasserman and A. Ramdas, J.
Am. Stat. Assoc. 118, 2491 (2023), doi:10.1080/01621459.2022.2060112).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from palpate.calibration.coverage.conformal import pooled_quantile
from palpate.calibration.shear.touch_cues import TouchCues
from palpate.core import Bool, Float, InputError, Int, ndarray

LAWS = ("published", "placed", "any-tip")
MEMORY_S = (0.1, 0.3, 1.0, 4.0)
MAX_GAP_S = 1.0  # between frames: after a longer one the history is not known
PLACE_M = 10e-3  # unit of places in the terms
ROUNDS = 6  # until what is remembered fits the elastic part

Rows = Float[ndarray, "n k"]
Series = Float[ndarray, " n"]


def law_terms(law: str, cues: Sequence[TouchCues]) -> Rows:
    """Return the terms whose weighted sum is the elastic force, the constant last."""
    if law not in LAWS:
        raise InputError(f"law {law!r}; there are {', '.join(LAWS)}")
    table = np.array([c[:6] for c in cues], float).reshape(-1, 6)
    one = np.ones(len(table))
    if law == "published":
        return np.column_stack([table[:, 0], one])
    x, y = table[:, 4] / PLACE_M, table[:, 5] / PLACE_M
    used = table[:, :1] if law == "placed" else table[:, 1:4]
    return np.column_stack([*(used.T), *(used * x[:, None] ** 2).T, *(used * y[:, None] ** 2).T, one])


@dataclass(frozen=True)
class ForceLine:
    """Fitted law.

    Attributes:
        law: one of `LAWS`.
        weights: of the terms [N each].
        memory_s: T_i [s]; none without hysteresis.
        memory_share: s_i.
    """

    law: str
    weights: Float[ndarray, " k"]
    memory_s: Float[ndarray, " m"]
    memory_share: Float[ndarray, " m"]

    def elastic_n(self, cues: Sequence[TouchCues]) -> Series:
        """L of each frame [N]; NaN where the law needs a place and there is no contact."""
        return np.asarray(law_terms(self.law, cues) @ self.weights)

    def force_n(self, cues: Sequence[TouchCues], remembered: Rows) -> Series:
        """F of each frame [N]; `remembered` as `follow_memory` gives it."""
        return np.asarray(self.elastic_n(cues) + remembered @ self.memory_share)


class MemoryTrace:
    """Memory of the skin, followed from frame to frame; known from a frame without contact on, and lost where
    frames are too far apart.
    """

    def __init__(self, memory_s: Float[ndarray, " m"]) -> None:
        self._times = memory_s
        self._state = np.full(len(self._times), np.nan)
        self._last_n, self._last_s = math.nan, math.nan

    def step(self, time_s: float, elastic_n: float) -> Float[ndarray, " m"]:
        """Return m_i at a frame [N]; NaN where the history is not known.

        Args:
            time_s: of the frame [s]; NaN without a clock.
            elastic_n: L above that of the no-contact skin; 0 without contact [N].
        """
        step = time_s - self._last_s
        if not 0 < step <= MAX_GAP_S:  # the first frame too, and one without a clock, whose step is NaN
            self._state[:] = np.nan
            step = math.inf
        if elastic_n == 0 and not np.isfinite(self._state).all():
            self._state[:] = 0.0
        else:
            fades = np.exp(-step / self._times)
            self._state = self._state * fades + (elastic_n - self._last_n) * np.sqrt(fades)
        self._last_n, self._last_s = elastic_n, time_s
        return self._state.copy()


def follow_memory(
    line: ForceLine, cues: Sequence[TouchCues], time_s: Series, press: ndarray
) -> tuple[Rows, Series]:
    """Return m_i of each frame [N], and L; frames of one press in temporal order."""
    elastic = touched_n(line, cues)
    remembered = np.full((len(cues), len(line.memory_s)), np.nan)
    for one in dict.fromkeys(press.tolist()):
        trace = MemoryTrace(line.memory_s)
        for i in np.flatnonzero(press == one):
            remembered[i] = trace.step(float(time_s[i]), float(elastic[i]))
    return remembered, elastic


def touched_n(line: ForceLine, cues: Sequence[TouchCues]) -> Series:
    """Return the elastic force of each frame, 0 without contact [N]."""
    contact = np.array([c.contacts > 0 for c in cues])
    with np.errstate(invalid="ignore"):
        return np.where(contact, np.maximum(line.elastic_n(cues), 0.0), 0.0)


def fit_line(law: str, cues: Sequence[TouchCues], force_n: Series, used: Bool[ndarray, " n"]) -> ForceLine:
    """Fit the elastic law alone by least squares.

    Args:
        law: one of `LAWS`.
        used: frames to fit to.
    """
    terms = law_terms(law, cues)[used]
    _refuse_few(law, terms)
    return ForceLine(law, _least_squares(terms, force_n[used]), np.empty(0), np.empty(0))


def fit_remembering(
    law: str,
    cues: Sequence[TouchCues],
    force_n: Series,
    used: Bool[ndarray, " n"],
    time_s: Series,
    press: ndarray,
) -> ForceLine:
    """Fit the law with memory by least squares, no branch's weight below 0.

    Args:
        time_s, press: time and press of each frame, in temporal order within a press.
    """
    line = fit_line(law, cues, force_n, used)
    line = ForceLine(law, line.weights, np.array(MEMORY_S), np.zeros(len(MEMORY_S)))
    terms = law_terms(law, cues)
    for _ in range(ROUNDS):
        remembered, _ = follow_memory(line, cues, time_s, press)
        known = used & np.isfinite(remembered).all(axis=1)
        if known.sum() < 2 * (terms.shape[1] + len(MEMORY_S)):
            raise InputError(
                f"the history of {known.sum()} frames with a contact is known; record each press from a "
                f"frame without contact on, frames at most {MAX_GAP_S:g} s apart, or fit without hysteresis"
            )
        both = np.column_stack([terms[known], remembered[known]])
        scale = _column_scale(both)
        least = np.concatenate([np.full(terms.shape[1], -np.inf), np.zeros(len(MEMORY_S))])
        found = lsq_linear(both / scale, force_n[known], (least, np.full(len(least), np.inf))).x / scale
        weights, shares = np.split(found, [terms.shape[1]])
        line = ForceLine(law, weights, line.memory_s, np.where(shares > 1e-9, shares, 0.0))
    return line


def _refuse_few(law: str, terms: Rows) -> None:
    if len(terms) < 2 * terms.shape[1]:
        raise InputError(
            f"{len(terms)} frames with a contact and a force in the range; the law {law!r} needs at least "
            f"{2 * terms.shape[1]}"
        )


def _least_squares(terms: Rows, force_n: Series) -> Float[ndarray, " k"]:
    scale = _column_scale(terms)
    return np.asarray(np.linalg.lstsq(terms / scale, force_n, rcond=1e-10)[0] / scale)


def _column_scale(terms: Rows) -> Float[ndarray, " k"]:
    scale = np.sqrt((terms**2).mean(axis=0))
    return np.where(scale > 0, scale, 1.0)


FOLDS = 10
MIN_PRESSES = 10
PRESSES_PER_KNOT = 40
MAX_KNOTS = 20
FLOOR = 0.25  # of the mean error over the range: a stretch that happened to do well is not trusted below


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
