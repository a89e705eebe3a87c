"""Bundle adjustment of a lens and its views of a flat board: least squares with robust weights.

Each view's pose is eliminated by Schur's complement (Triggs et al. 2000, doi:10.1007/3-540-44480-7_21); the
inverse of the lens's normal equations is the covariance of its parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from palpate.calibration.lens.boards import BoardView
from palpate.core import Float, InputError, Lens, LensModel

PARAMETERS = {
    "kannala-brandt": ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "k4"),
    "pinhole": ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"),
}
POSE = 6  # rotation vector [rad], translation [m]
HUBER = 1.5  # standard deviations up to which an error counts in full
MAX_STEPS = 60
MIN_GAIN = 1e-9  # of the cost: a step that gains less is the last
MAX_DAMPING = 1e12
WIDTHS = np.geomspace(0.12, 4.0, 25)  # focal lengths tried first, in sides of the frame
MIN_DEPTH = 1e-3  # of a board's own size: corners nearer to the lens's plane have no place

Pose = Float[ndarray, "6"]


@dataclass(frozen=True, slots=True, eq=False)
class PosedLens:
    """Lens and the poses of its views, fitted or guessed.

    Attributes:
        numbers: of the lens, in the order of `PARAMETERS`.
        poses: rotation vector [rad] and translation [m] of each board in the camera frame; NaN for none.
    """

    model: LensModel
    numbers: Float[ndarray, " p"]
    poses: tuple[Pose, ...]

    def lens(self, size_px: tuple[int, int], max_angle_rad: float | None = None) -> Lens:
        values = [float(value) for value in self.numbers]
        focal, centre = (values[0], values[1]), (values[2], values[3])
        return Lens(self.model, focal, centre, tuple(values[4:]), size_px, max_angle_rad)

    def of_views(self, kept: Sequence[int]) -> PosedLens:
        """The same of fewer views, to begin another fit from."""
        return PosedLens(self.model, self.numbers, tuple(self.poses[view] for view in kept))


@dataclass(frozen=True, slots=True, eq=False)
class Bundle(PosedLens):
    """Fit.

    Attributes:
        errors_px: reprojection errors of each view ``[n 2]`` [px].
        normal, score: each view's reduced normal matrix and right-hand side, in units of 1 px.
        scale_px: robust standard deviation of an error along one axis [px].
    """

    errors_px: tuple[ndarray, ...]
    normal: Float[ndarray, "v p p"]
    score: Float[ndarray, "v p"]
    scale_px: float


def first_guess(model: LensModel, views: Sequence[BoardView]) -> PosedLens | None:
    """Return a lens without distortion at the focal length that fits the views best; None without a pose."""
    height, width = views[0].size_px
    centre = ((width - 1) / 2, (height - 1) / 2)
    best, least = None, math.inf
    for factor in WIDTHS:
        numbers = np.zeros(len(PARAMETERS[model]))
        numbers[:4] = factor * max(width, height), factor * max(width, height), *centre
        poses = [pose_of(model, numbers, view) for view in views]
        errors = [
            np.median(np.linalg.norm(_errors(model, numbers, pose, view), axis=1))
            if pose is not None
            else math.inf
            for pose, view in zip(poses, views, strict=True)
        ]
        typical = float(np.median(errors))
        if typical < least:
            best, least = (numbers, poses), typical
    if best is None:
        return None
    numbers, poses = best
    return PosedLens(model, numbers, tuple(np.full(POSE, np.nan) if pose is None else pose for pose in poses))


def pose_of(model: LensModel, numbers: Float[ndarray, " p"], view: BoardView) -> Pose | None:
    """Return the pose of a board from the directions of its corners; None where there is none."""
    rays = PosedLens(model, numbers, ()).lens(view.size_px).rays(view.places_px)
    known = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.02)
    if known.sum() < 6:
        return None
    flat = np.ascontiguousarray(rays[known, :2] / rays[known, 2:])
    try:
        found, turn, place = cv2.solvePnP(
            view.corners_m[known], flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return None
    pose = np.concatenate([turn.ravel(), place.ravel()]) if found else None
    return pose if pose is not None and np.isfinite(pose).all() and _in_front(pose, view) else None


def adjust(
    start: PosedLens,
    views: Sequence[BoardView],
    *,
    free: Sequence[int] | None = None,
    robust: bool = True,
    steps: int = MAX_STEPS,
) -> Bundle:
    """Refine a start by Levenberg-Marquardt to the least squares of all corners.

    Args:
        free: fitted lens parameters; None fits all, an empty one the poses alone.
        robust: use Huber's weights about the errors' own spread.
    """
    free = list(range(len(start.numbers)) if free is None else free)
    now = _linearised(start.model, start.numbers, start.poses, views, robust)
    if now is None:
        raise InputError("a fit begins where every board lies before the lens, with positive focal lengths")
    damping = 1e-3
    for _ in range(steps):
        moved = _stepped(now, free, damping)
        tried = None if moved is None else _linearised(start.model, *moved, views, robust)
        while tried is None or not tried.cost_at(now.scale) < now.cost_at(now.scale):
            damping *= 10
            if damping > MAX_DAMPING:
                return now.bundle()
            moved = _stepped(now, free, damping)
            tried = None if moved is None else _linearised(start.model, *moved, views, robust)
        before, after = now.cost_at(now.scale), tried.cost_at(now.scale)
        now, damping = tried, max(damping / 10, 1e-12)
        if before - after <= MIN_GAIN * before:
            break
    return now.bundle()


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """Errors at one place, and their slopes: of each view by lens and by pose, weighted."""

    model: LensModel
    numbers: np.ndarray
    poses: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]
    by_lens: tuple[np.ndarray, ...]
    by_pose: tuple[np.ndarray, ...]
    weights: tuple[np.ndarray, ...]
    scale: float
    robust: bool

    def cost_at(self, scale: float) -> float:
        size = np.abs(np.concatenate([error.ravel() for error in self.errors]))
        if not self.robust:
            return float(np.sum(size**2))
        bend = HUBER * scale
        return float(np.sum(np.where(size <= bend, size**2, bend * (2 * size - bend))))

    def reduced(self, view: int, free: list[int], damping: float = 0.0) -> tuple[np.ndarray, ...]:
        weight = self.weights[view][:, None]
        lens, pose, error = self.by_lens[view][:, free], self.by_pose[view], self.errors[view].ravel()
        corner = pose.T @ (weight * pose)
        corner[np.diag_indices(POSE)] *= 1 + damping
        mixed = lens.T @ (weight * pose)
        back = np.linalg.solve(corner, np.column_stack([mixed.T, pose.T @ (weight[:, 0] * error)]))
        whole = lens.T @ (weight * lens)
        score = lens.T @ (weight[:, 0] * error)
        return whole, whole - mixed @ back[:, :-1], score - mixed @ back[:, -1], back

    def bundle(self) -> Bundle:
        every = list(range(len(self.numbers)))
        parts = [self.reduced(view, every) for view in range(len(self.poses))]
        return Bundle(
            self.model,
            self.numbers,
            self.poses,
            tuple(error.reshape(-1, 2) for error in self.errors),
            np.array([part[1] for part in parts]),
            np.array([part[2] for part in parts]),
            self.scale,
        )


def _linearised(
    model: LensModel,
    numbers: np.ndarray,
    poses: Sequence[np.ndarray],
    views: Sequence[BoardView],
    robust: bool,
) -> _Linear | None:
    """None where a corner would lie behind the lens, or a focal length is not positive."""
    if numbers[:2].min() <= 0 or not all(
        _in_front(pose, view) for pose, view in zip(poses, views, strict=True)
    ):
        return None
    errors, by_lens, by_pose = [], [], []
    for pose, view in zip(poses, views, strict=True):
        places, lens, posed = _projected(model, numbers, pose, view.corners_m)
        errors.append((view.places_px - places).ravel())
        by_lens.append(lens)
        by_pose.append(posed)
    size = np.abs(np.concatenate(errors))
    if not np.isfinite(size).all():
        return None
    scale = max(1.4826 * float(np.median(size)), 1e-9)
    weights = [
        np.minimum(1.0, HUBER * scale / np.maximum(np.abs(error), 1e-12)) if robust else np.ones_like(error)
        for error in errors
    ]
    return _Linear(
        model,
        numbers,
        tuple(poses),
        tuple(errors),
        tuple(by_lens),
        tuple(by_pose),
        tuple(weights),
        scale,
        robust,
    )


def _stepped(
    now: _Linear, free: list[int], damping: float
) -> tuple[np.ndarray, tuple[np.ndarray, ...]] | None:
    try:
        parts = [now.reduced(view, free, damping) for view in range(len(now.poses))]
        numbers, change = now.numbers.copy(), np.zeros(0)
        if free:
            normal = sum(part[1] for part in parts)
            whole = sum(part[0] for part in parts)
            normal = normal + damping * np.diag(np.diag(whole))
            # Scaled to a unit diagonal: numbers of thousands of pixels stand beside eighth powers of angles.
            unit = 1 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
            change = unit * np.linalg.solve(
                unit[:, None] * normal * unit, unit * sum(part[2] for part in parts)
            )
            numbers[free] += change
        poses = tuple(
            pose + part[3][:, -1] - part[3][:, :-1] @ change
            for pose, part in zip(now.poses, parts, strict=True)
        )
    except np.linalg.LinAlgError:
        return None
    return (numbers, poses) if np.isfinite(numbers).all() and np.isfinite(poses).all() else None


def _projected(
    model: LensModel, numbers: np.ndarray, pose: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places [n 2] and their slopes [2n p] by the lens's numbers, [2n 6] by the pose."""
    fx, fy, cx, cy = (float(number) for number in numbers[:4])
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    turn, place = pose[:3].copy(), pose[3:].copy()
    if model == "kannala-brandt":
        places, slopes = cv2.fisheye.projectPoints(corners[:, None], turn, place, matrix, numbers[4:].copy())
        return places.reshape(-1, 2), slopes[:, :8], slopes[:, 8:14]
    places, slopes = cv2.projectPoints(corners, turn, place, matrix, numbers[4:].copy())
    return places.reshape(-1, 2), slopes[:, 6:15], slopes[:, :6]


def _errors(model: LensModel, numbers: np.ndarray, pose: np.ndarray, view: BoardView) -> np.ndarray:
    return view.places_px - _projected(model, numbers, pose, view.corners_m)[0]


def _in_front(pose: np.ndarray, view: BoardView) -> bool:
    if not np.isfinite(pose).all():
        return False
    depth = view.corners_m @ cv2.Rodrigues(pose[:3].copy())[0][2] + pose[5]
    return bool(depth.min() > MIN_DEPTH * np.ptp(view.corners_m))


def view_error_px(model: LensModel, numbers: Float[ndarray, " p"], view: BoardView) -> float:
    """Return the RMS error of a view's corners with only its pose fitted [px]; or inf."""
    pose = pose_of(model, numbers, view)
    if pose is None:
        return math.inf
    fitted = adjust(PosedLens(model, numbers, (pose,)), [view], free=(), steps=20)
    return float(np.sqrt(np.mean(np.sum(fitted.errors_px[0] ** 2, axis=1))))
