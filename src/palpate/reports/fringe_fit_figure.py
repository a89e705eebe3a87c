"""The picture of a stress-optic coefficient: orders against load, and the light that tells them."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.calibration.stress_optic_fit import FringeFit
from palpate.core import Values, new_file
from palpate.estimators.fringe_order import RIVAL
from palpate.optics.colour import encode_srgb
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, STYLE

CHANNELS = (("red", "#c0392b"), ("green", "#2e8b57"), ("blue", "#2c6fbb"))
BREWSTER = 1e-12  # [1/Pa], the unit in which C is shown


def write_figure(fit: FringeFit, path: Path) -> None:
    """Draw a fit: the line through the orders, the light of each order, and colors seen and expected."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.9), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1), height_ratios=(2.5, 1))
        _line(figure.add_subplot(grid[:, 0]), fit)
        _curves(figure.add_subplot(grid[0, 1]), fit)
        _colours(figure.add_subplot(grid[1, 1]), fit)
        figure.suptitle(fit_headline(fit), fontsize=11, fontweight="bold", color=INK)
        figure.supxlabel(f"{fit.specimen}; {fit.lamp}", fontsize=7.5, color=INK)
        with new_file(path) as building:
            figure.savefig(building, format="png", dpi=160)


def fit_headline(fit: FringeFit) -> str:
    """Return C, its interval, and whether it is unambiguous, in one line."""
    C, low, high = (c / BREWSTER for c in (fit.coefficient_per_pa, fit.low_per_pa, fit.high_per_pa))
    up_to = f"no other slope up to order {fit.settings['greatest_order']:g} fits nearly as well"
    digits = max(0, 1 - int(np.floor(np.log10(high - low))))
    return (
        f"C = {C:.{digits}f} brewster ({low:.{digits}f} to {high:.{digits}f}, 95 %) "
        f"at {fit.wavelength_m * 1e9:g} nm; {'ambiguous' if fit.ambiguous else up_to}"
    )


def _line(axes: Axes, fit: FringeFit) -> None:
    load, seen = np.array(fit.load_n), np.array(fit.seen)
    ends = np.array([0.0, 1.04 * load.max()])
    slopes = fit.orders_per_n * np.array([fit.low_per_pa, fit.high_per_pa]) / fit.coefficient_per_pa
    # The band turns about N0 at no load; how far N0 may lie off is within C's interval already.
    axes.fill_between(
        ends,
        fit.residual_order + slopes[0] * ends,
        fit.residual_order + slopes[1] * ends,
        color=BAND,
        label="95 % interval of C",
    )
    axes.plot(ends, fit.residual_order + fit.orders_per_n * ends, color=ACCENT, lw=1.5, label="fit")
    rivals = [rival for rival in fit.rivals if rival.likelihood > RIVAL]
    for rival, style in zip(rivals, ("--", ":", "-."), strict=False):
        slope = fit.orders_per_n * rival.coefficient_per_pa / fit.coefficient_per_pa
        C = rival.coefficient_per_pa / BREWSTER
        label = f"also allowed: {C:.3g} brewster, likelihood {rival.likelihood:.2f}"
        axes.plot(ends, slope * ends, color=BAD, lw=1, ls=style, label=label)
    ranges = np.abs(np.array([fit.seen_low, fit.seen_high]) - seen)
    axes.errorbar(load, seen, ranges, fmt="o", color=INK, ms=4, lw=1, capsize=2, label="photographs, 95 %")
    top = max(np.max(fit.seen_high), fit.order[int(load.argmax())])
    axes.set(xlim=ends, ylim=(min(0.0, np.min(fit.seen_low)) - 0.03, 1.12 * top))
    axes.set(xlabel="load [N]", ylabel="fringe order N", title="order against load")
    axes.legend(frameon=False, fontsize=7.5, loc="lower right")


def _curves(axes: Axes, fit: FringeFit) -> None:
    whole = fit.scale_light.max()
    for c in fit.channels:
        name, colour = CHANNELS[c]
        axes.plot(fit.scale_order, fit.scale_light[:, c] / whole, color=colour, lw=1.2, label=f"{name}: fit")
        axes.plot(fit.order, fit.observed[:, c] / whole, "o", color=colour, ms=4, alpha=0.8)
    axes.plot([], [], "o", color=INK, ms=4, label="photographs")
    axes.set(xlim=(0, 1.03 * fit.scale_order[-1]), ylim=(-0.03, None), xlabel="order of the fit at each load")
    axes.set(ylabel="light [share of the greatest]", title="light against order")
    axes.legend(frameon=False, fontsize=7, loc="upper center", ncols=4, bbox_to_anchor=(0.5, 1.02))
    axes.set_ylim(top=1.22 * max(1.0, fit.observed[:, list(fit.channels)].max() / whole))


def _colours(axes: Axes, fit: FringeFit) -> None:
    whole = max(fit.scale_light.max(), fit.observed.max())
    end = fit.scale_order[-1]
    axes.imshow(_shown(fit.scale_light / whole)[None], extent=(0, end, 0, 1), aspect="auto")
    half = 0.022 * end
    for order, colour in zip(fit.order, _shown(fit.observed / whole), strict=True):
        axes.imshow(colour[None, None], extent=(order - half, order + half, 1.15, 2.15), aspect="auto")
    axes.set(xlim=(-half, end + half), ylim=(0, 2.15), xlabel="fringe order N", yticks=(0.5, 1.65))
    axes.set_yticklabels(("fit", "seen"))
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.tick_params(length=0)


def _shown(light: Values) -> np.ndarray:
    return np.asarray(encode_srgb(light))
