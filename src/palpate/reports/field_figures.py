"""Figures of fringes: the fit of a stress-optic coefficient, and maps of fringe orders as files.

The flow of a sequence as a table and a picture.

The picture of a lens's calibration: where the boards were, and the error of each view.

A plan's places, drawn: the layer, the probe at each place, and the order.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
import tifffile
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from palpate.calibration.lens import LensFit
from palpate.calibration.stress_optic_fit import FringeFit
from palpate.core import Bool, InputError, UInt8, Values, ndarray, new_file, new_folder, storage_errors
from palpate.estimators.flow.horn_schunck import METHODS, FlowField, Step, contact_region, course
from palpate.estimators.fringe_map import OrderMap, Untold
from palpate.estimators.fringe_order import RIVAL
from palpate.optics.colour import encode_srgb
from palpate.recordings.exchange.frame_sequences import FrameSequence, open_sequence
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK, STYLE
from palpate.rig.plans.recording_plan import RecordingPlan

WORDS = {
    Untold.TOLD: "told",
    Untold.OUTSIDE: "outside",
    Untold.SATURATED: "saturated",
    Untold.UNLIKE: "unlike calibration",
    Untold.RIVAL: "another as likely",
    Untold.FAINT: "too uncertain",
    Untold.BEYOND: "beyond range",
}
HUES = ("#cfe8e6", "#ffffff", "#d62728", "#8c564b", "#ff7f0e", "#7f7f7f", "#9467bd")
FRINGE_COLUMNS = ("frame", "told_share", "order_median", "order_greatest", "sigma_median", "misfit_median")


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
            writer = csv.DictWriter(file, FRINGE_COLUMNS, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(self._lines)
        if self._last is not None:
            with storage_errors(self._folder):
                draw_orders(*self._last).savefig(self._folder / "order.png", dpi=150)


def map_arrays(found: OrderMap) -> dict[str, Any]:
    """Return a map as named arrays; the numbers of `why` are those of `Untold`."""
    names = ("order", "sigma", "lead", "misfit", "why")
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


ARROWS = 24  # along the image's longer side
FLOW_COLUMNS = ["frame", "speed_px", "divergence_per_frame", "border_flux_per_frame"]
SUMMED = {
    "accumulated_divergence": "divergence_per_frame",
    "accumulated_border_flux": "border_flux_per_frame",
}
SPEEDS = "GnBu"  # light where little moves


def write_flow(
    frames: Path,
    out: Path,
    *,
    method: str = "horn-schunck",
    from_first: bool = False,
    fields: bool = False,
    region_px: tuple[int, int, int, int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Compute flow along a sequence; write ``flow.csv``, ``flow.png``, and with `fields` ``fields.npy``.

    Args:
        frames: multi-page TIFF, video, folder of images, or run.
        out: folder to make; must not exist.
        method, from_first: see `course`.
        fields: also write every flow ``[steps 2 h w]``, float32.
        region_px: (x, y, width, height) of the divergence; None for `contact_region` [px].

    Returns:
        The summary that the command prints.
    """
    with open_sequence(frames) as sequence, new_folder(out) as building:
        rows: list[tuple[int, float, float, float]] = []
        region = _region(sequence, method, region_px)
        fastest: Step | None = None
        flows: np.ndarray | None = None
        for i, step in enumerate(course(sequence, method, from_first=from_first, region=region)):
            rows.append((i + 1, step.speed_px, step.divergence, step.border_flux))
            if fastest is None or step.speed_px > fastest.speed_px:
                fastest = step
            if fields:
                if flows is None:
                    flows = _flows_file(building, len(sequence) - 1, step)
                flows[i] = step.field
            progress(i + 1, len(sequence) - 1)
        assert fastest is not None
        table = pd.DataFrame(rows, columns=FLOW_COLUMNS)
        for name, column in SUMMED.items():
            table[name] = table[column] if from_first else table[column].cumsum()
        with storage_errors(building):
            table.to_csv(building / "flow.csv", index=False)
            _draw(
                table, fastest, f"{method}, from {'the first frame' if from_first else 'frame to frame'}"
            ).savefig(building / "flow.png")
    return {
        "out": str(out),
        "method": method,
        "from_first": from_first,
        "steps": len(table),
        "fastest_frame": _fastest(table),
        "mean_speed_px": float(table["speed_px"].mean()),
        **{name: float(table[name].iloc[-1]) for name in SUMMED},
        "region": {
            "kind": _kind(region, region_px),
            "pixels": int(region.sum()),
            "box_px": [int(x) for x in cv2.boundingRect(region.astype(np.uint8))],
        },
    }


def _region(
    sequence: FrameSequence, method: str, region_px: tuple[int, int, int, int] | None
) -> Bool[np.ndarray, "h w"]:
    if method not in METHODS:
        raise InputError(f"no method {method!r}; there are {', '.join(METHODS)}")
    if region_px is None:
        return contact_region(sequence, method)
    x, y, width, height = region_px
    rows, columns = next(iter(sequence)).shape[:2]
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise InputError(
            f"A region of {width} x {height} px at ({x}, {y}) is not inside the images of {columns} x {rows} "
            "px. Give X,Y,WIDTH,HEIGHT inside them."
        )
    region = np.zeros((rows, columns), bool)
    region[y : y + height, x : x + width] = True
    return region


def _kind(region: Bool[np.ndarray, "h w"], region_px: tuple[int, int, int, int] | None) -> str:
    if region.all():
        return "image"  # its mean divergence is the border flux
    return "contact" if region_px is None else "given"


def _flows_file(folder: Path, steps: int, step: Step) -> np.ndarray:
    with storage_errors(folder):
        return np.lib.format.open_memmap(
            folder / "fields.npy", "w+", np.float32, shape=(steps, *step.field.shape)
        )


def _fastest(table: pd.DataFrame) -> int:
    return int(table["frame"].iloc[int(table["speed_px"].argmax())])


def _draw(table: pd.DataFrame, fastest: Step, how: str) -> Figure:
    """The fastest flow, as colours and arrows, beside speed and divergence over the frames."""
    frame = _fastest(table)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 4.6), layout="constrained")
        panels = figure.subplot_mosaic("fs;fd", width_ratios=[1.2, 1])
        above, below = panels["s"], panels["d"]
        figure.suptitle(f"Optical flow: {how}", color=INK)
        _field(panels["f"], fastest.field, f"fastest flow, to frame {frame}")
        above.plot(table["frame"], table["speed_px"], color=ACCENT)
        above.set(title="mean speed", ylabel="speed [px]", ylim=(0, None))
        below.plot(table["frame"], table["accumulated_divergence"], color=ACCENT)
        below.axhline(0, color=INK, lw=0.6)
        below.set(title="mean divergence of the region so far", xlabel="frame", ylabel="divergence [1]")
        below.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
        above.sharex(below)
        above.tick_params(labelbottom=False)
        for axes in (above, below):
            axes.axvline(frame, color=INK, lw=0.8, ls=":")
        return figure


def _field(axes: Axes, field: FlowField, title: str) -> None:
    h, w = field.shape[1:]
    speed = np.hypot(*field)
    most = float(np.quantile(speed, 0.999)) or 1.0  # a few pixels at edges claim far more
    image = axes.imshow(speed, cmap=SPEEDS, vmin=0, vmax=most, extent=(-0.5, w - 0.5, h - 0.5, -0.5))
    axes.figure.colorbar(image, ax=axes, label="speed [px]", shrink=0.85, extend="max")
    side = min(-(-max(h, w) // ARROWS), h, w)
    y, x = (np.arange(n // side) * side + (side - 1) / 2 for n in (h, w))
    u, v = (
        part[: len(y) * side, : len(x) * side].reshape(len(y), side, len(x), side).mean(axis=(1, 3))
        for part in field
    )
    longest = float(np.hypot(u, v).max()) or 1.0
    arrows = axes.quiver(
        x, y, u, v, color=INK, angles="xy", scale_units="xy", scale=longest / (1.5 * side), width=0.0025
    )
    key = float(f"{longest:.1g}")
    axes.quiverkey(
        arrows, 0.93, -0.12, key, f"mean of {side} x {side} px: {key:g} px", labelpos="W", coordinates="axes"
    )
    axes.set_title(title, loc="left")
    axes.set(xlabel="x [px]", ylabel="y [px]", xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5))


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


LAYER, PROBE, PLACE_INK = "#cfe8e6", "#0b7a75", "#1b2a33"
MARGIN_MM = 3.0


def draw_places(plan: RecordingPlan, path: Path) -> None:
    """Write a PNG of the positions to press."""
    places = plan.places.places()
    layer, probe = (diameter / 2 for diameter in plan.places.sizes_mm())
    figure = Figure(figsize=(6, 6.4), layout="constrained")
    axes = figure.add_subplot()
    axes.add_patch(Circle((0, 0), layer, facecolor=LAYER, edgecolor=PLACE_INK, lw=1.2))
    for i, place in enumerate(places):
        at = (place.x_mm, place.y_mm)
        axes.add_patch(Circle(at, probe, facecolor="none", edgecolor=PROBE, lw=0.6, alpha=0.45))
        axes.text(*at, str(i + 1), ha="center", va="center", fontsize=7, color=PLACE_INK)
    furthest = max(max(abs(place.x_mm), abs(place.y_mm)) for place in places)
    reach = max(layer, furthest + probe) + MARGIN_MM
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="x [mm]", ylabel="y [mm], towards the viewer")
    axes.set_aspect("equal")
    presses = f"{len(places)} places × {plan.cycles} {'cycle' if plan.cycles == 1 else 'cycles'}"
    axes.set_title(
        f"{plan.name}: {presses}, probe of {2 * probe:g} mm on {2 * layer:g} mm", fontsize=10, loc="left"
    )
    axes.spines[["top", "right"]].set_visible(False)
    with new_file(path) as file:
        figure.savefig(file, format="png", dpi=120)
