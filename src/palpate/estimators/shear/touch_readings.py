"""Readings of a touch: values with 90 % intervals, ranges, and reasons of invalidity.

Standard errors become normal intervals; gamma has a bound, because noise changes a shift by at most its own
length. Rotation and shift of the pattern under a contact come from the traction if layers are known, else
from the ring less the apparent shift X w / D of the sinking pattern.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from palpate.core import CircularReading, ClassReading, Frame, MeasurementResult, Reading, Readings
from palpate.core.reading import NONE, Refusal
from palpate.estimators.shear.reference_check import LatticeFit
from palpate.estimators.shear.skin_marks import SkinMarks, TiledSkin
from palpate.estimators.shear.touch_places import TouchPlace, TouchPlaces, area_of, motion_limit
from palpate.estimators.surface_strain import RecoveredTraction, ShearRing, StrainFields, shear_measure
from palpate.estimators.surface_strain.strain_fields import PUBLISHED_ALPHA

MIN_SHIFT_ERROR = 3.0  # times the marks' noise: standard error of a shift even where no friction is assumed
MIN_TURN_ERROR = 2.0  # the same of a rotation, over the pitch
SINKING_ERROR = 0.25  # relative standard error of the sinking by the ring
MODEL_ERROR = 0.1  # relative standard error of shift and rotation by traction


class PatternShift(NamedTuple):
    """Rotation about the normal from x towards y [rad], and shift (x, y) [unit], with standard errors."""

    turn: float
    turn_error: float
    along: tuple[float, float]
    along_error: tuple[float, float]


NOT_TOLD = PatternShift(math.nan, math.nan, (math.nan, math.nan), (math.nan, math.nan))


def pattern_shift(fields: StrainFields, places: TouchPlaces, pitch: float, skin: object) -> PatternShift:
    """Return the motion of the pattern under the first contact; NaN if neither form identifies it."""
    if places.traction is not None and places.explained and len(places.contacts) == 1:
        return _by_traction(fields, places.traction, pitch)
    ring = places.contacts[0].ring
    return NOT_TOLD if ring is None else _by_ring(ring, skin)


def _by_traction(fields: StrainFields, traction: RecoveredTraction, pitch: float) -> PatternShift:
    noise = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    x, y, turn = traction.moved
    least = (MIN_SHIFT_ERROR * noise, MIN_SHIFT_ERROR * noise, MIN_TURN_ERROR * noise / pitch)
    ex, ey, et = (
        math.sqrt(error**2 + (MODEL_ERROR * value) ** 2 + floor**2)
        for error, value, floor in zip(traction.moved_error, traction.moved, least, strict=True)
    )
    return PatternShift(turn, et, (x, y), (ex, ey))


def _by_ring(ring: ShearRing, skin: object) -> PatternShift:
    per_place = skin.sinking * ring.outward / skin.camera_m if isinstance(skin, TiledSkin) else 0.0
    along, errors = [], []
    for at, seen, error in zip((ring.x, ring.y), ring.along, ring.along_error, strict=True):
        along.append(seen - at * per_place)
        errors.append(math.hypot(error, SINKING_ERROR * at * per_place))
    return PatternShift(
        ring.around / ring.radius,
        ring.around_error / ring.radius,
        (along[0], along[1]),
        (errors[0], errors[1]),
    )


COVERAGE = 0.9
NORMAL_90 = 1.6449  # standard errors
COUNTS = tuple(map(str, range(7)))
NO_CONTACT = Refusal("no_contact", "no contact")
UNSURE = Refusal("no_contact_form", "stretched, but not as a contact does")
NO_PAST = Refusal("no_history", "slip is a change of one contact from frame to frame")
NO_EDGE = Refusal("no_edge", "no edge: the contact is round, or there are several")
FLAG = ("no", "yes")
NAN = math.nan


def touch_readings(
    frame: Frame,
    marks: SkinMarks,
    skin: object,
    lattice: LatticeFit,
    seen: int,
    fields: StrainFields | None,
    places: TouchPlaces,
    refusal: Refusal,
    reach: Refusal = NONE,
    slip: bool | None = None,
    damage: Refusal = NONE,
) -> Readings:
    """Return the readings of a frame.

    Args:
        frame: Frame.
        marks, skin: Marks and description of the reader.
        lattice: Lattice of the reference.
        seen: Number of marks in the frame.
        fields, places: Strain and contacts; None and nothing if the frame is refused.
        refusal: Refusal of the frame.
        reach: Refusal of a contact outside the area.
        slip: Slip of the contact; None if unknown.
        damage: Reason why the skin seems torn.
    """
    common: dict[str, Any] = {
        "coverage": COVERAGE, "drift": None, "calibration": "", "frame": frame.name, "time_s": frame.time_s,
    }  # fmt: skip
    made = _Maker(common, marks, skin, lattice)
    first = places.contacts[0] if places.contacts else None
    why = refusal or damage or reach or (NONE if first else _why_none(places))
    rows: list[MeasurementResult] = [
        *made.place(first, why),
        made.edge(places, why),
        _count(places, refusal, damage or reach, common),
        *made.turn_and_shift(places, fields, why, skin),
        made.gamma(fields, places, refusal or damage or reach),
        made.share(seen, refusal),
        _flag("slip", slip, refusal or reach or (NONE if slip is not None else NO_PAST), common),
        _flag(
            "damage",
            None if refusal or (reach and not damage) else bool(damage),
            refusal or (NONE if damage else reach),
            common,
        ),
    ]
    return Readings({row.column: row for row in rows})


def _why_none(places: TouchPlaces) -> Refusal:
    return UNSURE if places.unsure else NO_CONTACT


def _verdict(why: Refusal) -> dict[str, Any]:
    return {"valid": not why, "why": why.why, "code": why.code}


class _Maker:
    """Readings of one frame with their common fields."""

    def __init__(self, common: dict[str, Any], marks: SkinMarks, skin: object, lattice: LatticeFit) -> None:
        self._common, self._marks = common, marks
        self._low, self._high = area_of(marks, skin)
        self._off, self._bent = (0.0, 0.0), 0.0
        if isinstance(skin, TiledSkin):
            along, across = (abs(side / skin.pitch_m - 1) for side in lattice.sides)
            self._off, self._bent = (along, across), lattice.bent

    def place(self, contact: TouchPlace | None, why: Refusal) -> list[MeasurementResult]:
        """Position with the error of lens and distance, estimated from the pattern's pitch."""
        made: list[MeasurementResult] = []
        for i, axis in enumerate("xy"):
            at = NAN if contact is None else getattr(contact, axis)
            error = NAN if contact is None else getattr(contact, f"{axis}_error")
            whole = math.hypot(error, self._off[i] * at, self._bent)
            span = (self._low[i], self._high[i])
            made.append(self._scalar(axis, self._marks.unit, at, whole, span, why))
        return made

    def edge(self, places: TouchPlaces, why: Refusal) -> MeasurementResult:
        edge = None if why else places.edge
        why = why or (NONE if edge else NO_EDGE)
        if edge is None:
            value = low = high = NAN
        else:
            value, low, high = edge.angle_rad, edge.angle_rad - edge.half_rad, edge.angle_rad + edge.half_rad
        return CircularReading(
            quantity="edge", unit="rad", value=value, low=low, high=high, period=math.pi,
            calibrated_range=(0.0, math.pi), **_verdict(why), **self._common,
        )  # fmt: skip

    def turn_and_shift(
        self, places: TouchPlaces, fields: StrainFields | None, why: Refusal, skin: object
    ) -> list[MeasurementResult]:
        """Rotation and lateral shift of the pattern under the first contact."""
        if why or fields is None:
            moved = PatternShift(NAN, NAN, (NAN, NAN), (NAN, NAN))
        else:
            moved = pattern_shift(fields, places, self._marks.pitch, skin)
        half = self._marks.pitch / 2
        return [
            self._scalar("rotation", "rad", moved.turn, moved.turn_error, (-math.pi / 4, math.pi / 4), why),
            *(
                self._scalar(f"shift_{axis}", self._marks.unit, value, error, (-half, half), why)
                for axis, value, error in zip("xy", moved.along, moved.along_error, strict=True)
            ),
        ]

    def gamma(self, fields: StrainFields | None, places: TouchPlaces, why: Refusal) -> MeasurementResult:
        """Gamma, bounded by noise and unreported camera motion."""
        value = floor = NAN
        if fields is not None:
            alpha = PUBLISHED_ALPHA * self._marks.px_per_unit * (1 - 1e-12)
            value = shear_measure(fields, alpha).mean_form
            per_axis = math.sqrt(float(fields.variances.sum(axis=0).mean()))
            camera = motion_limit(fields, self._marks.pitch, places)
            floor = alpha * fields.basis.count * (math.sqrt(math.pi / 2) * per_axis + camera)
        low = max(value - floor, 0.0) if math.isfinite(value) else NAN
        return Reading(
            quantity="gamma", unit="ratio", value=value, low=low, high=value + floor,
            calibrated_range=(0.0, math.inf), **_verdict(why), **self._common,
        )  # fmt: skip

    def share(self, seen: int, why: Refusal) -> MeasurementResult:
        value = seen / len(self._marks.reference)
        return Reading(
            quantity="seen", unit="ratio", value=value, low=value, high=value, calibrated_range=(0.0, 1.0),
            **_verdict(why), **self._common,
        )  # fmt: skip

    def _scalar(
        self, quantity: str, unit: str, value: float, error: float, span: tuple[float, float], why: Refusal
    ) -> Reading:
        if not why and not span[0] <= value <= span[1]:
            outside = f"{value:.4g} {unit} is outside {span[0]:.4g} to {span[1]:.4g} {unit}"
            why = Refusal("out_of_range", outside)
        half = NORMAL_90 * error
        return Reading(
            quantity=quantity, unit=unit, value=value, low=value - half, high=value + half,
            calibrated_range=span, **_verdict(why), **self._common,
        )  # fmt: skip


def _flag(quantity: str, up: bool | None, why: Refusal, common: dict[str, Any]) -> ClassReading:
    value = "" if up is None else FLAG[up]
    return ClassReading(
        quantity=quantity, unit="", value=value, members=(value,) if value else (), classes=FLAG,
        **_verdict(why), **common,
    )  # fmt: skip


def _count(places: TouchPlaces, refusal: Refusal, doubt: Refusal, common: dict[str, Any]) -> ClassReading:
    why = refusal or doubt or (_why_none(places) if places.unsure else NONE)
    count = str(len(places.contacts))
    most = str(min(len(places.contacts) + places.unsure, len(COUNTS) - 1))
    members = () if refusal else tuple(c for c in COUNTS if count <= c <= most)
    return ClassReading(
        quantity="contacts", unit="", value="" if refusal else count, members=members, classes=COUNTS,
        **_verdict(why), **common,
    )  # fmt: skip
