"""Pictures and files of compliance by touch: one press, and several specimens beside each other.

The picture of a fitted tip: twin and taps side by side, and where on the tip they differ.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from palpate.calibration.compliance.compliance_calibration import ReferenceTrial
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.calibration.compliance.press_cues import PressCues
from palpate.calibration.compliance.specimen_comparison import LABELS, SpecimenComparison
from palpate.core import Float, ndarray, new_folder, storage_errors
from palpate.estimators.compliance.spread_rate import AsReported
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, styled_panels

# specimens in order, as in the report
COLOURS = ("#31688e", "#c0392b", "#35a36a", "#d8a013", "#7b4fa3", "#5b6b75")
UNBOUNDED = 30.0  # upper end that is drawn of a range without one, over its lower end

Course = tuple[Float[ndarray, " _"], Float[ndarray, " _"]]
Courses = Mapping[str, Sequence[Course]]
Colours = Mapping[str, str]


def write_press_readings(
    out: Path, record: dict[str, Any], cues: PressCues, touch: PressReading | None
) -> None:
    """Write a press as a folder of ``readings.json`` and ``press.png``."""
    with new_folder(out) as building:
        (building / "readings.json").write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
        press_figure(cues.trial, touch, cues.reported).savefig(building / "press.png")


def write_comparison(out: Path, comparison: SpecimenComparison) -> None:
    """Write a folder of ``trials.csv``, ``comparison.json``, ``comparison.png``, and with groups
    ``differences.csv``.
    """
    text = json.dumps(comparison.record, indent=1, allow_nan=False) + "\n"
    with new_folder(out) as building, storage_errors(out):
        comparison.table.to_csv(building / "trials.csv", index=False)
        if comparison.differences is not None:
            comparison.differences.to_csv(building / "differences.csv", index=False)
        (building / "comparison.json").write_text(text)
        comparison_figure(comparison).savefig(building / "comparison.png")


def comparison_figure(comparison: SpecimenComparison) -> Figure:
    """Draw area over force of all trials, and a panel of boxes for every cue."""
    groups, table, calibration = comparison.groups, comparison.table, comparison.calibration
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


def press_figure(trial: ReferenceTrial, touch: PressReading | None, reported: AsReported) -> Figure:
    """Draw the pins at the greatest force, contact area over force, and the stiffness."""
    with styled_panels(11.5, 3.7, columns=3, width_ratios=[1, 1.25, 1.25]) as (figure, panels):
        left, middle, right = panels
        _pins(left, trial)
        if touch is not None and touch.course is not None:
            _area(middle, trial, touch)
        else:
            middle.plot(reported.force_n, reported.area, color=ACCENT, marker=".")
            middle.set(xlabel="force [N]", ylabel="A / A0 [-]", title="relative area, by divergence")
        if touch is None:
            _approach(right, trial)
        else:
            _stiffness(right, touch)
        return figure


def _pins(axes: Axes, trial: ReferenceTrial) -> None:
    press = trial.press
    x, y = press.untouched_px.T
    u, v = press.moved_px[-1].T
    axes.quiver(
        x, y, u, v, np.hypot(u, v), angles="xy", scale_units="xy", scale=1, cmap="viridis", width=6e-3
    )
    axes.set(
        aspect="equal", xlabel="x [px]", ylabel="y [px]", title=f"motion of pins at {press.force_n[-1]:.2g} N"
    )
    axes.invert_yaxis()
    axes.margins(0.12)


def _area(axes: Axes, trial: ReferenceTrial, touch: PressReading) -> None:
    assert touch.course is not None
    force, area = touch.course.force_n, 1e6 * touch.course.area_m2
    axes.fill_between(force, area[:, 1], area[:, 2], color=BAND, label="90 % interval")
    axes.plot(force, area[:, 0], color=ACCENT, marker=".", label="all pins")
    if trial.area_m2 is not None and np.isfinite(trial.area_m2).any():
        axes.plot(force, 1e6 * trial.area_m2, color=BAD, lw=0.8, ls="--", label="known")
    axes.set(xlabel="force [N]", ylabel="contact area [mm²]", title="contact area")
    axes.legend(frameon=False, fontsize=8)


def _stiffness(axes: Axes, touch: PressReading) -> None:
    rows = {"touch": touch.stiffness}
    if touch.stiffness_both is not None:
        rows["touch and\nposition"] = touch.stiffness_both
    low, high = (x / 1e3 for x in touch.stiffness.calibrated_range)
    high = min(high, UNBOUNDED * low)  # the axis is logarithmic
    axes.axvspan(low, high, color=BAND, zorder=0)
    axes.annotate(
        "calibrated",
        ((low * high) ** 0.5, 1.0),
        xycoords=("data", "axes fraction"),
        ha="center",
        va="top",
        fontsize=8,
    )
    for i, one in enumerate(rows.values()):
        value = one.value / 1e3
        ends, at = (np.clip(x, low / 5, high * 5) for x in (np.array([one.low, one.high]) / 1e3, value))
        colour = ACCENT if one.valid else BAD
        axes.plot(ends, [i, i], color=colour, lw=2)
        axes.plot(at, i, "o", color=colour)
        text = f"{value:.3g} N/mm" if np.isfinite(value) else "rigid"
        axes.annotate(
            text if one.valid else f"{text} (not valid)", (at, i),
            textcoords="offset points", xytext=(0, 8), ha="center", fontsize=9,
        )  # fmt: skip
    axes.set(
        xscale="log",
        ylim=(-0.6, len(rows) - 0.2),
        xlabel="stiffness [N/mm]",
        title="stiffness of the specimen",
    )
    axes.set_yticks(range(len(rows)), list(rows))
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _approach(axes: Axes, trial: ReferenceTrial) -> None:
    press = trial.press
    if press.position_m is None:
        axes.plot(press.frame, press.force_n, color=ACCENT, marker=".")
        axes.set(xlabel="frame", ylabel="force [N]", title="force")
        return
    axes.plot(1e3 * press.position_m, press.force_n, color=ACCENT, marker=".")
    axes.set(xlabel="approach [mm]", ylabel="force [N]", title="sensor and specimen in series")


def boxes(
    groups: Mapping[str, Sequence[float]], label: str, axes: Axes, colours: Colours | None = None
) -> None:
    """Draw a box per specimen with every trial as a point."""
    names = list(groups)
    drawn = axes.boxplot(
        [list(groups[name]) for name in names], widths=0.5, patch_artist=True, showfliers=False
    )
    for i, name in enumerate(names):
        colour = COLOURS[i % len(COLOURS)] if colours is None else colours[name]
        drawn["boxes"][i].set(facecolor=colour, alpha=0.35, edgecolor=INK, lw=0.8)
        drawn["medians"][i].set(color=INK, lw=1.2)
        at = i + 1 + np.linspace(-0.12, 0.12, len(groups[name]))
        axes.plot(at, groups[name], ".", color=colour, ms=6)
    axes.set_xticks(range(1, len(names) + 1), names)
    axes.set_ylabel(label)


def trial_lines(
    courses: Courses, across: str, label: str, axes: Axes, colours: Colours | None = None, **style: Any
) -> None:
    """Draw a line per trial, a color per specimen."""
    for i, (name, lines) in enumerate(courses.items()):
        colour = COLOURS[i % len(COLOURS)] if colours is None else colours[name]
        for k, (x, y) in enumerate(lines):
            axes.plot(x, y, color=colour, label=name if k == 0 else None, **style)
    axes.set(xlabel=across, ylabel=label)
    axes.legend(frameon=False, fontsize=8)


def compare_figure(
    courses: Courses, course_label: str, cues: Mapping[str, Mapping[str, Sequence[float]]]
) -> Figure:
    """Draw area over force of all trials, and a panel of boxes for every cue."""
    count = 1 + len(cues)
    wide = min(count, 4)
    high = -(-count // wide)
    with styled_panels(3.3 * wide, 3.1 * high, high, wide) as (figure, panels):
        trial_lines(courses, "force [N]", course_label, panels[0], lw=0.9, alpha=0.8)
        for axes, (label, groups) in zip(panels[1:], cues.items(), strict=False):
            boxes(groups, label, axes)
        for axes in panels[count:]:
            axes.set_axis_off()
        return figure


RINGS = 8


@dataclass(frozen=True)
class TipPicture:
    """Drawn data of a fitted tip.

    Attributes:
        rest_px: pins at rest ``[p 2]`` [px].
        depths_mm: depths of upright taps [mm].
        taps_px, twin_px: pins at these depths, by taps and by the twin ``[d p 2]`` [px].
        residual_px: RMS of each pin in held-out taps ``[p]`` [px].
        left_px: RMS by name in held-out taps: motion, twin, smooth regression, twin with learned error [px].
    """

    rest_px: Float[ndarray, "p 2"]
    depths_mm: Float[ndarray, " d"]
    taps_px: Float[ndarray, "d p 2"]
    twin_px: Float[ndarray, "d p 2"]
    residual_px: Float[ndarray, " p"]
    left_px: dict[str, float]


def write_tip_files(out: Path, record: dict[str, Any], reader: dict[str, Any], picture: TipPicture) -> None:
    """Write a fitted tip as a folder of ``tip.json``, ``reader.json``, and ``tip.png``."""
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    with new_folder(out) as building, storage_errors(out):
        (building / "tip.json").write_text(text)
        (building / "reader.json").write_text(json.dumps(reader, allow_nan=False) + "\n")
        tip_figure(picture).savefig(building / "tip.png")


def tip_figure(picture: TipPicture) -> Figure:
    """Draw outward motion in upright taps over distance from the middle, the residual's map, and RMS."""
    with styled_panels(12.0, 3.8, columns=3, width_ratios=[1.3, 1.1, 0.8]) as (figure, panels):
        course, plan, bars = panels
        _course(course, picture)
        x, y = picture.rest_px.T
        dots = plan.scatter(x, y, c=picture.residual_px, s=14, cmap="viridis", vmin=0)
        plan.set(aspect="equal", xticks=[], yticks=[], title="residual by pin [px rms], new taps")
        plan.invert_yaxis()
        figure.colorbar(dots, ax=plan, shrink=0.8)
        colours = [ACCENT if name == "twin" else INK for name in picture.left_px]
        bars.bar(list(picture.left_px), list(picture.left_px.values()), color=colours)
        bars.set(ylabel="rms over pins, new taps [px]", title="what is left")
        return figure


def _course(axes: Axes, picture: TipPicture) -> None:
    rest, middle = picture.rest_px, np.median(picture.rest_px, axis=0)
    away = np.hypot(*(rest - middle).T)
    out = (rest - middle) / np.maximum(away, 1e-9)[:, None]
    ring = np.minimum((away / away.max() * RINGS).astype(int), RINGS - 1)
    at = [away[ring == k].mean() for k in range(RINGS)]
    for taps, twin, depth in zip(picture.taps_px, picture.twin_px, picture.depths_mm, strict=True):
        seen, told = (np.einsum("pi,pi->p", places - rest, out) for places in (taps, twin))
        line = axes.plot(at, [told[ring == k].mean() for k in range(RINGS)], label=f"{depth:.1f} mm")[0]
        axes.plot(at, [seen[ring == k].mean() for k in range(RINGS)], "o", color=line.get_color())
    axes.set(xlabel="distance from the middle [px]", ylabel="outward motion [px]")
    axes.set_title("upright: taps (dots) and twin (lines)")
    axes.legend(title="depth")
