"""The flow of a sequence as a table and a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from palpate.core.files import new_folder, storage_errors
from palpate.estimators.flow.course import Step, course
from palpate.recordings.sequences import open_sequence
from palpate.reports.figures import ACCENT, INK, STYLE

ARROWS = 24  # along the image's longer side


def write_flow(
    frames: Path,
    out: Path,
    *,
    method: str = "horn-schunck",
    from_first: bool = False,
    fields: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Compute flow along a sequence and write ``flow.csv``, ``flow.png`` and perhaps ``fields.npy``.

    Memory does not grow with the sequence.

    Args:
        frames: a multi-page TIFF, a video, a folder of images or a run.
        out: folder to make; must not exist. It appears when all is done.
        method, from_first: see `course`.
        fields: also write every flow ``[steps 2 h w]``, float32.
        progress: told how many steps are done of how many.

    Returns:
        What was found, as the verb prints it.

    Raises:
        ExistsError: `out` exists.
        InputError, ImageError, RecordingError: nothing that flows.
    """
    with open_sequence(frames) as sequence, new_folder(out) as building:
        rows: list[tuple[int, float, float]] = []
        last: Step | None = None
        kept: np.ndarray | None = None
        for i, step in enumerate(course(sequence, method, from_first=from_first)):
            rows.append((i + 1, step.speed_px, step.divergence))
            last = step
            if fields:
                kept = kept if kept is not None else _kept(building, len(sequence) - 1, step)
                kept[i] = step.field
            progress(i + 1, len(sequence) - 1)
        assert last is not None
        table = pd.DataFrame(rows, columns=["frame", "speed_px", "divergence_per_frame"])
        total = table["divergence_per_frame"]
        table["accumulated_divergence"] = total if from_first else total.cumsum()
        with storage_errors(building):
            table.to_csv(building / "flow.csv", index=False)
            _draw(table, last).savefig(building / "flow.png")
    return {
        "out": str(out),
        "method": method,
        "from_first": from_first,
        "steps": len(table),
        "mean_speed_px": float(table["speed_px"].mean()),
        "accumulated_divergence": float(table["accumulated_divergence"].iloc[-1]),
    }


def _kept(folder: Path, steps: int, step: Step) -> np.ndarray:
    with storage_errors(folder):
        return np.lib.format.open_memmap(
            folder / "fields.npy", "w+", np.float32, shape=(steps, *step.field.shape)
        )


def _draw(table: pd.DataFrame, last: Step) -> Figure:
    """The last flow as arrows; speed and accumulated divergence over the frames."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.5, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.4])
        every = max(1, max(last.field.shape[1:]) // ARROWS)
        u, v = last.field[:, every // 2 :: every, every // 2 :: every]
        y, x = np.mgrid[: u.shape[0], : u.shape[1]] * every + every // 2
        left.quiver(x, y, u, v, color=ACCENT, angles="xy")
        left.set(xlim=(0, last.field.shape[2]), ylim=(last.field.shape[1], 0), aspect="equal")
        left.set(title="flow of the last step", xlabel="x [px]", ylabel="y [px]")
        right.plot(table["frame"], table["accumulated_divergence"], color=ACCENT)
        right.set(xlabel="frame", ylabel="accumulated mean divergence", title="along the sequence")
        speed = right.twinx()
        speed.plot(table["frame"], table["speed_px"], color=INK, lw=0.8, ls=":")
        speed.set_ylabel("mean speed [px] (dotted)")
        return figure
