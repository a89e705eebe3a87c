"""A run as a plain folder: one PNG a frame and a table of labels, for any other tool to read."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from PIL import Image

from palpate.core import PathText, ProgressCount, new_folder
from palpate.recordings.label_tables import refuse_formulas
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.run_reader import Run

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
