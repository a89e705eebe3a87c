"""Cues of one press: its pins, the line of force over approach, and the report's route by optical flow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
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
from palpate.core import InputError, LabelError, Reading, Shaped, ndarray
from palpate.estimators.compliance.literature_method import AsReported, as_reported, circle_through_pins
from palpate.estimators.compliance.press_force import CONTACT_N, MAX_N, loading, smoothed, within
from palpate.psychophysics import Line, bootstrap_interval, fit_line
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_table import PressTable, read_press_table

LATE_N = 2.5  # the report's section V takes forces above it
UNITS = {
    "stiffness": "N_per_mm", "stiffness_both_cues": "N_per_mm", "area_at_4_N": "mm2",
    "spread_rate": "mm2_per_N", "modulus": "MPa", "radius": "mm",
}  # fmt: skip
UNCALIBRATED = (
    "no calibration was given: areas are relative and stiffness is that of sensor and specimen in series; "
    "calibrate with `palpate compliance calibrate`"
)
MIN_PLATE_R2 = 0.85  # adjusted, of a trial; the report's worst is 0.882
CURVED = "{}: adjusted R2 {:.3g}, less than {:g}: no line; look at first contact and the plate's seating"


@dataclass(frozen=True)
class PressCues:
    """Cues of a press, with and without a calibration.

    Attributes:
        trial: pins and, where it is known, area.
        series: force [N] over approach [m], sensor and specimen in series; None without a position.
        reported: the report's route over the circle through the pins, from frames above 0.5 N.
        late: the same above 2.5 N.
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
    """Cues from frames that can be read more than once, and their table.

    Raises:
        InputError, ImageError: it cannot be read as a press.
    """
    trial = reference_trial(frames, table)
    circle = circle_through_pins(trial.press.untouched_px, *next(iter(frames)).shape[:2])
    reported = as_reported(frames, table.force_n, table.frame_sample, region=circle)
    line = None if table.position_m is None else series(table)
    return PressCues(trial, line, reported, reported.above(LATE_N))


def series(table: PressTable) -> Line:
    """Force over position between 0.5 and 5 N: the stiffness of all that yields [N/m]."""
    assert table.position_m is not None
    force = smoothed(table.force_n)
    part = within(force, loading(force), CONTACT_N, MAX_N)
    return fit_line(table.position_m[part], force[part])


def read_press(
    frames: Path,
    force: Path,
    *,
    calibration: Path | None = None,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
) -> tuple[PressCues, PressReading | None]:
    """Cues of a press in files, and its readings where a calibration is given.

    Args:
        frames, force: of the press.
        calibration: of the sensor; None for the cues that need none.
        force_column, position_column, rate_hz: see `read_press_table`.

    Raises:
        PalpateError: a file that cannot be read.
    """
    tip = None if calibration is None else ComplianceCalibration.load(calibration)
    with open_sequence(frames) as sequence:
        table = read_press_table(
            force, len(sequence), force_column=force_column, position_column=position_column, rate_hz=rate_hz
        )
        cues = cues_of(sequence, table)
    return cues, None if tip is None else read_touch(tip, [cues.trial.press], frames.name)


def press_record(cues: PressCues, touch: PressReading | None) -> dict[str, Any]:
    """A press in plain numbers; what is not finite is None."""
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
    if touch is not None and touch.course is not None:
        names, course = ("area_mm2", "low_mm2", "high_mm2"), touch.course
        record["area"] = [
            {"force_N": float(f)}
            | {name: finite_or_none(1e6 * x) for name, x in zip(names, area, strict=True)}
            | {"by_ring_mm2": finite_or_none(1e6 * ring)}
            for f, area, ring in zip(course.force_n, course.area_m2, course.ring_m2, strict=True)
        ]
    return record


def reading_record(reading: Reading) -> dict[str, Any]:
    """A reading in plain numbers, in the units of the edges."""
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
        "drift": None if one.drift is None else {"statistic": one.drift.statistic, "limit": one.drift.limit},
        "drifted": bool(one.drift and one.drift.drifted),
        "calibration": one.calibration,
        "frame": one.frame,
    }


def plate_stiffness(
    tables: Sequence[Path],
    *,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
) -> dict[str, Any]:
    """Stiffness of a specimen itself: slope of force over the position of a rigid plate, 0.5 to 5 N.

    Args:
        tables: of force and position, one a trial on the same specimen.
        force_column, position_column, rate_hz: see `read_press_table`.

    Raises:
        InputError: no table, or no loading part in one.
        LabelError: a table that cannot be read, or one without a position.
    """
    if not tables:
        raise InputError("no table; give one a trial, five if you can")
    lines = {str(path): _plate_line(path, force_column, position_column, rate_hz) for path in tables}
    slopes = [1e-3 * line.slope for line in lines.values()]
    low, high = bootstrap_interval(slopes) if len(slopes) > 1 else (None, None)
    return {
        "stiffness_N_per_mm": float(np.mean(slopes)),
        "low_N_per_mm": low,
        "high_N_per_mm": high,
        "coverage": 0.95,
        "trials": [
            {"table": path, "stiffness_N_per_mm": 1e-3 * line.slope, "adjusted_r2": line.adjusted_r2}
            for path, line in lines.items()
        ],
        "flags": [
            CURVED.format(path, line.adjusted_r2, MIN_PLATE_R2)
            for path, line in lines.items()
            if not line.adjusted_r2 >= MIN_PLATE_R2
        ],
    }


def _plate_line(path: Path, force: str | None, position: str | None, rate_hz: float | None) -> Line:
    table = read_press_table(path, None, force_column=force, position_column=position, rate_hz=rate_hz)
    if table.position_m is None:
        raise LabelError(
            f"{path} has no column of position, e.g. actual_mm; stiffness is force over position"
        )
    line = series(table)
    if not line.slope > 0:
        raise InputError(f"{path}: force falls as the position grows; turn the position's sign")
    return line
