"""Stiffness of a specimen itself: a rigid plate presses it, and force rises in a line over deformation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, LabelError
from palpate.psychophysics.line_fit import Line
from palpate.recordings.exchange.press_table import read_press_table
from palpate.workflows.compliance.press_cues import series
from palpate.workflows.compliance.specimen_comparison import bootstrap

LINEAR = 0.85  # least adjusted R2 of a trial; the report's worst is 0.882
CURVED = "{}: adjusted R2 {:.3g}, less than {:g}: no line; look at first contact and the plate's seating"


def by_plate(
    tables: Sequence[Path],
    *,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
) -> dict[str, Any]:
    """Slope of force over position between 0.5 and 5 N, a value a trial, as the verb prints it.

    Args:
        tables: of force and position, one a trial on the same specimen.
        force_column, position_column, rate_hz: see `read_press_table`.

    Raises:
        InputError: no table, or no loading part in one.
        LabelError: a table that cannot be read, or one without a position.
    """
    if not tables:
        raise InputError("no table; give one a trial, five if you can")
    lines = {str(path): _line(path, force_column, position_column, rate_hz) for path in tables}
    slopes = [1e-3 * line.slope for line in lines.values()]
    low, high = bootstrap(slopes) if len(slopes) > 1 else (None, None)
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
            CURVED.format(path, line.adjusted_r2, LINEAR)
            for path, line in lines.items()
            if not line.adjusted_r2 >= LINEAR
        ],
    }


def _line(path: Path, force: str | None, position: str | None, rate_hz: float | None) -> Line:
    table = read_press_table(path, None, force_column=force, position_column=position, rate_hz=rate_hz)
    if table.position_m is None:
        raise LabelError(
            f"{path} has no column of position, e.g. actual_mm; stiffness is force over position"
        )
    line = series(table)
    if not line.slope > 0:
        raise InputError(f"{path}: force falls as the position grows; turn the position's sign")
    return line
