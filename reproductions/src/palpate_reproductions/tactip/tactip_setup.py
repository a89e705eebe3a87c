"""The compliance report's numbers, and its experiments on the virtual TacTip.

Specimens are pressed under a rigid plate, and under the tip.

Source: Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile Optical Sensing and Optical
Flow Computation: A Biomimetic Approach, IEEE Robotics and Automation Letters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceSpecimen,
    calibrate_compliance,
)
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.calibration.compliance.press_cues import PressCues, cues_of
from palpate.calibration.compliance.reference_stiffness import series_line
from palpate.calibration.compliance.specimen_comparison import trials_table
from palpate.core import Float, Progress, ndarray
from palpate.psychophysics import Line, fit_line
from palpate.recordings.exchange.press_table import PressTable
from palpate.rig.virtual.linear_rig import LinearDrive, LinearRig
from palpate.sensors.tactip import TacTipSpec
from palpate.workflows.tactip_trials import VirtualPress, record_press, specimens_at
from palpate_reproductions.study_results import Published

NAMES = ("S1", "new", "S2", "S3")
"""Stiffest first."""

KAPPA = {
    "S1": Published(7.6, "section V"),
    "new": Published(5.3, "section V"),
    "S2": Published(3.1, "section V"),
    "S3": Published(1.1, "section V"),
}
"""By a rigid plate [N/mm]."""

KAPPA_NEW = {
    0: Published(4.99, "section V, Fig. 7"),
    30: Published(3.95, "section V, Fig. 9"),
    45: Published(6.8, "section V, Fig. 9"),
}
"""Of the new specimen by touch, at each tilt in degrees [N/mm]."""

ADJUSTED_R2 = Published(0.882, "section V, the worst of Fig. 5(a)")
RANK_SUM_P = Published(9.91e-55, "section V, the worst pair of Fig. 5(b), pooled samples")
KRUSKAL_P = Published(6.3e-5, "section V, Fig. 6(b)")
DUNN_P = {
    0: Published(0.01, "section V, Fig. 6(b), worst pair, 'LSD'"),
    30: Published(0.01, "section V, Fig. 9(b), worst pair, 'LSD'"),
    45: Published(0.005, "section V, Fig. 9(d), worst pair, 'LSD'"),
}


RIGID = "rigid"
REFERENCES = (RIGID, "S1", "S2", "S3")
NEW = "new"


def kappa_n_m(name: str) -> float:
    """Stiffness of a specimen [N/m]."""
    return float("inf") if name == RIGID else 1e3 * KAPPA[name].value


def press_table_of(trial: VirtualPress) -> PressTable:
    """A trial's table, as if read from a file."""
    return PressTable(
        trial.time_s, trial.raw_n, trial.position_m, trial.true_area_m2, trial.frame_sample,
        "force_raw_N", "actual_mm", "true_area_mm2", False,
    )  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """Specimens at one tilt.

    Attributes:
        calibration: on the first five trials of the references.
        touch: readings of the new specimen, its trials together.
        table: a row a trial that the calibration has not seen, with every cue.
    """

    tilt_deg: int
    cues: Mapping[str, tuple[PressCues, ...]]
    calibration: ComplianceCalibration
    touch: PressReading
    table: pd.DataFrame

    def unseen(self) -> dict[str, tuple[PressCues, ...]]:
        """Trials of the specimens, stiffest first, that the calibration has not seen."""
        counts = self.table["specimen"].value_counts()
        return {name: self.cues[name][-counts[name] :] for name in NAMES}


def press_all(
    spec: TacTipSpec, tilt_deg: int, seed: int, *, calibrating: int, testing: int, progress: Progress
) -> Experiment:
    """Press, calibrate on the references, read the rest.

    Args:
        calibrating, testing: trials of each reference; the new specimen has `testing` alone.
        progress: called at every press.
    """
    counts = {RIGID: calibrating} | dict.fromkeys(("S1", "S2", "S3"), calibrating + testing) | {NEW: testing}
    kappas = {name: kappa_n_m(name) for name in counts}
    specimens = specimens_at(spec, kappas, float(np.deg2rad(tilt_deg)), progress=progress)
    done, total, cues = 0, sum(counts.values()), {}
    for i, (name, count) in enumerate(counts.items()):
        results = []
        for k in range(count):
            trial = record_press(spec, specimens[name], seed=100_000 * seed + 1000 * tilt_deg + 100 * i + k)
            results.append(cues_of(list(trial.frames()), press_table_of(trial)))
            done += 1
            progress(f"presses at {tilt_deg} degrees", done, total)
        cues[name] = tuple(results)
    calibration = calibrate_compliance(
        [
            ReferenceSpecimen(name, kappa_n_m(name), tuple(c.trial for c in cues[name][:calibrating]))
            for name in REFERENCES
        ],
        tilt_rad=float(np.deg2rad(tilt_deg)),
        note=f"virtual {spec.tip} tip",
    )
    table = trials_table({name: cues[name][-testing:] for name in NAMES}, calibration)
    touch = read_touch(calibration, [c.trial.press for c in cues[NEW]], NEW)
    return Experiment(tilt_deg, cues, calibration, touch, table)


PLATE_N = 5.5  # to which a specimen is pressed under the plate


@dataclass(frozen=True)
class Plate:
    """A specimen under a rigid plate: lines of its trials, and the samples of the first."""

    lines: tuple[Line, ...]
    position_m: Float[ndarray, " s"]
    force_n: Float[ndarray, " s"]


Displacement = Literal["encoder", "command"]


def under_plate(
    spec: TacTipSpec,
    name: str,
    trials: int,
    seed: int,
    rig: LinearRig | None = None,
    over: Displacement = "encoder",
) -> Plate:
    """Force over deformation between 0.5 and 5 N at the rig's speed, rates and noise; F = kappa d.

    Args:
        spec: the sensor, of whose rig are speed, force sensor and seating.
        rig: that drives the plate; None for an ideal one, whose encoder has what was asked for.
        over: deformation as the encoder has it, or as it was asked for.
    """
    lines, tables = [], []
    for k in range(trials):
        rng = np.random.default_rng([seed, k])
        tables.append(_plate_table(spec, kappa_n_m(name), rng, rig, over))
        lines.append(series_line(tables[-1]))
    position = tables[0].position_m
    assert position is not None
    return Plate(tuple(lines), position, tables[0].force_n)


def _plate_table(
    spec: TacTipSpec, kappa: float, rng: np.random.Generator, rig: LinearRig | None, over: Displacement
) -> PressTable:
    sensor, step = spec.force, spec.force.resolution_n
    start = -1e-3 - rng.uniform(0, spec.speed_m_s / spec.camera.rate_hz)
    behind = 0.0 if rig is None else rig.lag_m(spec.speed_m_s, PLATE_N)
    n = int((PLATE_N / kappa + behind - start) / spec.speed_m_s * sensor.rate_hz)
    time = np.arange(n) / sensor.rate_hz
    asked = start + spec.speed_m_s * time
    depth = asked if rig is None else _driven(rig, asked, kappa, sensor.rate_hz)
    force = kappa * np.maximum(depth, 0) + sensor.noise_n * rng.standard_normal(n)
    read = asked if rig is None or over == "command" else rig.read_m(depth)
    displacement = read + spec.seating.position_m * rng.standard_normal()
    steps_n = step * np.rint(force / step)
    return PressTable(
        time, steps_n, displacement, None, np.arange(n), "force_raw_N", "actual_mm", None, False
    )  # fmt: skip


def _driven(
    rig: LinearRig, asked_m: Float[ndarray, " s"], kappa: float, rate_hz: float
) -> Float[ndarray, " s"]:
    """Depths of a plate at samples, each place asked for until the next sample [m]."""
    ticks, drive = rig.ticks_in(rate_hz), LinearDrive(rig, float(asked_m[0]))
    places = drive.follow(np.repeat(asked_m[:-1], ticks), np.array([0.0, 1.0]), np.array([0.0, kappa]))
    return np.concatenate([asked_m[:1], places[ticks - 1 :: ticks]])


def stiffness_line(experiment: Experiment, cue: str) -> tuple[Line, float]:
    """The report's route: a line of kappa [N/mm] over a cue of S1 to S3, and the new specimen's mean cue."""
    rows = experiment.table[["specimen", cue]].dropna()
    known = rows[rows["specimen"] != NEW]
    kappa = known["specimen"].map(lambda name: KAPPA[name].value).to_numpy(np.float64)
    new = rows.loc[rows["specimen"] == NEW, cue].mean()
    return fit_line(known[cue].to_numpy(np.float64), kappa), float(new)
