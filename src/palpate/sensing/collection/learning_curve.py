"""Learning curve of presses: error against the number trained on, and the effect of ten more.

Models train on some presses and are scored on all others. E(n) = a n^-b is fitted; its interval (Student's)
adds the variances of refits about the law and of resampled presses. In 300 simulated sessions the 90 %
interval covered the effect of ten more presses in 93 %. A floor of the error is not modeled.

Reference: C. Cortes et al., Learning curves: asymptotic values and rate of convergence, NIPS 6 (1994).
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from palpate.calibration.calibration_job import CalibrationJob, preparation_of
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.core import InputError, Progress, silent
from palpate.estimators.networks import make_model
from palpate.estimators.networks.model_interface import predict_rows
from palpate.recordings import PackedSet, Run, Split, pack
from palpate.recordings.splits import group_names, within_session
from palpate.sensing.collection.press_collector import FEW_PRESSES, REST

SHARES = (0.25, 0.5, 0.8)
REPEATS = 2
DRAWS = 500
MORE = 10
MIN_PRESSES = 8
RATE = 0.9  # of intervals


@dataclass(frozen=True, slots=True)
class LearningCurve:
    """Error against presses.

    Attributes:
        mae: mean absolute error on presses not learnt from, in the target's unit.
        expected: error with all of them, and its interval of 90 %.
        with_more: the same with `more` presses more.
        ratio: of the two errors, the later over the present one, and its interval of 90 %.
    """

    presses: tuple[int, ...]
    mae: tuple[float, ...]
    a: float
    b: float
    have: int
    expected: tuple[float, float, float]
    with_more: tuple[float, float, float]
    ratio: tuple[float, float, float]
    unit: str = "N"
    more: int = MORE

    @property
    def text(self) -> str:
        """What more presses would bring, in one sentence."""
        if self.b <= 0 and self.have < FEW_PRESSES:
            return (
                f"{self.have} presses are few and do not tell yet whether more lessen the error: press more, "
                f"to {FEW_PRESSES} or more"
            )
        if self.b <= 0:
            return (
                f"up to {self.have} presses, more have not lessened the error: look at how they are "
                "labelled, or press elsewhere"
            )
        least, share, most = (100 * (ratio - 1) for ratio in (self.ratio[1], self.ratio[0], self.ratio[2]))
        return (
            f"{self.more} more presses would change the error by {share:.0f} % ({least:.0f} to {most:.0f} %)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "presses": list(self.presses), "mae": list(self.mae), "a": self.a, "b": self.b, "have": self.have,
            "expected": list(self.expected), "with_more": list(self.with_more), "ratio": list(self.ratio),
            "unit": self.unit, "more": self.more, "text": self.text,
        }  # fmt: skip


def power_law(presses: np.ndarray, errors: np.ndarray) -> tuple[float, float]:
    """Coefficients a and b of E = a n^-b, by least squares of logarithms.

    Example:
        >>> a, b = power_law(np.array([10.0, 20.0, 40.0]), np.array([0.4, 0.2, 0.1]))
        >>> round(a, 6), round(b, 6)
        (4.0, 1.0)
    """
    slope, level = np.polyfit(np.log(presses), np.log(np.maximum(errors, 1e-12)), 1)
    return float(math.exp(level)), float(-slope)


def curve_of(presses: np.ndarray, errors: np.ndarray, have: int, *, seed: int = 0) -> LearningCurve:
    """The curve of errors that were found.

    Args:
        presses: learnt from in each trial ``[k]``.
        errors: mean absolute error of each press in each trial, NaN where it was learnt from ``[k p]``.
    """

    def means(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sizes = np.unique(presses)
        scored = [errors[presses == n][:, columns] for n in sizes]
        scored = [part[np.isfinite(part)] for part in scored]
        return sizes, np.array([part.mean() if len(part) else math.nan for part in scored])

    rng, every = np.random.default_rng(seed), np.arange(errors.shape[1])
    sizes, mae = means(every)
    a, b = power_law(sizes, mae)
    drawn = []
    for _ in range(DRAWS):
        numbers, each = means(rng.choice(every, len(every)))
        if np.isfinite(each).all():
            drawn.append(power_law(numbers, each))
    laws = np.array(drawn)
    off = np.log(np.nanmean(errors, axis=1)) - np.log(a * presses**-b)
    free = max(len(off) - 2, 1)
    refits = float(off @ off) / free
    tried = np.log(presses)
    far = float(((tried - tried.mean()) ** 2).sum())
    wide = float(student.ppf((1 + RATE) / 2, free))

    def interval(value: float, of_refits: float, of_presses: np.ndarray) -> tuple[float, float, float]:
        half = wide * math.sqrt(refits * of_refits + float(of_presses.var()))
        return value, value * math.exp(-half), value * math.exp(half)

    def at(n: int) -> tuple[float, float, float]:
        beyond = 1 / len(off) + (math.log(n) - tried.mean()) ** 2 / far
        return interval(a * n**-b, beyond, np.log(laws[:, 0]) - laws[:, 1] * math.log(n))

    fewer = math.log(have / (have + MORE))
    ratio = interval(math.exp(fewer * b), fewer**2 / far, fewer * laws[:, 1])
    return LearningCurve(
        tuple(sizes.tolist()), tuple(mae.tolist()), a, b, have, at(have), at(have + MORE), ratio
    )


def learning_curve(run: Run, plan: CalibrationPlan, progress: Progress = silent) -> LearningCurve:
    """Learn from parts of a run's presses, and score on the others.

    Args:
        run: of presses, as a `PressCollector` makes it.
        plan: what is estimated and how; its first target counts.
    """
    with tempfile.TemporaryDirectory() as folder:
        packed = Path(folder) / "packed"
        pack(run, packed, preparation_of(run, plan))
        single = Split("random", (), None, (), "each row by itself")
        learning = CalibrationJob.of(run, plan, single, PackedSet.open(packed))
        table = learning.packed.table
        rest = (table["press"] == REST).to_numpy()  # learnt from always, and never scored
        names = np.asarray(group_names(table, within_session(table, ("press",))))
        press = np.full(len(names), -1)
        press[~rest] = np.unique(names[~rest], return_inverse=True)[1]
        count = int(press.max()) + 1
        if count < MIN_PRESSES:
            raise InputError(f"{count} presses tell no learning curve; collect {MIN_PRESSES} or more")
        rng, trials, errors = np.random.default_rng(plan.seed), [], []
        sizes = sorted({max(4, round(share * count)) for share in SHARES})
        for done, size in enumerate(np.repeat(sizes, REPEATS).tolist()):
            progress("learning curve", done, REPEATS * len(sizes))
            chosen = rng.choice(count, size, replace=False)
            inside = np.isin(press, chosen)
            rows, others = np.flatnonzero(inside | rest), np.flatnonzero(~inside & ~rest)
            fitted = make_model(plan.model, plan.options).fit(learning.data, rows, seed=plan.seed)
            off = np.abs(predict_rows(fitted, learning.data, others) - learning.data.values[others])[:, 0]
            each = np.full(count, np.nan)
            sums, n = np.bincount(press[others], off, count), np.bincount(press[others], minlength=count)
            each[n > 0] = sums[n > 0] / n[n > 0]
            trials.append(size)
            errors.append(each)
        progress("learning curve", 1, 1)
    return curve_of(np.array(trials), np.array(errors), count, seed=plan.seed)
