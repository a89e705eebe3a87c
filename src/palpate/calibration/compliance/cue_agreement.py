"""Agreement of the cues of one press: do pins and approach belong to one object of the references' kind?

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
from scipy.optimize import minimize, minimize_scalar

from palpate.calibration.compliance.compliance_calibration import (
    APPROACH_PX,
    ComplianceCalibration,
    approach_row,
    touch_row,
)
from palpate.calibration.compliance.press_nuisances import NONE
from palpate.core import Bool, Float, ndarray
from palpate.estimators.compliance.pin_press import PinPress
from palpate.estimators.compliance.shape_surface import BENDS as SURFACE_BENDS, GRID as SHAPES, ShapeSurface
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
    sizes = NONE if calibration.nuisances is None else calibration.nuisances
    y = row(press)
    changes = np.array([row(one) - y for one in sizes.altered(press).values()]).reshape(-1, len(y))
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
