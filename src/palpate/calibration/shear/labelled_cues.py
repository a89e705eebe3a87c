"""Frames of presses with the force that a sensor measured, as a force calibration takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.shear.touch_cues import CueMeter, TouchCues
from palpate.core import (
    Float,
    ImageError,
    InputError,
    LabelError,
    Lens,
    PathText,
    Progress,
    Shaped,
    ndarray,
    silent,
)
from palpate.estimators.lattice import ControlPoints, MarkTracker
from palpate.recordings import Run

FORCE, PRESS, TIP, REFERENCE = "force_N", "press", "indenter", "reference"
MAX_REFERENCES = 12


@dataclass(frozen=True)
class LabelledCues:
    """Cues of frames with ground-truth force.

    Attributes:
        force_n: normal force, positive in compression ``[n]`` [N].
        time_s: ``[n]`` [s]; in temporal order within a press.
        press, tip: press and indenter of each frame ``[n]``.
        image: moments of each frame's difference from the no-contact one ``[n 6]``; None without frames.
    """

    cues: tuple[TouchCues, ...]
    force_n: Float[ndarray, " n"]
    time_s: Float[ndarray, " n"]
    press: ndarray
    tip: ndarray
    image: Float[ndarray, "n 6"] | None = None

    def __post_init__(self) -> None:
        n = len(self.cues)
        if any(len(part) != n for part in (self.force_n, self.time_s, self.press, self.tip)):
            raise InputError(f"{n} frames' cues; give a force, time, press and tip for each")
        if not np.isfinite(self.force_n).all() or not np.isfinite(self.time_s).all():
            raise InputError("a force or a time is not finite; leave frames without them out")


def joined(parts: Sequence[LabelledCues]) -> LabelledCues:
    """Join frames of several runs; presses of one name in two runs stay two."""
    if not parts:
        raise InputError("no run; give one or more")
    images = [part.image for part in parts if part.image is not None]
    return LabelledCues(
        tuple(cue for part in parts for cue in part.cues),
        np.concatenate([part.force_n for part in parts]),
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([np.array([f"{i}/{name}" for name in part.press]) for i, part in enumerate(parts)]),
        np.concatenate([part.tip for part in parts]),
        np.concatenate(images) if len(images) == len(parts) else None,
    )


def cues_of_run(
    path: PathText, lens: Lens, camera_m: float, pitch_px: float, progress: Progress = silent
) -> tuple[LabelledCues, ControlPoints]:
    """Return labeled cues of a run, and the marks of its no-contact skin [px].

    Up to 12 reference frames are averaged. Frames whose pattern cannot be found are left out.

    Args:
        path: run with the labels force_N, press, and reference.
        camera_m: distance of the camera from the pattern [m].
        pitch_px: approximate side of a tile [px].
    """
    run = Run.open(path)
    labels = run.labels
    missing = [name for name in (FORCE, PRESS, REFERENCE) if name not in labels]
    if missing:
        raise LabelError(
            f"{path} has no label {', '.join(missing)}; a force calibration takes a run that the rig recorded"
        )
    rest = np.flatnonzero(labels[REFERENCE].fillna(False).to_numpy(bool))
    if not len(rest):
        raise LabelError(f"{path} has no reference frame; record some of the untouched skin")
    untouched = run.frame(int(rest[0])).image
    tracker = MarkTracker(untouched, pitch_px)
    marks = [tracker.follow(run.frame(int(i)).image).points for i in rest[:MAX_REFERENCES]]
    reference = mean_marks(marks)
    meter = CueMeter(reference, lens, camera_m)
    force, press = labels[FORCE].to_numpy(float), labels[PRESS].to_numpy(object)
    tip = labels[TIP].to_numpy(object) if TIP in labels else np.full(len(run), "")
    wanted = [i for i in range(len(run)) if np.isfinite(force[i]) and press[i] is not None]
    kept, cues, image = [], [], []
    for count, i in enumerate(wanted):
        frame = run.frame(i).image
        points = tracker.settled(tracker.follow(frame), frame, len(reference)).points
        if len(points):
            kept.append(i)
            cues.append(meter.cues(points))
            image.append(difference_moments(frame, untouched))
        progress("frames", count + 1, len(wanted))
    if 2 * len(kept) < len(wanted):
        raise ImageError(f"the pattern was found in {len(kept)} of {len(wanted)} frames of {path}")
    names, tips = np.array([str(press[i]) for i in kept]), np.array([str(tip[i]) for i in kept])
    return LabelledCues(tuple(cues), force[kept], run.times_s[kept], names, tips, np.array(image)), reference


def difference_moments(frame: Shaped[ndarray, ...], untouched: Shaped[ndarray, ...]) -> Float[ndarray, " 6"]:
    """Return moments to the second order of the pixel change: the zeroth in grey levels, the others over it
    in image sides.
    """
    change = np.abs(frame.astype(np.float32) - untouched.astype(np.float32))
    change = change.reshape(*change.shape[:2], -1).mean(axis=2)
    y, x = (np.linspace(-1, 1, side, dtype=np.float32) for side in change.shape)
    whole = float(change.mean())
    weight = change / max(float(change.sum()), 1e-9)
    rows, columns = weight.sum(axis=1), weight.sum(axis=0)
    across = float(y @ weight @ x)
    return np.array([whole, columns @ x, rows @ y, columns @ x**2, across, rows @ y**2], float)


def mean_marks(frames: Sequence[ControlPoints]) -> ControlPoints:
    """Return the mean of the marks that all no-contact frames have."""
    first = frames[0]
    common = {tuple(cell) for cell in first.cells.tolist()}
    for one in frames[1:]:
        common &= {tuple(cell) for cell in one.cells.tolist()}
    if not common:
        raise ImageError("the frames of the untouched skin have no mark in common; did it move between them?")
    cells = np.array(sorted(common))
    rows = [_rows_of(one, cells) for one in frames]
    places = np.mean([one.places[row] for one, row in zip(frames, rows, strict=True)], axis=0)
    sigma = np.sqrt(np.mean([one.sigma[row] ** 2 for one, row in zip(frames, rows, strict=True)], axis=0))
    return ControlPoints(cells, places, sigma / np.sqrt(len(frames)), first.unit)


def _rows_of(points: ControlPoints, cells: ndarray) -> ndarray:
    at = {tuple(cell): i for i, cell in enumerate(points.cells.tolist())}
    return np.array([at[tuple(cell)] for cell in cells.tolist()])
