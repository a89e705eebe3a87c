"""The photoelastic palm's own recordings: a table a press, a folder of photographs a shot, turned into a run.

A press is one table `Cycle_Indent5mm_r{row}c{col}_{cycle}.csv` of force samples. While the probe dwells at a
depth, some five samples are taken and some 25 photographs; the column `image_file` of all of them names the
folder of these photographs, or one photograph. So all frames of a shot share one force, the mean of its
samples, and belong on the same side of a split: by `location`, `press` or `shot`.

The layout is taken from the source's published code: no recording of it has been read yet.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core.errors import LabelError
from palpate.core.files import refuse_existing, storage_errors
from palpate.recordings.importers.images import ImportReport, Progress, import_images
from palpate.recordings.importers.palm_shots import Shot, check_no_strays, check_once, shots_of
from palpate.recordings.importers.palm_tables import NEAR_MM, Press, presses_in, table_of


def import_palm(
    folder: Path,
    run: Path,
    *,
    sensor: str = "palm",
    licence: str = "",
    origin: str = "",
    allow_unlabelled: bool = False,
    progress: Progress | None = None,
) -> ImportReport:
    """Turn a folder of the palm's tables and photographs into a run.

    Frames come by place, cycle and the table's order of shots, with the labels of `rig.acquisition` as far as
    the source has them, and `row`, `column` and, where each shot has several samples, their spread
    `force_sd_N`. When photographs were taken is not known: the run's times are ordinal, and `t_s` is the
    middle of the dwell by the table.

    `force_N` is the normal force, positive in compression, whichever way the source's Fz points: its sign is
    that of the deepest shots. So noise about zero keeps its sign, and its mean is not pushed up. `depth_mm`
    is the source's own, from its own zero. Shots at depth 0 are references; x and y are the source's own.

    Args:
        folder: where the tables are, the photographs beside them or in a folder ``images``.
        run: the run to make; must not exist.
        sensor: which sensor was recorded.
        licence: of the data.
        origin: who recorded it, and where it was had from.
        allow_unlabelled: leave out photographs that no table names, rather than refuse the folder.
        progress: told how many steps are done of how many.

    Raises:
        ExistsError: `run` exists.
        InputError: no folder, or it has no tables.
        LabelError: a table with another name, a missing column, a cell that is no finite number, a photograph
            or folder that is missing, outside `folder` or named by two shots; the message names file and row.
        ImageError: a photograph cannot be read, or is not of the first one's size and kind.
        StorageError: the disk is full, or refused.
    """
    refuse_existing(run)
    presses = presses_in(folder)
    tables = {press: table_of(press) for press in presses}
    shots = [shot for press, table in tables.items() for shot in shots_of(press, table, folder)]
    check_once(shots)
    if not allow_unlabelled:
        check_no_strays(shots, folder)
    labels = _labels(shots, tables, folder)
    with tempfile.TemporaryDirectory() as scratch, storage_errors(Path(scratch)):
        table_file = Path(scratch, "labels.parquet")
        labels.to_parquet(table_file)
        return import_images(
            folder,
            run,
            labels=table_file,
            image_column="image_file",
            sensor=sensor,
            licence=licence,
            origin=origin,
            rig="imported from the palm's own tables",
            allow_unlabelled=True,
            progress=progress,
        )


def _labels(shots: Sequence[Shot], tables: dict[Press, pd.DataFrame], folder: Path) -> pd.DataFrame:
    """A row a photograph."""
    sign = _normal_sign(tables)
    rows: list[dict[str, object]] = []
    for shot in shots:
        samples = tables[shot.press].iloc[shot.rows]
        about = _about(shot, samples, sign)
        for k, photo in enumerate(shot.photos):
            name = photo.relative_to(folder).as_posix()
            rows.append({"image_file": name, "frame_in_shot": float(k), **about})
    return pd.DataFrame(rows).dropna(axis=1)  # the spread, where there is none


def _about(shot: Shot, samples: pd.DataFrame, sign: float) -> dict[str, object]:
    press, force = shot.press, samples[["Fx", "Fy", "Fz"]].to_numpy(dtype=np.float64)
    fx, fy, fz = force.mean(axis=0).tolist()
    return {
        "shot": shot.key,
        "location": press.location,
        "row": float(press.row),
        "column": float(press.column),
        "press": press.name,
        "cycle": float(press.cycle),
        "phase": shot.label,
        "reference": shot.depth_mm == 0.0,
        "x_mm": float(samples["x_mm"].mean()),
        "y_mm": float(samples["y_mm"].mean()),
        "depth_mm": shot.depth_mm,
        "force_N": sign * fz,
        "force_x_N": fx,
        "force_y_N": fy,
        "force_sd_N": float(force[:, 2].std(ddof=1)) if len(force) > 1 else np.nan,
        "t_s": float(samples["t_s"].mean()),
    }


def _normal_sign(tables: dict[Press, pd.DataFrame]) -> float:
    """Which way Fz points: at a press's deepest shot the skin is compressed, whatever its sign.

    Raises:
        LabelError: presses say otherwise of one another.
    """
    signs: dict[float, Press] = {}
    for press, table in tables.items():
        depth, fz = table["indent_mm"].to_numpy(), table["Fz"].to_numpy()
        deepest = float(np.mean(fz[depth >= depth.max() - NEAR_MM]))
        if depth.max() > NEAR_MM and deepest != 0.0:
            signs.setdefault(float(np.sign(deepest)), press)
    if len(signs) > 1:
        one, other = signs[1.0].path, signs[-1.0].path
        raise LabelError(
            f"at the deepest indentation Fz is positive in {one} and negative in {other}; import "
            "presses of one sign convention at a time"
        )
    return next(iter(signs), 1.0)
