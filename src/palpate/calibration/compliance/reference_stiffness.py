"""Check of the stated stiffness of the references, before a calibration is written.

- Order: a softer reference gives way more.
- Series: the additional approach d_i - d_0 is proportional to 1/kappa_i - 1/kappa_0, since tip and specimen
  act as springs in series. The factor G of virtual tips varies as kappa^0.03 within 5 % on level tops, and by
  up to 30 % between 7.6 and 1.1 N/mm on tops inclined by 45 degrees.
- Leave-one-out: the other references read each reference between them (four references or more).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from palpate.core import Float, InputError, ndarray
from palpate.estimators.compliance.stiffness_curve import SoftnessCurve, left_out_n_m, without

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
