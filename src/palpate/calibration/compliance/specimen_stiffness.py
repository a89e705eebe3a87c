"""Stiffness of a specimen itself: slope of force over the position of a rigid plate pressed onto it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.press_nuisances import Nuisances
from palpate.core import InputError, LabelError
from palpate.estimators.compliance.press_force import CONTACT_N, MAX_N, loading, smoothed, within
from palpate.psychophysics import Line, fit_line, mean_interval
from palpate.recordings.exchange.press_table import PressTable, read_press_table

MIN_PLATE_R2 = 0.85  # adjusted, of a trial; the report's worst is 0.882
CURVED = "{}: adjusted R2 {:.3g}, less than {:g}: no line; look at first contact and the plate's seating"


def series_line(table: PressTable) -> Line:
    """Fit force over position between 0.5 and 5 N: the stiffness of all that yields [N/m]."""
    assert table.position_m is not None
    force = smoothed(table.force_n)
    part = within(force, loading(force), CONTACT_N, MAX_N)
    return fit_line(table.position_m[part], force[part])


def plate_stiffness(
    tables: Sequence[Path],
    *,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    nuisances: Nuisances | None = None,
) -> dict[str, Any]:
    """Return a specimen's stiffness: slope of force over the position of a rigid plate, 0.5 to 5 N.

    The interval contains the trials' scatter and the shared errors of the force scale and the frame's
    compliance.

    Args:
        tables: force and position, one per trial on the same specimen.
        nuisances: standard sizes of force gain and frame compliance; None for the standard ones.
    """
    if not tables:
        raise InputError("no table; give one a trial, five if you can")
    lines = {str(path): _plate_line(path, force_column, position_column, rate_hz) for path in tables}
    slopes = [1e-3 * line.slope for line in lines.values()]
    mean = float(np.mean(slopes))
    sizes = Nuisances() if nuisances is None else nuisances
    shared = mean * math.hypot(sizes.force_gain, 1e3 * mean * sizes.frame_yield_m_n)
    low, high = mean_interval(slopes, known_sd=shared) if len(slopes) > 1 else (None, None)
    return {
        "stiffness_N_per_mm": mean,
        "low_N_per_mm": low,
        "high_N_per_mm": high,
        "coverage": 0.95,
        "contained": {"force_gain": sizes.force_gain, "frame_yield_mm_per_N": 1e3 * sizes.frame_yield_m_n},
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
    line = series_line(table)
    if not line.slope > 0:
        raise InputError(f"{path}: force falls as the position grows; turn the position's sign")
    return line
