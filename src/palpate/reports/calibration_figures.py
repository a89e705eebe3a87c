"""The pictures of a calibration: PNG in a data address, or SVG that takes the page's own colours."""

from __future__ import annotations

import base64
import io
import pathlib
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path

from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval
from palpate.calibration.coverage.range_scores import shortest
from palpate.core import Bool, Float
from palpate.estimators.intervals import within
from palpate.estimators.model_card import TargetCard

INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
DECIDES = "#b2381f"
# in drawing order
COLOURS = ("#5b6b75", "#c77d0a", "#8e44ad", "#2e6fb7", ACCENT, "#b03060", "#1b2a33")
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "axes.titlecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "figure.dpi": 130,
}

# label columns of the position on the skin or dome
SURFACES = (("x_mm", "y_mm"), ("contact_x_mm", "contact_y_mm"), ("tilt_x_deg", "tilt_y_deg"))


def picture(path: pathlib.Path) -> str:
    """Return a PNG file as a data address."""
    return _address(path.read_bytes())


@dataclass(frozen=True, slots=True)
class Panel:
    """Titled SVG drawing of a page."""

    title: str
    drawing: Markup


PANEL_INCH = (3.4, 2.9)


def target_panels(target: TargetCard, table: pd.DataFrame, groups: np.ndarray) -> tuple[Panel, ...]:
    """Draw predicted against true, error against truth, and coverage along the truth."""
    true, guess, _ = target_columns(target, table)
    error, inside = errors_of(target, true, guess), held_rows(target, table)
    sides = _sides(target, table)
    return (
        _panel("held-out estimate against truth", _predicted, target, true, true + error, inside),
        _panel("error against truth", _errors, target, true, error, sides, inside),
        _panel("rows inside their interval", _coverage, target, true, inside, groups),
    )


def _panel(title: str, draw: Callable[..., None], *arguments: Any) -> Panel:
    with styled_panels(*PANEL_INCH) as (figure, (axes,)):
        draw(axes, *arguments)
        axes.set_title(title)
        return Panel(title, sketched(figure))


def surface_columns(table: pd.DataFrame) -> tuple[str, str] | None:
    """Return the pair of columns of the position on the skin."""
    for x, y in SURFACES:
        if x in table and y in table and table[x].nunique() > 2 and table[y].nunique() > 2:
            return x, y
    return None


def surface_figure(
    targets: tuple[TargetCard, ...], table: pd.DataFrame, where: tuple[str, str]
) -> tuple[Panel, ...]:
    """Draw the mean absolute error over the skin, a map for each target."""
    x, y = (table[c].to_numpy(float) for c in where)
    panels = []
    for target in targets:
        true, guess, _ = target_columns(target, table)
        title = target.quantity.replace("_", " ")
        panels.append(_panel(title, _map, target, (x, y), np.abs(errors_of(target, true, guess)), where))
    return tuple(panels)


def deciding_panel(
    title: str,
    unit: str,
    image: np.ndarray,
    growth: Float[np.ndarray, "y x"],
    edges: tuple[np.ndarray, np.ndarray],
) -> Panel:
    """Draw the prepared picture under the growth of the error by occluded block.

    Args:
        unit: of the growth.
        image: grey from 0 to 1 ``[h w]``.
        growth: of the mean absolute error.
        edges: limits of the blocks down and across [px].
    """
    return _panel(title, _deciding, unit, image, growth, edges)


def _deciding(
    axes: Axes, unit: str, image: np.ndarray, growth: np.ndarray, edges: tuple[np.ndarray, np.ndarray]
) -> None:
    down, across = edges
    pale = image * 0.45 + 0.55  # so that the blocks' red stands out, on a light page and on a dark one
    axes.imshow(pale, cmap="gray", vmin=0, vmax=1, extent=(0, across[-1], down[-1], 0))
    most = max(float(growth.max()), float(np.finfo(np.float32).tiny))
    shades = ListedColormap([(*to_rgb(DECIDES), 0.85 * part) for part in np.linspace(0, 1, 128)])
    shown = axes.pcolormesh(across, down, np.clip(growth, 0, None), cmap=shades, vmin=0, vmax=most)
    for row, column in np.argwhere(deciding_blocks(growth)):
        corner = (across[column], down[row])
        size = (across[column + 1] - across[column], down[row + 1] - down[row])
        axes.add_patch(Rectangle(corner, *size, fill=False, ec="#000000", lw=0.9))
    figure = axes.get_figure(root=True)
    assert figure is not None
    tall = min(1.0, max(0.5, 1.2 * float(down[-1] / across[-1])))
    bar = figure.colorbar(shown, ax=axes, shrink=tall, label=f"growth [{unit}]")
    bar.outline.set_edgecolor(INK)
    # The reds let through what lies beneath: in the bar the picture's mean grey, and not the page.
    bar.ax.axhspan(0, most, color=str(float(pale.mean())), lw=0, zorder=0)
    axes.set(xlim=(0, across[-1]), ylim=(down[-1], 0), xlabel="[px]", aspect="equal")


def deciding_blocks(growth: Float[np.ndarray, "y x"]) -> Bool[np.ndarray, "y x"]:
    """Return the fewest blocks that hold half of all growth."""
    gains = np.clip(growth, 0, None)
    order = np.argsort(gains, axis=None)[::-1]
    before = np.concatenate([[0.0], np.cumsum(gains.ravel()[order])[:-1]])
    chosen = np.zeros(growth.size, bool)
    chosen[order[before < gains.sum() / 2]] = True
    return chosen.reshape(growth.shape) & (gains > 0)


def target_columns(target: TargetCard, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return truth, estimate, and half-width of a target's held-out rows."""
    names = (target.column, f"estimate:{target.column}", f"half_width:{target.column}")
    true, guess, half = (table[name].to_numpy(float) for name in names)
    return true, guess, half


def errors_of(target: TargetCard, true: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return estimates less truths, the shortest way round for a circular target."""
    return shortest(guess - true, target.period)


def held_rows(target: TargetCard, table: pd.DataFrame) -> np.ndarray:
    """Return which rows' intervals covered the truth; by half-widths in earlier tables."""
    true, guess, half = target_columns(target, table)
    if target.over_range is None or f"low:{target.column}" not in table:
        return np.abs(errors_of(target, true, guess)) <= half
    return within(true, *(table[f"{end}:{target.column}"].to_numpy(float) for end in ("low", "high")))


def interval_ends(target: TargetCard, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of each row's interval; by half-widths in earlier tables."""
    _, guess, half = target_columns(target, table)
    if f"low:{target.column}" not in table:
        return guess - half, guess + half
    return table[f"low:{target.column}"].to_numpy(float), table[f"high:{target.column}"].to_numpy(float)


def _sides(target: TargetCard, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    (low, high), guess = interval_ends(target, table), target_columns(target, table)[1]
    return guess - high, guess - low


def _predicted(
    axes: Axes, target: TargetCard, true: np.ndarray, guess: np.ndarray, inside: np.ndarray
) -> None:
    ends = [target.least, target.greatest]
    axes.plot(ends, ends, color=INK, lw=0.8)
    _marks(axes, true, guess, inside)
    axes.set(xlabel=_label(target, "true"), ylabel=_label(target, "estimated"))


def _errors(
    axes: Axes,
    target: TargetCard,
    true: np.ndarray,
    error: np.ndarray,
    sides: tuple[np.ndarray, np.ndarray],
    inside: np.ndarray,
) -> None:
    centres, (typical, least, greatest) = _binned(true, np.abs(error), *sides)
    _marks(axes, true, error, inside)
    axes.fill_between(centres, least, greatest, color=BAND, zorder=0, label="90 % interval")
    axes.plot(centres, typical, color=INK, lw=1.4, label="mean |error|")
    axes.axhline(0, color=INK, lw=0.6)
    axes.set(xlabel=_label(target, "true"), ylabel=f"error [{target.unit}]")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))  # room for the legend
    axes.legend(frameon=False, fontsize=7, loc="upper right", ncols=2)


def _marks(axes: Axes, x: np.ndarray, y: np.ndarray, inside: np.ndarray) -> None:
    """Dots where the interval covered the truth, crosses elsewhere; all dots are one path, for its size."""
    ends = np.repeat(np.column_stack([x, y])[inside], 2, axis=0)
    dots = Path(ends, np.tile([Path.MOVETO, Path.LINETO], len(ends) // 2), closed=False)
    dots.should_simplify = False
    axes.add_patch(PathPatch(dots, fill=False, lw=2.6, ec=ACCENT, alpha=0.55, capstyle="round"))
    axes.scatter(x[~inside], y[~inside], s=14, color=BAD, marker="x", linewidths=0.9)
    axes.update_datalim(np.column_stack([x, y]))
    axes.autoscale_view()


def _coverage(
    axes: Axes, target: TargetCard, true: np.ndarray, inside: np.ndarray, groups: np.ndarray
) -> None:
    least = 40.0
    for rows in _bins(true):
        low, high = grouped_coverage_interval(inside[rows], groups[rows])
        centre, covered = float(true[rows].mean()), 100 * float(inside[rows].mean())
        axes.plot([centre, centre], [100 * low, 100 * high], color=ACCENT, lw=1.4)
        axes.plot(centre, covered, "o", color=ACCENT, ms=4)
        least = min(least, covered - 3)
    axes.axhline(90, color=INK, lw=0.8, ls="--")
    axes.set(ylabel="[%], bars: 95 % interval", ylim=(least, 102))
    axes.set_xlabel(_label(target, "true"))


def _map(
    axes: Axes,
    target: TargetCard,
    at: tuple[np.ndarray, np.ndarray],
    error: np.ndarray,
    where: tuple[str, str],
) -> None:
    places = pd.DataFrame({"x": at[0], "y": at[1], "error": error})
    drawn: Any
    if len(places.drop_duplicates(["x", "y"])) <= 300:
        means = places.groupby(["x", "y"], as_index=False)["error"].mean()
        drawn = axes.scatter(means["x"], means["y"], c=means["error"], s=50, cmap="viridis", vmin=0)
    else:
        drawn = axes.hexbin(*at, C=error, gridsize=14, mincnt=1, cmap="viridis", vmin=0, linewidths=0.1)
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.colorbar(drawn, ax=axes, label=f"mean |error| [{target.unit}]").outline.set_edgecolor(INK)
    axes.set(xlabel=_axis(where[0]), ylabel=_axis(where[1]))


def _binned(true: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
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
    """Make a figure of a size [inch] and its panels in the pages' style."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid).ravel()


def drawn(figure: Figure) -> str:
    """Return a figure as a PNG in a data address."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return _address(buffer.getvalue())


_IN_PAGE = ((INK, "currentColor"), (ACCENT, "var(--accent)"), (BAND, "var(--band)"), (BAD, "var(--bad)"))
_NOT_IN_PAGE = re.compile(r"<metadata>.*?</metadata>|\sxmlns(:\w+)?=\"[^\"]*\"", re.DOTALL)


def sketched(figure: Figure) -> Markup:
    """Return a figure as SVG in the page's own colors."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "palpate"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    text = _NOT_IN_PAGE.sub("", text[text.index("<svg") :]).replace("xlink:href", "href")
    for colour, name in _IN_PAGE:
        text = text.replace(colour, name)
    return Markup(text)  # noqa: S704 -- of our own figures; matplotlib escapes the words in them


def _address(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
