"""Compliance from files: one press against a calibration, and a calibration from a folder of references."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    calibrate_compliance,
    load_references,
)
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.core import InputError, Reading, new_folder, refuse_existing
from palpate.estimators.networks.model_interface import Progress, silent
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_folder import press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.reports.compliance_figures import press_figure
from palpate.workflows.compliance.press_cues import UNITS, PressCues, cues_of

UNCALIBRATED = (
    "no calibration was given: areas are relative and stiffness is that of sensor and specimen in series; "
    "calibrate with `palpate compliance calibrate`"
)


def read_files(
    frames: Path,
    force: Path,
    *,
    calibration: Path | None = None,
    out: Path | None = None,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
) -> dict[str, Any]:
    """What one press says, as the verb prints it.

    Args:
        frames, force: of the press.
        calibration: of the sensor; None for what can be said without.
        out: folder to make with ``press.png`` and ``readings.json``; None for neither.
        force_column, position_column, rate_hz: see `read_press_table`.

    Raises:
        PalpateError: what cannot be read; a folder that exists.
    """
    if out is not None:
        refuse_existing(out)
    known = None if calibration is None else ComplianceCalibration.load(calibration)
    with open_sequence(frames) as sequence:
        table = read_press_table(
            force,
            len(sequence),
            force_column=force_column,
            position_column=position_column,
            rate_hz=rate_hz,
        )
        cues = cues_of(sequence, table)
    touch = None if known is None else read_touch(known, [cues.trial.press], frames.name)
    found = said(cues, touch)
    if out is not None:
        with new_folder(out) as building:
            (building / "readings.json").write_text(json.dumps(found, indent=1, allow_nan=False) + "\n")
            press_figure(cues.trial, touch, cues.reported).savefig(building / "press.png")
        found["out"] = str(out)
    return found


def said(cues: PressCues, touch: PressReading | None) -> dict[str, Any]:
    """A press in plain numbers; what is not finite is null."""
    press, reported = cues.trial.press, cues.reported
    found: dict[str, Any] = {
        "readings": [] if touch is None else [plain(one) for one in touch.readings],
        "flags": list(press.flaws) + ([UNCALIBRATED] if touch is None else []),
        "frames": len(press.force_n),
        "force_N": [float(press.force_n[0]), float(press.force_n[-1])],
        "pins": int(np.isfinite(press.moved_px).all(axis=(0, 2)).sum()),
        "speed_mm_s": _finite(1e3 * press.speed_m_s),
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
        line = cues.series
        found["series_stiffness"] = {
            "what": "sensor and specimen in series",
            "value_N_per_mm": 1e-3 * line.slope,
            "adjusted_r2": _finite(line.adjusted_r2),
        }
    if touch is not None and touch.course is not None:
        course = touch.course
        found["area"] = [
            {
                "force_N": float(f),
                **{
                    name: _finite(1e6 * x)
                    for name, x in zip(("area_mm2", "low_mm2", "high_mm2"), a, strict=True)
                },
                "by_ring_mm2": _finite(1e6 * ring),
            }
            for f, a, ring in zip(course.force_n, course.area_m2, course.ring_m2, strict=True)
        ]
    return found


def plain(reading: Reading) -> dict[str, Any]:
    """A reading as JSON has it."""
    one = reading.in_unit(UNITS[reading.quantity])
    return {
        "quantity": one.quantity,
        "value": _finite(one.value),
        "low": _finite(one.low),
        "high": _finite(one.high),
        "unit": one.unit,
        "coverage": one.coverage,
        "calibrated_range": [_finite(x) for x in one.calibrated_range],
        "valid": one.valid,
        "why": one.why,
        "drift": None if one.drift is None else {"statistic": one.drift.statistic, "limit": one.drift.limit},
        "drifted": bool(one.drift and one.drift.drifted),
        "calibration": one.calibration,
        "frame": one.frame,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def calibrate_folder(
    folder: Path, out: Path, *, tilt_deg: float = 0.0, note: str = "", progress: Progress = silent
) -> dict[str, Any]:
    """Calibrate on the specimens of known stiffness in a folder; what was found, as the verb prints it.

    Args:
        folder: of an experiment; see `recordings.press_folder`.
        out: ``.npz`` to make.
        tilt_deg: of the specimens' tops [deg].
        note: kept with the calibration.
        progress: told how many presses are read.

    Raises:
        PalpateError: a folder, press or reference that cannot be used; `out` exists.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out} is not an .npz file; name the calibration e.g. tip.npz")
    refuse_existing(out)
    references = load_references(press_folder(folder), progress)
    made = calibrate_compliance(references, tilt_rad=float(np.deg2rad(tilt_deg)), note=note)
    made.save(out)
    return {
        "calibration": made.id,
        "out": str(out),
        "references": [
            {
                "specimen": one.name,
                "stiffness_N_per_mm": _finite(1e-3 * one.kappa_n_m),
                "trials": len(one.trials),
            }
            for one in references
        ],
        "pins": len(made.layout_px),
        "error_between_references": _finite(made.touch.between),
        "error_between_references_both_cues": None if made.both is None else _finite(made.both.between),
        "area_known": made.area is not None,
        "area_error": None if made.area is None else _finite(made.area.spread),
        "tilt_deg": tilt_deg,
    }
