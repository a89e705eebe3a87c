"""Scores of held-out frames with intervals over places: frames of one place are not independent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy import ndarray

from palpate.calibration.uncertainty import grouped_coverage_interval
from palpate.core.errors import InputError
from palpate.core.shapes import Float, Shaped
from palpate.core.units import split_column
from palpate.studies.palm.published import PLACE

DRAWS = 2000
GROUP = "location"
ROUNDING = 1e-9

Column = Float[ndarray, " n"]


def scores_of(table: pd.DataFrame, columns: Sequence[str], group: str = GROUP) -> dict[str, dict[str, Any]]:
    """Score every target of a table of labels, estimates and half-widths, and the place as a whole.

    Args:
        table: as `calibration.evaluate.predictions` makes it; rows that could not be read are left out.
        columns: the targets.
        group: the column whose values are drawn anew for the intervals.

    Returns:
        ``{target: {"unit", "mae", "mae_low", "mae_high", "rmse", "r2", "n", "groups", "coverage",
        "coverage_low", "coverage_high", "half_width"}}``; the place, where x and y are among the targets, by
        the distance (and without an interval of its own).

    Raises:
        InputError: no row was read, or the distances break the law of triangles: a fault in here.
    """
    read = table[[f"estimate:{c}" for c in columns]].notna().all(axis=1)
    if not read.any():
        raise InputError("no frame could be read: nothing to score")
    table = table[read]
    groups = table[group].to_numpy()
    errors = {c: (table[f"estimate:{c}"] - table[c]).to_numpy(float) for c in columns}
    found = {c: _one(c, table, errors[c], groups) for c in columns}
    if "x_mm" in errors and "y_mm" in errors:
        away = np.hypot(errors["x_mm"], errors["y_mm"])
        mean_x, mean_y, mean = (float(np.abs(e).mean()) for e in (errors["x_mm"], errors["y_mm"], away))
        if not math.hypot(mean_x, mean_y) - ROUNDING <= mean <= mean_x + mean_y + ROUNDING:
            raise InputError(f"a mean distance of {mean} mm cannot be, of {mean_x} and {mean_y} mm")
        found[PLACE] = {"unit": "mm", **_sizes(away, groups)}
    return found


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
    _, index = np.unique(groups, return_inverse=True)
    count = int(index.max()) + 1
    sums, sizes = np.bincount(index, weights=values), np.bincount(index)
    drawn = np.random.default_rng(seed).integers(0, count, (draws, count))
    means = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
