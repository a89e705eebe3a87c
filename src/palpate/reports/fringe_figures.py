"""Figures of fringes: the fit of a stress-optic coefficient, and maps of fringe orders as files."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType
from typing import Any

import matplotlib as mpl
import numpy as np
import tifffile
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from palpate.calibration.stress_optic_fit import FringeFit
from palpate.core import UInt8, Values, ndarray, new_file, storage_errors
from palpate.estimators.fringe_map import OrderMap, Untold
from palpate.estimators.fringe_order import RIVAL
from palpate.optics.colour import encode_srgb
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, STYLE

WORDS = {
    Untold.TOLD: "told",
    Untold.OUTSIDE: "outside",
    Untold.SATURATED: "saturated",
    Untold.UNLIKE: "unlike calibration",
    Untold.RIVAL: "another as likely",
    Untold.FAINT: "too uncertain",
    Untold.BEYOND: "beyond range",
    Untold.APART: "apart from reference",
    Untold.DENSE: "fringes too dense",
}
HUES = ("#cfe8e6", "#ffffff", "#d62728", "#8c564b", "#ff7f0e", "#7f7f7f", "#9467bd", "#1f77b4", "#bcbd22")
COLUMNS = ("frame", "told_share", "order_median", "order_greatest", "sigma_median", "misfit_median")


class OrderFiles:
    """Files of a series of maps in an empty folder, written one by one; use it in a `with` block.

    ``order.tif`` and ``sigma.tif`` have a page of 32-bit numbers per frame, NaN for no order; ``000000.npz``
    and so on hold each map; ``frames.csv`` has a row per frame; ``order.png`` shows the last.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with storage_errors(folder):
            self._pages = [
                tifffile.TiffWriter(folder / f"{name}.tif", ome=False) for name in ("order", "sigma")
            ]
        self._lines: list[dict[str, object]] = []
        self._last: tuple[ndarray, OrderMap] | None = None

    def __enter__(self) -> OrderFiles:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pages in self._pages:
            pages.close()
        if kind is None:
            self._finish()

    def add(self, index: int, name: str, image: UInt8[ndarray, "h w *c"], found: OrderMap) -> None:
        with storage_errors(self._folder):
            for pages, values in zip(self._pages, (found.order, found.sigma), strict=True):
                told = np.where(found.valid, values, np.float32(np.nan))
                pages.write(told, photometric="minisblack", contiguous=False, metadata=None)
            np.savez_compressed(self._folder / f"{index:06d}.npz", **map_arrays(found))
        self._lines.append({"frame": name, **found.summary()})
        self._last = image, found

    def _finish(self) -> None:
        with storage_errors(self._folder), (self._folder / "frames.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(self._lines)
        if self._last is not None:
            with storage_errors(self._folder):
                draw_orders(*self._last).savefig(self._folder / "order.png", dpi=150)


def map_arrays(found: OrderMap) -> dict[str, Any]:
    """Return a map as named arrays; the numbers of `why` are those of `Untold`."""
    names = ("order", "sigma", "lead", "axis_rad", "misfit", "why")
    return {name: getattr(found, name) for name in names}


def draw_orders(image: UInt8[ndarray, "h w *c"], found: OrderMap) -> Figure:
    """Draw a frame with its orders, their standard deviation, and why some are missing."""
    told = found.valid
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 7.4), layout="constrained")
        (frame, orders), (spread, reasons) = figure.subplots(2, 2)
        frame.imshow(image, cmap="gray")
        order, sigma = (np.where(told, v, np.nan) for v in (found.order, found.sigma))
        most = 1.2 * float(np.nanquantile(sigma, 0.98)) if told.any() else 1.0
        shown = orders.imshow(order, cmap="viridis", vmin=0, interpolation="nearest")
        figure.colorbar(shown, ax=orders, label="fringe order")
        shown = spread.imshow(sigma, cmap="magma_r", vmin=0, vmax=most, interpolation="nearest")
        figure.colorbar(shown, ax=spread, label="standard deviation [orders]", extend="max")
        hues, norm = ListedColormap(HUES), BoundaryNorm(np.arange(len(HUES) + 1) - 0.5, len(HUES))
        shown = reasons.imshow(found.why, cmap=hues, norm=norm, interpolation="nearest")
        bar = figure.colorbar(shown, ax=reasons, ticks=range(len(HUES)))
        bar.ax.set_yticklabels([WORDS[Untold(i)] for i in range(len(HUES))])
        titles = ("frame", "order", "uncertainty", "what is told")
        for axes, title in zip((frame, orders, spread, reasons), titles, strict=True):
            axes.set_title(title, color=INK)
            axes.set_xticks([])
            axes.set_yticks([])
        inside = max(int((found.why != Untold.OUTSIDE).sum()), 1)
        figure.suptitle(f"{told.sum() / inside:.0%} of the specimen's pixels told", color=INK)
    return figure


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
