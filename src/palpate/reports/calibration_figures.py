"""The pictures of a calibration, each as a PNG in a data address."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.calibration.conformal import few_groups_coverage_interval
from palpate.calibration.coverage.circular_scores import shortest
from palpate.estimators.certified import within
from palpate.estimators.model_card import TargetCard

INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "figure.dpi": 130,
}

SURFACES = (("x_mm", "y_mm"), ("contact_x_mm", "contact_y_mm"), ("tilt_x_deg", "tilt_y_deg"))
"""Pairs of label columns that say where on the skin a press was; a tilt says where on a dome."""


def picture(path: Path) -> str:
    """A PNG file as a data address."""
    return _address(path.read_bytes())


def target_figure(target: TargetCard, table: pd.DataFrame, groups: np.ndarray) -> str:
    """Predicted against true, error against the truth, coverage along the truth, groups counted as groups."""
    true, guess, half = target_columns(target, table)
    with styled_panels(10.2, 3.1, columns=3) as (figure, (left, middle, right)):
        error, inside = errors_of(target, true, guess), held_rows(target, table)
        _predicted(left, target, true, true + error, inside)
        _errors(middle, target, true, error, half)
        _coverage(right, target, true, inside, groups)
        return drawn(figure)


def surface_columns(table: pd.DataFrame) -> tuple[str, str] | None:
    """The pair of columns that says where on the skin each frame was pressed."""
    for x, y in SURFACES:
        if x in table and y in table and table[x].nunique() > 2 and table[y].nunique() > 2:
            return x, y
    return None


def surface_figure(targets: tuple[TargetCard, ...], table: pd.DataFrame, where: tuple[str, str]) -> str:
    """Mean absolute error over the skin, a map for each target."""
    x, y = (table[c].to_numpy(float) for c in where)
    columns = min(len(targets), 3)
    rows = -(-len(targets) // columns)
    with styled_panels(3.4 * columns, 2.9 * rows, rows, columns) as (figure, panels):
        for axes in panels[len(targets) :]:
            axes.set_axis_off()
        for axes, target in zip(panels, targets, strict=False):
            true, guess, _ = target_columns(target, table)
            _map(figure, axes, target, (x, y), np.abs(errors_of(target, true, guess)), where)
        return drawn(figure)


def target_columns(target: TargetCard, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, estimate and half-width of a target's held-out rows."""
    names = (target.column, f"estimate:{target.column}", f"half_width:{target.column}")
    true, guess, half = (table[name].to_numpy(float) for name in names)
    return true, guess, half


def errors_of(target: TargetCard, true: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Estimates less truths, the shortest way round where the target is circular."""
    return shortest(guess - true, target.period)


def held_rows(target: TargetCard, table: pd.DataFrame) -> np.ndarray:
    """Tell which rows' intervals held the truth; by half-widths in tables of before."""
    true, guess, half = target_columns(target, table)
    if target.over_range is None or f"low:{target.column}" not in table:
        return np.abs(errors_of(target, true, guess)) <= half
    return within(true, *(table[f"{end}:{target.column}"].to_numpy(float) for end in ("low", "high")))


def _predicted(
    axes: Axes, target: TargetCard, true: np.ndarray, guess: np.ndarray, inside: np.ndarray
) -> None:
    ends = [target.least, target.greatest]
    axes.plot(ends, ends, color=INK, lw=0.8)
    for rows, colour in ((inside, ACCENT), (~inside, BAD)):
        axes.scatter(true[rows], guess[rows], s=7, color=colour, alpha=0.55, linewidths=0)
    axes.set(title="held-out estimate against truth", xlabel=_label(target, "true"))
    axes.set_ylabel(_label(target, "estimated"))


def _errors(axes: Axes, target: TargetCard, true: np.ndarray, error: np.ndarray, half: np.ndarray) -> None:
    centres, (typical, width) = _binned(true, np.abs(error), half)
    axes.scatter(true, error, s=7, color=ACCENT, alpha=0.4, linewidths=0)
    axes.fill_between(centres, -width, width, color=BAND, zorder=0, label="90 % interval")
    axes.plot(centres, typical, color=INK, lw=1.4, label="mean |error|")
    axes.axhline(0, color=INK, lw=0.6)
    axes.set(title="error against truth", xlabel=_label(target, "true"), ylabel=f"error [{target.unit}]")
    axes.legend(frameon=False, fontsize=7, loc="upper right", ncols=2)


def _coverage(
    axes: Axes, target: TargetCard, true: np.ndarray, inside: np.ndarray, groups: np.ndarray
) -> None:
    for rows in _bins(true):
        low, high = few_groups_coverage_interval(inside[rows], groups[rows])
        centre = float(true[rows].mean())
        axes.plot([centre, centre], [100 * low, 100 * high], color=ACCENT, lw=1.4)
        axes.plot(centre, 100 * inside[rows].mean(), "o", color=ACCENT, ms=4)
    axes.axhline(90, color=INK, lw=0.8, ls="--")
    axes.set(title="rows whose interval covers the truth", ylabel="[%], bars: 95 % interval", ylim=(40, 102))
    axes.set_xlabel(_label(target, "true"))


def _map(
    figure: Figure,
    axes: Axes,
    target: TargetCard,
    at: tuple[np.ndarray, np.ndarray],
    error: np.ndarray,
    where: tuple[str, str],
) -> None:
    drawn: Any
    places = pd.DataFrame({"x": at[0], "y": at[1], "error": error})
    if len(places.drop_duplicates(["x", "y"])) <= 300:
        means = places.groupby(["x", "y"], as_index=False)["error"].mean()
        drawn = axes.scatter(means["x"], means["y"], c=means["error"], s=70, cmap="viridis", vmin=0)
    else:
        drawn = axes.hexbin(*at, C=error, gridsize=14, mincnt=1, cmap="viridis", vmin=0, linewidths=0.1)
    figure.colorbar(drawn, ax=axes, label=f"mean |error| [{target.unit}]")
    axes.set(title=target.quantity, xlabel=_axis(where[0]), ylabel=_axis(where[1]))


def _binned(true: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Means of equal parts of the rows, ordered by the truth."""
    parts = _bins(true)
    centres = np.array([true[rows].mean() for rows in parts])
    return centres, tuple(np.array([value[rows].mean() for rows in parts]) for value in values)


def _bins(true: np.ndarray) -> list[np.ndarray]:
    return np.array_split(np.argsort(true, kind="stable"), int(np.clip(len(true) // 25, 1, 12)))


def _label(target: TargetCard, what: str) -> str:
    return f"{what} {target.quantity.replace('_', ' ')} [{target.unit}]"


def _axis(column: str) -> str:
    quantity, _, unit = column.rpartition("_")
    return f"{quantity.replace('_', ' ')} [{unit}]"


@contextmanager
def styled_panels(
    width: float, height: float, rows: int = 1, columns: int = 1, **grid: Any
) -> Iterator[tuple[Figure, np.ndarray]]:
    """A figure of a size [inch] and its panels, row by row, while the pages' style holds."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid).ravel()


def drawn(figure: Figure) -> str:
    """A figure as a PNG in a data address."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return _address(buffer.getvalue())


def _address(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
