"""Readings of a press by a calibrated TacTip, with intervals, ranges, flags and calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    approach_row,
    touch_row,
    wobble_px,
)
from palpate.core import Drift, Float, InputError, Reading, ndarray
from palpate.estimators.compliance.contact_area import AreaFit, ring_measures
from palpate.estimators.compliance.hertz_inversion import PressCurves, invert_hertz
from palpate.estimators.compliance.pin_press import PinPress, at_forces, motion_on_layout
from palpate.estimators.compliance.spread_rate import spread
from palpate.estimators.compliance.stiffness_curve import SoftnessCurve

COVERAGE = 0.9
AREA_AT_N = 4.0
MAX_NOVELTY = 5.0  # times what the references' own trials showed
MAX_DRIFT = 4.0
SPEED_SHARE = 3.0  # times faster or slower than any reference
UNLIKE = (
    "the pins move as on no reference ({:.1f} times the references' own scatter, {:g} are allowed): another "
    "tilt, shape or skin than was calibrated"
)
OUTSIDE = "{:.3g} N/mm is outside of the calibrated range, {:.3g} to {:.3g} N/mm"
AREA_OUTSIDE = "{:.4g} mm2 is outside of the calibrated range, {:.4g} to {:.4g} mm2"
SPEED = "pressed at {:.3g} mm/s, calibrated at {:.3g} to {:.3g} mm/s; the skin may answer otherwise"
DRIFTED = "the untouched pins have moved against each other since calibration; calibrate anew"
EDGE = 1.05  # how far beyond the outermost reference an interval may begin: it scatters about its own value
HEAD_ON_RAD = 0.05
INCLINED = "E* and R are of head-on presses; this calibration is of an inclined top"
MISFIT = 0.1
NO_HERTZ = (
    "the tip is no Hertz body (its modulus changes by {:.0%} over the forces, {:.0%} is allowed), so its "
    "part of the radius cannot be taken off"
)
NO_BETWEEN = "two references cannot tell what is lost between them; calibrate on a third"


@dataclass(frozen=True)
class AreaCourse:
    """Over force [N], one row a frame: area, low and high [m^2], and area by the ring [m^2]."""

    force_n: Float[ndarray, " f"]
    area_m2: Float[ndarray, "f 3"]
    ring_m2: Float[ndarray, " f"]


@dataclass(frozen=True)
class PressReading:
    """Readings of what was touched.

    Attributes:
        stiffness: by images and force alone.
        stiffness_both: with the approach beside them; None without one.
        area: of the contact, at 4 N; None where the calibration knows no area.
        spread_rate: dA/dF by regression, of the same.
        modulus, radius: E* and R of the object by both cues, the tip being a Hertz pair; None without an
            approach or areas.
        course: the area of every frame.
    """

    stiffness: Reading
    stiffness_both: Reading | None
    area: Reading | None
    spread_rate: Reading | None
    modulus: Reading | None
    radius: Reading | None
    course: AreaCourse | None

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The readings that there are."""
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
        presses: trials.
        name: of the recording, for the readings.

    Raises:
        InputError: no press, one of another sensor, or one that does not reach the calibrated forces.
    """
    if not presses:
        raise InputError("no press; give one or more")
    reader = _PressReader(calibration, presses, name)
    rows = np.stack([touch_row(one, calibration.layout_px, calibration.levels_n) for one in presses])
    stiffness = reader.stiffness("stiffness", calibration.touch, rows)
    both = None
    if calibration.both is not None and all(one.position_m is not None for one in presses):
        beside = np.stack([approach_row(one, calibration.levels_n) for one in presses])
        both = reader.stiffness("stiffness_both_cues", calibration.both, np.hstack([rows, beside]))
    if calibration.area is None:
        return PressReading(stiffness, both, None, None, None, None, None)
    courses = [_course(calibration, one) for one in presses]
    area, rate = reader.area(courses), reader.rate(courses)
    modulus, radius = reader.modulus_and_radius(courses) if both is not None else (None, None)
    return PressReading(stiffness, both, area, rate, modulus, radius, courses[0])


def _course(calibration: ComplianceCalibration, press: PinPress) -> AreaCourse:
    assert calibration.area is not None
    assert calibration.motions is not None
    motion = motion_on_layout(press, calibration.layout_px)
    ring = np.full(len(motion), np.nan)
    if calibration.ring is not None:
        ring = calibration.ring.at(ring_measures(calibration.layout_px, motion))[:, 0]
    return AreaCourse(press.force_n, calibration.area.at(calibration.motions.of(motion), COVERAGE), ring)


class _PressReader:
    """Readings of some presses, with the flags that hold for all of them."""

    def __init__(self, calibration: ComplianceCalibration, presses: Sequence[PinPress], name: str) -> None:
        self.calibration, self.presses, self.name = calibration, presses, name
        wobble = max(wobble_px(one, calibration.layout_px) for one in presses)
        self.drift = Drift(wobble / calibration.wobble_px, MAX_DRIFT)
        self.flaws = list(dict.fromkeys(flaw for one in presses for flaw in one.flaws))
        if self.drift.drifted:
            self.flaws.append(DRIFTED)
        self.flaws += self._speed()

    def _speed(self) -> list[str]:
        low, high = self.calibration.speed_m_s
        return [
            SPEED.format(1e3 * one.speed_m_s, 1e3 * low, 1e3 * high)
            for one in self.presses
            if one.speed_m_s > SPEED_SHARE * high or one.speed_m_s < low / SPEED_SHARE
        ][:1]

    def reading(
        self, quantity: str, value: tuple[float, float, float], unit: str, range_: tuple[float, float],
        why: Sequence[str] = (), coverage: float = COVERAGE,
    ) -> Reading:  # fmt: skip
        reasons = [*self.flaws, *why]
        return Reading(
            quantity=quantity, value=value[0], low=value[1], high=value[2], unit=unit, coverage=coverage,
            calibrated_range=range_, valid=not reasons, why="; ".join(reasons), drift=self.drift,
            calibration=self.calibration.id, frame=self.name, time_s=0.0,
        )  # fmt: skip

    def stiffness(self, quantity: str, curve: SoftnessCurve, rows: Float[ndarray, "t d"]) -> Reading:
        kappa, low, high = curve.of(rows, COVERAGE).kappa_n_m
        finite = curve.kappa_n_m[np.isfinite(curve.kappa_n_m)]
        range_ = float(finite.min()), float(finite.max())
        why = [] if np.isfinite(curve.between) else [NO_BETWEEN]
        novelty = max(curve.novelty_score(row) for row in rows)
        if novelty > MAX_NOVELTY:
            why.append(UNLIKE.format(novelty, MAX_NOVELTY))
        if low > range_[1] * EDGE or high < range_[0] / EDGE:
            why.append(OUTSIDE.format(1e-3 * kappa, 1e-3 * range_[0], 1e-3 * range_[1]))
        return self.reading(quantity, (kappa, low, high), "N_per_m", range_, why)

    def area(self, courses: Sequence[AreaCourse]) -> Reading:
        fit = self._fit
        level = np.array([AREA_AT_N])
        value = np.mean([at_forces(one.force_n, one.area_m2, level)[0] for one in courses], axis=0)
        low, high = fit.range_m2
        why = [] if np.isfinite(fit.spread) else [NO_BETWEEN]
        if not low <= value[0] <= high:
            why.append(AREA_OUTSIDE.format(1e6 * value[0], 1e6 * low, 1e6 * high))
        return self.reading("area_at_4_N", (value[0], value[1], value[2]), "m2", fit.range_m2, why)

    def rate(self, courses: Sequence[AreaCourse]) -> Reading:
        """dA/dF; its relative error is at most the areas', which err together."""
        levels = self.calibration.levels_n
        rates = []
        for one in courses:
            good = (one.force_n >= levels[0]) & (one.force_n <= levels[-1] + 0.5)
            rates.append(spread(one.force_n[good], one.area_m2[good, 0]).rate_m2_n)
        rate, relative = float(np.mean(rates)), float(np.expm1(1.645 * self._fit.spread))
        low, high = self._fit.range_m2
        reach = levels[-1] - levels[0]
        why = [] if np.isfinite(self._fit.spread) else [NO_BETWEEN]
        value = (rate, rate * (1 - relative), rate * (1 + relative))
        return self.reading("spread_rate", value, "m2_per_N", (0.0, float((high - low) / reach)), why)

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
        why = [contact.why] if contact.why else []
        if not np.isfinite(self._fit.spread):
            why.append(NO_BETWEEN)
        if self.calibration.tilt_rad > HEAD_ON_RAD:
            why.append(INCLINED)
        round_ = [NO_HERTZ.format(finger.misfit, MISFIT)] if finger.misfit > MISFIT else []
        beyond = (0.0, float("inf"))
        return (
            self.reading("modulus", contact.modulus_pa, "Pa", beyond, why),
            self.reading("radius", contact.radius_m, "m", beyond, [*why, *round_]),
        )

    @property
    def _fit(self) -> AreaFit:
        assert self.calibration.area is not None
        return self.calibration.area
