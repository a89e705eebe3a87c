"""Whether a reference frame shows no contact: its marks lie on an even lattice up to casting errors.

A wrong lens or distance bends or scales the lattice smoothly; a touch moves a few marks.

Signs of a torn skin.

unexplained     neighboring marks moved as no traction on the whole skin moves them
stayed          marks stay moved without a touch
missing         marks are missing along a line, which lost tiles do not explain
gaping          a dark line crosses the tiles
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from palpate.core import Bool, Float, ImageError, Int, ndarray
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear.skin_marks import SkinMarks, TiledSkin
from palpate.estimators.shear.touch_places import (
    MAX_MISFIT,
    MIN_GROUP,
    NEIGHBOURS,
    TouchPlaces,
    largest_group,
    strayed,
)
from palpate.estimators.surface_strain import StrainFields, StrainMeter, contact_peaks

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


STRAYED = 5.0  # standard errors of an unexplained mark
OF_MOTION = 0.08  # ratio to the greatest shift; stated layers leave up to 0.05 on other units
MIN_STAYED = 6  # neighbouring marks; a touch too light to be found moves up to four
MIN_LINE = 4  # missing marks in a row, or a row and a diagonal
MAX_THICKNESS = 0.8  # cells, standard deviation across such a line
MIN_SEEN = 0.9  # ratio of the lattice's marks needed to detect what stays moved
BESIDE_TOUCH = 3.0  # pitches from a contact, within which marks may be lost by the press


def damage_of(
    fields: StrainFields,
    places: TouchPlaces,
    reference: ControlPoints,
    seen: ControlPoints,
    bare: set[tuple[int, int]],
    gap: float,
    pitch: float,
    *,
    moved: bool = True,
) -> str:
    """Return why a frame's skin seems torn; empty if it seems whole.

    Args:
        fields: Strain fields of the frame.
        places: Contacts.
        reference, seen: Marks of the reference and of the frame.
        bare: Corners of lost tiles.
        gap: Length of the longest dark line across tiles [pitches].
        pitch: Distance of marks [unit].
        moved: Whether motion and loss of marks count.
    """
    if gap:
        return f"a dark line crosses {gap:.1f} tiles"
    if not moved:
        return ""
    if found := _moved(fields, places):
        return found
    lost = _lost(reference, seen, bare)
    touched = [(c.x, c.y) for c in places.contacts]
    if touched and lost.any():
        at = np.array([_place_of(reference, cell) for cell in np.argwhere(lost)[:, ::-1]])
        away = np.min([np.hypot(*(at - p).T) for p in touched], axis=0)
        rows = np.argwhere(lost)[away < BESIDE_TOUCH * pitch]
        lost[tuple(rows.T)] = False
    return _line_of(lost)


def _moved(fields: StrainFields, places: TouchPlaces) -> str:
    """Reason if marks moved as no touch moves them, or without a touch."""
    traction = places.traction
    error = np.sqrt(fields.variances.sum(axis=0))
    cells = fields.basis.cells
    if traction is not None:
        if traction.misfit < MAX_MISFIT:
            return ""
        off = np.hypot(*traction.unexplained_m.T)
        least = OF_MOTION * float(np.hypot(*fields.moved.T).max())
        count = largest_group(cells, (off > STRAYED * error) & (off > least))
        if count < MIN_GROUP:
            return ""
        return f"{count} neighbouring marks have moved as no touch of a whole skin moves them"
    if places.contacts:
        return ""
    if len(fields.rest) < MIN_SEEN * np.prod(np.ptp(cells, axis=0) + 1):
        return ""  # a touch may be where the marks are missing
    count = strayed(fields)
    return f"{count} neighbouring marks stay moved where nothing touches" if count >= MIN_STAYED else ""


def _lost(
    reference: ControlPoints, seen: ControlPoints, bare: set[tuple[int, int]]
) -> Bool[ndarray, "rows columns"]:
    """Cells of the reference without a mark in the frame, except those of lost tiles."""
    low, high = reference.cells.min(axis=0), reference.cells.max(axis=0)
    size = (high - low + 1)[::-1]
    there = np.zeros(size, bool)
    wanted = np.zeros(size, bool)
    for points, grid in ((reference, wanted), (seen, there)):
        inside = ((points.cells >= low) & (points.cells <= high)).all(axis=1)
        column, row = (points.cells[inside] - low).T
        grid[row, column] = True
    for cell in bare:
        column, row = np.array(cell) - low
        if 0 <= row < size[0] and 0 <= column < size[1]:
            there[row, column] = True
    return wanted & ~there


def _place_of(points: ControlPoints, cell: Int[ndarray, " 2"]) -> Float[ndarray, " 2"]:
    low = points.cells.min(axis=0)
    found = np.nonzero((points.cells == cell + low).all(axis=1))[0]
    return points.places[found[0]]


def _line_of(lost: Bool[ndarray, "rows columns"]) -> str:
    """Reason if cells are missing along a line."""
    single, count = label(lost, NEIGHBOURS)
    for i in range(1, count + 1):
        at = np.argwhere(single == i)
        if len(at) >= MIN_LINE and _length(at) >= MIN_LINE - 1 and _thickness(at) < MAX_THICKNESS:
            return f"{len(at)} neighbouring marks are missing along a line"
    return ""


def _length(at: Int[ndarray, "n 2"]) -> float:
    centred = at - at.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return float(np.ptp(centred @ axis))


def _thickness(at: Int[ndarray, "n 2"]) -> float:
    if len(at) < 2:
        return 0.0
    return math.sqrt(max(float(np.linalg.eigvalsh(np.cov(at.T))[0]), 0.0))
