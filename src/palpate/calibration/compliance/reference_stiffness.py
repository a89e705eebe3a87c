"""Check of the stated stiffness of the references, before a calibration is written.

- Order: a softer reference gives way more.
- Series: the additional approach d_i - d_0 is proportional to 1/kappa_i - 1/kappa_0, since tip and specimen
  act as springs in series. The factor G of virtual tips varies as kappa^0.03 within 5 % on level tops, and by
  up to 30 % between 7.6 and 1.1 N/mm on tops inclined by 45 degrees.
- Leave-one-out: the other references read each reference between them (four references or more).

Stiffness of a specimen itself: slope of force over the position of a rigid plate pressed onto it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.press_nuisances import Nuisances
from palpate.core import Float, InputError, LabelError, ndarray
from palpate.estimators.compliance.stiffness_curve import (
    CONTACT_N,
    MAX_N,
    SoftnessCurve,
    left_out_n_m,
    loading,
    smoothed,
    within,
    without,
)
from palpate.psychophysics import Line, fit_line, mean_interval
from palpate.recordings.exchange.press_table import PressTable, read_press_table

MAX_SERIES = 0.2  # range of log G over references with level tops
MAX_SERIES_INCLINED = 0.45
LEVEL_RAD = 0.05  # largest tilt of a level top
SERIES_EXPONENT = 0.03  # of G over stiffness
MAX_LEFT_OUT = 0.5  # error of log kappa of a reference read by the others
TIED = 0.8  # a removal that leaves less than this fraction of the runner-up's contradiction is unambiguous

Vector = Float[ndarray, " k"]
Contradiction = Callable[[Sequence[int]], float]

REFUSED = (
    "The presses contradict the stated stiffness of {}: {:.3g} N/mm is stated, {:.3g} N/mm fits the other "
    "references{}. Correct specimens.csv, or press that specimen again"
)


class ReferenceStiffnessError(InputError):
    """The stated stiffness of a reference contradicts its presses.

    Attributes:
        code: machine-readable reason.
        reference: name of the suspicious reference.
        stated_n_m, expected_n_m: its stated stiffness, and that which fits the others [N/m].
    """

    code = "reference-stiffness"

    def __init__(self, reference: str, stated_n_m: float, expected_n_m: float, others: Sequence[str]) -> None:
        also = f" (or the fault is in {' or '.join(others)})" if others else ""
        super().__init__(REFUSED.format(reference, 1e-3 * stated_n_m, 1e-3 * expected_n_m, also))
        self.reference, self.stated_n_m, self.expected_n_m = reference, stated_n_m, expected_n_m


def check_references(
    names: Sequence[str],
    touch: SoftnessCurve,
    both: SoftnessCurve | None,
    *,
    approach_px: float,
    tilt_rad: float,
) -> None:
    """Raise unless the stated stiffness of every reference agrees with its presses.

    Args:
        touch, both: curves of the pins, and of pins and approach; None without positions.
        approach_px: weight of the approach in `both` [px/m].
        tilt_rad: inclination of their tops [rad].
    """
    if len(names) < 3:
        return
    inclined = tilt_rad > LEVEL_RAD
    if both is not None:
        approach = (both.middle[-1] + both.means @ both.basis[:, -1]) / approach_px
        _check_series(names, both.kappa_n_m, approach, MAX_SERIES_INCLINED if inclined else MAX_SERIES)
    curve = touch if both is None else both
    if curve.between > MAX_LEFT_OUT and not (inclined and len(names) < 4):
        _refuse_left_out(names, curve)


def _check_series(names: Sequence[str], kappa: Vector, approach_m: Vector, limit: float) -> None:
    def contradiction(kept: Sequence[int]) -> float:
        log_g = _log_series(kappa[list(kept)], approach_m[list(kept)])
        return float(np.ptp(log_g)) if np.isfinite(log_g).all() else float("inf")

    everything = range(len(names))
    if contradiction(everything) <= limit:
        return
    suspect, others = _suspect(kappa, contradiction)
    rest = [i for i in everything if i != suspect]
    raise ReferenceStiffnessError(
        names[suspect],
        float(kappa[suspect]),
        _by_series(kappa[rest], approach_m[rest], float(approach_m[suspect])),
        [names[i] for i in others],
    )


def _log_series(kappa: Vector, approach_m: Vector) -> Float[ndarray, " _"]:
    """Return log G of every reference but the stiffest; -inf or NaN where a softer one gives way less."""
    order = np.argsort(-kappa)
    stiffest, softer = order[0], order[1:]
    between = np.diff(approach_m[order])
    compliance = 1 / kappa[softer] - 1 / kappa[stiffest]
    with np.errstate(invalid="ignore", divide="ignore"):
        log_g = np.log((approach_m[softer] - approach_m[stiffest]) / compliance)
    log_g -= SERIES_EXPONENT * np.log(kappa[softer])
    return np.asarray(np.where(between > 0, log_g, np.nan))


def _by_series(kappa: Vector, approach_m: Vector, at_m: float) -> float:
    """Return the stiffness at which the other references would give way by an approach [N/m]."""
    log_g = np.nanmedian(_log_series(kappa, approach_m))
    stiffest = int(np.argmax(kappa))
    found = float(np.median(kappa[np.isfinite(kappa)]))
    for _ in range(20):  # G depends weakly on the stiffness
        g = np.exp(log_g + SERIES_EXPONENT * np.log(found))
        compliance = (at_m - approach_m[stiffest]) / g + 1 / kappa[stiffest]
        if compliance <= 0:
            return float("inf")
        found = float(1 / compliance)
    return found


def _refuse_left_out(names: Sequence[str], curve: SoftnessCurve) -> None:
    def contradiction(kept: Sequence[int]) -> float:
        (left,) = set(range(len(names))) - set(kept)
        fewer = without(curve, left)
        return 0.0 if np.isnan(fewer.between) else fewer.between

    found = left_out_n_m(curve)
    if len(names) > 3:
        suspect, others = _suspect(curve.kappa_n_m, contradiction)
    else:
        suspect, others = next(iter(found)), tuple(i for i in range(3) if i not in found)
    expected = found.get(suspect)
    if expected is None:
        expected = without(curve, suspect).stiffness_n_m(curve.means[suspect])
    raise ReferenceStiffnessError(
        names[suspect], float(curve.kappa_n_m[suspect]), expected, [names[i] for i in others]
    )


def _suspect(kappa: Vector, contradiction: Contradiction) -> tuple[int, tuple[int, ...]]:
    """Reference whose removal leaves least contradiction (never a rigid plate), and the close runners-up."""
    everything = range(len(kappa))
    left = {
        one: contradiction([i for i in everything if i != one])
        for one in everything
        if np.isfinite(kappa[one])
    }
    suspect = min(left, key=lambda one: left[one])
    return suspect, tuple(i for i in left if i != suspect and TIED * left[i] <= left[suspect])


MIN_PLATE_R2 = 0.85  # adjusted, of a trial; the report's worst is 0.882
CURVED = "{}: adjusted R2 {:.3g}, less than {:g}: no line; look at first contact and the plate's seating"


def series_line(table: PressTable) -> Line:
    """Fit force over position between 0.5 and 5 N: the stiffness of all that yields [N/m]."""
    assert table.position_m is not None
    force = smoothed(table.force_n)
    part = within(force, loading(force), CONTACT_N, MAX_N)
    return fit_line(table.position_m[part], force[part])


def plate_stiffness(
    tables: Sequence[Path],
    *,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    nuisances: Nuisances | None = None,
) -> dict[str, Any]:
    """Return a specimen's stiffness: slope of force over the position of a rigid plate, 0.5 to 5 N.

    The interval contains the trials' scatter and the shared errors of the force scale and the frame's
    compliance.

    Args:
        tables: force and position, one per trial on the same specimen.
        nuisances: standard sizes of force gain and frame compliance; None for the standard ones.
    """
    if not tables:
        raise InputError("no table; give one a trial, five if you can")
    lines = {str(path): _plate_line(path, force_column, position_column, rate_hz) for path in tables}
    slopes = [1e-3 * line.slope for line in lines.values()]
    mean = float(np.mean(slopes))
    sizes = Nuisances() if nuisances is None else nuisances
    shared = mean * math.hypot(sizes.force_gain, 1e3 * mean * sizes.frame_yield_m_n)
    low, high = mean_interval(slopes, known_sd=shared) if len(slopes) > 1 else (None, None)
    return {
        "stiffness_N_per_mm": mean,
        "low_N_per_mm": low,
        "high_N_per_mm": high,
        "coverage": 0.95,
        "contained": {"force_gain": sizes.force_gain, "frame_yield_mm_per_N": 1e3 * sizes.frame_yield_m_n},
        "trials": [
            {"table": path, "stiffness_N_per_mm": 1e-3 * line.slope, "adjusted_r2": line.adjusted_r2}
            for path, line in lines.items()
        ],
        "flags": [
            CURVED.format(path, line.adjusted_r2, MIN_PLATE_R2)
            for path, line in lines.items()
            if not line.adjusted_r2 >= MIN_PLATE_R2
        ],
    }


def _plate_line(path: Path, force: str | None, position: str | None, rate_hz: float | None) -> Line:
    table = read_press_table(path, None, force_column=force, position_column=position, rate_hz=rate_hz)
    if table.position_m is None:
        raise LabelError(
            f"{path} has no column of position, e.g. actual_mm; stiffness is force over position"
        )
    line = series_line(table)
    if not line.slope > 0:
        raise InputError(f"{path}: force falls as the position grows; turn the position's sign")
    return line
