"""Presses from files: frames and table of one press, or the presses of an experiment's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from palpate.calibration.compliance import Reference, ReferenceTrial
from palpate.core.errors import InputError
from palpate.estimators.casr.pin_press import watched
from palpate.recordings.press_folder import PressFolder
from palpate.recordings.press_table import PressTable, read_press_table
from palpate.recordings.sequences import open_sequence

Progress = Callable[[str, int, int], None]


def quiet(what: str, done: int, total: int) -> None:
    """No progress shown."""


def load_press(frames: Path, table: Path, **columns: object) -> tuple[ReferenceTrial, PressTable]:
    """One press: its pins followed, and its contact area where the table has it.

    Args:
        frames: a multi-page TIFF, a video, a folder of images or a run.
        table: of its force; see `read_press_table`.
        columns: for `read_press_table`, e.g. ``rate_hz``.

    Raises:
        InputError, ImageError, LabelError: what cannot be read as a press.
    """
    with open_sequence(frames) as sequence:
        held = read_press_table(table, len(sequence), **columns)  # type: ignore[arg-type]
        press = watched(sequence, held.force_n, held.frame_sample, held.position_m, held.time_s)
    area = None if held.area_m2 is None else held.area_m2[held.frame_sample[press.frame]]
    return ReferenceTrial(press, area), held


def load_references(folder: PressFolder, progress: Progress = quiet) -> list[Reference]:
    """The specimens of known stiffness, in the folder's order.

    Raises:
        InputError: fewer than two have a known stiffness; and as `load_press`.
    """
    known = [one for one in folder.specimens if one.stiffness_n_m is not None]
    if len(known) < 2:
        raise InputError(
            f"{len(known)} of {len(folder.specimens)} specimens in {folder.path} have a known stiffness; "
            "write two or more into specimens.csv: stiffness_N_per_mm, inf for a rigid plate"
        )
    total, done = sum(len(one.presses) for one in known), 0
    references = []
    for one in known:
        trials = []
        for frames, table in one.presses:
            trials.append(load_press(frames, table)[0])
            done += 1
            progress("presses", done, total)
        assert one.stiffness_n_m is not None
        references.append(Reference(one.name, one.stiffness_n_m, tuple(trials)))
    return references
