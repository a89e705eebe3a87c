"""Every cue of one press: its pins, the line of force over approach, and the report's route by flow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceTrial,
    followed,
)
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.core import Shaped, ndarray
from palpate.estimators.compliance.literature_method import AsReported, as_reported, over_pins
from palpate.estimators.compliance.press_force import (
    CONTACT_N,
    MAX_N,
    loading,
    moving_average,
    within,
    without_spikes,
)
from palpate.psychophysics.line_fit import Line, fit_line
from palpate.recordings.exchange.press_table import PressTable

LATE_N = 2.5  # the report's section V takes forces above it
UNITS = {
    "stiffness": "N_per_mm", "stiffness_both_cues": "N_per_mm", "area_at_4_N": "mm2",
    "spread_rate": "mm2_per_N", "modulus": "MPa", "radius": "mm",
}  # fmt: skip


@dataclass(frozen=True)
class PressCues:
    """Of one press.

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
        """One number a cue, its unit in its name; what cannot be told is left out."""
        row: dict[str, float] = {}
        if calibration is not None:
            row |= numbers(read_touch(calibration, [self.trial.press], name))
        if self.series is not None:
            row["series_stiffness_N_per_mm"] = 1e-3 * self.series.slope
            row["series_adjusted_r2"] = self.series.adjusted_r2
        row["accumulated_divergence"] = float(self.reported.divergence.sum())
        row["frames"] = float(len(self.reported.force_n))
        for way, found in self.late.spreads.items():
            row[f"divergence_{way}_per_N"] = found.rate_m2_n
        return row


def numbers(touch: PressReading) -> dict[str, float]:
    """Values of the valid readings, in the units of the edges."""
    converted = [reading.in_unit(UNITS[reading.quantity]) for reading in touch.readings if reading.valid]
    return {reading.column: reading.value for reading in converted}


def cues_of(frames: Iterable[Shaped[ndarray, ...]], table: PressTable) -> PressCues:
    """From frames that can be gone through more than once, and their table.

    Raises:
        InputError, ImageError: it cannot be read as a press.
    """
    trial = followed(frames, table)
    circle = over_pins(trial.press.untouched_px, *next(iter(frames)).shape[:2])
    reported = as_reported(frames, table.force_n, table.frame_sample, region=circle)
    return PressCues(
        trial,
        None if table.position_m is None else series(table),
        reported,
        reported.above(LATE_N),
    )


def series(table: PressTable) -> Line:
    """Force over position between 0.5 and 5 N: the stiffness of all that yields [N/m]."""
    assert table.position_m is not None
    smooth = moving_average(without_spikes(table.force_n))
    part = within(smooth, loading(smooth), CONTACT_N, MAX_N)
    return fit_line(table.position_m[part], smooth[part])
