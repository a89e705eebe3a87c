"""Verdict on a press, shared by all its quantities: repeated frames, contact off the apex, and pin motion
that no reference shows, with the known fault that explains most of it.

Agreement of the cues of one press: do pins and approach belong to one object of the references' kind?

The pins and the approach at the calibrated forces form one vector y. For an object of the references' kind,

    y = m(p) + B a + J b + K c + e,

with m(p) the references' mean at the object's parameters p, B scatter between trials, J changes by the stated
nuisances, K other curves through the references (and their leave-one-out distances for curved objects), and e
noise; a, b, c, e independent with zero mean and known variance. The misfit is the generalized least-squares
minimum over p. The pins' misfit tests the pins; its increase by the approach tests their agreement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

import numpy as np
from scipy import stats
from scipy.optimize import brentq, minimize, minimize_scalar

from palpate.calibration.compliance.compliance_calibration import (
    APPROACH_PX,
    ComplianceCalibration,
    approach_row,
    touch_row,
    wobble_px,
)
from palpate.core import Bool, Drift, Float, ndarray
from palpate.core.reading import ReasonCode, Refusal
from palpate.estimators.compliance.hertz_inversion import BENDS as SURFACE_BENDS, GRID as SHAPES, ShapeSurface
from palpate.estimators.compliance.pin_press import PinPress, sideways_px
from palpate.estimators.compliance.stiffness_curve import (
    BENDS,
    SOFTEST,
    SmallSpace,
    SoftnessCurve,
    Vector,
    scatter_directions,
)

MAX_PINS = 24.0  # misfit of the pins, if the scatter between trials is known exactly
MAX_SHAPE_PINS = 60.0  # misfit of the pins where they also determine a radius; set from 168 virtual presses
MAX_APPROACH = 13.0  # increase by the approach, likewise
MAX_SHAPE_APPROACH = 32.5  # likewise where a radius is determined: greater by the ratio of the limits of pins
SURE = 0.995  # quantile at which limits grow with the number of trials
PIN_NOISE = 10.0  # standard deviation of the pins that no direction explains, over that of the references
APPROACH_NOISE_PX = 3.5e-6 * APPROACH_PX  # standard deviation of the approach, from 3.5 um
GRID = 24  # softness values at which the minimum is bracketed
RANK = 1e-9  # smallest singular value that counts, over the largest

Vectors = Float[ndarray, "n d"]
Point = Float[ndarray, " m"]  # parameters of the object
Place = Float[ndarray, " q"]  # in the small space
Places = Float[ndarray, "n q"]


@dataclass(frozen=True)
class CueMisfit:
    """Misfit of a press.

    Attributes:
        pins: misfit of the pins alone.
        approach: increase by the approach; 0 without position.
        birge: Birge ratio of both, R. T. Birge, Phys. Rev. 40, 207 (1932), doi:10.1103/PhysRev.40.207.
    """

    pins: float
    approach: float
    birge: float = 1.0


@dataclass(frozen=True)
class _CueModel:
    """m(p) in the small space of the references, its alternatives, and its minimizer."""

    space: SmallSpace
    mean: Callable[[Point], Place]
    others: Callable[[Point], Places]
    minimize: Callable[[Callable[[Point], float], Place], float]
    parameters: int


def cue_misfit(calibration: ComplianceCalibration, press: PinPress, *, flat: bool = False) -> CueMisfit:
    """Return the misfit of the pins, and its increase by the approach.

    Args:
        flat: test against flat references alone, where the calibration has spheres as well.
    """
    placed = calibration.both is not None and press.position_m is not None

    def row(one: PinPress) -> Vector:
        pins = touch_row(one, calibration.layout_px, calibration.levels_n)
        return np.concatenate([pins, approach_row(one, calibration.levels_n)]) if placed else pins

    model = _model(calibration, placed, flat=flat)
    y = row(press)
    changes = np.array([row(one) - y for one in calibration.nuisances.altered(press).values()]).reshape(
        -1, len(y)
    )
    known = np.isfinite(y) & np.isfinite(model.space.middle) & np.isfinite(changes).all(axis=0)
    approach = np.zeros(len(y), bool)
    if placed:
        approach[-(len(calibration.levels_n) - 1) :] = True
    pins, freedom = _misfit(model, y, changes, approach, known & ~approach)
    total, freedom = _misfit(model, y, changes, approach, known) if placed else (pins, freedom)
    return CueMisfit(pins, total - pins, float(np.sqrt(total / freedom)))


def greatest_misfit(calibration: ComplianceCalibration, *, flat: bool = False) -> CueMisfit:
    """Return the limits by Hotelling's T², which are wider for a scatter estimated from few trials."""
    shape = None if flat else calibration.shape
    freedom = (shape or calibration.touch).space.freedom
    count = scatter_directions(freedom)
    left = freedom - count + 1
    distance = count * freedom / left * stats.f.ppf(SURE, count, left)
    more = float(distance / stats.chi2.ppf(SURE, count))
    pins, approach = (MAX_PINS, MAX_APPROACH) if shape is None else (MAX_SHAPE_PINS, MAX_SHAPE_APPROACH)
    return CueMisfit(pins * more, approach * more)


def _model(calibration: ComplianceCalibration, placed: bool, *, flat: bool) -> _CueModel:
    if not placed:
        return _curve_model(calibration.touch)
    if calibration.shape is not None and not flat:
        return _surface_model(calibration.shape)
    assert calibration.both is not None
    return _curve_model(calibration.both)


def _curve_model(curve: SoftnessCurve) -> _CueModel:
    def others(p: Point) -> Places:
        bent = [curve.at(p, bend * curve.turning_n_m) for bend in BENDS]
        return np.concatenate(bent) - curve.at(p)

    def least(misfit: Callable[[Point], float], _start: Place) -> float:
        grid = np.linspace(0.0, SOFTEST, GRID)
        best = int(np.argmin([misfit(np.array([s])) for s in grid]))
        bounds = (grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)])
        return float(minimize_scalar(lambda s: misfit(np.array([s])), bounds=bounds, method="bounded").fun)

    return _CueModel(curve.space, lambda p: curve.at(p)[0], others, least, 1)


def _surface_model(surface: ShapeSurface) -> _CueModel:
    def others(p: Point) -> Places:
        bent = np.stack([surface.at(p, bend) for bend in SURFACE_BENDS]) - surface.at(p)
        return np.vstack([bent, surface.misses])

    def least(misfit: Callable[[Point], float], start: Place) -> float:
        tolerance = {"xatol": 1e-4, "fatol": 0.01}
        begun = (surface.nearest(start), min(SHAPES, key=misfit))
        return float(min(minimize(misfit, at, method="Nelder-Mead", options=tolerance).fun for at in begun))

    return _CueModel(surface.space, surface.at, others, least, 2)


def _misfit(
    model: _CueModel, y: Vector, changes: Vectors, approach: Bool[ndarray, " d"], known: Bool[ndarray, " d"]
) -> tuple[float, int]:
    """Minimum over p, from the known values, in the directions that the model has; degrees of freedom."""
    space = model.space
    noise = np.where(approach, APPROACH_NOISE_PX, PIN_NOISE * space.outside)[known]
    basis, changes = space.basis[:, known] / noise, changes[:, known] / noise
    single = np.eye(len(y))[approach][:, known] / noise
    _, sizes, directions = np.linalg.svd(np.vstack([basis, changes, single]), full_matrices=False)
    directions = directions[sizes > RANK * sizes[0]].T
    basis, changes = basis @ directions, changes @ directions
    seen = ((y - space.middle)[known] / noise) @ directions
    scatter = np.linalg.cholesky(space.scatter).T @ basis

    def at(p: Point) -> float:
        off = seen - model.mean(p) @ basis
        wide = np.vstack([scatter, changes, model.others(p) @ basis])
        return float(off @ np.linalg.solve(np.eye(len(off)) + wide.T @ wide, off))

    least = model.minimize(at, space.place(np.where(known, y, np.nan)))
    return least, directions.shape[1] - model.parameters


def worst_misfit(
    calibration: ComplianceCalibration, presses: Sequence[PinPress], *, flat: bool = False
) -> CueMisfit:
    """Return the greatest misfit over presses, of either kind; see `cue_misfit`."""
    found = [cue_misfit(calibration, press, flat=flat) for press in presses]
    pins, approach, birge = (max(kind) for kind in zip(*(astuple(one) for one in found), strict=True))
    return CueMisfit(pins, approach, birge)


MAX_NOVELTY = 5.0  # times what the references' own trials showed
MAX_DRIFT = 4.0
MAX_OFF = 4.0  # standard deviations of the references' seating
SPEED_SHARE = 3.0  # times faster or slower than any reference
REPEATED_PX = 1e-3  # by which no pin moved between two frames: a new image has noise
RISE_N = 0.02  # of the force between them
MAX_SIZES = 1.3  # of the nuisances together, in standard sizes, beyond what MAX_NOVELTY leaves unexplained
DAMPED = 1e-9  # of the nuisances' own strength: next to none, and over it, next to all
UNLIKE = (
    "the pins move as on no reference ({:.1f} times the references' own scatter, {:g} are allowed): another "
    "tilt, shape or skin than was calibrated"
)
BEYOND = (
    "the pins move as on no reference, unless force, time, lever or frame are off by {:.1f} times their "
    "stated sizes ({:g} are allowed)"
)
FROZEN = (
    "{} of {} frames repeat the one before while the force rises: the camera stood still or frames were "
    "copied; record again"
)
OFF_CENTRE = (
    "off centre: all pins move to one side, {:.1f} times as far as the references' seating and the stated "
    "nuisances scatter ({:g} are allowed); centre the tip on the specimen, or level its top"
)
DRIFTED = "the untouched pins have moved against each other since calibration; calibrate anew"
SPEED = "pressed at {:.3g} mm/s, calibrated at {:.3g} to {:.3g} mm/s; the skin may answer otherwise"
PINS_APART = (
    "the pins fit no single object of the references' kind at all forces (misfit {:.3g}, {:.3g} is allowed); "
    "calibrate on that kind of object, such as a layer on a hard base"
)
APPROACH_APART = (
    "pins and approach fit no single object of the references' kind (misfit {:.3g}, {:.3g} is allowed); "
    "check the scale of the position, or calibrate on that kind of object"
)


def drift_of(calibration: ComplianceCalibration, presses: Sequence[PinPress]) -> Drift:
    """Return the relative motion of no-contact pins since calibration."""
    wobble = max(wobble_px(one, calibration.layout_px) for one in presses)
    return Drift(wobble / calibration.wobble_px, MAX_DRIFT)


def press_reasons(
    calibration: ComplianceCalibration, presses: Sequence[PinPress], misfit: CueMisfit | None = None
) -> list[Refusal]:
    """Return why no quantity of these presses is valid; empty where they resemble the references'.

    Args:
        misfit: Result of `worst_misfit`, if it is already known.
    """
    flaws = dict.fromkeys(flaw for one in presses for flaw in one.flaws)
    reasons = [Refusal(ReasonCode.FLAWED_PRESS, flaw) for flaw in flaws]
    if drift_of(calibration, presses).drifted:
        reasons.append(Refusal(ReasonCode.DRIFTED, DRIFTED))
    rows = [touch_row(one, calibration.layout_px, calibration.levels_n) for one in presses]
    for code, ask in ASKED.items():
        answers = (ask(calibration, one, row) for one, row in zip(presses, rows, strict=True))
        reasons += [Refusal(code, why) for why in answers if why][:1]
    misfit = misfit or worst_misfit(calibration, presses)
    return reasons + misfit_reasons(misfit, greatest_misfit(calibration))


def misfit_reasons(misfit: CueMisfit, limit: CueMisfit) -> list[Refusal]:
    """Return why the cues of a press do not belong to one object; empty where they do."""
    found = ((PINS_APART, misfit.pins, limit.pins), (APPROACH_APART, misfit.approach, limit.approach))
    return [
        Refusal(ReasonCode.CUES_DISAGREE, text.format(value, most))
        for text, value, most in found
        if not value <= most  # NaN does not agree
    ]


def _speed(calibration: ComplianceCalibration, press: PinPress, row: Vector) -> str:
    low, high = calibration.speed_m_s
    if press.speed_m_s > SPEED_SHARE * high or press.speed_m_s < low / SPEED_SHARE:
        return SPEED.format(1e3 * press.speed_m_s, 1e3 * low, 1e3 * high)
    return ""


def _frozen(calibration: ComplianceCalibration, press: PinPress, row: Vector) -> str:
    step = np.abs(np.diff(press.moved_px, axis=0))
    still = np.nanmax(step.reshape(len(step), -1), axis=1) < REPEATED_PX
    repeated = still & (np.diff(press.force_n) > RISE_N)
    return FROZEN.format(int(repeated.sum()), len(press.force_n)) if repeated.any() else ""


def _off_centre(calibration: ComplianceCalibration, press: PinPress, row: Vector) -> str:
    layout = calibration.layout_px
    altered = [sideways_px(one, layout) for one in calibration.nuisances.altered(press).values()]
    off = calibration.seat.off(sideways_px(press, layout), calibration.touch.of(row[None]).s, altered)
    return "" if off <= MAX_OFF else OFF_CENTRE.format(off, MAX_OFF)  # NaN of lost pins is not centred


def _unlike(calibration: ComplianceCalibration, press: PinPress, row: Vector) -> str:
    def pins(one: PinPress) -> Vector:
        return touch_row(one, calibration.layout_px, calibration.levels_n)

    def pins_and_approach(one: PinPress) -> Vector:
        return np.concatenate([pins(one), approach_row(one, calibration.levels_n)])

    shown: list[tuple[SmallSpace, Callable[[PinPress], Vector]]] = [(calibration.touch.space, pins)]
    if calibration.both is not None and press.position_m is not None:
        shown.append((calibration.both.space, pins_and_approach))
    if calibration.shape is not None and press.position_m is not None:
        shown = [(calibration.shape.space, pins_and_approach)]
    if max(curve.novelty_score(of(press)) for curve, of in shown) <= MAX_NOVELTY:
        return ""
    altered = list(calibration.nuisances.altered(press).values())
    left = [_left_unlike(curve, of(press), [of(one) for one in altered]) for curve, of in shown]
    score, beyond = (max(each) for each in zip(*left, strict=True))
    if score <= MAX_NOVELTY and beyond <= MAX_SIZES:
        return ""
    return UNLIKE.format(score, MAX_NOVELTY) if score > MAX_NOVELTY else BEYOND.format(beyond, MAX_SIZES)


def _left_unlike(curve: SmallSpace, row: Vector, altered: Sequence[Vector]) -> tuple[float, float]:
    """Residual that no reference shows and no nuisance explains, over the references' scatter, and the
    smallest nuisance sizes that leave no more than is allowed.
    """
    unlike = _outside(curve, row)
    seen = np.isfinite(unlike)
    unlike = unlike[seen] / (curve.outside * np.sqrt(seen.sum()))
    if not altered:
        return float(np.linalg.norm(unlike)), 0.0
    along = np.stack([_outside(curve, one)[seen] for one in altered]) / (curve.outside * np.sqrt(seen.sum()))
    along -= unlike
    normal, onto = along @ along.T, along @ unlike

    def left(damping: float) -> tuple[float, float]:
        sizes = np.linalg.solve(normal + damping * np.eye(len(normal)), onto)
        return float(np.linalg.norm(unlike - sizes @ along)), float(np.linalg.norm(sizes))

    weakest, strongest = DAMPED * np.trace(normal), np.trace(normal) / DAMPED
    if left(weakest)[0] > MAX_NOVELTY:
        return left(weakest)
    if left(strongest)[0] < MAX_NOVELTY:
        return left(strongest)[0], 0.0
    damping = brentq(lambda log: left(np.exp(log))[0] - MAX_NOVELTY, np.log(weakest), np.log(strongest))
    return MAX_NOVELTY, left(float(np.exp(damping)))[1]


def _outside(curve: SmallSpace, row: Vector) -> Vector:
    return np.asarray(row - curve.middle - curve.place(row) @ curve.basis)


ASKED: dict[ReasonCode, Callable[[ComplianceCalibration, PinPress, Vector], str]] = {
    ReasonCode.SPEED: _speed,
    ReasonCode.REPEATED_FRAMES: _frozen,
    ReasonCode.OFF_CENTER: _off_centre,
    ReasonCode.OUT_OF_DISTRIBUTION: _unlike,
}
