"""Whether a reference frame shows no contact: its marks lie on an even lattice up to casting errors.

A wrong lens or distance bends or scales the lattice smoothly; a touch moves a few marks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, ImageError, Int, ndarray
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear.skin_marks import SkinMarks, TiledSkin
from palpate.estimators.surface_strain import StrainMeter, contact_peaks

MIN_MARKS = 0.5  # of the skin's
MAX_BENT = 5.0  # multiple of the tolerance, RMS deviation from straight lines
MAD_TO_SIGMA = 1.4826
DOT_TOLERANCE = 0.01  # of the pitch, for dots whose casting is not stated
POWERS = [(i, j) for i in range(4) for j in range(4 - i)]


@dataclass(frozen=True, slots=True, eq=False)
class LatticeFit:
    """Marks relative to the cast lattice.

    Attributes:
        nominal: Positions by a cubic in column and row ``[n 2]`` [unit].
        pitch: Side of a cell of the best affine lattice [unit].
        sides: Its sides along columns and rows [unit].
        bent: RMS of the cubic relative to that lattice [unit].
        spread: Standard deviation of marks about the cubic, by their median [unit].
    """

    nominal: Float[ndarray, "n 2"]
    pitch: float
    sides: tuple[float, float]
    bent: float
    spread: float


def fit_lattice(points: ControlPoints) -> LatticeFit:
    """Return the lattice fit of marks, with strays omitted from the cubic."""
    cells = _scaled(points.cells)
    affine = _fitted(cells, points.places, [(0, 0), (1, 0), (0, 1)], np.ones(len(cells), bool))
    sound = np.ones(len(cells), bool)
    for _ in range(4):
        nominal = _fitted(cells, points.places, POWERS, sound)
        off = np.hypot(*(points.places - nominal).T)
        spread = MAD_TO_SIGMA * float(np.median(np.abs(points.places - nominal)[sound]))
        sound = off < 4 * max(spread, 1e-12 + float(np.median(points.sigma)))
    steps = np.linalg.lstsq(np.column_stack([np.ones(len(cells)), points.cells]), points.places, rcond=None)[
        0
    ][1:]
    pitch = math.sqrt(abs(float(np.linalg.det(steps))))
    along, across = np.hypot(*steps.T).tolist()
    bent = math.sqrt(float(((nominal - affine) ** 2).sum(axis=1).mean()))
    return LatticeFit(nominal, pitch, (along, across), bent, spread)


def refuse_reference(marks: SkinMarks, skin: object) -> LatticeFit:
    """Refuse a reference of another skin or lens, or with a touch."""
    points = marks.reference
    fit = fit_lattice(points)
    if isinstance(skin, TiledSkin):
        _refuse_other_skin(points, fit, skin)
    tolerance = skin.tolerance_m if isinstance(skin, TiledSkin) else DOT_TOLERANCE * marks.pitch
    sigma = np.full(len(points), math.hypot(max(tolerance, fit.spread), float(np.median(points.sigma))))
    nominal = ControlPoints(points.cells, fit.nominal, np.zeros(len(points)), points.unit)
    peaks = contact_peaks(
        StrainMeter(nominal).fields(ControlPoints(points.cells, points.places, sigma, points.unit))
    )
    if peaks:
        at = ", ".join(f"({p.x:.4g}, {p.y:.4g})" for p in peaks)
        raise ImageError(
            f"the reference is touched or torn: stretched by {100 * peaks[0].area_strain:.1f} % at {at} "
            f"{marks.unit}; give a frame without contact",
            code="reference-touched",
        )
    return fit


def _refuse_other_skin(points: ControlPoints, fit: LatticeFit, skin: TiledSkin) -> None:
    wanted = (skin.columns - 1) * (skin.rows - 1)
    if len(points) < MIN_MARKS * wanted:
        raise ImageError(
            f"the reference shows {len(points)} of {wanted} marks, {100 * MIN_MARKS:.0f} % are needed; "
            "check focus and light"
        )
    if abs(fit.pitch / skin.pitch_m - 1) > skin.scale_tolerance or fit.bent > MAX_BENT * skin.tolerance_m:
        raise ImageError(
            f"tiles of {1e3 * fit.pitch:.3f} mm, bent by {1e3 * fit.bent:.3f} mm; the skin has "
            f"{1e3 * skin.pitch_m:.3f} mm within {100 * skin.scale_tolerance:.0f} %, bent by "
            f"{1e3 * MAX_BENT * skin.tolerance_m:.2f} mm: another lens, distance, or skin",
            code="lens-differs",
        )


def _scaled(cells: Int[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    low, high = cells.min(axis=0), cells.max(axis=0)
    return 2 * (cells - low) / np.maximum(high - low, 1) - 1.0


def _fitted(
    at: Float[ndarray, "n 2"], places: Float[ndarray, "n 2"], powers: list[tuple[int, int]], sound: ndarray
) -> Float[ndarray, "n 2"]:
    basis = np.column_stack([at[:, 0] ** i * at[:, 1] ** j for i, j in powers])
    return np.asarray(basis @ np.linalg.lstsq(basis[sound], places[sound], rcond=None)[0])
