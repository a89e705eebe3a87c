"""Fit a TacTip unit to presses, read presses by it, and reject what such a unit cannot show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.core import ImageError, InputError, Progress, RangeError, silent
from palpate.sensors.tactip.tip_copies.plate_presses import PlatePress
from palpate.sensors.tactip.tip_copies.tip_copy import TipCopy
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
