"""Fit a TacTip unit to presses, read presses by it, and reject what such a unit cannot show.

Check of a TacTip unit by a known weight; untouched pins do not show the moduli.

The image gives depth and shape, hence the expected force and the ratio of skin and gel. Tilted, sliding, or
moving weights are rejected; a level weight that is partly supported elsewhere is not detectable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import ImageError, InputError, Progress, RangeError, silent
from palpate.estimators.unit_fit import SAID, WEIGHT_SHARE, changed_since, drifted, since_fit, weight_n
from palpate.sensors.tactip.tip_copies.plate_presses import PlatePress
from palpate.sensors.tactip.tip_copies.tip_copy import COPY_TERMS, SPREADS, TermCovariance, TipCopy
from palpate.sensors.tactip.tip_copies.tip_estimate import PlateReading, TipCopyFit, TipEstimate

OFF_PX = 0.3  # rms misfit that is always accepted
MAX_FORCE_Z = 3.0  # maximum rms of forces' residuals in standard deviations
MIN_SPAN = 1.5  # minimum ratio of the largest to the smallest known force
SAME_PX = 0.5  # maximum rms difference of untouched pins from the unit's
MAX_TURN_RAD = math.radians(3.5)  # maximum tilt of a plate


def fit_tip_copy(
    known: TipCopy, presses: Sequence[PlatePress], progress: Progress = silent, *, advise: bool = True
) -> TipCopyFit:
    """Estimate a unit's terms, and depth, alignment, and force of each press.

    Args:
        known: Prior of the unit.
        presses: With or without forces; one is a reading, five to ten of known force calibrate.
        progress: Callback for the rounds.
        advise: Whether to rank further presses.
    """
    if not presses:
        raise InputError("no press; a copy is found from one at least", code="no-presses")
    _refuse_one_load([one.force_n for one in presses if one.force_n is not None])
    for one in presses:
        _refuse_other(known, one)
    estimate = TipEstimate(known, presses)
    found = estimate.found(estimate.settled(progress))
    _refuse_unlike(known, found)
    if known.rest_px is None:
        found = replace(found, copy=_with_layout(found, presses))
    return replace(found, helpful=estimate.helpful()) if advise else found


def read_plate_press(known: TipCopy, press: PlatePress, progress: Progress = silent) -> PlateReading:
    """Read depth and force of one press, with intervals that include the unit's uncertainty."""
    unknown = replace(press, force_n=None, position_m=None)
    return fit_tip_copy(known, [unknown], progress, advise=False).presses[0]


def _refuse_one_load(forces_n: Sequence[float]) -> None:
    if len(forces_n) > 1 and max(forces_n) < MIN_SPAN * min(forces_n):
        raise InputError(
            f"all presses have about one load, {min(forces_n):.3g} to {max(forces_n):.3g} N; stiffness and "
            f"shape are told apart by loads of which the greatest is {MIN_SPAN:g} times the least or more",
            code="one-load",
        )


def _refuse_other(known: TipCopy, one: PlatePress) -> None:
    """Reject untouched pins that differ from the unit's."""
    if known.rest_px is None or known.cells is None:
        return
    order = {cell: i for i, cell in enumerate(map(tuple, known.cells.tolist()))}
    mine = [(i, order[cell]) for i, cell in enumerate(map(tuple, one.cells.tolist())) if cell in order]
    if len(mine) < 0.9 * len(known.cells):
        raise ImageError(f"{len(mine)} of {len(known.cells)} pins are seen: another tip", code="tip-differs")
    here, there = np.array(mine).T
    off = one.rest_px[here] - known.rest_px[there]
    away = float(np.sqrt(np.mean(np.sum((off - off.mean(axis=0)) ** 2, axis=1))))
    if away > SAME_PX:
        raise ImageError(
            f"untouched pins stand {away:.2f} px (rms) from the copy's, and {SAME_PX:g} px are allowed: "
            "another tip, or its camera or lens has moved; fit the copy anew",
            code="tip-differs",
        )


def _refuse_unlike(known: TipCopy, found: TipCopyFit) -> None:
    for one in found.presses:
        if math.hypot(*one.turn_rad) > MAX_TURN_RAD:
            raise ImageError(
                f"the plate leans by {math.degrees(math.hypot(*one.turn_rad)):.1f} degrees, and to "
                f"{math.degrees(MAX_TURN_RAD):.1f} presses are taken for flat: lay it level on the apex, so "
                "that it rests on the tip alone",
                code="plate-inclined",
            )
        if one.off_px > max(OFF_PX, known.limit_off * one.motion_px):
            raise ImageError(
                f"pins differ from the nearest press of this tip by {one.off_px:.2f} px of "
                f"{one.motion_px:.1f} px of motion, and {known.limit_off:.0%} are allowed: another tip, "
                "no flat rigid plate, one that slides or leans, or known forces of other frames",
                code="pins-differ",
            )
    if found.forces_off > MAX_FORCE_Z:
        raise RangeError(
            f"known forces are {found.forces_off:.1f} standard deviations (rms) from what any tip between "
            f"the tables would have, and {MAX_FORCE_Z:g} are allowed: forces of other frames, or known "
            "less well than was said",
            code="forces-differ",
        )


def _with_layout(found: TipCopyFit, presses: Sequence[PlatePress]) -> TipCopy:
    """Unit with the mean untouched pins of presses that show the first one's."""
    first = presses[0]
    same = [one for one in presses if np.array_equal(one.cells, first.cells)]
    rest = np.mean([one.rest_px - one.rest_px.mean(axis=0) for one in same], axis=0)
    return replace(found.copy, rest_px=rest, cells=first.cells)


FLOOR = 0.015  # minimum relative uncertainty of the stiffness
MAX_LEAN_RAD = math.radians(2.0)  # maximum tilt from the unit's usual one
MAX_SLIDE_PX = 1.0  # maximum shift of the whole field
STILL_MM = 0.05  # maximum difference of depth between frames
STILL_RAD = math.radians(1.0)  # maximum difference of tilt between frames
CHANGED = ("stiffness", "ratio")


@dataclass(frozen=True, slots=True)
class TipWeightCheck:
    """Result of a weight check of a calibrated unit.

    Attributes:
        force_n, read_n: Weight, and force read from the frames [N].
        stiffness_change, ratio_change: Relative changes of all forces, and of the ratio of skin and gel.
        stiffness_deviations, ratio_deviations: Changes in standard deviations.
        least_change: Minimum detectable relative change of the stiffness.
    """

    force_n: float
    read_n: float
    depth_mm: float
    stiffness_change: float
    ratio_change: float
    stiffness_deviations: float
    ratio_deviations: float
    least_change: float

    @property
    def drifted(self) -> tuple[str, ...]:
        """Names of the changed constants, of `CHANGED`."""
        return drifted(dict(zip(CHANGED, (self.stiffness_deviations, self.ratio_deviations), strict=True)))


def check_tip_weight(
    calibrated: TipCopy, presses: Sequence[PlatePress], mass_kg: float, progress: Progress = silent
) -> TipWeightCheck:
    """Compare a calibrated unit with a flat rigid object of known mass that lies level on the tip.

    Args:
        calibrated: Unit.
        presses: Frames of the weight at rest, which must agree; their forces and positions are ignored.
        mass_kg: Total mass on the tip [kg].
        progress: Callback for the rounds.
    """
    force_n = weight_n(mass_kg)
    if not presses:
        raise InputError("no frame of the weight; give one or several")
    unknown = [replace(one, force_n=None, position_m=None) for one in presses]
    design = np.diag([SPREADS[name] ** 2 for name in COPY_TERMS])
    now, freedom = since_fit(calibrated.covariance, design, len(CHANGED))
    known = replace(calibrated, covariance=now)
    read = [read_plate_press(known, one, progress) for one in unknown]
    _refuse_unsteady(calibrated, read)
    read_n = float(np.mean([one.force_n for one in read]))
    share = math.hypot(read[0].force_share, WEIGHT_SHARE, FLOOR)
    change = math.log(force_n / read_n)
    ratio, ratio_sd = _ratio_change(known, freedom, unknown[0], force_n, progress)
    return TipWeightCheck(
        force_n,
        read_n,
        float(np.mean([one.depth_mm for one in read])),
        math.expm1(change),
        math.expm1(ratio),
        change / share,
        ratio / ratio_sd,
        math.expm1(SAID * share),
    )


def _refuse_unsteady(calibrated: TipCopy, read: Sequence[PlateReading]) -> None:
    depths = [one.depth_mm for one in read]
    if max(depths) - min(depths) > STILL_MM:
        raise ImageError(
            f"the weight's frames differ by {max(depths) - min(depths):.2f} mm of depth, and {STILL_MM:g} mm "
            "are allowed: it rolls or rocks; wait until it rests",
            code="weight-moved",
        )
    turns = np.array([one.turn_rad for one in read])
    rocks = float(np.hypot(*np.ptp(turns, axis=0)))
    if rocks > STILL_RAD:
        raise ImageError(
            f"the weight's frames differ by {math.degrees(rocks):.1f} degrees of lean, and "
            f"{math.degrees(STILL_RAD):g} are allowed: it rolls or rocks; wait until it rests",
            code="weight-moved",
        )
    usual = calibrated.terms[8:10]
    for one in read:
        lean = math.hypot(*(np.array(one.turn_rad) - usual))
        if lean > MAX_LEAN_RAD:
            raise ImageError(
                f"the weight leans by {math.degrees(lean):.1f} degrees, and {math.degrees(MAX_LEAN_RAD):g} "
                "are allowed: part of it rests elsewhere, or it rolls; lay it level, on the tip alone",
                code="weight-inclined",
            )
        slide = math.hypot(*one.shift_px)
        if slide > MAX_SLIDE_PX:
            raise ImageError(
                f"the field of pins is {slide:.1f} px aside, and {MAX_SLIDE_PX:g} px are allowed: the weight "
                "slides or is pushed; let it rest on the tip alone",
                code="weight-slid",
            )


def _ratio_change(
    known: TipCopy, free: TermCovariance, press: PlatePress, force_n: float, progress: Progress
) -> tuple[float, float]:
    """Change of the log ratio if stiffness and ratio are both free, and its standard deviation."""
    freed = replace(known, covariance=known.covariance + free)
    weighed = replace(press, force_n=force_n, force_sd_n=WEIGHT_SHARE * force_n)
    now = fit_tip_copy(freed, [weighed], progress, advise=False).copy
    change, spread = changed_since(now.terms - known.terms, free, known.covariance, now.covariance)
    return float(change[1]), math.sqrt(max(float(spread[1, 1]), 0.0))
