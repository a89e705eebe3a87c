"""Bundle adjustment of a lens and its views of a flat board: least squares of all corners.

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
MAX_STEPS = 60
MIN_GAIN = 1e-9  # of the cost: a step that gains less is the last
MAX_DAMPING = 1e12
WIDTHS = np.geomspace(0.12, 4.0, 25)  # focal lengths tried first, in sides of the frame
MIN_DEPTH = 1e-3  # of a board's own size: corners nearer to the lens's plane have no place

Pose = Float[ndarray, "6"]


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Lens and the poses of its views.

    Attributes:
        numbers: Lens parameters in the order of `PARAMETERS`.
        poses: Rotation vector [rad] and translation [m] of each board in the camera frame.
        errors_px: Observed minus projected position of each corner, one array ``[n 2]`` per view [px].
        slopes: Derivatives of these positions by the lens ``[2n p]`` and by the pose ``[2n 6]``, per view.
    """

    model: LensModel
    numbers: Float[ndarray, " p"]
    poses: tuple[Pose, ...]
    errors_px: tuple[ndarray, ...]
    slopes: tuple[tuple[ndarray, ndarray], ...]

    @property
    def cost(self) -> float:
        """Sum of squared errors [px^2]."""
        return float(np.sum(np.concatenate(self.errors_px) ** 2))

    @property
    def scale_px(self) -> float:
        """Robust standard deviation of an error along one axis [px]."""
        return max(1.4826 * float(np.median(np.abs(np.concatenate(self.errors_px)))), 1e-9)

    def reduced(self, view: int, free: int, damping: float = 0.0) -> tuple[ndarray, ndarray, ndarray]:
        """Normal matrix and score of one view in the first lens parameters, and its pose's part of a step."""
        by_lens, by_pose = self.slopes[view]
        wanted = np.column_stack([by_lens[:, :free], self.errors_px[view].ravel()])
        own = by_pose.T @ by_pose
        own[np.diag_indices(POSE)] *= 1 + damping
        back = np.linalg.solve(own, by_pose.T @ wanted)
        whole = wanted[:, :-1].T @ (wanted - by_pose @ back)
        return whole[:, :-1], whole[:, -1], back


def lens_of(
    model: LensModel, numbers: Float[ndarray, " p"], size_px: tuple[int, int], widest_rad: float | None = None
) -> Lens:
    """Return the lens with these parameters."""
    fx, fy, cx, cy, *bends = (float(number) for number in numbers)
    return Lens(model, (fx, fy), (cx, cy), tuple(bends), size_px, widest_rad)


def first_guess(model: LensModel, views: Sequence[BoardView]) -> tuple[ndarray, list[Pose | None]] | None:
    """Return parameters without distortion and poses at the focal length that fits the views best.

    From a focal length far off, a fit of a wide lens descends into a valley of its own. None without a pose.
    """
    height, width = views[0].size_px
    centre = ((width - 1) / 2, (height - 1) / 2)
    best, least = None, math.inf
    for factor in WIDTHS:
        numbers = np.zeros(len(PARAMETERS[model]))
        numbers[:4] = factor * max(width, height), factor * max(width, height), *centre
        poses = [pose_of(model, numbers, view) for view in views]
        errors = [
            math.inf
            if pose is None
            else np.median(np.linalg.norm(_projected(model, numbers, pose, view)[0], axis=1))
            for pose, view in zip(poses, views, strict=True)
        ]
        typical = float(np.median(errors))
        if typical < least:
            best, least = (numbers, poses), typical
    return best


def pose_of(model: LensModel, numbers: Float[ndarray, " p"], view: BoardView) -> Pose | None:
    """Return the pose of a board from the directions of its corners; None where there is none."""
    rays = lens_of(model, numbers, view.size_px).rays(view.places_px)
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
    model: LensModel,
    numbers: Float[ndarray, " p"],
    poses: Sequence[Pose],
    views: Sequence[BoardView],
    free: int | None = None,
) -> Bundle:
    """Refine a start by Levenberg-Marquardt to the least squares of all corners.

    Args:
        poses: one per view.
        free: how many of the parameters are fitted; None fits all, 0 the poses alone.

    Raises:
        InputError: at the start a board lies behind the lens, or a focal length is not positive.
    """
    now = _bundle(model, numbers, poses, views)
    if now is None:
        raise InputError("a fit begins where every board lies before the lens, with positive focal lengths")
    free, damping = len(numbers) if free is None else free, 1e-3
    for _ in range(MAX_STEPS):
        while (tried := _stepped(now, views, free, damping)) is None or not tried.cost < now.cost:
            damping *= 10
            if damping > MAX_DAMPING:
                return now
        gain, now, damping = now.cost - tried.cost, tried, max(damping / 10, 1e-12)
        if gain <= MIN_GAIN * (now.cost + gain):
            break
    return now


def _bundle(
    model: LensModel, numbers: ndarray, poses: Sequence[ndarray], views: Sequence[BoardView]
) -> Bundle | None:
    """None where a corner would lie behind the lens, or a focal length is not positive."""
    pairs = list(zip(poses, views, strict=True))
    if numbers[:2].min() <= 0 or not all(_in_front(pose, view) for pose, view in pairs):
        return None
    errors, by_lens, by_pose = zip(*(_projected(model, numbers, *pair) for pair in pairs), strict=True)
    if not all(np.isfinite(error).all() for error in errors):
        return None
    return Bundle(model, numbers, tuple(poses), errors, tuple(zip(by_lens, by_pose, strict=True)))


def _stepped(now: Bundle, views: Sequence[BoardView], free: int, damping: float) -> Bundle | None:
    """The fit after one damped Gauss-Newton step."""
    try:
        parts = [now.reduced(view, free, damping) for view in range(len(views))]
        normal, score = sum(part[0] for part in parts), sum(part[1] for part in parts)
        # Scaled to a unit diagonal: parameters of thousands of pixels stand beside eighth powers of angles.
        unit = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = unit[:, None] * normal * unit + damping * np.eye(free)
        change = unit * np.linalg.solve(scaled, unit * score)
    except np.linalg.LinAlgError:
        return None
    poses = [
        pose + back[:, -1] - back[:, :-1] @ change
        for pose, (_, _, back) in zip(now.poses, parts, strict=True)
    ]
    numbers = now.numbers + np.pad(change, (0, len(now.numbers) - free))
    return _bundle(now.model, numbers, poses, views) if np.isfinite(numbers).all() else None


def _projected(
    model: LensModel, numbers: ndarray, pose: ndarray, view: BoardView
) -> tuple[ndarray, ndarray, ndarray]:
    """Errors ``[n 2]``, and derivatives of the positions by the lens ``[2n p]`` and the pose ``[2n 6]``."""
    fx, fy, cx, cy = (float(number) for number in numbers[:4])
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    corners, turn, place = view.corners_m, pose[:3].copy(), pose[3:].copy()
    if model == "kannala-brandt":
        places, slopes = cv2.fisheye.projectPoints(corners[:, None], turn, place, matrix, numbers[4:].copy())
        return view.places_px - places.reshape(-1, 2), slopes[:, :8], slopes[:, 8:14]
    places, slopes = cv2.projectPoints(corners, turn, place, matrix, numbers[4:].copy())
    return view.places_px - places.reshape(-1, 2), slopes[:, 6:15], slopes[:, :6]


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
    fitted = adjust(model, numbers, [pose], [view], free=0)
    return math.sqrt(fitted.cost / len(view.places_px))
