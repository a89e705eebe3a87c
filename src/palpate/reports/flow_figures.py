"""The flow of a sequence as a table and a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.core import Bool, InputError, new_folder, storage_errors
from palpate.estimators.flow.flow_sequence import METHODS, Step, contact_region, course
from palpate.estimators.flow.horn_schunck import FlowField
from palpate.recordings.exchange.frame_sequences import FrameSequence, open_sequence
from palpate.reports.calibration_figures import ACCENT, INK, STYLE

ARROWS = 24  # along the image's longer side
COLUMNS = ["frame", "speed_px", "divergence_per_frame", "border_flux_per_frame"]
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
        table = pd.DataFrame(rows, columns=COLUMNS)
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
