"""Readings of a touch: values with 90 % intervals, ranges, and why one is not to be used.

Standard errors become intervals as of a normal error. The sum gamma has a bound instead: noise changes the
length of a shift by no more than its own, so that gamma lies within gamma of noise alone.
"""

from __future__ import annotations

import math
from typing import Any

from palpate.core import CircularReading, ClassReading, Frame, MeasurementResult, Reading, Readings
from palpate.estimators.shear.pattern_shift import PatternShift, pattern_shift
from palpate.estimators.shear.skin_marks import SkinMarks
from palpate.estimators.shear.touch_places import TouchPlace, TouchPlaces
from palpate.estimators.surface_strain import StrainFields, shear_measure
from palpate.estimators.surface_strain.shear_measure import PUBLISHED_ALPHA

COVERAGE = 0.9
NORMAL_90 = 1.6449  # standard errors
COUNTS = tuple(map(str, range(7)))
NO_CONTACT = "no contact"
NO_PAST = "slip is a change of one contact from frame to frame"
TORN = "the skin looks torn"
FLAG = ("no", "yes")
NAN = math.nan


def touch_readings(
    frame: Frame,
    marks: SkinMarks,
    skin: object,
    seen: int,
    fields: StrainFields | None,
    places: TouchPlaces,
    reason: str,
    slip: bool | None = None,
    damage: str = "",
) -> Readings:
    """Readings of a frame.

    Args:
        frame: where they come from.
        marks, skin: of the reader.
        seen: number of marks in the frame.
        fields, places: of the frame; None and nothing where it is not to be read.
        reason: why it is not.
        slip: of the contact; None where it cannot be told.
        damage: why the skin looks torn; empty where it looks whole.
    """
    common: dict[str, Any] = {
        "coverage": COVERAGE, "drift": None, "calibration": "", "frame": frame.name, "time_s": frame.time_s,
    }  # fmt: skip
    made = _Maker(common, marks)
    first = places.contacts[0] if places.contacts else None
    why = reason or (f"{TORN}: {damage}" if damage else "") or ("" if first else _why_none(places))
    rows: list[MeasurementResult] = [
        *made.place(first, why),
        made.edge(places, why),
        _count(places, reason, damage, common),
        *made.turn_and_shift(places, fields, why, skin),
        made.gamma(fields, reason),
        made.share(seen, reason),
        _flag("slip", slip, reason or ("" if slip is not None else NO_PAST), common),
        _flag("damage", None if reason else bool(damage), reason, common),
    ]
    return Readings({row.column: row for row in rows})


def _why_none(places: TouchPlaces) -> str:
    return "stretched, but not as a contact does" if places.unsure else NO_CONTACT


class _Maker:
    """Readings of one frame, with what they share."""

    def __init__(self, common: dict[str, Any], marks: SkinMarks) -> None:
        self._common, self._marks = common, marks
        at = marks.reference.places
        self._low, self._high = at.min(axis=0).tolist(), at.max(axis=0).tolist()

    def place(self, contact: TouchPlace | None, why: str) -> list[MeasurementResult]:
        return [
            self._scalar(
                axis,
                self._marks.unit,
                NAN if contact is None else getattr(contact, axis),
                NAN if contact is None else getattr(contact, f"{axis}_error"),
                (self._low[i], self._high[i]),
                why,
            )
            for i, axis in enumerate("xy")
        ]

    def edge(self, places: TouchPlaces, why: str) -> MeasurementResult:
        edge = None if why else places.edge
        why = why or ("" if edge else "no edge: the contact is round, or there are several")
        if edge is None:
            value = low = high = NAN
        else:
            value, low, high = edge.angle_rad, edge.angle_rad - edge.half_rad, edge.angle_rad + edge.half_rad
        return CircularReading(
            quantity="edge", unit="rad", value=value, low=low, high=high, period=math.pi,
            calibrated_range=(0.0, math.pi), valid=not why, why=why, **self._common,
        )  # fmt: skip

    def turn_and_shift(
        self, places: TouchPlaces, fields: StrainFields | None, why: str, skin: object
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

    def gamma(self, fields: StrainFields | None, why: str) -> MeasurementResult:
        value = floor = NAN
        if fields is not None:
            alpha = PUBLISHED_ALPHA * self._marks.px_per_unit * (1 - 1e-12)
            value = shear_measure(fields, alpha).mean_form
            per_axis = math.sqrt(float(fields.variances.sum(axis=0).mean()))
            floor = alpha * fields.basis.count * math.sqrt(math.pi / 2) * per_axis
        low = max(value - floor, 0.0) if math.isfinite(value) else NAN
        return Reading(
            quantity="gamma", unit="ratio", value=value, low=low, high=value + floor,
            calibrated_range=(0.0, math.inf), valid=not why, why=why, **self._common,
        )  # fmt: skip

    def share(self, seen: int, why: str) -> MeasurementResult:
        value = seen / len(self._marks.reference)
        return Reading(
            quantity="seen", unit="ratio", value=value, low=value, high=value, calibrated_range=(0.0, 1.0),
            valid=not why, why=why, **self._common,
        )  # fmt: skip

    def _scalar(
        self, quantity: str, unit: str, value: float, error: float, span: tuple[float, float], why: str
    ) -> Reading:
        if not why and not span[0] <= value <= span[1]:
            why = f"{value:.4g} {unit} is outside {span[0]:.4g} to {span[1]:.4g} {unit}"
        half = NORMAL_90 * error
        return Reading(
            quantity=quantity, unit=unit, value=value, low=value - half, high=value + half,
            calibrated_range=span, valid=not why, why=why, **self._common,
        )  # fmt: skip


def _flag(quantity: str, up: bool | None, why: str, common: dict[str, Any]) -> ClassReading:
    value = "" if up is None else FLAG[up]
    return ClassReading(
        quantity=quantity, unit="", value=value, members=(value,) if value else (), classes=FLAG,
        valid=not why, why=why, **common,
    )  # fmt: skip


def _count(places: TouchPlaces, reason: str, damage: str, common: dict[str, Any]) -> ClassReading:
    torn = f"{TORN}: {damage}" if damage else ""
    why = reason or torn or (_why_none(places) if places.unsure else "")
    count = str(len(places.contacts))
    most = str(min(len(places.contacts) + places.unsure, len(COUNTS) - 1))
    members = () if reason else tuple(c for c in COUNTS if count <= c <= most)
    return ClassReading(
        quantity="contacts", unit="", value="" if reason else count, members=members, classes=COUNTS,
        valid=not why, why=why, **common,
    )  # fmt: skip
