"""Presses from files: frames and table of one press, or the presses of an experiment's folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from numpy import ndarray

from palpate.calibration.compliance import Reference, ReferenceTrial
from palpate.core.errors import InputError
from palpate.core.shapes import Shaped
from palpate.estimators.compliance.pin_press import watched
from palpate.estimators.networks.model_interface import Progress, silent
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_folder import PressFolder
from palpate.recordings.exchange.press_table import PressTable, read_press_table


def followed(frames: Iterable[Shaped[ndarray, ...]], table: PressTable) -> ReferenceTrial:
    """One press: its pins followed, and its contact area at their frames where the table has it.

    Raises:
        InputError, ImageError: they cannot be read as a press.
    """
    press = watched(frames, table.force_n, table.frame_sample, table.position_m, table.time_s)
    area = None if table.area_m2 is None else table.area_m2[table.frame_sample[press.frame]]
    return ReferenceTrial(press, area)


def load_press(frames: Path, table: Path) -> ReferenceTrial:
    """The same from files.

    Raises:
        InputError, ImageError, LabelError: what cannot be read as a press.
    """
    with open_sequence(frames) as sequence:
        return followed(sequence, read_press_table(table, len(sequence)))


def load_references(folder: PressFolder, progress: Progress = silent) -> list[Reference]:
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
            trials.append(load_press(frames, table))
            done += 1
            progress("presses", done, total)
        assert one.stiffness_n_m is not None
        references.append(Reference(one.name, one.stiffness_n_m, tuple(trials)))
    return references
