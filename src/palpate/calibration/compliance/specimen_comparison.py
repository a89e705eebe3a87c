"""Specimens of an experiment compared: a table with a row a trial, and rank tests of every cue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    finite_or_none,
    read_presses,
)
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.latency_file import CameraLatency, with_latency
from palpate.calibration.compliance.press_cues import LATE_N, PressCues, cues_of, reading_record
from palpate.core import InputError, Progress, silent
from palpate.psychophysics import (
    compare,
    compare_grouped,
    corrected_by_holm,
    mean_interval,
    refuse_confounded,
)
from palpate.psychophysics.grouped_trials import DEGREES_OF_FREEDOM
from palpate.recordings.exchange.press_folder import PressFolder, press_folder, trial_groups

BESIDE = ("frames", "series_adjusted_r2")  # in the table, but no cues
IGNORES_GROUPS = (
    "ranks, Student's intervals and Kolmogorov and Smirnov's test take every trial as independent, which "
    "trials of one {} are not: use the mixed model"
)
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


@dataclass(frozen=True)
class SpecimenComparison:
    """Comparison of specimens.

    Attributes:
        groups: cues of every trial, by specimen.
        table: one row per trial, see `trials_table`.
        differences: one row per cue and pair of specimens, by the mixed model; None without named groups.
        record: tests and means in plain numbers, as in ``comparison.json``.
    """

    groups: Groups
    table: pd.DataFrame
    calibration: ComplianceCalibration | None
    record: dict[str, Any]
    differences: pd.DataFrame | None = None


def compare_specimens(
    folder: Path,
    *,
    calibration: Path | None = None,
    pooled: bool = False,
    groups: Sequence[str] = (),
    latency: CameraLatency | None = None,
    progress: Progress = silent,
) -> SpecimenComparison:
    """Compare the specimens of an experiment's folder.

    Args:
        folder: see `recordings.exchange.press_folder`.
        calibration: of the sensor; None for the cues that need none.
        pooled: also test the report's pooled samples, with a warning.
        groups: columns of ``trials.csv`` for a mixed model, the outer one first; see
            `psychophysics.compare_grouped`.
        latency: camera latency to take off.

    Raises:
        InputError: fewer than two specimens, groups of one specimen each, or a calibration that does not fit
            the latency.
        LabelError: ``trials.csv`` lacks the groups of a press.
    """
    known = None
    if calibration is not None:
        known, apart = with_latency(ComplianceCalibration.load(calibration), latency)
        if apart:
            raise InputError(apart)
    experiment = press_folder(folder)
    if len(experiment.specimens) < 2:
        raise InputError(f"{folder} holds one specimen; two or more can be compared")
    shared = _shared_by_trials(experiment, groups)
    late_s = 0.0 if latency is None else latency.seconds
    presses = read_presses(experiment.specimens, cues_of, progress, late_s)
    table = trials_table(presses, known)
    record: dict[str, Any] = {
        "calibration": None if known is None else known.id,
        "references": [] if known is None else [name for name in presses if name in known.names],
        "trials": {name: len(each) for name, each in presses.items()},
        "cues": cue_tests(table),
    }
    if shared is not None:
        add_mixed_models(record, table, shared)
        table = pd.concat(
            [table.iloc[:, :2], shared.drop(columns="specimen", errors="ignore"), table.iloc[:, 2:]], axis=1
        )
    if known is not None:
        record["specimens"] = {
            name: [
                reading_record(one) for one in read_touch(known, [c.trial.press for c in each], name).readings
            ]
            for name, each in presses.items()
        }
        for cue, test in record["cues"].items():
            told = {name: _interval_of(cue, each) for name, each in record["specimens"].items()}
            if any(told.values()):
                test["interval_90_with_calibration"] = {name: one for name, one in told.items() if one}
    if pooled:
        late = {
            name: [c.reported.summed[c.reported.force_n >= LATE_N] for c in each]
            for name, each in presses.items()
        }
        record["pooled_sums"] = asdict(compare(late, pooled=True))
    return SpecimenComparison(
        presses, table, known, _plain(record), differences_table(record) if groups else None
    )


def _interval_of(cue: str, readings: Sequence[Mapping[str, Any]]) -> list[float] | None:
    for one in readings:
        if cue == f"{one['quantity']}_{one['unit']}" and one["valid"]:
            return [one["low"], one["high"]]
    return None


def trials_table(groups: Groups, calibration: ComplianceCalibration | None) -> pd.DataFrame:
    """Return one row per trial: specimen, trial, and every cue; empty for invalid readings."""
    rows = [
        {"specimen": name, "trial": i + 1, **one.row(calibration, f"{name}/{i + 1}")}
        for name, each in groups.items()
        for i, one in enumerate(each)
    ]
    table = pd.DataFrame(rows)
    first = ["specimen", "trial", *(cue for cue in LABELS if cue in table)]
    return table[first + [column for column in table if column not in first]]


def cue_tests(table: pd.DataFrame) -> dict[str, Any]:
    """Return means with Student's intervals, and rank tests, of every cue that two specimens have.

    p-values of all cues (Kruskal-Wallis) and of all pairs (rank-sum) are also corrected by Holm.
    """
    tests: dict[str, Any] = {}
    for cue in [one for one in table.columns[2:] if one not in BESIDE]:
        groups = {str(name): list(rows[cue]) for name, rows in table.groupby("specimen", sort=False)}
        groups = {name: [x for x in each if np.isfinite(x)] for name, each in groups.items()}
        groups = {name: each for name, each in groups.items() if len(each) >= 2}
        if len(groups) >= 2 and len({x for each in groups.values() for x in each}) > 1:
            tests[cue] = {
                "mean": {name: float(np.mean(each)) for name, each in groups.items()},
                "interval_95": {name: mean_interval(each) for name, each in groups.items()},
                **asdict(compare(groups)),
            }
    for test, p in zip(
        tests.values(), corrected_by_holm([one["kruskal_p"] for one in tests.values()]), strict=True
    ):
        test["kruskal_p_all_cues"] = p
    pairs = [pair for one in tests.values() for pair in one["pairs"]]
    for pair, p in zip(pairs, corrected_by_holm([pair["rank_sum_p"] for pair in pairs]), strict=True):
        pair["rank_sum_p_all_cues"] = p
    return tests


def _shared_by_trials(experiment: PressFolder, columns: Sequence[str]) -> pd.DataFrame | None:
    """Groups of every press, before any is opened; None where no columns are named."""
    if not columns:
        return None
    if len(set(columns)) < len(columns) or "trial" in columns:
        raise InputError(
            f"groups by {', '.join(columns)}: name one column, or two different ones, none a trial"
        )
    shared = trial_groups(experiment, columns)
    specimens = [one.name for one in experiment.specimens for _ in one.presses]
    if columns[0] != "specimen":
        refuse_confounded(specimens, {columns[0]: list(shared[columns[0]])})
    return shared


def add_mixed_models(record: dict[str, Any], table: pd.DataFrame, shared: pd.DataFrame) -> None:
    """Add a linear mixed model to every cue's tests, in place.

    Args:
        record: with ``cues``, see `cue_tests`.
        table: one row per trial.
        shared: groups of the same rows, one column per level, the outer one first.
    """
    levels = [str(one) for one in shared.columns]
    random = [f"(1 | {':'.join(levels[: i + 1])})" for i in range(len(levels))]
    record["groups"] = {
        "levels": levels,
        "model": " + ".join(["specimen", *random]),
        "variances": "restricted maximum likelihood",
        "degrees_of_freedom": DEGREES_OF_FREEDOM,
        "warning": IGNORES_GROUPS.format(levels[0]),
    }
    for cue, test in record["cues"].items():
        rows = (np.isfinite(table[cue]) & table["specimen"].isin(list(test["mean"]))).to_numpy()
        try:
            found = compare_grouped(
                list(table[cue][rows]),
                [str(one) for one in table["specimen"][rows]],
                {level: list(shared[level][rows]) for level in levels},
            )
        except InputError as e:
            test["mixed_model"] = {"why_not": str(e)}
        else:
            test["mixed_model"] = asdict(found)
    pairs = [pair for _, pair in _mixed_pairs(record)]
    for pair, p in zip(pairs, corrected_by_holm([one["difference"]["p"] for one in pairs]), strict=True):
        pair["difference"]["p_all_cues"] = p


def _mixed_pairs(record: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [
        (cue, pair) for cue, one in record["cues"].items() for pair in one["mixed_model"].get("pairs", [])
    ]


def differences_table(record: Mapping[str, Any]) -> pd.DataFrame:
    """Return one row per cue and pair of specimens: difference of means with its interval."""
    columns = [
        "cue", "first", "second", "shared", "value", "low", "high", "freedom", "p", "p_all_cues",
    ]  # fmt: skip
    rows = [
        {"cue": cue, **{k: pair[k] for k in ("first", "second", "shared")}, **pair["difference"]}
        for cue, pair in _mixed_pairs(record)
    ]
    return pd.DataFrame(rows, columns=columns)


def _plain(value: Any) -> Any:
    """Plain containers, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return finite_or_none(value) if isinstance(value, float) else value
