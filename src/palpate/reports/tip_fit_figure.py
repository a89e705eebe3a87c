"""The picture of a fitted tip: twin and taps side by side, and where on the tip they differ."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.core import Float, ndarray, new_folder, storage_errors
from palpate.reports.calibration_figures import ACCENT, INK, styled_panels

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
