"""Contacts of a frame with their position and standard error, from strain and traction.

If the skin's layers are known, the position is the center of the recovered pressure; else, or if no traction
explains the marks, the center of the ring, which a lateral load shifts by up to 2 mm. Near the rim the
pressure is biased inward and marks fit no touch: a contact outside the validated area has no valid reading
and is no evidence of a tear.

Motion of the camera relative to the skin: shift, rotation, or zoom of the whole pattern.

Touch moves marks near the contact; a camera that moves also moves those far from it, affinely. The RMS of
that motion is compared with the noise of one mark (at least the scatter of far marks) plus a ratio of touch
motion that layers carry there. Motion below the limit is part of gamma's interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, Int, RangeError, ndarray
from palpate.core.reading import NONE, Refusal
from palpate.estimators.shear.skin_marks import SkinMarks, TiledSkin
from palpate.estimators.surface_strain import (
    ContactPeak,
    EdgeDirection,
    RecoveredTraction,
    ShearRing,
    StrainFields,
    contact_peaks,
    edge_direction,
    find_rings,
    recover_traction,
)

STRAYED = 8.0  # times a mark's standard error
MIN_GROUP = 3  # neighbouring marks: noise moves one, rarely two
NEIGHBOURS = np.ones((3, 3), bool)


def strayed(fields: StrainFields) -> int:
    """Return the number of marks in the largest group that moved relative to an affine motion."""
    error = np.sqrt(fields.variances.sum(axis=0))
    off = np.hypot(*_beside_affine(fields.rest, fields.moved).T)
    return largest_group(fields.basis.cells, off > STRAYED * error)


def _beside_affine(at: Float[ndarray, "n 2"], moved: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    """Shifts less an affine motion fitted without strays."""
    basis = np.column_stack([np.ones(len(at)), at / max(float(np.abs(at).max()), 1e-12)])
    sound = np.ones(len(at), bool)
    off = moved
    for _ in range(3):
        off = moved - basis @ np.linalg.lstsq(basis[sound], moved[sound], rcond=None)[0]
        size = np.hypot(*off.T)
        sound = size <= 3 * max(float(np.median(size)), 1e-12)
    return off


def largest_group(cells: Int[ndarray, "n 2"], which: Bool[ndarray, " n"]) -> int:
    """Return the number of marks in the largest group of neighbors."""
    if not which.any():
        return 0
    column, row = (cells[which] - cells.min(axis=0)).T
    grid = np.zeros((int(row.max()) + 1, int(column.max()) + 1), bool)
    grid[row, column] = True
    groups, _ = label(grid, NEIGHBOURS)
    return int(np.bincount(groups.ravel())[1:].max())


MIN_SIGNIFICANCE = 6.0  # of a ring's outward shift over its error: one in 10,000 frames would exceed 4
MIN_FORCE = 8.0  # times its standard error, of a traction
MAX_MISFIT = 1.6  # of marks' standard errors: beyond, a traction does not explain the marks
TRACTION_SPREAD = 1.4  # of the centre's errors over stated ones, on the virtual pad at 0.4 to 8 N
FRICTION_SPREAD = 1.7  # the same under a lateral load
FROM_PEAKS = 1.5  # pitches, of the pressure's centre from where the skin is stretched most
RING_SPREAD = 1.25  # the same of a ring's
MAX_SADDLE = 0.5  # of the lesser end's pressure: two contacts have less between them
MIN_ELONGATION = 1.8  # length over width of an edge's pressure
EDGE_SPREAD = 1.5  # of an edge's errors over stated ones
MIN_EDGE_ERROR_RAD = 1e-3  # standard error of an edge however hard it is pressed
NORMAL_90 = 1.6449
SAME_CONTACT = 2.5  # pitches between a peak and its ring


@dataclass(frozen=True, slots=True)
class TouchPlace:
    """One contact.

    Attributes:
        x, y: Center [unit of the marks].
        x_error, y_error: Standard errors [unit].
        told_by: Origin of the position.
    """

    x: float
    y: float
    x_error: float
    y_error: float
    told_by: Literal["pressure", "ring"]
    ring: ShearRing | None


@dataclass(frozen=True, slots=True, eq=False)
class TouchPlaces:
    """Contacts of one frame, the strongest first.

    Attributes:
        unsure: Number of stretched positions without a contact's form.
        edge: Direction of the edge, if the only contact is one.
        traction: Traction that explains the marks best, if layers are known.
    """

    contacts: tuple[TouchPlace, ...]
    unsure: int
    edge: EdgeDirection | None
    traction: RecoveredTraction | None

    @property
    def explained(self) -> bool:
        """Whether a traction explains the motion of the marks."""
        return self.traction is not None and self.traction.misfit < MAX_MISFIT


def touch_places(fields: StrainFields, marks: SkinMarks, skin: object) -> TouchPlaces:
    """Return the contacts of a frame."""
    peaks = contact_peaks(fields, marks.pitch)
    if not peaks:  # marks may be missing where the skin is stretched
        return TouchPlaces((), int(strayed(fields) >= MIN_GROUP), None, None)
    stretched = contact_peaks(fields)  # by the pitch of the marks that are seen
    rings = [r for r in find_rings(fields, stretched) if r.outward > MIN_SIGNIFICANCE * r.outward_error]
    traction = _best_traction(fields, stretched, skin)
    explained = traction is not None and traction.misfit < MAX_MISFIT and _certain(traction)
    if traction is not None and explained:
        peaks = _apart(peaks, traction)
        edge = _pressed_edge(traction) if len(peaks) == 1 else None
    else:
        edge = edge_direction(fields) if len(peaks) == 1 else None
    if traction is not None and explained and (edge or _amid(traction, peaks) < FROM_PEAKS * marks.pitch):
        contacts = _by_pressure(traction, peaks, rings)
    else:
        contacts = tuple(_by_ring(ring) for ring in rings if _near(ring, peaks) < SAME_CONTACT * marks.pitch)
    return TouchPlaces(contacts, len(peaks) - len(contacts), edge, traction)


def _apart(peaks: list[ContactPeak], traction: RecoveredTraction) -> list[ContactPeak]:
    """Peaks between which the pressure falls; lost marks also split the stretch of an edge."""
    near = cKDTree(traction.nodes_m)
    kept: list[ContactPeak] = []
    for peak in peaks:
        ways = [np.linspace(peak[:2], other[:2], 25) for other in kept]
        lows = []
        for way in ways:
            pressure = traction.pressure_pa[near.query(way, k=4)[1]].mean(axis=1)
            lows.append(float(pressure.min()) < MAX_SADDLE * float(min(pressure[0], pressure[-1])))
        if all(lows):
            kept.append(peak)
    return kept


def _pressed_edge(traction: RecoveredTraction) -> EdgeDirection | None:
    """Direction of an edge by its pressure; None for a round contact."""
    if traction.elongation < MIN_ELONGATION:
        return None
    error = math.hypot(EDGE_SPREAD * traction.axis_error_rad, MIN_EDGE_ERROR_RAD)
    half = min(NORMAL_90 * error, math.pi / 2)
    return EdgeDirection(traction.axis_rad % math.pi, error, half, traction.elongation, traction.centre_m)


def _best_traction(fields: StrainFields, peaks: list[ContactPeak], skin: object) -> RecoveredTraction | None:
    """Frictionless traction, or one with friction if that does not explain the marks."""
    if not isinstance(skin, TiledSkin) or skin.layers is None:
        return None
    traction = None
    for closure in ("frictionless", "coulomb"):
        try:
            traction = recover_traction(fields, skin.layers, closure, peaks=peaks)
        except RangeError:  # reaches over too much of the skin, as noise does under the lightest touch
            return traction
        if traction is None or traction.misfit < MAX_MISFIT:
            break
    return traction


def _certain(traction: RecoveredTraction) -> bool:
    """Whether its force is significant and its center known."""
    told = np.isfinite([*traction.centre_m, *traction.centre_error_m]).all()
    known = bool(told) and min(traction.centre_error_m) > 0
    return known and traction.force_n > MIN_FORCE * traction.force_error_n


def _amid(traction: RecoveredTraction, peaks: list[ContactPeak]) -> float:
    """Distance of the center of pressure from the mean peak, which noise may shift."""
    x, y = np.mean([p[:2] for p in peaks], axis=0).tolist()
    return math.hypot(traction.centre_m[0] - x, traction.centre_m[1] - y)


def _near(ring: ShearRing, peaks: list[ContactPeak]) -> float:
    return min(math.hypot(ring.x - p.x, ring.y - p.y) for p in peaks)


def _by_pressure(
    traction: RecoveredTraction, peaks: list[ContactPeak], rings: list[ShearRing]
) -> tuple[TouchPlace, ...]:
    """Center of pressure; for several contacts, of the nodes nearest to each peak."""
    spread = TRACTION_SPREAD if traction.closure == "frictionless" else FRICTION_SPREAD
    x_error, y_error = (spread * len(peaks) * error for error in traction.centre_error_m)
    away = [np.hypot(*(traction.nodes_m - p[:2]).T) for p in peaks]
    owner = np.argmin(away, axis=0)
    made = []
    for i, peak in enumerate(peaks):
        weight = np.where(owner == i, traction.pressure_pa, 0.0)
        if not weight.sum() > 0:
            continue
        x, y = (weight @ traction.nodes_m / weight.sum()).tolist()
        far = [math.hypot(ring.x - peak.x, ring.y - peak.y) for ring in rings]
        own = None if not rings or len(rings) < len(peaks) else rings[int(np.argmin(far))]
        made.append(TouchPlace(x, y, x_error, y_error, "pressure", own))
    return tuple(made)


def _by_ring(ring: ShearRing) -> TouchPlace:
    return TouchPlace(ring.x, ring.y, RING_SPREAD * ring.x_error, RING_SPREAD * ring.y_error, "ring", ring)


RIM = 1.15  # pitches from the outermost marks: the area of NUSense is then 40 x 28 mm
MAX_OUTSIDE = 0.25  # fraction of the pressure outside of the outermost marks
CODE = "outside_calibrated_area"


def area_of(marks: SkinMarks, skin: object) -> tuple[list[float], list[float]]:
    """Return the least and greatest (x, y) of valid positions [unit of the marks]."""
    rim = RIM * marks.pitch if isinstance(skin, TiledSkin) else 0.0
    at = marks.reference.places
    return (at.min(axis=0) + rim).tolist(), (at.max(axis=0) - rim).tolist()


def reach_of(fields: StrainFields, places: TouchPlaces, marks: SkinMarks, skin: object) -> Refusal:
    """Return the refusal of a frame with a contact outside of the area."""
    if not isinstance(skin, TiledSkin):
        return NONE
    low, high = (np.array(end) for end in area_of(marks, skin))
    at = [(c.x, c.y) for c in places.contacts] or [p[:2] for p in contact_peaks(fields, marks.pitch)[:1]]
    outside = any(((np.array(one) < low) | (np.array(one) > high)).any() for one in at)
    if not outside and not _presses_outside(places, marks):
        return NONE
    size = ", ".join(f"{1e3 * a:.0f} to {1e3 * b:.0f}" for a, b in zip(low, high, strict=True))
    return Refusal(
        CODE, f"the contact reaches outside of the calibrated area, ({size}) mm; press inside of it"
    )


def _presses_outside(places: TouchPlaces, marks: SkinMarks) -> bool:
    """Whether much of the recovered pressure lies outside of the outermost marks."""
    traction, at = places.traction, marks.reference.places
    if traction is None or not traction.pressure_pa.sum() > 0:
        return False
    nodes = traction.nodes_m
    outside = ((nodes < at.min(axis=0)) | (nodes > at.max(axis=0))).any(axis=1)
    return float(traction.pressure_pa[outside].sum()) > MAX_OUTSIDE * float(traction.pressure_pa.sum())


FAR = 75.0  # percentile of the distance to the nearest contact from which a mark is far
OF_TOUCH = 0.4  # of the mean shift by touch: limit where the layers are not known
OF_TRACTION = 0.05  # the same where the recovered traction is subtracted
CAMERA_CODE = "camera_moved"


def motion_limit(fields: StrainFields, pitch: float, places: TouchPlaces | None = None) -> float:
    """Return the greatest RMS camera motion over the far marks that is not reported [unit of the marks].

    Args:
        fields: Strain fields of the frame.
        pitch: Distance of marks [unit].
        places: Contacts whose recovered traction is subtracted.
    """
    stated = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    scatter = _far_motion(fields, _unexplained(fields, places), pitch).scatter
    by_touch = _far_motion(fields, fields.moved, pitch).mean_rest
    known = places is not None and places.traction is not None
    return max(stated, scatter) + (OF_TRACTION if known else OF_TOUCH) * by_touch


def camera_motion(
    fields: StrainFields, pitch: float, px_per_unit: float, places: TouchPlaces | None = None
) -> Refusal:
    """Return the refusal of a frame whose whole pattern has moved; arguments as of `motion_limit`."""
    motion = _far_motion(fields, _unexplained(fields, places), pitch).affine
    limit = motion_limit(fields, pitch, places)
    if motion <= limit:
        return NONE
    return Refusal(
        CAMERA_CODE,
        f"the whole pattern has moved by {px_per_unit * motion:.2f} px, and {px_per_unit * limit:.2f} px are "
        "allowed; fix the camera and take a new reference",
    )


def _unexplained(fields: StrainFields, places: TouchPlaces | None) -> Float[ndarray, "n 2"]:
    """Motion that the recovered traction does not explain."""
    traction = None if places is None else places.traction
    return fields.moved if traction is None else traction.unexplained_m


class FarMotion(NamedTuple):
    """RMS affine motion of far marks, their scatter, and the mean shift of all relative to it [unit]."""

    affine: float
    scatter: float
    mean_rest: float


def _far_motion(fields: StrainFields, moved: Float[ndarray, "n 2"], pitch: float) -> FarMotion:
    at, peaks = fields.rest, contact_peaks(fields, pitch)
    far = np.ones(len(at), bool)
    if peaks:
        away = np.min([np.hypot(*(at - (p.x, p.y)).T) for p in peaks], axis=0)
        far = away >= np.percentile(away, FAR)
    basis = np.column_stack([np.ones(len(at)), at / max(float(np.abs(at).max()), 1e-12)])
    affine = basis @ np.linalg.lstsq(basis[far], moved[far], rcond=None)[0]
    rest = np.hypot(*(moved - affine).T)
    return FarMotion(
        math.sqrt(float((affine[far] ** 2).sum(axis=1).mean())),
        math.sqrt(float((rest[far] ** 2).mean())),
        float(rest.mean()),
    )
