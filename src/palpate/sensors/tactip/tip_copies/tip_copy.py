"""One TacTip unit: its terms and their prior.

On a flat rigid plate an image determines depth, alignment, the ratio of skin and gel moduli, pins, and
camera; the force is proportional to the moduli and determines the stiffness. Calibration, reading, and weight
check are one estimate that differs only in the prior.

A TacTip unit on disk.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import Float, InputError, Int, RangeError, ndarray
from palpate.core.parsing import parser
from palpate.estimators.unit_fit import correlated_pairs, read_unit, term_rows, write_unit
from palpate.mechanics.axisymmetric.tip_table import tip_between
from palpate.sensors.tactip.posed_tip import TipOptics
from palpate.sensors.tactip.tactip_sensor import tactip
from palpate.sensors.tactip.tactip_spec import TacTipSpec

COPY_TERMS = (
    "stiffness", "ratio", "lever_mm", "camera_mm", "distortion", "edge_rad", "axis_x_mm", "axis_y_mm",
    "seat_x_rad", "seat_y_rad",
)  # fmt: skip
"""Log force at `STATED_MM` over the design's; log ratio of skin and gel moduli; length of the pins; height of
the pinhole above the apex; lens distortion at the outermost ring, and polar angle of its roots; offset of the
dome's axis from the camera's; usual rotation of the contact about the dome's centre."""

STATED_MM = 3.0  # depth at which the stiffness is stated

SPREADS = {
    "stiffness": 0.25, "ratio": 0.6, "lever_mm": 0.3, "camera_mm": 3.0, "distortion": 0.04, "edge_rad": 0.015,
    "axis_x_mm": 0.5, "axis_y_mm": 0.5, "seat_x_rad": 0.015, "seat_y_rad": 0.015,
}  # fmt: skip
"""Standard deviations of units about their design. Assumed."""

TermVector = Float[ndarray, " t"]
TermCovariance = Float[ndarray, "t t"]


@dataclass(frozen=True, eq=False)
class TipCopy:
    """A unit of the TacTip.

    Attributes:
        spec: Design.
        terms: Values of `COPY_TERMS`.
        rest_px: Untouched pins (x, y) from their middle [px]; None before the first press.
        cells: Lattice cells of these pins.
        limit_off: Maximum misfit of an image over the pins' motion.
    """

    spec: TacTipSpec
    terms: TermVector
    covariance: TermCovariance
    rest_px: Float[ndarray, "p 2"] | None = None
    cells: Int[ndarray, "p 2"] | None = None
    limit_off: float = 0.12

    @property
    def optics(self) -> TipOptics:
        return TipOptics(*self.terms[2:6].tolist())

    @property
    def stiffness_share(self) -> float:
        """Relative standard deviation of the force at 3 mm."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def stated_force_n(self) -> float:
        """Force at 3 mm [N]."""
        return design_force_n(self.spec, STATED_MM) * math.exp(self.terms[0])

    @property
    def moduli_pa(self) -> tuple[float, float]:
        """Young's moduli of skin and gel for the tables' dimensions [Pa]."""
        tip = tip_between(float(self.terms[1]))
        scale = self.stated_force_n / float(tip.press.force_at(np.array([1e-3 * STATED_MM]))[0])
        return scale * tip.skin_pa, scale * tip.gel_pa

    @property
    def told(self) -> dict[str, dict[str, float]]:
        """Each term with its standard deviation."""
        return term_rows(COPY_TERMS, self.terms, self.covariance)

    @property
    def tied(self) -> tuple[tuple[str, str], ...]:
        """Pairs of strongly correlated terms."""
        return correlated_pairs(COPY_TERMS, self.covariance)


def design_force_n(spec: TacTipSpec, depth_mm: float) -> float:
    """Return the force of the design's tip on a rigid plate [N]."""
    return float(spec.table.press(math.inf).force_at(np.array([1e-3 * depth_mm]))[0])


def designed_tip(spec: TacTipSpec, spreads: Mapping[str, float] = SPREADS) -> TipCopy:
    """Return the prior of a unit: its design, and standard deviations of `COPY_TERMS`."""
    sd = np.array([spreads[name] for name in COPY_TERMS])
    if not (np.isfinite(sd).all() and (sd > 0).all()):
        raise RangeError(f"spreads {dict(spreads)}; give finite ones above 0", code="not-positive")
    table, pins = spec.table, spec.pins
    along = np.arange(pins.rings)  # one side of the outermost ring
    away = pins.pitch_m * np.sqrt(pins.rings**2 - pins.rings * along + along**2)
    edge_rad = float(np.arcsin(away / spec.inner_radius_m).mean())
    terms = [
        0.0, math.log(table.skin_pa / table.gel_pa), 1e3 * pins.length_m, 1e3 * spec.camera.height_m, 0.0,
        edge_rad, 0.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip
    return TipCopy(spec, np.array(terms), np.diag(sd**2))


TIP_COPY_FORMAT = "palpate tip copy 1"


def write_tip_copy(copy: TipCopy, design: str, path: Path) -> None:
    """Write a unit of the preset `design` with its untouched pins as JSON; the path must not exist."""
    if copy.rest_px is None or copy.cells is None:
        raise InputError("this copy has seen no press; fit it to presses first", code="no-presses")
    others = {
        "preset": design, "rest_px": copy.rest_px.tolist(), "cells": copy.cells.tolist(),
        "limit_off": copy.limit_off,
    }  # fmt: skip
    write_unit(path, TIP_COPY_FORMAT, COPY_TERMS, copy.terms, copy.covariance, others)


@parser("tip unit", InputError)
def load_tip_copy(path: Path) -> TipCopy:
    """Read a unit written by `write_tip_copy`."""
    return read_unit(path, TIP_COPY_FORMAT, COPY_TERMS, "palpate calibrate --method tip-unit", _made)


def _made(record: dict[str, Any], terms: ndarray, covariance: ndarray) -> TipCopy:
    rest, cells = np.array(record["rest_px"], np.float64), np.array(record["cells"], np.int64)
    spec, limit = tactip(str(record["preset"])).spec, float(record["limit_off"])
    if not (rest.shape == cells.shape == (len(rest), 2) and len(rest) > 0):
        raise ValueError("its pins and their cells do not fit each other")
    if not (np.isfinite(rest).all() and math.isfinite(limit)):
        raise ValueError("places of pins, or the limit of a misfit, are not finite")
    return TipCopy(spec, terms, covariance, rest, cells, limit)
