"""Cues of one press: its pins, the line of force over approach, and the report's route by optical flow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceTrial,
    finite_or_none,
    reference_trial,
)
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.calibration.compliance.latency_file import CameraLatency, with_latency
from palpate.calibration.compliance.reference_stiffness import series_line
from palpate.core import Reading, Shaped, ndarray
from palpate.core.reading import SEPARATOR
from palpate.estimators.compliance.spread_rate import (
    AsReported,
    as_reported,
    circle_through_pins,
)
from palpate.estimators.pins import grey_frame
from palpate.psychophysics import Line
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_table import PressTable, read_press_table

LATE_N = 2.5  # the report's section V takes forces above it
UNITS = {
    "stiffness": "N_per_mm", "stiffness_both_cues": "N_per_mm", "area_at_4_N": "mm2",
    "spread_rate": "mm2_per_N", "modulus": "MPa", "radius": "mm",
}  # fmt: skip
UNCALIBRATED = (
    "no calibration was given: areas are relative and stiffness is that of sensor and specimen in series; "
    "calibrate with `palpate calibrate --method compliance`"
)


@dataclass(frozen=True)
class PressCues:
    """Cues of a press, with and without a calibration.

    Attributes:
        trial: pins and, if known, area.
        series: force [N] over approach [m] of sensor and specimen in series; None without position.
        reported, late: the published route over the circle through the pins, above 0.5 and above 2.5 N.
    """

    trial: ReferenceTrial
    series: Line | None
    reported: AsReported
    late: AsReported

    def row(self, calibration: ComplianceCalibration | None, name: str = "") -> dict[str, float]:
        """One number a cue, its unit in its name; cues that this press does not have are left out."""
        row: dict[str, float] = {}
        if calibration is not None:
            touch = read_touch(calibration, [self.trial.press], name)
            readings = [one.in_unit(UNITS[one.quantity]) for one in touch.readings if one.valid]
            row |= {reading.column: reading.value for reading in readings}
        if self.series is not None:
            row["series_stiffness_N_per_mm"] = 1e-3 * self.series.slope
            row["series_adjusted_r2"] = self.series.adjusted_r2
        row["accumulated_divergence"] = float(self.reported.divergence.sum())
        row["frames"] = float(len(self.reported.force_n))
        for way, spread in self.late.spreads.items():
            row[f"divergence_{way}_per_N"] = spread.rate_m2_n
        return row


def cues_of(frames: Iterable[Shaped[ndarray, ...]], table: PressTable) -> PressCues:
    """Return the cues of re-readable frames and their table."""
    trial = reference_trial(frames, table)
    press = trial.press
    height, width = next(iter(frames)).shape[:2]
    circle = circle_through_pins(press.untouched_px, height, width, press.cells)
    grey = (one for one in map(grey_frame, frames) if one is not None)  # others were refused with the pins
    reported = as_reported(grey, table.force_n, table.frame_sample, region=circle)
    line = None if table.position_m is None else series_line(table)
    return PressCues(trial, line, reported, reported.above(LATE_N))


def read_press(
    frames: Path,
    force: Path,
    *,
    calibration: Path | None = None,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    latency: CameraLatency | None = None,
) -> tuple[PressCues, PressReading | None]:
    """Return the cues of a press in files, and its readings if a calibration is given.

    Args:
        calibration: of the sensor; None for the cues that need none.
        latency: camera latency to take off.
    """
    tip, flag = None, ""
    if calibration is not None:
        tip, flag = with_latency(ComplianceCalibration.load(calibration), latency)
    with open_sequence(frames) as sequence:
        table = read_press_table(
            force, len(sequence), force_column=force_column, position_column=position_column, rate_hz=rate_hz
        )
        cues = cues_of(sequence, table.earlier(0.0 if latency is None else latency.seconds))
    if flag:
        press = replace(cues.trial.press, flaws=(*cues.trial.press.flaws, flag))
        cues = replace(cues, trial=replace(cues.trial, press=press))
    return cues, None if tip is None else read_touch(tip, [cues.trial.press], frames.name)


def press_record(cues: PressCues, touch: PressReading | None) -> dict[str, Any]:
    """Return a press in plain numbers; None for what is not finite."""
    press, reported = cues.trial.press, cues.reported
    record: dict[str, Any] = {
        "readings": [] if touch is None else [reading_record(one) for one in touch.readings],
        "flags": list(press.flaws) + ([UNCALIBRATED] if touch is None else []),
        "frames": len(press.force_n),
        "force_N": [float(press.force_n[0]), float(press.force_n[-1])],
        "pins": int(np.isfinite(press.moved_px).all(axis=(0, 2)).sum()),
        "speed_mm_s": finite_or_none(1e3 * press.speed_m_s),
        "as_reported": {
            "what": "relative areas, by divergence over the circle through the pins",
            "accumulated_divergence": float(reported.divergence.sum()),
            **{
                f"{way}_per_N": {"value": one.rate_m2_n, "steps": one.steps, "warning": one.warning}
                for way, one in reported.spreads.items()
            },
        },
    }
    if cues.series is not None:
        record["series_stiffness"] = {
            "what": "sensor and specimen in series",
            "value_N_per_mm": 1e-3 * cues.series.slope,
            "adjusted_r2": finite_or_none(cues.series.adjusted_r2),
        }
    if touch is not None and touch.nuisances:
        record["nuisances"] = touch.nuisances.at_edge()
        record["changes_by_nuisance"] = {
            quantity: {name: finite_or_none(share) for name, share in each.items()}
            for quantity, each in touch.budget.items()
        }
    if touch is not None and touch.course is not None:
        names, course = ("area_mm2", "low_mm2", "high_mm2"), touch.course
        record["area"] = [
            {"force_N": float(f)}
            | {name: finite_or_none(1e6 * x) for name, x in zip(names, area, strict=True)}
            for f, area in zip(course.force_n, course.area_m2, strict=True)
        ]
    return record


def reading_record(reading: Reading) -> dict[str, Any]:
    """Return a reading in plain numbers, in the units of files."""
    one = reading.in_unit(UNITS[reading.quantity])
    return {
        "quantity": one.quantity,
        "value": finite_or_none(one.value),
        "low": finite_or_none(one.low),
        "high": finite_or_none(one.high),
        "unit": one.unit,
        "coverage": one.coverage,
        "calibrated_range": [finite_or_none(x) for x in one.calibrated_range],
        "valid": one.valid,
        "why": one.why,
        "codes": one.code.split(SEPARATOR) if one.code else [],
        "drift": None if one.drift is None else {"statistic": one.drift.statistic, "limit": one.drift.limit},
        "drifted": bool(one.drift and one.drift.drifted),
        "calibration": one.calibration,
        "frame": one.frame,
    }
