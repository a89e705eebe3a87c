"""Cues of normal force in the motion of a pattern's marks.

    gamma  = alpha K mean |s - s_ref|                    the published measure, alpha and K explicit
    moment = integral (X - X_c) . U exp(-|X - X_c|^2 / 2 r^2) dA     for three reaches r [m^4]

The moment over the whole plane is proportional to the force for any pressure distribution. A window excludes
the pattern's edge and far noise; three windows distinguish tips.

Source: "NUSense: Shear Based Robust Optical Tactile Sensor", equation 3.3.

Frames of presses with the force that a sensor measured, as a force calibration takes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_fill_holes

from palpate.core import (
    Bool,
    Float,
    ImageError,
    InputError,
    LabelError,
    Lens,
    PathText,
    Progress,
    RangeError,
    Shaped,
    ndarray,
    silent,
)
from palpate.estimators.lattice import ControlPoints, MarkTracker
from palpate.estimators.surface_strain import StrainFields, StrainMeter, find_rings, on_plane
from palpate.recordings import Run

PUBLISHED_ALPHA_PX = 1 / 18_000  # per px of an undistorted image
SIDE_SAMPLES = 164  # along both sides: K = 164 x 164
REACHES_M = (2.5e-3, 5e-3, 10e-3)
DEGREE = 3
EVERY = 4  # samples along both sides, of which one goes into a moment


class TouchCues(NamedTuple):
    """Cues of one frame; NaN without a contact.

    Attributes:
        gamma: published measure, mean form.
        near, middle, far: moments within 2.5, 5, and 10 mm of the contact [1e-9 m^4].
        x_m, y_m: contact position from the camera's axis [m].
        radius_m: of the ring of greatest outward motion [m].
    """

    gamma: float
    near: float
    middle: float
    far: float
    x_m: float
    y_m: float
    contacts: int
    radius_m: float


class CueMeter:
    """Cues of frames against the no-contact pattern.

    Args:
        reference: marks of the no-contact pattern [px of the camera's image].
        camera_m: distance of the camera from the pattern [m].
        alpha: of the published measure [1/px of the undistorted image].
        samples: along each side of the surface; K is its square.
    """

    def __init__(
        self,
        reference: ControlPoints,
        lens: Lens,
        camera_m: float,
        alpha: float = PUBLISHED_ALPHA_PX,
        samples: int = SIDE_SAMPLES,
    ) -> None:
        if not 0 < alpha < math.inf:
            raise InputError(f"a scale alpha of {alpha} per px; give a positive number, published is 1/18000")
        self._lens, self._camera_m = lens, camera_m
        self._alpha_m = alpha * lens.flat().focal_px[0] / camera_m
        self._meter = StrainMeter(on_plane(reference, lens, camera_m), DEGREE, (samples, samples))

    def fields(self, points: ControlPoints) -> StrainFields:
        """Strain of a frame's marks, in m from the camera's axis."""
        return self._meter.fields(on_plane(points, self._lens, self._camera_m))

    def cues(self, points: ControlPoints) -> TouchCues:
        return self.cues_of(self.fields(points))

    def cues_of(self, fields: StrainFields) -> TouchCues:
        gamma = self._alpha_m * fields.basis.count * mean_shift(fields)
        rings = find_rings(fields)
        if not rings:
            nan = math.nan
            return TouchCues(gamma, nan, nan, nan, nan, nan, 0, nan)
        centre = np.array([rings[0].x, rings[0].y])
        near, middle, far = (1e9 * outward_moment(fields, centre, reach) for reach in REACHES_M)
        return TouchCues(gamma, near, middle, far, rings[0].x, rings[0].y, len(rings), rings[0].radius)


def bridged(fields: StrainFields) -> tuple[Float[ndarray, "2 nv nu"], Bool[ndarray, "nv nu"]]:
    """Return the shift of the samples [unit], interpolated amid lost marks, and which count."""
    basis = fields.basis
    return basis.sampled(basis.net(fields.moved)), binary_fill_holes(basis.supported)


def mean_shift(fields: StrainFields) -> float:
    """Return the mean length of the samples' shift [unit]."""
    shift, counted = bridged(fields)
    return float(np.hypot(*shift)[counted].mean())


def outward_moment(fields: StrainFields, centre_m: Float[ndarray, " 2"], reach_m: float) -> float:
    """Integrate the outward shift times the distance, in a Gaussian window about a position [m^4].

    Args:
        fields: of marks in m.
        centre_m, reach_m: middle and standard deviation of the window [m].
    """
    if fields.unit != "m":
        raise InputError("a moment needs marks in m; take those of an image to the pattern with on_plane")
    if not 0 < reach_m < math.inf:
        raise RangeError(f"a reach of {reach_m} m; give a positive number of m")
    parts = (fields.at, *bridged(fields), fields.to_axes)
    at, shift, counted, J = (part[..., ::EVERY, ::EVERY] for part in parts)
    away = at - centre_m[:, None, None]
    window = np.exp(-0.5 * (away**2).sum(axis=0) / reach_m**2)
    area = 1 / np.abs(J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0])  # of the square of parameters, 0 to 1
    area = np.where(np.isfinite(area), area, np.nanmean(area))
    steps = np.diff(fields.basis.u[::EVERY]).mean() * np.diff(fields.basis.v[::EVERY]).mean()
    return float(((away * shift).sum(axis=0) * window * area)[counted].sum() * steps)


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
