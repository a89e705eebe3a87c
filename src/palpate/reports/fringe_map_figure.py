"""Maps of fringe orders as files: numbers of every frame, and a picture to look at."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType
from typing import Any

import matplotlib as mpl
import numpy as np
import tifffile
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from palpate.core import UInt8, ndarray, storage_errors
from palpate.estimators.fringe_map import OrderMap, Untold
from palpate.reports.calibration_figures import INK, STYLE

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
