"""Readings of a press by a calibrated TacTip, with intervals, ranges, flags and calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    AREA_AT_N,
    ComplianceCalibration,
    approach_row,
    area_at_4_n,
    moduli_pa,
    rate_by_areas,
    shape_reasons,
    touch_row,
)
from palpate.calibration.compliance.press_nuisances import Nuisances
from palpate.calibration.compliance.press_verdict import (
    CueMisfit,
    drift_of,
    greatest_misfit,
    misfit_reasons,
    press_reasons,
    worst_misfit,
)
from palpate.core import Drift, Float, InputError, RangeError, Reading, ndarray
from palpate.core.reading import SEPARATOR, ReasonCode, Refusal, joined
from palpate.estimators.compliance.contact_area import AreaFit
from palpate.estimators.compliance.hertz_inversion import PressCurves, ShapeSurface, invert_hertz
from palpate.estimators.compliance.pin_press import PinPress, at_forces, motion_on_layout
from palpate.estimators.compliance.stiffness_curve import SoftnessCurve, softness

COVERAGE = 0.9
NORMAL = 1.645  # standard deviations from the mean to either end of an interval of that coverage
OUTSIDE = "{:.3g} {} is outside the references, {:.3g} to {:.3g} {}"
REACHES = "the interval, {:.3g} to {:.3g} {}, reaches beyond the calibrated range, {:.3g} to {:.3g} {}"
EDGE = 1.05  # how far beyond the outermost reference an interval may begin: it scatters about its own value
HEAD_ON_RAD = 0.05
INCLINED = "E* and R are of head-on presses; this calibration is of an inclined top"
MISFIT = 0.1
NO_HERTZ = (
    "the tip is no Hertz body (its modulus changes by {:.0%} over the forces, {:.0%} is allowed), so its "
    "part of the radius cannot be taken off"
)
TOO_STIFF = (
    "above {:.3g} MPa: it cannot be told from a rigid object, as which a thin layer on a hard base shows "
    "itself too"
)
CURVED = "the object is curved (R {:.3g} mm, {:.3g} to {:.3g} mm); this quantity is of flat specimens"
APART = (
    "{} of {:.3g} to {:.3g} {} does not agree with a stiffness of {:.3g} to {:.3g} N/mm, which needs {:.3g} "
    "to {:.3g} {}: no flat specimen of the references' shape"
)
UNITS = {
    "N_per_m": ("N/mm", 1e-3), "m2": ("mm2", 1e6), "m2_per_N": ("mm2/N", 1e6), "Pa": ("MPa", 1e-6),
}  # fmt: skip
FLAT_ONLY = ("stiffness", "stiffness_both", "area", "spread_rate")  # quantities of flat specimens
FIELDS = (*FLAT_ONLY, "modulus", "radius")
NO_BETWEEN = "two references cannot tell what is lost between them; calibrate on a third"


@dataclass(frozen=True)
class AreaCourse:
    """Over force [N], one row a frame: area, low and high [m^2]."""

    force_n: Float[ndarray, " f"]
    area_m2: Float[ndarray, "f 3"]


@dataclass(frozen=True)
class PressReading:
    """Readings of a touched object; None where the calibration or press lacks what they need.

    Attributes:
        stiffness, stiffness_both: by images and force alone, and with the approach.
        area, spread_rate: contact area at 4 N, and dA/dF by regression.
        modulus, radius: E* and R by both cues, from spheres among the references or the tip as a Hertz pair.
        course: area of every frame.
        budget: relative change of every quantity by each nuisance of its standard size.
    """

    stiffness: Reading
    stiffness_both: Reading | None
    area: Reading | None
    spread_rate: Reading | None
    modulus: Reading | None
    radius: Reading | None
    course: AreaCourse | None
    budget: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nuisances: Nuisances | None = None

    @property
    def readings(self) -> tuple[Reading, ...]:
        all_ = (
            self.stiffness, self.stiffness_both, self.area, self.spread_rate, self.modulus, self.radius
        )  # fmt: skip
        return tuple(one for one in all_ if one is not None)


def read_touch(
    calibration: ComplianceCalibration, presses: Sequence[PinPress], name: str = ""
) -> PressReading:
    """Read one press, or several of one specimen as one.

    Args:
        calibration: of this tip at this tilt.
        name: name of the recording in the readings.
    """
    if not presses:
        raise InputError("no press; give one or more")
    flat = worst_misfit(calibration, presses, flat=True)
    reasons = press_reasons(calibration, presses, flat if calibration.shape is None else None)
    verdict = _Verdict(calibration, drift_of(calibration, presses), reasons, name)
    read = _read(calibration, presses, verdict)
    read = _widened(calibration, read, _altered_values(calibration, presses, verdict))
    return _stretched(calibration, _judged(calibration, read, flat), flat.birge)


def _stretched(calibration: ComplianceCalibration, read: PressReading, birge: float) -> PressReading:
    wide: dict[str, Any] = {}
    for name in ("area", "spread_rate"):
        one: Reading | None = getattr(read, name)
        if one is not None and one.value > 0 and birge > 1:
            low, high = (one.value * (max(end, 0.0) / one.value) ** birge for end in (one.low, one.high))
            stretched = replace(one, low=low, high=high)
            reasons = _range_reasons(calibration, name, stretched) if one.valid else []
            wide[name] = _refused(stretched, reasons) if reasons else stretched
    return replace(read, **wide)


def _judged(calibration: ComplianceCalibration, read: PressReading, misfit: CueMisfit) -> PressReading:
    reasons = {name: _range_reasons(calibration, name, getattr(read, name)) for name in FIELDS}
    curved = calibration.shape is not None and _curved(read)
    if curved:
        assert read.radius is not None
        text = CURVED.format(*(1e3 * x for x in (read.radius.value, read.radius.low, read.radius.high)))
        flat = [Refusal(ReasonCode.CURVED, text), *_reasons_of(read.radius)]
        everywhere = []
    else:
        flat = [] if calibration.shape is None else _not_flat(calibration, read, misfit)
        everywhere = _disagreements(calibration, read)
    for name in FLAT_ONLY:
        reasons[name] += flat
    checked: dict[str, Any] = {
        name: _refused(getattr(read, name), [*reasons[name], *everywhere]) for name in FIELDS
    }
    return replace(read, **checked)


def _not_flat(calibration: ComplianceCalibration, read: PressReading, misfit: CueMisfit) -> list[Refusal]:
    return _reasons_of(read.radius) + misfit_reasons(misfit, greatest_misfit(calibration, flat=True))


def _curved(read: PressReading) -> bool:
    return read.radius is not None and bool(np.isfinite(read.radius.high))


def _range_reasons(calibration: ComplianceCalibration, name: str, one: Reading | None) -> list[Refusal]:
    if one is None or name == "radius":
        return []
    if name == "modulus" and calibration.shape is not None:
        too_stiff = np.isinf(one.high) or one.low > EDGE * moduli_pa(calibration.shape)[1]
        return [Refusal(ReasonCode.TOO_STIFF, TOO_STIFF.format(1e-6 * one.low))] if too_stiff else []
    unit, scale = UNITS[one.unit]
    low, high = one.calibrated_range
    reasons = []
    if name.startswith("stiffness"):
        known = calibration.touch.kappa_n_m
        least, most = float(known.min()), float(known[np.isfinite(known)].max())
        if one.low > most * EDGE or one.high < least / EDGE:
            text = OUTSIDE.format(scale * one.value, unit, scale * least, scale * most, unit)
            reasons.append(Refusal(ReasonCode.OUTSIDE_RANGE, text))
    if one.low < low or one.high > high or np.isinf(one.high):
        ends = scale * one.low, scale * one.high, unit, scale * low, scale * high, unit
        reasons.append(Refusal(ReasonCode.INTERVAL_OUTSIDE_RANGE, REACHES.format(*ends)))
    return reasons


def _disagreements(calibration: ComplianceCalibration, read: PressReading) -> list[Refusal]:
    base = read.stiffness if read.stiffness_both is None else read.stiffness_both
    ends = np.array([base.low, base.high])
    for name in ("stiffness", "area", "spread_rate", "modulus"):
        one: Reading | None = getattr(read, name)
        allowed = None if one is None else _on_flat(calibration, name, ends)
        if one is None or allowed is None or (one.low <= allowed.max() and allowed.min() <= one.high):
            continue
        unit, scale = UNITS[one.unit]
        text = APART.format(
            one.quantity, scale * one.low, scale * one.high, unit, 1e-3 * base.low, 1e-3 * base.high,
            scale * allowed.min(), scale * allowed.max(), unit,
        )  # fmt: skip
        return [Refusal(ReasonCode.CUES_DISAGREE, text)]
    return []


def _on_flat(
    calibration: ComplianceCalibration, name: str, kappa_n_m: Float[ndarray, " n"]
) -> Float[ndarray, " n"] | None:
    """Return a quantity of flat specimens of some stiffness; None where the references do not state it."""
    if name == "stiffness":
        return kappa_n_m
    if name == "modulus":
        return None if calibration.moduli_per_m is None else calibration.moduli_per_m * kappa_n_m
    fit = calibration.level if name == "area" else calibration.rate
    if fit is None or len(fit.means) != len(calibration.touch.kappa_n_m):
        return None
    curve = calibration.touch
    known, asked = (softness(k, curve.turning_n_m) for k in (curve.kappa_n_m, kappa_n_m))
    return np.asarray(np.exp(np.polyval(np.polyfit(known, np.log(fit.means), len(known) - 1), asked)))


def _reasons_of(reading: Reading | None) -> list[Refusal]:
    if reading is None or reading.valid:
        return []
    texts, codes = reading.why.split(SEPARATOR), reading.code.split(SEPARATOR)
    return [Refusal(ReasonCode(codes[min(i, len(codes) - 1)]), text) for i, text in enumerate(texts)]


def _refused(reading: Reading | None, reasons: Sequence[Refusal]) -> Reading | None:
    if reading is None or not reasons:
        return reading
    fields = joined([*_reasons_of(reading), *reasons])
    return replace(reading, **fields)  # type: ignore[arg-type]


def _read(calibration: ComplianceCalibration, presses: Sequence[PinPress], verdict: _Verdict) -> PressReading:
    reader = _PressReader(calibration, presses, verdict)
    rows = np.stack([touch_row(one, calibration.layout_px, calibration.levels_n) for one in presses])
    both = modulus = radius = None
    if calibration.both is not None and all(one.position_m is not None for one in presses):
        beside = np.stack([approach_row(one, calibration.levels_n) for one in presses])
        joined = np.hstack([rows, beside])
        if calibration.shape is not None:
            modulus, radius = reader.by_surface(calibration.shape, joined)
        both = reader.stiffness("stiffness_both_cues", calibration.both, joined)
    stiffness = reader.stiffness("stiffness", calibration.touch, rows)
    if calibration.area is None:
        return PressReading(stiffness, both, None, None, modulus, radius, None)
    courses = [_course(calibration, one) for one in presses]
    area, rate = reader.area(courses), reader.rate(courses)
    if both is not None and calibration.shape is None:
        modulus, radius = reader.modulus_and_radius(courses)
    return PressReading(stiffness, both, area, rate, modulus, radius, courses[0])


def _altered_values(
    calibration: ComplianceCalibration, presses: Sequence[PinPress], verdict: _Verdict
) -> dict[str, dict[str, float]]:
    by_press = [calibration.nuisances.altered(press) for press in presses]
    values = {}
    for name in by_press[0]:
        altered = [one[name] for one in by_press]
        with suppress(InputError, RangeError):  # beyond the forces that the press reached
            read = _read(calibration, altered, verdict)
            values[name] = {one.quantity: one.value for one in read.readings}
    return values


def _widened(
    calibration: ComplianceCalibration, read: PressReading, altered: Mapping[str, Mapping[str, float]]
) -> PressReading:
    """The readings with intervals that contain the nuisances, as standard deviations beside their own."""
    wide, budget = {}, {}
    for name in FIELDS:
        one: Reading | None = getattr(read, name)
        if one is None:
            continue
        moved = {nuisance: values[one.quantity] for nuisance, values in altered.items()}
        low, high = contained(one, list(moved.values()), _scale(one, calibration.touch.turning_n_m))
        wide[name] = replace(one, low=low, high=high)
        if np.isfinite(one.value) and one.value:
            budget[one.quantity] = {
                key: value / one.value - 1 for key, value in moved.items() if value != one.value
            }
    return replace(read, **wide, budget=budget, nuisances=calibration.nuisances)  # type: ignore[arg-type]


Scale = Callable[[float], float]


def _scale(reading: Reading, turning: float) -> tuple[Scale, Scale]:
    """Scale on which a quantity's errors are uniform, and its inverse; both decrease with the quantity."""
    if reading.quantity.startswith("stiffness"):
        return lambda k: 1 / (1 + k / turning), lambda s: turning * (1 / min(s, 1.0) - 1) if s > 0 else np.inf
    if reading.quantity in ("modulus", "radius"):
        return lambda x: 1 / x if x else np.inf, lambda y: 1 / y if y > 0 else np.inf
    return lambda x: -float(np.log(x)), lambda y: float(np.exp(-y))


def contained(reading: Reading, altered: Sequence[float], scale: tuple[Scale, Scale]) -> tuple[float, float]:
    """Return the interval's ends including changes of one standard deviation each, of unknown sign.

    Args:
        altered: value under each change.
        scale: decreasing function on which errors are uniform, and its inverse.
    """
    to, back = scale
    middle = to(reading.value)
    moves = np.array([to(value) - middle for value in altered])
    half = NORMAL * float(np.sqrt(np.nansum(moves**2)))
    low, high = to(reading.low) - middle, middle - to(reading.high)
    return back(middle + float(np.hypot(low, half))), back(middle - float(np.hypot(high, half)))


def _course(calibration: ComplianceCalibration, press: PinPress) -> AreaCourse:
    assert calibration.area is not None
    assert calibration.motions is not None
    motion = motion_on_layout(press, calibration.layout_px)
    return AreaCourse(press.force_n, calibration.area.at(calibration.motions.of(motion), COVERAGE))


@dataclass(frozen=True)
class _Verdict:
    """What every reading of the presses carries."""

    calibration: ComplianceCalibration
    drift: Drift
    reasons: Sequence[Refusal]
    name: str


class _PressReader:
    """Readings of some presses under one verdict."""

    def __init__(
        self, calibration: ComplianceCalibration, presses: Sequence[PinPress], verdict: _Verdict
    ) -> None:
        self.calibration, self.presses, self.verdict = calibration, presses, verdict

    def reading(
        self, quantity: str, value: tuple[float, float, float], unit: str, range_: tuple[float, float],
        why: Sequence[Refusal] = (), coverage: float = COVERAGE,
    ) -> Reading:  # fmt: skip
        return Reading(
            quantity=quantity, value=value[0], low=value[1], high=value[2], unit=unit, coverage=coverage,
            calibrated_range=range_, drift=self.verdict.drift,
            calibration=self.calibration.id, frame=self.verdict.name, time_s=0.0,
            **joined([*self.verdict.reasons, *why]),  # type: ignore[arg-type]
        )  # fmt: skip

    def by_surface(self, surface: ShapeSurface, rows: Float[ndarray, "t d"]) -> tuple[Reading, Reading]:
        found = surface.of(rows, COVERAGE)
        why = shape_reasons(surface, found)
        flat_to = float(surface.radius_m.min()), float("inf")
        return (
            self.reading("modulus", found.modulus_pa, "Pa", moduli_pa(surface), why),
            self.reading("radius", found.radius_m, "m", flat_to, why),
        )

    def stiffness(self, quantity: str, curve: SoftnessCurve, rows: Float[ndarray, "t d"]) -> Reading:
        value = curve.of(rows, COVERAGE).kappa_n_m
        return self.reading(quantity, value, "N_per_m", curve.range_n_m, self._between(curve.between))

    def area(self, courses: Sequence[AreaCourse]) -> Reading:
        fit, at = self._fit, np.array([AREA_AT_N])
        if (level := self.calibration.level) is not None:
            areas = np.array([area_at_4_n(one.force_n, one.area_m2[:, 0]) for one in courses])
            if not (areas > 0).all():
                raise InputError(
                    f"a press has no contact area at {AREA_AT_N:g} N; press as far as the references were"
                )
            value = np.array(level.of(areas, COVERAGE))
        else:
            value = np.mean([at_forces(one.force_n, one.area_m2, at)[0] for one in courses], axis=0)
        range_ = fit.range_m2 if level is None else level.known
        ends = (float(value[0]), float(value[1]), float(value[2]))
        return self.reading("area_at_4_N", ends, "m2", range_, self._between(fit.spread))

    def rate(self, courses: Sequence[AreaCourse]) -> Reading | None:
        """dA/dF against known ones; None where two references know it."""
        if (fit := self.calibration.rate) is None:
            return None
        rates = np.array([rate_by_areas(one.force_n, one.area_m2[:, 0]) for one in courses])
        if not (rates > 0).all():
            raise InputError("areas of a press do not grow with force; are table and frames of one press?")
        value = fit.of(rates, COVERAGE)
        return self.reading("spread_rate", value, "m2_per_N", fit.known, self._between(self._fit.spread))

    def _between(self, error: float) -> list[Refusal]:
        return [] if np.isfinite(error) else [Refusal(ReasonCode.TWO_REFERENCES, NO_BETWEEN)]

    def modulus_and_radius(self, courses: Sequence[AreaCourse]) -> tuple[Reading | None, Reading | None]:
        finger = self.calibration.finger
        if finger is None:
            return None, None
        presses = [
            PressCurves(one.force_n[good], one.position_m[good], course.area_m2[good, 0])
            for one, course in zip(self.presses, courses, strict=True)
            if one.position_m is not None
            for good in [one.force_n >= self.calibration.levels_n[0]]
        ]
        contact = invert_hertz(presses, finger, np.random.default_rng(0), COVERAGE)
        why = [Refusal(ReasonCode.TOO_STIFF, contact.why)] if contact.why else []
        why += self._between(self._fit.spread)
        if self.calibration.tilt_rad > HEAD_ON_RAD:
            why.append(Refusal(ReasonCode.INCLINED, INCLINED))
        no_hertz = Refusal(ReasonCode.NOT_HERTZ, NO_HERTZ.format(finger.misfit, MISFIT))
        round_ = [no_hertz] if finger.misfit > MISFIT else []
        beyond = (0.0, float("inf"))
        return (
            self.reading("modulus", contact.modulus_pa, "Pa", beyond, why),
            self.reading("radius", contact.radius_m, "m", beyond, [*why, *round_]),
        )

    @property
    def _fit(self) -> AreaFit:
        assert self.calibration.area is not None
        return self.calibration.area
