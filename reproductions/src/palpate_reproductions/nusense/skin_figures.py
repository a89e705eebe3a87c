"""Figures of a study on a patterned skin: force over gamma, places, loops, repeats, edges, damage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from palpate.estimators.surface_strain import StrainFields
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, drawn, styled_panels

COLOURS = (ACCENT, "#c77d0a", BAD, "#2e6fb7")
"""One a tip or a pad, in the order in which they are named."""
GROWN = 10  # times: errors of places beside the places
GAMMA = "γ [1]"
FORCE = "normal force [N]"


class ForceLineShown(NamedTuple):
    """Frames of one tip or pad, and their line F = slope gamma + offset."""

    name: str
    gamma: Sequence[float]
    force_n: Sequence[float]
    slope: float
    offset: float


def force_lines(
    shown: Sequence[ForceLineShown], printed: tuple[float, float], curves: Mapping[str, Any]
) -> str:
    """Force over gamma with a line each and the printed one; beside it what a formula makes of each tip.

    Args:
        printed: slope and offset [N].
    """
    with styled_panels(10.6, 3.9, 1, 2) as (figure, (left, right)):
        for axes in (left, right):
            for one, colour in zip(shown, COLOURS, strict=False):
                axes.plot(one.gamma, one.force_n, ".", color=colour, ms=3.5, alpha=0.6, label=one.name)
            axes.set(xlabel=GAMMA, ylabel=FORCE, xlim=(0, None), ylim=(-0.3, 9))
        for one, colour in zip(shown, COLOURS, strict=False):
            _line(left, one.slope, one.offset, max(one.gamma), colour)
        top = max(max(one.gamma) for one in shown)
        _line(left, *printed, top, INK, dashes=(0, (5, 3)), label="printed line")
        left.set_title("lines of each tip, loading, from 1 N on", loc="left")
        for (name, curve), colour in zip(curves.items(), COLOURS, strict=False):
            right.plot(
                curve["gamma"],
                curve["force_N"],
                color=colour,
                ls=(0, (4, 2)),
                label=f"{name}, equation (3.1)",
            )
        right.set_title("equation (3.1), nothing fitted", loc="left")
        for axes in (left, right):
            axes.legend(frameon=False, fontsize=8)
        return drawn(figure)


def _line(
    axes: Axes, slope: float, offset: float, top: float, colour: str, dashes: Any = "-", label: str = ""
) -> None:
    ends = np.array([0.0, top])
    axes.plot(ends, slope * ends + offset, color=colour, ls=dashes, lw=1.3, label=label or None)


def shift_map(fields: StrainFields | None) -> str:
    """How far each sample of the pattern has moved, and which way; empty without fields."""
    if fields is None:
        return ""
    with styled_panels(6.6, 4.4) as (figure, (axes,)):
        shift = 1e3 * np.hypot(*fields.displacement)
        mesh = axes.pcolormesh(
            *(1e3 * fields.at), np.ma.masked_invalid(shift), cmap="GnBu", vmin=0, shading="gouraud"
        )
        figure.colorbar(mesh, ax=axes, label="shift [mm]", shrink=0.9)
        some = np.zeros_like(fields.basis.supported)
        some[4::8, 4::8] = True
        some &= fields.basis.supported
        axes.quiver(
            *(1e3 * fields.at[:, some]), *fields.displacement[:, some], color=INK, angles="xy", width=0.0025
        )
        axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
        axes.set_title("how far the pattern moved, and which way", loc="left")
        return drawn(figure)


def place_errors(
    touches: Sequence[Mapping[str, Any]], told: Mapping[str, str], by_place: Mapping[str, Mapping[str, float]]
) -> str:
    """Places of touches with their errors drawn ten times as long, a panel a way to tell them.

    Args:
        touches: each with ``true_mm`` and the key of every way, places or None [mm]; and its ``place``.
        told: key of each way, and its title.
        by_place: of each way the root mean square of each place [mm].
    """
    with styled_panels(11.5, 4.0, 1, len(told)) as (figure, panels):
        for axes, (key, title) in zip(panels, told.items(), strict=True):
            at = {str(one["place"]): one["true_mm"] for one in touches}
            for one in touches:
                if one[key] is not None:
                    true = np.array(one["true_mm"])
                    end = true + GROWN * (np.array(one[key]) - true)
                    axes.plot(*np.column_stack([true, end]), color=BAD, lw=0.9)
                    axes.plot(*end, ".", color=BAD, ms=3)
            for name, (x, y) in at.items():
                axes.plot(x, y, "+", color=INK, ms=7)
                if name in by_place[key]:
                    axes.text(x, y - 2.6, f"{by_place[key][name]:.2f}", ha="center", fontsize=7, color=INK)
            axes.set(
                xlabel="x [mm]", ylabel="y [mm]", xlim=(-25, 25), ylim=(-19, 19), aspect="equal", title=title
            )
        return drawn(figure)


def hysteresis_loops(courses: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Force over gamma of one press of each pad, and how much more it bears on the way down."""
    with styled_panels(10.6, 3.7, 1, 2) as (figure, (left, right)):
        for (name, course), colour in zip(courses.items(), COLOURS, strict=False):
            force, gamma = np.array(course["force_N"]), np.array(course["gamma"])
            top = int(force.argmax())
            left.plot(gamma[: top + 1], force[: top + 1], "-", color=colour, lw=1.3, label=f"{name}, loading")
            left.plot(gamma[top:], force[top:], ":", color=colour, lw=1.6, label=f"{name}, unloading")
            at = np.linspace(gamma.min(), gamma.max(), 200)
            up = np.interp(at, gamma[: top + 1], force[: top + 1])
            down = np.interp(at, gamma[top:][::-1], force[top:][::-1])
            right.plot(at, up - down, color=colour, label=name)
        left.set(xlabel=GAMMA, ylabel=FORCE)
        left.set_title("one press and release", loc="left")
        right.set(xlabel=GAMMA, ylabel="loading less unloading [N]")
        right.set_title("width of the loop at the same γ", loc="left")
        for axes in (left, right):
            axes.legend(frameon=False, fontsize=8)
        return drawn(figure)


def repeated_touches(at_force: Sequence[float], greatest: Sequence[float], label: str) -> str:
    """A value of every touch in order, and the histogram of their greatest."""
    with styled_panels(10.6, 3.2, 1, 2) as (figure, (left, right)):
        index = np.arange(1, len(at_force) + 1)
        left.plot(index, at_force, ".-", color=ACCENT, lw=0.8, ms=4)
        middle = float(np.nanmean(at_force))
        left.axhline(middle, color=INK, lw=0.8, ls=(0, (4, 2)))
        left.set(xlabel="touch", ylabel=label, ylim=(0.9 * middle, 1.1 * middle))
        left.set_title("the same force, touch after touch", loc="left")
        right.hist(greatest, bins=min(14, max(3, len(greatest) // 4)), color=BAND, edgecolor=INK, lw=0.6)
        right.set(xlabel="greatest γ of a touch [1]", ylabel="touches")
        right.set_title("greatest of each touch", loc="left")
        return drawn(figure)


def edge_errors(rows: Sequence[Mapping[str, Any]], told: Mapping[str, str]) -> str:
    """Error of every edge with half its 90 % interval over its direction.

    Args:
        rows: each with ``true_deg`` and, for the key of every way, ``KEY_off_deg`` and ``KEY_half_deg``.
        told: key of each way, and its name.
    """
    with styled_panels(10.6, 3.4) as (figure, (axes,)):
        axes.axhline(0, color=INK, lw=0.8)
        for i, ((key, name), colour) in enumerate(zip(told.items(), COLOURS, strict=False)):
            known = [row for row in rows if row[f"{key}_off_deg"] is not None]
            x = np.array([row["true_deg"] for row in known]) + 1.6 * (i - (len(told) - 1) / 2)
            y = [row[f"{key}_off_deg"] for row in known]
            half = [row[f"{key}_half_deg"] for row in known]
            axes.errorbar(x, y, half, fmt="o", ms=4, lw=0.9, color=colour, label=name)
        axes.set(xlabel="direction of the edge [°]", ylabel="error [°]")
        axes.set_xticks(sorted({row["true_deg"] for row in rows}))
        axes.legend(frameon=False, fontsize=8)
        return drawn(figure)


def pads_lines(shown: Sequence[ForceLineShown]) -> str:
    """Force over gamma of several pads with a line each."""
    with styled_panels(6.2, 3.8) as (figure, (axes,)):
        for one, colour in zip(shown, COLOURS, strict=False):
            axes.plot(one.gamma, one.force_n, "o", color=colour, ms=4, alpha=0.7, label=one.name)
            _line(axes, one.slope, one.offset, max(one.gamma), colour)
        axes.set(xlabel=GAMMA, ylabel=FORCE, xlim=(0, None), ylim=(-0.3, None))
        axes.legend(frameon=False, fontsize=8)
        return drawn(figure)
