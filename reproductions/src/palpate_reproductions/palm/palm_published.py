"""Numbers that the source prints, and scores to set beside them.

Source: "Photoelastic Tactile Sensor for a Robotic Palm" (2026), tables 2 to 4 and section 6. Scores have
intervals over places, since frames of one place are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from palpate.calibration.coverage.grouped_rates import group_sizes, grouped_coverage_interval
from palpate.core import Float, InputError, Shaped, ndarray, split_column
from palpate_reproductions.study_results import Published


class Training(NamedTuple):
    """A row of its Table 2."""

    optimiser: str
    batch: int
    epochs: int
    split: str


NAMES: Mapping[str, str] = {
    "palm-joint-raw": "Joint multi-task (raw RGB)",
    "palm-force-conditioned": "Force-conditioned (differential RGB)",
    "palm-mlp-delta": "MLP (flattened fringe delta, grey)",
    "palm-two-stage": "Two-stage (differential grey)",
    "palm-compact": "palm-compact (ours, differential RGB)",
    "palm-moments": "Moments and trees (differential grey)",
    "kernel-ridge": "Kernel ridge (differential grey)",
    "mean": "Always the mean",
}

TABLE_2: Mapping[str, Training] = {
    "palm-joint-raw": Training("Adam", 32, 30, "location-disjoint"),
    "palm-force-conditioned": Training("Adam", 32, 30, "location-disjoint"),
    "palm-mlp-delta": Training("Adam", 200, 2000, "location-disjoint"),
    "palm-two-stage": Training("Adam", 32, 50, "location-disjoint"),
}

FORCE, PLACE, DEPTH = "force_N", "place_mm", "depth_mm"

MAE: Mapping[tuple[str, str], Published] = {
    ("palm-joint-raw", FORCE): Published(0.443, "Table 3"),
    ("palm-joint-raw", PLACE): Published(2.321, "Table 3"),
    ("palm-joint-raw", "x_mm"): Published(1.718, "sec. 6.2.2"),
    ("palm-joint-raw", "y_mm"): Published(1.243, "sec. 6.2.2"),
    ("palm-force-conditioned", FORCE): Published(0.244, "Table 3"),
    ("palm-force-conditioned", PLACE): Published(3.205, "Table 3"),
    ("palm-force-conditioned", "x_mm"): Published(1.247, "sec. 6.2.2"),
    ("palm-force-conditioned", "y_mm"): Published(2.757, "sec. 6.2.2"),
    ("palm-mlp-delta", FORCE): Published(0.330, "Table 3"),
    ("palm-mlp-delta", "force_x_N"): Published(0.036, "sec. 6.2.1"),
    ("palm-mlp-delta", "force_y_N"): Published(0.045, "sec. 6.2.1"),
    ("palm-two-stage", FORCE): Published(0.486, "Table 3"),
    ("palm-two-stage", PLACE): Published(0.204, "Table 3"),
    ("palm-two-stage", DEPTH): Published(0.165, "sec. 6.2.3"),
    ("palm-two-stage", "x_mm"): Published(0.131, "Table 4"),
    ("palm-two-stage", "y_mm"): Published(0.147, "Table 4"),
    ("palm-two-stage", "force_x_N"): Published(0.035, "sec. 6.2.1"),
    ("palm-two-stage", "force_y_N"): Published(0.037, "sec. 6.2.1"),
    ("palm-two-stage", "force_magnitude_N"): Published(0.457, "sec. 6.2.1"),
}
"""Mean absolute errors; a place's is the mean distance."""

R2: Mapping[tuple[str, str], Published] = {
    ("palm-two-stage", FORCE): Published(0.990, "sec. 6.2.1"),
    ("palm-two-stage", "force_x_N"): Published(0.600, "sec. 6.2.1"),
    ("palm-two-stage", "force_y_N"): Published(0.975, "sec. 6.2.1"),
    ("palm-two-stage", "force_magnitude_N"): Published(0.990, "sec. 6.2.1"),
    ("palm-two-stage", DEPTH): Published(0.978, "sec. 6.2.3"),
    ("palm-two-stage", "x_mm"): Published(0.9997, "sec. 6.2.2"),
    ("palm-two-stage", "y_mm"): Published(0.9998, "sec. 6.2.2"),
}


def targets_with_place(targets: Sequence[str]) -> tuple[str, ...]:
    """Targets, and the place as a whole where it is among them."""
    return (*targets, PLACE) if "x_mm" in targets else tuple(targets)


class Peer(NamedTuple):
    """A row of its Table 4."""

    sensor: str
    force: str
    place: str
    principle: str


PEERS = (
    Peer("Insight", "about 0.03 N, normal and shear", "about 0.4 mm", "photometric stereo, deep network"),
    Peer("Kakani et al.", "0.022 N average", "x 1.396, y 0.973 mm", "stereo camera, VGG16"),
    Peer("Soft-bubble", "not as MAE", "not as MAE", "depth camera inside, ICP"),
    Peer("ROMEO palm", "not as MAE", "not as MAE", "camera inside, LED array"),
)
"""The other sensors of Table 4, as the source gives them."""


DRAWS = 2000
GROUP = "location"
ROUNDING = 1e-9

Column = Float[ndarray, " n"]


def scores_of(table: pd.DataFrame, columns: Sequence[str], group: str = GROUP) -> dict[str, dict[str, Any]]:
    """Score every target of a table of labels, estimates and half-widths, and the place as a whole.

    Args:
        table: as `calibration.evaluation.predictions` makes it; rows that could not be read are left out.
        group: the column whose values are drawn anew for the intervals.

    Returns:
        ``{target: {"unit", "mae", "mae_low", "mae_high", "rmse", "r2", "n", "groups", "coverage",
        "coverage_low", "coverage_high", "half_width"}}``; the place, where x and y are among the targets, by
        the distance (and without an interval of its own).
    """
    read = table[[f"estimate:{c}" for c in columns]].notna().all(axis=1)
    if not read.any():
        raise InputError("no frame could be read: nothing to score", code="no-reading")
    table = table[read]
    groups = table[group].to_numpy()
    errors = {c: (table[f"estimate:{c}"] - table[c]).to_numpy(float) for c in columns}
    results = {c: _one(c, table, errors[c], groups) for c in columns}
    if "x_mm" in errors and "y_mm" in errors:
        away = np.hypot(errors["x_mm"], errors["y_mm"])
        mean_x, mean_y, mean = (float(np.abs(e).mean()) for e in (errors["x_mm"], errors["y_mm"], away))
        if not math.hypot(mean_x, mean_y) - ROUNDING <= mean <= mean_x + mean_y + ROUNDING:
            raise InputError(
                f"a mean distance of {mean} mm cannot be, of {mean_x} and {mean_y} mm", code="mean-distance"
            )
        results[PLACE] = {"unit": "mm", **_sizes(away, groups)}
    return results


def _one(column: str, table: pd.DataFrame, error: Column, groups: Shaped[ndarray, " n"]) -> dict[str, Any]:
    half = table[f"half_width:{column}"].to_numpy(float)
    inside = np.abs(error) <= half
    low, high = grouped_coverage_interval(inside, groups)
    variance = float(table[column].var(ddof=0))
    return {
        "unit": split_column(column)[1].symbol,
        **_sizes(error, groups),
        "r2": 1 - float(np.mean(error**2)) / variance if variance > 0 else None,
        "coverage": float(inside.mean()),
        "coverage_low": low,
        "coverage_high": high,
        "half_width": float(half.mean()),
    }


def _sizes(error: Column, groups: Shaped[ndarray, " n"]) -> dict[str, Any]:
    low, high = interval_of_mean(np.abs(error), groups)
    return {
        "mae": float(np.abs(error).mean()),
        "mae_low": low,
        "mae_high": high,
        "rmse": float(np.sqrt(np.mean(error**2))),
        "n": len(error),
        "groups": len(np.unique(groups)),
    }


def interval_of_mean(
    values: Column, groups: Shaped[ndarray, " n"], *, seed: int = 0, draws: int = DRAWS
) -> tuple[float, float]:
    """95 % percentile interval of a mean, from whole groups drawn again with replacement."""
    sizes, index = group_sizes(groups)
    sums = np.bincount(index, weights=values)
    drawn = np.random.default_rng(seed).integers(0, len(sizes), (draws, len(sizes)))
    means = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
