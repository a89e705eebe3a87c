"""Taps in a folder: images with a table of poses, pins identified, and a tip fitted and evaluated."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import (
    Bool,
    Float,
    ImageError,
    InputError,
    LabelError,
    Progress,
    ndarray,
    silent,
    storage_errors,
)
from palpate.core.parsing import parser
from palpate.sensors.tactip.posed_tip import POSE, TipTerms
from palpate.sensors.tactip.taps.tap_pins import NamedPins, named_taps, read_image, spots
from palpate.sensors.tactip.taps.tip_fit import PosePolynomial, TipFit, TipJudgement, judge_tip, refuse_alike
from palpate.sensors.tactip.taps.tip_reader import MIN_LEARNT, PoseReadings, TipReader, fit_pins

TABLE, IMAGES = "labels.csv", "images"
NAMES = ("image_file", "image", "file")
COVERED = 1.645  # normal quantile of a 90 % interval
SMOOTH = 4  # degree of the smooth regression
MIN_PINS = 37
MAX_LOST = 0.4  # maximum fraction of taps with unidentified pins


@dataclass(frozen=True)
class RegisteredTaps:
    """Taps with identified pins.

    Attributes:
        poses: `POSE` in its units.
        places_px: Pin positions, NaN where one was not found.
        lost: Number of taps whose pins could not be identified.
    """

    poses: Float[ndarray, "t 6"]
    places_px: Float[ndarray, "t p 2"]
    lost: int
    layout: NamedPins


def register_taps(
    folders: Sequence[Path], pins: int, progress: Progress = silent, layout: NamedPins | None = None
) -> list[RegisteredTaps]:
    """Identify the pins of one sensor's taps in one or several folders.

    Args:
        folders: Each with ``labels.csv`` (file name and `POSE`) and binarised images in ``images``.
        pins: Number of pins.
        progress: Callback for images read and identified.
        layout: Known pin layout.
    """
    if pins < MIN_PINS:
        raise InputError(f"a tip of {pins} pins; give {MIN_PINS} or more", code="pin-count")
    tables = [_table(folder) for folder in folders]
    if layout is None and (count := sum(len(files) for files, _ in tables)) < MIN_LEARNT:
        raise InputError(
            f"{_counted(count, 'tap')} in {_counted(len(tables), 'folder')}; {MIN_LEARNT} or more are needed "
            "to name pins",
            code="too-few-taps",
        )
    names = [(folder, name) for folder, (files, _) in zip(folders, tables, strict=True) for name in files]
    found, size = [], (0, 0)
    for i, (folder, name) in enumerate(names):
        progress("reading taps", i, len(names))
        image = read_image(_image_path(folder, name))
        if i and image.shape != size:
            raise ImageError(
                f"{folder / name} has {image.shape} px, the first image {size}; give one sensor's"
            )
        size = (image.shape[0], image.shape[1])
        found.append(spots(image))
    places, layout = named_taps(found, size, pins, progress, layout)
    good = np.isfinite(places[..., 0]).any(axis=1)
    if good.mean() < 1 - MAX_LOST:
        raise InputError(
            f"the pins of {int((~good).sum())} of {len(good)} taps could not be named; {MAX_LOST:.0%} are "
            f"allowed: are there {pins} pins, and are images binarised with bright pins?"
        )
    first, parts = 0, []
    for files, own in tables:
        part = slice(first, first + len(files))
        named = good[part]
        lost = int((~named).sum())
        parts.append(RegisteredTaps(own[named], places[part][named], lost, layout))
        first += len(files)
    return parts


@dataclass(frozen=True)
class FolderFit:
    """A tip fitted to one folder of taps and evaluated on another.

    Attributes:
        learnt_px: Residual after correction by the learned error [px rms].
        known, new: Taps of both folders.
        readings: Readings of the new taps.
    """

    reader: TipReader
    fit: TipFit
    judged: TipJudgement
    learnt_px: float
    known: RegisteredTaps
    new: RegisteredTaps
    readings: PoseReadings


def fit_folder(
    folder: Path,
    judged_by: Path,
    *,
    pins: int = 331,
    taps: int = 400,
    seed: int = 0,
    progress: Progress = silent,
) -> FolderFit:
    """Fit a tip to taps of one folder, and evaluate it and its reader on another.

    Args:
        folder, judged_by: Folders of one sensor, see `register_taps`.
        pins: Number of pins.
        taps: Number of taps drawn from the first folder for the fit.
        seed: Seed of the draw.
        progress: Callback, see `register_taps` and `fit_tip`.
    """
    if len(asked := _table(folder)[1]):
        refuse_alike(asked)  # before the slow identification
    known, new = register_taps([folder, judged_by], pins, progress)
    some = np.random.default_rng(seed).permutation(len(known.poses))[:taps]
    poses, places = known.poses[some], known.places_px[some]
    fit = fit_pins(poses, places, progress)
    progress("learning to read", 0, 1)
    reader = TipReader.learnt(fit, poses, places, progress)
    judged = judge_tip(fit, (known.poses, known.places_px), (new.poses, new.places_px))
    off = reader.expected_px(new.poses) - new.places_px
    learnt = float(np.sqrt(np.nanmean(np.sum(off**2, axis=2))))
    return FolderFit(reader, fit, judged, learnt, known, new, reader.read(new.places_px))


def tip_record(found: FolderFit) -> dict[str, Any]:
    """Return a fitted tip as plain values."""
    fit, judged = found.fit, found.judged
    return {
        "terms": {
            name: {"value": value, "low": value - COVERED * sd, "high": value + COVERED * sd}
            for name, value, sd in zip(TipTerms._fields, fit.terms, fit.spread, strict=True)
        },
        "coverage": 0.9,
        "untold": list(fit.untold),
        "tied": [list(pair) for pair in fit.tied],
        "taps_fitted": fit.taps,
        "taps_registered": [len(one.poses) for one in (found.known, found.new)],
        "taps_left_out": [one.lost for one in (found.known, found.new)],
        "residual_px": judged.residual_px,
        "floor_px": judged.floor_px,
        "floor": f"polynomial of the pose, degree {judged.floor_degree}, by all registered taps",
        "motion_px": judged.motion_px,
        "residual_over_floor": judged.residual_px / judged.floor_px,
        "residual_over_motion": judged.residual_px / judged.motion_px,
        "shift_px": judged.shift_px,
        "residual_with_learnt_error_px": found.learnt_px,
        "reading": reading_record(found.readings, found.new.poses, found.fit.taps),
    }


def reading_record(read: PoseReadings, poses: Float[ndarray, "t 6"], taps: int) -> dict[str, Any]:
    """Return errors and interval coverage of readings of known poses."""
    valid, off = read.valid, np.abs(read.poses - poses)
    held = off <= read.half_widths

    def of(rows: Bool[ndarray, " t"]) -> dict[str, Any]:
        if not rows.any():
            return {"taps": 0}
        columns = {
            "mean_absolute_error": off[rows].mean(axis=0), "held_by_90_percent": held[rows].mean(axis=0),
            "median_half_width": np.median(read.half_widths[rows], axis=0),
        }  # fmt: skip
        return {"taps": int(rows.sum())} | {
            name: dict(zip(POSE, column.tolist(), strict=True)) for name, column in columns.items()
        }

    return {
        "taps_learnt_from": taps, "all": of(np.isfinite(read.poses[:, 0])), "valid": of(valid),
        "valid_share": float(valid.mean()),
    }  # fmt: skip


def upright_places(
    fit: TipFit, known: RegisteredTaps, count: int = 4
) -> tuple[Float[ndarray, " d"], Float[ndarray, "d p 2"], Float[ndarray, "d p 2"]]:
    """Return depths [mm], and pins of upright taps by smooth regression and by the fitted tip [px]."""
    poses = np.zeros((count, len(POSE)))
    shallow, deep = np.quantile(known.poses[:, 0], [0.1, 0.98])
    poses[:, 0] = np.linspace(shallow, deep, count)
    smooth = PosePolynomial.fitted(known.poses, known.places_px, SMOOTH)
    return poses[:, 0], smooth.at(poses), fit.tip.places_px(fit.terms, poses)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


@parser("tap table", InputError)
def _table(folder: Path) -> tuple[list[str], Float[ndarray, "t 6"]]:
    path = folder / TABLE
    with storage_errors(path):
        text = path.read_bytes()
    try:
        table = pd.read_csv(io.BytesIO(text))
    except (ValueError, UnicodeDecodeError) as e:
        raise LabelError(f"{path} is no table: {e}") from e
    file = next((name for name in NAMES if name in table), None)
    missing = [name for name in POSE if name not in table]
    if file is None or missing:
        raise LabelError(
            f"{path} has no column {', '.join(missing) or ' or '.join(NAMES)}; it needs the images' names in "
            f"image_file and the pose in {', '.join(POSE)}",
            code="column-missing",
        )
    poses = table[list(POSE)].apply(pd.to_numeric, errors="coerce").to_numpy(float)
    bad = np.flatnonzero(~np.isfinite(poses).all(axis=1))
    if len(bad):
        raise LabelError(
            f"{path}: {len(bad)} of {len(poses)} taps have no finite pose, the first in row {bad[0] + 2} "
            f"(the header is row 1); give {', '.join(POSE)} in each, or leave these rows out",
            code="not-finite",
        )
    return [str(name) for name in table[file]], poses


def _image_path(folder: Path, name: str) -> Path:
    return next(
        (one for one in (folder / IMAGES / name, folder / name) if one.is_file()), folder / IMAGES / name
    )
