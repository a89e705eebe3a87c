"""A run of presses on specimens as an experiment's folder: what compliance is read from.

A press is a sweep of the run, down to a force and back. Its table has a row a force sample, and each frame
belongs to the sample of its own instant: the camera's latency, as the run's taps have told it, is taken off.

An experiment has one folder for every specimen at every tilt, since a tip that touches with its side gives
another curve: "S1=7.6" is pressed into the folder S1, "S1=7.6@20" into S1-20deg.

A run as a plain folder: one PNG a frame and a table of labels, for any other tool to read.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from palpate.core import (
    UNTOLD,
    Float,
    InputError,
    Int,
    PathText,
    ProgressCount,
    RecordingError,
    Specimen,
    ndarray,
    new_folder,
)
from palpate.recordings.exchange.press_folder import (
    PRESSES,
    PressFolder,
    press_folder,
    write_press,
    write_specimens,
)
from palpate.recordings.exchange.press_table import press_rows
from palpate.recordings.label_tables import refuse_formulas
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.run_reader import Run

SWEEP, CLOCKS = "sweep", "clocks"
AREA = "true_area_mm2"


@dataclass(frozen=True)
class _Press:
    """Sweep of the run: on what, by the plan's words, which, and its frames."""

    specimen: Specimen
    words: str
    name: str
    frames: Int[ndarray, " f"]


def export_presses(run: Run, out: Path | None = None) -> PressFolder | None:
    """Write the presses of a run.

    Args:
        run: recorded by a plan whose indenters are specimens, such as "S1=7.6".
        out: the folder to make; must not exist. None for ``presses`` within the run.

    Returns:
        The folder; None where the run has no presses on specimens.
    """
    presses = list(_presses(run))
    if not presses:
        return None
    out = run.path / PRESSES if out is None else out
    force, stage, late_s = run.force(), run.stage(), latency_s(run)
    folders = _folders(dict.fromkeys(press.words for press in presses))
    with new_folder(out) as building:
        write_specimens(building, {folders[press.words]: _told_n_m(press) for press in presses})
        for press in presses:
            rows = _rows(run, press, force, stage, late_s)
            images = (run.frame(int(i)).image for i in press.frames)
            write_press(building / folders[press.words], press.name, images, rows)
    return press_folder(out)


def latency_s(run: Run) -> float:
    """Latency of the frames' stamps behind the force's, by the run's last taps; 0 without any [s]."""
    events = run.events()
    clocks = [json.loads(text) for text in events.loc[events["kind"] == CLOCKS, "fields"]]
    return float(clocks[-1]["seconds"]) if clocks else 0.0


def _folders(indenters: Iterable[str]) -> dict[str, str]:
    """Folder of every indenter, by its words; numbered from 2 where others before it have the same name."""
    folders: dict[str, str] = {}
    for words in indenters:
        plain = _folder_of(words)
        numbered = (f"{plain}-{count}" for count in itertools.count(2))
        taken = set(folders.values())
        folders[words] = next(name for name in itertools.chain([plain], numbered) if name not in taken)
    return folders


def _folder_of(words: str) -> str:
    """Name of a specimen, with its tilt where it leans: S1 of "S1=7.6", S1-20deg of "S1=7.6@20"."""
    what, _, leaning = words.partition("@")
    name = Specimen.parse(what).name
    try:
        tilt_deg = float(leaning or 0.0)
    except ValueError:  # a sensor of one's own may say otherwise what follows the @
        return name
    return f"{name}-{tilt_deg:g}deg" if tilt_deg else name


def _told_n_m(press: _Press) -> float:
    """Stiffness of what is pressed; NaN where it is not known, or shall not be told [N/m]."""
    stiffness_n_m = press.specimen.stiffness_n_m
    return math.nan if stiffness_n_m is None or UNTOLD in press.words else stiffness_n_m


def _presses(run: Run) -> Iterator[_Press]:
    labels = run.labels
    if not {"phase", "indenter", "location", "approach", "cycle"} <= set(labels.columns):
        return
    sweeps = labels[labels["phase"] == SWEEP]
    places = sweeps["location"].nunique()
    for (place, words, _), rows in sweeps.groupby(["location", "indenter", "cycle"], sort=False):
        try:
            specimen = Specimen.parse(str(words).partition("@")[0])
        except InputError:
            continue
        last = rows[rows["approach"] == rows["approach"].max()]  # an interrupted sweep was done again
        cycle = int(last["cycle"].iloc[0])
        name = f"{cycle:02d}" if places == 1 else f"{place}-{cycle:02d}"
        yield _Press(specimen, str(words), name, last.index.to_numpy(np.int64))


def _rows(run: Run, press: _Press, force: pd.DataFrame, stage: pd.DataFrame, late_s: float) -> pd.DataFrame:
    times = force["time_s"].to_numpy(np.float64)
    frame_s = run.times_s[press.frames] - late_s
    at = np.clip(np.searchsorted(times, frame_s), 1, max(len(times) - 1, 1))
    if len(times) < 2 or not (np.diff(frame_s) > 0).all():
        raise RecordingError(f"{run.path}: press {press.name} has no force samples, or frames out of order")
    sample = at - (frame_s - times[at - 1] < times[at] - frame_s)
    part = slice(int(sample[0]), int(sample[-1]) + 1)
    time_s, first = times[part], int(sample[0])
    z_m = np.interp(time_s, stage["time_s"], stage["z_m"])
    return press_rows(
        time_s - time_s[0],
        force["fz_N"].to_numpy(np.float64)[part],
        z_m - z_m[0],
        z_m - z_m[0],
        sample - first,
        _areas_m2(run, press, sample - first, len(time_s)),
    )


def _areas_m2(
    run: Run, press: _Press, sample: Int[ndarray, " f"], samples: int
) -> Float[ndarray, " s"] | None:
    """Contact area where a frame is, from a simulator; none elsewhere."""
    if AREA not in run.labels.columns:
        return None
    area = np.full(samples, np.nan)
    area[sample] = 1e-6 * run.labels[AREA].to_numpy(np.float64)[press.frames]
    return area


FILE_COLUMN = "frame_file"
TIME_COLUMN = "frame_time_s"
LABELS_NAME = "labels.csv"


def export_folder(run: Run, path: PathText, progress: ProgressCount | None = None) -> int:
    """Write a run as a new folder of PNG files and tables; return the number of frames.

    The folder holds ``images/000000.png`` and so on, ``labels.csv`` with the columns ``frame_file`` and
    ``frame_time_s`` [s], ``manifest.json``, and ``force.csv``, ``stage.csv``, and ``events.csv`` for recorded
    channels. `import_images` reads it back unchanged if no label is missing.
    """
    with new_folder(Path(path)) as building:
        _write_table(building / LABELS_NAME, _labels(run))
        for name, table in (("force", run.force()), ("stage", run.stage()), ("events", run.events())):
            if not table.empty:
                _write_table(building / f"{name}.csv", table)
        (building / MANIFEST).write_text(run.manifest.model_dump_json(indent=2), encoding="utf-8")
        (building / "images").mkdir()
        for i in range(len(run)):
            Image.fromarray(run.frame(i).image).save(building / _file_name(i), format="PNG")
            if progress is not None:
                progress(i + 1, len(run))
    return len(run)


def _file_name(i: int) -> str:
    return f"images/{i:06d}.png"


def _labels(run: Run) -> pd.DataFrame:
    own = {FILE_COLUMN: [_file_name(i) for i in range(len(run))], TIME_COLUMN: run.times_s}
    labels = run.labels
    return pd.DataFrame(
        own | {str(name): labels[name].to_numpy() for name in labels.columns if name not in own}
    )


def _write_table(path: Path, table: pd.DataFrame) -> None:
    refuse_formulas(table, path)
    # RFC 4180's line ends; with them the writer also quotes a text that holds either of the two marks
    table.to_csv(path, index=False, lineterminator="\r\n")
