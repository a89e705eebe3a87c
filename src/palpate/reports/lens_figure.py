"""The picture of a lens's calibration: where the boards were, and the error of each view."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from palpate.calibration.lens import LensFit
from palpate.core import new_file
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, STYLE

MAX_NAME = 18  # characters of a file's name under a bar


def write_lens_figure(fit: LensFit, path: Path) -> None:
    """Draw the region that each board covered, rings of angle from the axis, and errors by view."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.4), layout="constrained")
        frame, bars = figure.subplots(1, 2, width_ratios=(1.25, 1))
        _coverage(frame, fit)
        _errors(bars, fit)
        left_out = f", {len(fit.rejected)} left out" if fit.rejected else ""
        figure.suptitle(
            f"{fit.lens.model} lens {fit.lens.name or fit.lens.id}: {fit.held_out_px:.2f} px rms held out, "
            f"{len(fit.views)} views{left_out}",
            fontsize=11,
            fontweight="bold",
            color=INK,
        )
        with new_file(path) as building:
            figure.savefig(building, format="png", dpi=160)


def _coverage(axes: Axes, fit: LensFit) -> None:
    height, width = fit.lens.size_px
    axes.add_patch(Rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=INK, linewidth=1))
    for view in fit.views:
        axes.add_patch(Polygon(view.hull_px, facecolor=ACCENT, edgecolor=ACCENT, alpha=0.12, linewidth=0.8))
    around = np.linspace(0, math.tau, 181)
    for degrees in range(10, int(math.degrees(fit.lens.field_rad)) + 1, 10):
        theta = math.radians(degrees)
        points = [
            np.sin(theta) * np.cos(around),
            np.sin(theta) * np.sin(around),
            np.full(len(around), math.cos(theta)),
        ]
        ring = fit.lens.project(np.stack(points, axis=1))
        axes.plot(*ring.T, color=INK, linewidth=0.5, linestyle=":")
        axes.annotate(f"{degrees}°", ring[0], fontsize=6, color=INK, annotation_clip=True)
    axes.set(xlim=(-0.02 * width, 1.02 * width), ylim=(1.02 * height, -0.02 * height), aspect="equal")
    axes.set_title(f"boards cover {fit.coverage:.0%} of the frame; rings: angle from the axis", fontsize=8)
    axes.set(xlabel="x [px]", ylabel="y [px]")


def _errors(axes: Axes, fit: LensFit) -> None:
    place = np.arange(len(fit.views))
    axes.barh(place - 0.2, [view.rms_px for view in fit.views], 0.4, color=BAND, label="fitted")
    held_out = [view.held_out_px for view in fit.views]
    axes.barh(place + 0.2, held_out, 0.4, color=ACCENT, label="held out")
    axes.axvline(fit.held_out_px, color=BAD, linewidth=0.8, linestyle="--", label="rms of held out")
    axes.set_yticks(place, [view.name[-MAX_NAME:] for view in fit.views], fontsize=6)
    axes.invert_yaxis()
    axes.set_xlabel("error of a view, rms [px]")
    axes.legend(fontsize=6.5, loc="lower right")
