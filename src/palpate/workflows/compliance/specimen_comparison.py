"""Several specimens, several trials each: every cue as a table, its tests, and a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.core import InputError, new_folder, refuse_existing, storage_errors
from palpate.estimators.networks.model_interface import Progress, silent
from palpate.psychophysics.rank_tests import Comparison, compare
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_folder import PressFolder, press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.reports.compliance_figures import compare_figure
from palpate.workflows.compliance.press_cues import LATE_N, PressCues, cues_of

DRAWS = 2000
BESIDE = ("frames", "series_adjusted_r2")  # of the table, but no cues
LABELS = {
    "stiffness_N_per_mm": "stiffness by touch [N/mm]",
    "stiffness_both_cues_N_per_mm": "stiffness, both cues [N/mm]",
    "area_at_4_N_mm2": "area at 4 N [mm²]",
    "spread_rate_mm2_per_N": "spread rate dA/dF [mm²/N]",
    "series_stiffness_N_per_mm": "in series with the tip [N/mm]",
    "divergence_regression_per_N": "by divergence, regression [1/N]",
    "divergence_paper_per_N": "by divergence, eq. (12) [1/N]",
}

Groups = Mapping[str, Sequence[PressCues]]


def compare_specimens(
    folder: Path,
    out: Path,
    *,
    calibration: Path | None = None,
    pooled: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Compare the specimens of an experiment's folder.

    Args:
        folder: see `recordings.press_folder`.
        out: folder to make: ``trials.csv``, ``comparison.json``, ``comparison.png``.
        calibration: of the sensor; None for the cues that need none.
        pooled: also test the report's pooled samples, with a warning.
        progress: told how many presses are read.

    Returns:
        What ``comparison.json`` holds.

    Raises:
        InputError: fewer than two specimens; and as a press cannot be read.
        ExistsError: `out` exists.
    """
    refuse_existing(out)
    known = None if calibration is None else ComplianceCalibration.load(calibration)
    held = press_folder(folder)
    if len(held.specimens) < 2:
        raise InputError(f"{folder} holds one specimen; two or more can be compared")
    groups = _read(held, progress)
    table = trials_table(groups, known)
    found: dict[str, Any] = {
        "calibration": None if known is None else known.id,
        "references": [] if known is None else [name for name in groups if name in known.names],
        "trials": {name: len(each) for name, each in groups.items()},
        "cues": tests_of(table),
    }
    if known is not None:
        found["specimens"] = pooled_readings(groups, known)
    if pooled:
        found["pooled_sums"] = asdict(_pooled(groups))
    with new_folder(out) as building, storage_errors(out):
        table.to_csv(building / "trials.csv", index=False)
        (building / "comparison.json").write_text(json.dumps(_null(found), indent=1, allow_nan=False) + "\n")
        _figure(groups, table, known).savefig(building / "comparison.png")
    return _null(found) | {"out": str(out)}


def _read(held: PressFolder, progress: Progress) -> dict[str, list[PressCues]]:
    total, done = sum(len(one.presses) for one in held.specimens), 0
    groups: dict[str, list[PressCues]] = {}
    for one in held.specimens:
        groups[one.name] = []
        for frames, force in one.presses:
            with open_sequence(frames) as sequence:
                groups[one.name].append(cues_of(sequence, read_press_table(force, len(sequence))))
            done += 1
            progress("presses", done, total)
    return groups


def trials_table(groups: Groups, calibration: ComplianceCalibration | None) -> pd.DataFrame:
    """One row a trial: specimen, trial, and every cue; empty where a reading is not valid."""
    rows = [
        {"specimen": name, "trial": i + 1, **one.row(calibration, f"{name}/{i + 1}")}
        for name, each in groups.items()
        for i, one in enumerate(each)
    ]
    table = pd.DataFrame(rows)
    first = ["specimen", "trial", *(cue for cue in LABELS if cue in table)]
    return table[first + [column for column in table if column not in first]]


def tests_of(table: pd.DataFrame) -> dict[str, Any]:
    """Of every cue that trials have: means with bootstrap intervals over trials, and the tests between."""
    found = {}
    for cue in [one for one in table.columns[2:] if one not in BESIDE]:
        groups = {str(name): list(rows[cue]) for name, rows in table.groupby("specimen", sort=False)}
        groups = {name: [x for x in each if np.isfinite(x)] for name, each in groups.items()}
        groups = {name: each for name, each in groups.items() if len(each) >= 2}
        if len(groups) >= 2 and len({x for each in groups.values() for x in each}) > 1:
            found[cue] = {
                "mean": {name: float(np.mean(each)) for name, each in groups.items()},
                "interval_95": {name: bootstrap(each) for name, each in groups.items()},
                **asdict(compare(groups)),
            }
    return found


def bootstrap(values: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Interval of the mean by resampling trials: the percentile bootstrap at 95 %, too narrow for few trials.

    Of few trials it covers less often than 95 %: about 83 % with five, 76 % with three, 50 % with two.
    """
    drawn = np.random.default_rng(seed).choice(np.asarray(values), (DRAWS, len(values)))
    low, high = np.quantile(drawn.mean(axis=1), [0.025, 0.975])
    return float(low), float(high)


def pooled_readings(groups: Groups, calibration: ComplianceCalibration) -> dict[str, Any]:
    """The readings of every specimen, its trials taken together."""
    from palpate.workflows.compliance.compliance_files import plain

    return {
        name: [plain(one) for one in read_touch(calibration, [c.trial.press for c in each], name).readings]
        for name, each in groups.items()
    }


def _pooled(groups: Groups) -> Comparison:
    """Of equation (12) at every frame above 2.5 N, as the report pools them."""
    sums = {
        name: [c.reported.summed[c.reported.force_n >= LATE_N] for c in each] for name, each in groups.items()
    }
    return compare(sums, pooled=True)


def _figure(groups: Groups, table: pd.DataFrame, calibration: ComplianceCalibration | None) -> Any:
    cues = {
        label: {str(name): list(rows[cue].dropna()) for name, rows in table.groupby("specimen", sort=False)}
        for cue, label in LABELS.items()
        if cue in table
    }
    if calibration is None or calibration.area is None:
        courses = {n: [(c.reported.force_n, c.reported.area) for c in each] for n, each in groups.items()}
        return compare_figure(courses, "relative area, by divergence [-]", cues)
    areas = {
        name: [
            (course.force_n, 1e6 * course.area_m2[:, 0])
            for c in each
            for course in [read_touch(calibration, [c.trial.press]).course]
            if course is not None
        ]
        for name, each in groups.items()
    }
    return compare_figure(areas, "contact area [mm²]", cues)


def _null(held: Any) -> Any:
    """Plain containers, what is not finite as None."""
    if isinstance(held, Mapping):
        return {str(key): _null(value) for key, value in held.items()}
    if isinstance(held, list | tuple):
        return [_null(value) for value in held]
    if isinstance(held, float):
        return held if np.isfinite(held) else None
    return held
