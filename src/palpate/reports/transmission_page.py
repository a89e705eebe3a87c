"""A page on softness transmitted: what was touched, what is felt, and what each stage loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from palpate.core import new_file
from palpate.mechanics.fingertip_laws import Fingertip
from palpate.reports.calibration_figures import ACCENT, BAND, COLOURS, INK, STYLE, drawn
from palpate.reports.certificate_page import filled_template
from palpate.softness.characteristics import SoftObject
from palpate.softness.transmission import STAGES, StageJudgement, Transmission, object_under
from palpate.version import __version__

MM, MM2 = 1e3, 1e6
MARKS = {"touch": "the touch", "display": "display and arm", "together": "all together"}


def write_transmission_page(
    path: Path, transmissions: Sequence[Transmission], judgements: Mapping[str, StageJudgement],
    record: Mapping[str, Any], finger: Fingertip,
) -> None:  # fmt: skip
    """Write the page of a transmission study.

    Args:
        transmissions: one per object.
        judgements: by stage; empty for a single object.
        record: what `--json` prints.
        finger: on a rigid flat.
    """
    text = filled_template(
        "transmission.html", version=__version__, record=record, stages=STAGES, marks=MARKS,
        judgements=judgements, curves=_curves(transmissions, finger), losses=_losses(transmissions),
    )  # fmt: skip
    with new_file(path) as part:
        part.write_text(text, encoding="utf-8")


def _curves(transmissions: Sequence[Transmission], finger: Fingertip) -> str:
    """Both cues of each object: itself, as touched with its interval, and what the finger felt."""
    with mpl.rc_context(STYLE):
        rows = len(transmissions)
        figure = Figure(figsize=(9.2, 0.5 + 2.6 * rows), layout="constrained")
        panels = figure.subplots(rows, 2, squeeze=False)
        for (arm, skin), one in zip(panels, transmissions, strict=True):
            for axes, cue, scale in ((arm, "displacement", MM), (skin, "area", MM2)):
                _cue(axes, one, cue, scale, finger)
            arm.set_title(f"{one.name}: to the arm", loc="left", fontsize=10)
            skin.set_title("to the skin", loc="left", fontsize=10)
            arm.set_ylabel("force [N]")
        panels[-1][0].set_xlabel("displacement of the finger [mm]")
        panels[-1][1].set_xlabel("contact area [mm²]")
        panels[0][0].legend(frameon=False, fontsize=8)
        return drawn(figure)


def _cue(axes: Any, one: Transmission, cue: str, scale: float, finger: Fingertip) -> None:
    force = one.peak_n * np.linspace(0.0, 1.0, 120) ** 1.5

    def curve(soft: SoftObject) -> np.ndarray:
        return scale * np.asarray(getattr(soft, cue).at_force(force))

    low, high = (
        curve(object_under(finger, float(one.touched.at(np.array([share]))[0]), one.peak_n))
        for share in (0.05, 0.95)
    )
    axes.fill_betweenx(force, high, low, color=BAND, label="as touched, 90 %")
    felt = one.rendering
    x = felt.displacement_m if cue == "displacement" else felt.area_m2
    shown = felt.scored
    axes.plot(scale * x[shown], felt.force_n[shown], ".", ms=1.2, color=ACCENT, alpha=0.5, label="felt")
    axes.plot(
        curve(object_under(finger, one.touched.flat_pa, one.peak_n)),
        force,
        color=ACCENT,
        lw=1,
        label="as touched",
    )
    if one.object is not None:
        axes.plot(curve(one.object), force, "--", color=INK, lw=1.2, label="object itself")


def _losses(transmissions: Sequence[Transmission]) -> str | None:
    """Errors of each cue by stage; None where no object is known."""
    known = [one for one in transmissions if one.object is not None]
    if not known:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 3.0), layout="constrained")
        for axes, cue in zip(figure.subplots(1, 2, sharey=True), ("displacement", "area"), strict=True):
            for k, mark in enumerate(MARKS):
                at = np.arange(len(known)) + 0.26 * (k - 1)
                axes.bar(
                    at,
                    [100 * one.cues[cue].lost[mark] for one in known],
                    0.24,
                    color=COLOURS[k],
                    label=MARKS[mark],
                )
            axes.set_xticks(range(len(known)), [one.name for one in known])
            axes.axhline(0, color=INK, lw=0.8)
            axes.set_title(
                {"displacement": "to the arm", "area": "to the skin"}[cue], loc="left", fontsize=10
            )
        figure.axes[0].set_ylabel("error of the chord [%]")
        figure.axes[0].legend(frameon=False, fontsize=8)
        return drawn(figure)
