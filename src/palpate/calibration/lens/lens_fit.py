"""Calibration of a lens: views and corners rejected with the reason, errors on views held out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal, get_args

import cv2
import numpy as np

from palpate.calibration.lens.boards import Board, BoardView, MissedView, read_views
from palpate.calibration.lens.bundle import PARAMETERS, Bundle, adjust, first_guess, lens_of, view_error_px
from palpate.core import InputError, Lens, LensModel, PathText, Progress, silent

Choice = Literal["auto", "fisheye", "pinhole"]
MODELS: dict[str, LensModel] = {"fisheye": "kannala-brandt", "pinhole": "pinhole"}
MIN_VIEWS = 6
MIN_CORNERS_LEFT = 0.7  # of a view's corners, below which the view goes as a whole
MAX_CORNER_SCALES = 4.0  # robust standard deviations of an error; of Gaussian ones, one in 3,000 goes
MAX_VIEW_RATIO = 4.0  # a view's error over the median view's, fitted or held out
MIN_VIEW_ERROR_PX = 0.5  # below which no view is called bad
MIN_TILT_RAD = math.radians(10)  # between the boards' normals
MIN_REACH = 0.5  # of the way from the centre to the frame's corner
MIN_REGION = 0.2  # of the frame within the hull of all corners
MIN_GOOD_REGION = 0.6  # below which a warning asks for more
MAX_FOCAL_ERROR = 0.02  # standard error of a focal length, relative
MAX_FOLDS = 40
RESAMPLES = 400
CONFIDENCE = 1.96  # standard errors of a 95 % interval
WORSE = 1.5  # times the other model's held-out error: the model chosen does not fit the lens


@dataclass(frozen=True, slots=True)
class ViewScore:
    """One photograph in a calibration.

    Attributes:
        rms_px: RMS reprojection error of its kept corners [px].
        held_out_px: the same by a lens fitted without this view [px].
        corners, rejected_corners: number found, and number not used.
        hull_px: convex hull of its board (x, y) [px].
    """

    name: str
    rms_px: float
    held_out_px: float
    corners: int
    rejected_corners: int
    hull_px: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class LensFit:
    """Calibrated lens with its quality.

    Attributes:
        lens: valid up to the largest angle at which a corner was seen.
        rejected: rejected views, and why.
        mean_px, rms_px: mean and RMS reprojection error [px].
        held_out_px: RMS of the views' held-out errors [px].
        scale_px: robust standard deviation of an error along one axis [px].
        standard_errors: of each parameter, for independent corners.
        standard_errors_by_views: the same by resampling whole views.
        coverage: ratio of the frame within the hull of all corners.
        widest_rad: largest angle of a corner from the axis [rad].
        other_model, other_held_out_px: held-out error of the model not taken; None without a fit.
    """

    lens: Lens
    board: Board
    views: tuple[ViewScore, ...]
    rejected: tuple[MissedView, ...]
    mean_px: float
    rms_px: float
    held_out_px: float
    scale_px: float
    standard_errors: dict[str, float]
    standard_errors_by_views: dict[str, float]
    coverage: float
    widest_rad: float
    other_model: LensModel
    other_held_out_px: float | None
    warnings: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, float]:
        values = (*self.lens.focal_px, *self.lens.centre_px, *self.lens.distortion)
        return dict(zip(PARAMETERS[self.lens.model], values, strict=True))

    def card(self) -> dict[str, Any]:
        """Content of the lens file: the lens's own, and how it was calibrated."""
        told = asdict(self)
        views = [{k: v for k, v in view.items() if k != "hull_px"} for view in told.pop("views")]
        del told["lens"], told["widest_rad"]
        own = {"board": self.board.text, "widest_deg": math.degrees(self.widest_rad), "views": views}
        return {**self.lens.card(), "calibration": told | own}


def calibrate_lens(
    folder: PathText, board: Board, model: Choice = "auto", *, name: str = "", progress: Progress = silent
) -> LensFit:
    """Calibrate a lens from photographs of a board, all of one camera at one size.

    Args:
        model: "auto" takes the one with the smaller held-out error.
        name: name of the lens.
    """
    _check_choice(model)
    views, missed = read_views(folder, board, progress)
    return fit_lens(views, board, model, missed=missed, name=name, progress=progress)


def fit_lens(
    views: Sequence[BoardView],
    board: Board,
    model: Choice = "auto",
    *,
    missed: Sequence[MissedView] = (),
    name: str = "",
    progress: Progress = silent,
) -> LensFit:
    """Fit a lens to views of a board."""
    _check_choice(model)
    if len({view.size_px for view in views}) > 1:
        raise InputError("views of several image sizes; give those of one camera at one size")
    _refuse_few(len(views), missed)
    names: tuple[LensModel, ...] = get_args(LensModel)
    fits: dict[LensModel, _Accepted | InputError] = {}
    for count, kind in enumerate(names):
        try:
            fits[kind] = _accept(kind, views, partial(_part, progress, count))
        except InputError as error:
            fits[kind] = error
    compared = _compared(fits, views)
    wanted = MODELS[model] if model != "auto" else min(names, key=lambda kind: compared[kind])
    chosen = fits[wanted]
    if isinstance(chosen, InputError):
        raise chosen
    fit = _told(chosen, compared, views, board, missed)
    return replace(fit, lens=replace(fit.lens, name=name))


def _part(progress: Progress, part: int, done: int, total: int) -> None:
    progress("fitting and holding out views", part * total + done, len(PARAMETERS) * total)


def _check_choice(model: str) -> None:
    if model not in get_args(Choice):
        raise InputError(f"model {model!r}; there are {', '.join(get_args(Choice))}")


def _refuse_few(count: int, missed: Sequence[MissedView]) -> None:
    if count < MIN_VIEWS:
        told = "; ".join(f"{view.name}: {view.reason}" for view in missed[:5])
        raise InputError(
            f"{count} usable views; {MIN_VIEWS} or more are needed, and 15 to 25 are good: the board tilted, "
            f"near and far, in every part of the frame{'. Not used: ' + told if told else ''}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Accepted:
    """A fit with the views it keeps, each of its kept corners, and their held-out errors."""

    bundle: Bundle
    whole: tuple[BoardView, ...]
    kept: tuple[BoardView, ...]
    held_out: tuple[float, ...]
    rejected: tuple[MissedView, ...]

    def held_out_of(self, views: Sequence[BoardView], names: set[str]) -> float:
        """Root mean square of held-out errors of views of these names; rejected ones count too."""
        told = dict(zip((view.name for view in self.whole), self.held_out, strict=True))
        numbers, model = self.bundle.numbers, self.bundle.model
        return _rms(
            [
                told[view.name] if view.name in told else view_error_px(model, numbers, view)
                for view in views
                if view.name in names
            ]
        )


def _compared(
    fits: Mapping[LensModel, _Accepted | InputError], views: Sequence[BoardView]
) -> dict[LensModel, float]:
    fitted = {model: fit for model, fit in fits.items() if not isinstance(fit, InputError)}
    names = {view.name for fit in fitted.values() for view in fit.whole}
    return {model: fitted[model].held_out_of(views, names) if model in fitted else math.inf for model in fits}


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _accept(model: LensModel, views: Sequence[BoardView], progress: Any) -> _Accepted:
    guess = first_guess(model, views)
    poses = [None] * len(views) if guess is None else guess[1]
    rejected = [
        MissedView(view.name, "the board has no pose that its corners fit")
        for view, pose in zip(views, poses, strict=True)
        if pose is None
    ]
    whole = [view for view, pose in zip(views, poses, strict=True) if pose is not None]
    if guess is None or len(whole) < MIN_VIEWS:
        raise InputError(
            f"only {len(whole)} views have a pose that their corners fit; {MIN_VIEWS} are needed"
        )
    bundle = adjust(model, guess[0], [pose for pose in poses if pose is not None], whole, free=4)
    bundle = adjust(model, bundle.numbers, bundle.poses, whole)
    while True:
        corners = [_good_corners(*pair, bundle) for pair in zip(whole, bundle.errors_px, strict=True)]
        errors = [_rms_of(part) for _, part in corners]
        shares = [len(part) / len(full.places_px) for (_, part), full in zip(corners, whole, strict=True)]
        worst, emptiest = int(np.argmax(errors)), int(np.argmin(shares))
        if shares[emptiest] < MIN_CORNERS_LEFT:
            worst = emptiest
            reason = f"{1 - shares[worst]:.0%} of its corners lie far from where the lens puts them"
        elif errors[worst] > _bound(errors):
            reason = (
                f"its corners fit to {_px(errors[worst])}, against {_px(np.median(errors))} of the others"
            )
        else:
            kept = [view for view, _ in corners]
            fitted = adjust(model, bundle.numbers, bundle.poses, kept)
            held = _without_each(fitted, kept, progress)
            worst = int(np.argmax(held))
            if held[worst] <= _bound(held):
                return _Accepted(fitted, tuple(whole), tuple(kept), tuple(held), tuple(rejected))
            reason = f"the others put its corners {_px(held[worst])} off, against {_px(np.median(held))}"
        rejected.append(MissedView(whole[worst].name, reason))
        others = [i for i in range(len(whole)) if i != worst]
        _refuse_few(len(others), rejected)
        whole = [whole[i] for i in others]
        bundle = adjust(model, bundle.numbers, [bundle.poses[i] for i in others], whole)


def _px(value: float) -> str:
    return f"{value:.2g} px" if math.isfinite(value) else "without bound"


def _rms_of(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _bound(errors: Sequence[float]) -> float:
    usual = float(np.median(errors))
    return max(MIN_VIEW_ERROR_PX, MAX_VIEW_RATIO * usual) if math.isfinite(usual) else MIN_VIEW_ERROR_PX


def _good_corners(view: BoardView, errors: np.ndarray, bundle: Bundle) -> tuple[BoardView, np.ndarray]:
    """Corners whose errors are of their view's own kind, and these; a blurred view has larger ones."""
    own = max(bundle.scale_px, 1.4826 * float(np.median(np.abs(errors))))
    good = np.linalg.norm(errors, axis=1) <= MAX_CORNER_SCALES * own
    return BoardView(view.name, view.corners_m[good], view.places_px[good], view.size_px), errors[good]


def _without_each(bundle: Bundle, views: Sequence[BoardView], progress: Any) -> list[float]:
    count = len(views)
    folds = [list(range(i, count, MAX_FOLDS)) for i in range(min(count, MAX_FOLDS))]
    held = np.zeros(count)
    for done, fold in enumerate(folds, start=1):
        left = [i for i in range(count) if i not in fold]
        poses = [bundle.poses[i] for i in left]
        fitted = adjust(bundle.model, bundle.numbers, poses, [views[i] for i in left])
        for i in fold:
            held[i] = view_error_px(bundle.model, fitted.numbers, views[i])
        progress(done, len(folds))
    return held.tolist()


def _told(
    fit: _Accepted,
    compared: Mapping[LensModel, float],
    views: Sequence[BoardView],
    board: Board,
    missed: Sequence[MissedView],
) -> LensFit:
    bundle, size = fit.bundle, views[0].size_px
    lens = lens_of(bundle.model, bundle.numbers, size)
    rays = lens.rays(np.concatenate([view.places_px for view in fit.kept]))
    angles = np.arccos(np.clip(rays[:, 2], -1, 1))
    if not np.isfinite(angles).all():
        raise InputError(
            "the fitted polynomial turns back within the views: it is no lens. Add views with the board in "
            "the frame's corners, or give the other --model"
        )
    widest, error = float(angles.max()), np.concatenate(bundle.errors_px)
    by_noise, by_views = _standard_errors(bundle)
    covered = _refuse_degenerate(fit, lens, by_noise)
    other = next(model for model in compared if model != bundle.model)
    names = PARAMETERS[bundle.model]
    rows = zip(fit.whole, fit.kept, bundle.errors_px, fit.held_out, strict=True)
    return LensFit(
        lens=lens_of(bundle.model, bundle.numbers, size, widest),
        board=board,
        views=tuple(
            ViewScore(
                view.name,
                _rms_of(errors),
                held,
                len(view.places_px),
                len(view.places_px) - len(kept.places_px),
                tuple((float(x), float(y)) for x, y in _hull(view.places_px)),
            )
            for view, kept, errors, held in rows
        ),
        rejected=(*missed, *fit.rejected),
        mean_px=float(np.linalg.norm(error, axis=1).mean()),
        rms_px=_rms_of(error),
        held_out_px=_rms(fit.held_out),
        scale_px=bundle.scale_px,
        standard_errors=dict(zip(names, by_noise.tolist(), strict=True)),
        standard_errors_by_views=dict(zip(names, by_views.tolist(), strict=True)),
        coverage=covered,
        widest_rad=widest,
        other_model=other,
        other_held_out_px=compared[other] if math.isfinite(compared[other]) else None,
        warnings=_warnings(fit, covered, compared, other),
    )


def _standard_errors(bundle: Bundle) -> tuple[np.ndarray, np.ndarray]:
    """Standard errors of the lens parameters: from the spread of corners, and by resampling views, one
    Gauss-Newton step each.
    """
    parts = [bundle.reduced(view, len(bundle.numbers)) for view in range(len(bundle.poses))]
    normals, scores = np.array([part[0] for part in parts]), np.array([part[1] for part in parts])
    normal = normals.sum(axis=0)
    unit = 1 / np.sqrt(np.diag(normal))
    covariance = unit[:, None] * np.linalg.inv(unit[:, None] * normal * unit) * unit
    errors = np.concatenate(bundle.errors_px)
    unknowns = len(normal) + 6 * len(bundle.poses)
    variance = float(np.sum(errors**2)) / max(1, errors.size - unknowns)
    rng = np.random.default_rng(0)
    count, steps = len(normals), []
    for _ in range(RESAMPLES):
        drawn = np.bincount(rng.integers(0, count, count), minlength=count)
        again = np.tensordot(drawn, normals, axes=1)
        try:
            step = np.linalg.solve(unit[:, None] * again * unit, unit * (drawn @ scores))
        except np.linalg.LinAlgError:
            continue
        steps.append(unit * step)
    spread = np.percentile(np.array(steps), [15.87, 84.13], axis=0)
    # Few views vary less about their own fit than about the truth: n / (n - 1), as of any variance.
    by_views = np.diff(spread, axis=0)[0] / 2 * math.sqrt(count / (count - 1))
    return np.sqrt(np.diag(covariance) * variance), by_views


def _refuse_degenerate(fit: _Accepted, lens: Lens, errors: np.ndarray) -> float:
    """Share of the frame that the corners cover; refuses views that cannot tell the lens."""
    normals = np.array([cv2.Rodrigues(pose[:3].copy())[0][:, 2] for pose in fit.bundle.poses])
    tilt = float(np.arccos(np.clip(normals @ normals.T, -1, 1)).max())
    if tilt < MIN_TILT_RAD:
        raise InputError(
            f"the board is parallel in all views, to {math.degrees(tilt):.0f} degrees: focal length "
            "and distance cannot be told apart. Tilt it by 20 to 45 degrees to both sides, and up and down"
        )
    places = np.concatenate([view.places_px for view in fit.kept])
    height, width = lens.size_px
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    reach = float(np.linalg.norm(places - middle, axis=1).max() / np.linalg.norm(middle))
    covered = float(cv2.contourArea(_hull(places).astype(np.float32)) / (width * height))
    if reach < MIN_REACH or covered < MIN_REGION:
        raise InputError(
            f"all corners lie within {reach:.0%} of the way from the middle to the frame's corners, and "
            f"cover {covered:.0%} of it, where {MIN_REACH:.0%} and {MIN_REGION:.0%} are needed: a lens "
            "bends most where no board was. Add views with the board near each side and corner"
        )
    relative = float((errors[:2] / np.array(lens.focal_px)).max())
    if not relative <= MAX_FOCAL_ERROR:
        raise InputError(
            f"the focal length is known to {relative:.1%} only, where {MAX_FOCAL_ERROR:.0%} is allowed: the "
            "views are too alike. Add some that are tilted more, nearer, and at the frame's sides"
        )
    return covered


def _hull(places: np.ndarray) -> np.ndarray:
    return cv2.convexHull(places.astype(np.float32)).reshape(-1, 2)


def _warnings(
    fit: _Accepted, covered: float, compared: Mapping[LensModel, float], other: LensModel
) -> tuple[str, ...]:
    told = []
    own, beside = compared[fit.bundle.model], compared[other]
    if own > WORSE * beside:
        name = next(key for key, value in MODELS.items() if value == other)
        told.append(
            f"the lens is none of a {fit.bundle.model}: views held out are off by {own:.2f} px, and by "
            f"{beside:.2f} px with --model {name}; take that"
        )
    if covered < MIN_GOOD_REGION:
        told.append(f"the boards cover {covered:.0%} of the frame; beyond them the lens gives no number")
    if len(fit.whole) < 2 * MIN_VIEWS:
        told.append(f"{len(fit.whole)} views are few; 15 to 25 are good")
    return tuple(told)
