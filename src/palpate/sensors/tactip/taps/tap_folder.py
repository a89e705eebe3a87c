"""Taps in a folder: images with a table of poses, their pins named, and a tip fitted and judged."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from palpate.core import (
    Bool,
    Float,
    ImageError,
    InputError,
    LabelError,
    Progress,
    UInt8,
    ndarray,
    silent,
    storage_errors,
)
from palpate.sensors.tactip.posed_tip import POSE, PosedTip, TipTerms
from palpate.sensors.tactip.taps.pose_polynomial import PosePolynomial
from palpate.sensors.tactip.taps.tap_pins import identified_taps, rest_layout, spots
from palpate.sensors.tactip.taps.tip_fit import (
    MIN_TAPS,
    TipFit,
    TipJudgement,
    fit_tip,
    judge_tip,
    upright_course,
)

TABLE, IMAGES = "labels.csv", "images"
NAMES = ("image_file", "image", "file")
COVERED = 1.645  # standard deviations of a 90 % interval
REST_FROM = 60  # mildest taps, of which one shows all pins
SMOOTH = 4  # degree of the polynomial that gives the pins at rest
MIN_PINS = 37
MAX_OTHERS = 1.25  # times as many spots as pins, or as few
MAX_LOST = 0.4  # of the taps, whose pins could not be named


@dataclass(frozen=True)
class RegisteredTaps:
    """Taps whose pins are named.

    Attributes:
        poses: `POSE` in its units ``[t 6]``.
        places_px: of the pins, NaN where one was not found ``[t p 2]`` [px].
        lost: taps that were left out, since their pins could not be named for sure.
    """

    poses: Float[ndarray, "t 6"]
    places_px: Float[ndarray, "t p 2"]
    lost: int


def register_taps(folders: Sequence[Path], pins: int, progress: Progress = silent) -> list[RegisteredTaps]:
    """Name the pins of the taps of one sensor, in one or several folders.

    Args:
        folders: each with ``labels.csv`` (a file's name and `POSE`) and its images, binarised, in ``images``.
        pins: how many the tip has.
        progress: called with how many images are read.

    Raises:
        LabelError: no table, or one without a column or a value of the pose.
        ImageError: an image that cannot be read.
        InputError: too few taps, or too many whose pins cannot be named.
    """
    if pins < MIN_PINS:
        raise InputError(f"a tip of {pins} pins; {MIN_PINS} or more are needed, 127 and 331 are usual")
    tables = [_table(folder) for folder in folders]
    if (count := sum(len(files) for files, _ in tables)) < MIN_TAPS:
        raise InputError(f"{count} taps in {len(tables)} folders; {MIN_TAPS} or more are needed to name pins")
    names = [(folder, name) for folder, (files, _) in zip(folders, tables, strict=True) for name in files]
    found = []
    for i, (folder, name) in enumerate(names):
        progress("reading taps", i, len(names))
        found.append(spots(_image(folder, name)))
    usual = float(np.median([len(each) for each in found]))
    if not pins / MAX_OTHERS < usual < pins * MAX_OTHERS:
        raise InputError(
            f"images show {usual:.0f} round bright spots in the median, for {pins} pins; give the number of "
            "pins that the tip has, and binarised images with bright pins"
        )
    poses = np.concatenate([poses for _, poses in tables])
    upright = np.zeros(len(POSE))
    upright[0] = poses[:, 0].min()
    spread = poses.std(axis=0)
    mild = np.argsort(np.linalg.norm((poses - upright) / np.where(spread > 0, spread, 1), axis=1))
    rest = rest_layout([found[i] for i in mild[:REST_FROM]], pins)
    taps = identified_taps(found, poses, rest, upright)
    good = ~taps.mislabelled
    if good.mean() < 1 - MAX_LOST:
        raise InputError(
            f"the pins of {int((~good).sum())} of {len(good)} taps could not be named; {MAX_LOST:.0%} are "
            f"allowed: are there {pins} pins, and are images binarised with bright pins?"
        )
    first, parts = 0, []
    for files, own in tables:
        part = slice(first, first + len(files))
        parts.append(_registered(own, taps.places_px[part], good[part]))
        first += len(files)
    return parts


def _registered(
    poses: Float[ndarray, "t 6"], places: Float[ndarray, "t p 2"], good: Bool[ndarray, " t"]
) -> RegisteredTaps:
    return RegisteredTaps(poses[good], places[good], int((~good).sum()))


def fit_folder(
    folder: Path,
    judged_by: Path,
    *,
    pins: int = 331,
    taps: int = 400,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[TipFit, TipJudgement, tuple[RegisteredTaps, RegisteredTaps]]:
    """Fit a tip to taps of one folder and judge it by those of another.

    Args:
        folder, judged_by: see `register_taps`; of the same sensor.
        pins: how many the tip has.
        taps: how many are fitted to, drawn from the first folder.
        seed: of that draw.
        progress: see `register_taps` and `fit_tip`.

    Raises:
        LabelError, ImageError, InputError: as `register_taps` and `fit_tip`.
    """
    known, new = register_taps([folder, judged_by], pins, progress)
    shallow = float(known.poses[:, 0].min())
    upright = np.array([[shallow, 0, 0, 0, 0, 0]])
    rest = PosePolynomial.fitted(known.poses, known.places_px, SMOOTH).at(upright)[0]
    some = np.random.default_rng(seed).permutation(len(known.poses))[:taps]
    course = upright_course(known.poses, known.places_px)
    tip = PosedTip(rest, shallow)
    fit = fit_tip(tip, known.poses[some], known.places_px[some], progress, upright=course)
    return fit, judge_tip(fit, (known.poses, known.places_px), (new.poses, new.places_px)), (known, new)


def tip_record(fit: TipFit, judged: TipJudgement, taps: Sequence[RegisteredTaps]) -> dict[str, Any]:
    """A fitted tip in plain numbers."""
    return {
        "terms": {
            name: {"value": value, "low": value - COVERED * sd, "high": value + COVERED * sd}
            for name, value, sd in zip(TipTerms._fields, fit.terms, fit.spread, strict=True)
        },
        "coverage": 0.9,
        "untold": list(fit.untold),
        "tied": [list(pair) for pair in fit.tied],
        "taps_fitted": fit.taps,
        "taps_registered": [len(one.poses) for one in taps],
        "taps_left_out": [one.lost for one in taps],
        "residual_px": judged.residual_px,
        "floor_px": judged.floor_px,
        "floor": f"polynomial of the pose, degree {judged.floor_degree}, by all registered taps",
        "motion_px": judged.motion_px,
        "residual_over_floor": judged.residual_px / judged.floor_px,
        "residual_over_motion": judged.residual_px / judged.motion_px,
        "shift_px": judged.shift_px,
    }


def upright_places(
    fit: TipFit, known: RegisteredTaps, count: int = 4
) -> tuple[Float[ndarray, " d"], Float[ndarray, "d p 2"], Float[ndarray, "d p 2"]]:
    """Depths [mm], and pins of upright taps there by smooth regression on the taps and by the twin [px]."""
    poses = np.zeros((count, len(POSE)))
    shallow, deep = np.quantile(known.poses[:, 0], [0.1, 0.98])
    poses[:, 0] = np.linspace(shallow, deep, count)
    smooth = PosePolynomial.fitted(known.poses, known.places_px, SMOOTH)
    return poses[:, 0], smooth.at(poses), fit.tip.places_px(fit.terms, poses)


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
            f"image_file and the pose in {', '.join(POSE)}"
        )
    poses = table[list(POSE)].apply(pd.to_numeric, errors="coerce").to_numpy(float)
    bad = np.flatnonzero(~np.isfinite(poses).all(axis=1))
    if len(bad):
        raise LabelError(f"{path}: row {bad[0] + 1} has no finite pose, as {len(bad)} rows; leave them out")
    return [str(name) for name in table[file]], poses


def _image(folder: Path, name: str) -> UInt8[ndarray, "h w"]:
    path = next((one for one in (folder / IMAGES / name, folder / name) if one.is_file()), None)
    image = None
    if path is not None:
        with storage_errors(path):
            image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{folder / IMAGES / name} cannot be read as an image")
    return np.asarray(image, np.uint8)
