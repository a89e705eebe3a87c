"""Fit the terms of a TacTip to taps of known pose, with intervals, and compare with smooth regression.

Pin errors of one tap are correlated, so covariances are cluster-robust (K.-Y. Liang and S. L. Zeger,
Biometrika 73 (1986) 13, doi:10.1093/biomet/73.1.13), and a tap counts as `TELLS` independent values.

Polynomial of the pose through the pin positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares

from palpate.core import Float, InputError, Progress, ndarray, silent
from palpate.estimators.unit_fit import correlated_pairs, untold_terms
from palpate.sensors.tactip.posed_tip import PosedTip, TipTerms

RIDGE = 1e-6  # relative ridge, which keeps undetermined weights at 0
TAPS_EACH = 3  # minimum taps per monomial
POLYNOMIAL_ROUNDS = 3  # rounds of imputing missing pins


@dataclass(frozen=True)
class PosePolynomial:
    """Pin positions over a pose, with weights by monomial and coordinate."""

    middle: Float[ndarray, " q"]
    spread: Float[ndarray, " q"]
    degree: int
    weights: Float[ndarray, "m p 2"]

    @classmethod
    def fitted(
        cls, poses: Float[ndarray, "t q"], places: Float[ndarray, "t p 2"], degree: int
    ) -> PosePolynomial:
        """Fit by least squares over taps; missing pins are NaN."""
        middle, spread = poses.mean(axis=0), poses.std(axis=0)
        X = monomials((poses - middle) / spread, degree)
        flat = places.reshape(len(places), -1)
        missing = np.isnan(flat)
        flat = np.where(missing, np.nanmedian(flat, axis=0), flat)
        solve = np.linalg.solve(X.T @ X + RIDGE * len(X) * np.eye(X.shape[1]), X.T)
        for _ in range(POLYNOMIAL_ROUNDS):
            W = solve @ flat
            flat = np.where(missing, X @ W, flat)
        return cls(middle, spread, degree, (solve @ flat).reshape(-1, *places.shape[1:]))

    def at(self, poses: Float[ndarray, "t q"]) -> Float[ndarray, "t p 2"]:
        X = monomials((poses - self.middle) / self.spread, self.degree)
        return np.tensordot(X, self.weights, 1)


def told_by(poses: Float[ndarray, "t q"], degree: int) -> int:
    """Return the degree, reduced to what the number of taps determines."""
    while degree > 1 and len(poses) < TAPS_EACH * monomials(poses[:1], degree).shape[1]:
        degree -= 1
    return degree


def monomials(at: Float[ndarray, "n q"], degree: int) -> Float[ndarray, "n m"]:
    """Return all products of up to `degree` of the columns, the constant first."""
    columns = [np.ones(len(at))]
    for d in range(1, degree + 1):
        for which in combinations_with_replacement(range(at.shape[1]), d):
            columns.append(np.prod(at[:, which], axis=1))
    return np.stack(columns, axis=1)


MIN_TAPS = 8  # minimum number of taps
TELLS = 10.0  # effective number of independent values per tap
ERR_PX = 4.0  # model error of a pin, which weights taps against the prior
DEGREES = (2, 3, 4)
UPRIGHT_PX = 0.2  # accuracy of the smoothed pins of an upright tap
COURSE = np.linspace(0.05, 0.95, 8)  # quantiles of depth of the upright poses
COURSE_DEGREE = 4
COURSE_SHARE = 0.1  # weight of all upright poses over the taps'
ROUNDS = 60

SPREAD = TipTerms(
    lever_mm=0.5, camera_mm=15.0, depth_zero_mm=0.5, distortion=0.1, edge_rad=0.15,
    tilt_xx=1.0, tilt_xy=1.0, tilt_yx=1.0, tilt_yy=1.0,
    shear_xx=1.0, shear_xy=1.0, shear_yx=1.0, shear_yy=1.0,
    depth_per_tilt=3.0, shear_per_turn=0.3, turn_per_shear=0.3, shear_per_tilt_x=0.5, shear_per_tilt_y=0.5,
    twist=1.0, shear_by_twist=0.5, slip_mm=1.0, slip_power=1.0, shear_rad=0.4, shear_per_contact=0.5,
    shear_fade_rad=0.15, twist_rad=0.5, twist_per_contact=1.0, twist_fade_rad=0.15, shear_far=0.1,
    seat_x_rad=0.05, seat_y_rad=0.05,
)  # fmt: skip
"""Prior standard deviations of the terms about the defaults of `TipTerms`. Assumed."""
_BOUNDS = [[d + side * 8 * sd for d, sd in zip(TipTerms(), SPREAD, strict=True)] for side in (-1, 1)]
MIN_TERMS = TipTerms(*_BOUNDS[0])._replace(
    lever_mm=0.0, camera_mm=22.0, distortion=-0.4, edge_rad=0.4, slip_mm=0.05, slip_power=0.3,
    shear_fade_rad=0.03, twist_fade_rad=0.03,
)  # fmt: skip
MAX_TERMS = TipTerms(*_BOUNDS[1])._replace(lever_mm=6.0, distortion=0.4, edge_rad=1.3)

Poses = Float[ndarray, "t 6"]
Places = Float[ndarray, "t p 2"]
Course = tuple[Float[ndarray, "k 6"], Float[ndarray, "k p 2"]]


@dataclass(frozen=True)
class TipFit:
    """A fitted tip: most probable terms, their covariance, and the number of taps."""

    tip: PosedTip
    terms: TipTerms
    covariance: Float[ndarray, "q q"]
    taps: int

    @property
    def spread(self) -> TipTerms:
        return TipTerms(*np.sqrt(np.diag(self.covariance)).tolist())

    @property
    def untold(self) -> tuple[str, ...]:
        """Terms whose uncertainty is hardly below the prior's."""
        return untold_terms(TipTerms._fields, np.diag(np.square(SPREAD)), self.covariance)

    @property
    def tied(self) -> tuple[tuple[str, str], ...]:
        """Pairs of strongly correlated terms."""
        return correlated_pairs(TipTerms._fields, self.covariance)


@dataclass(frozen=True)
class TipJudgement:
    """Evaluation of a tip on taps outside its fit; rms over pins [px].

    Attributes:
        residual_px: Residual of the tip.
        floor_px: Residual of the best smooth regression on the pose, of degree `floor_degree`.
        motion_px: Motion of the pins from rest.
        shift_px: Part of the residual common to all pins of a tap.
        by_pin_px: Residual of each pin.
    """

    residual_px: float
    floor_px: float
    floor_degree: int
    motion_px: float
    shift_px: float
    by_pin_px: Float[ndarray, " p"]


def fit_tip(
    tip: PosedTip, poses: Poses, places: Places, progress: Progress = silent, *, upright: Course | None = None
) -> TipFit:
    """Fit the terms of a tip to taps.

    Args:
        tip: Tip with the pins at rest.
        poses: Poses in the units of `POSE`.
        places: Pin positions; NaN where one was not found [px].
        progress: Callback for the rounds.
        upright: Smoothed upright poses of `upright_course` with a large weight; None for too few taps.
    """
    if len(poses) != len(places) or len(poses) < MIN_TAPS or places.shape[1:] != tip.rest_px.shape:
        raise InputError(
            f"{len(poses)} poses and places of shape {list(places.shape)} for {len(tip.rest_px)} pins; give "
            f"one pose a tap, {MIN_TAPS} taps or more",
            code="too-few-taps",
        )
    refuse_alike(poses)
    weight = np.sqrt(TELLS / (2 * places.shape[1])) / ERR_PX
    prior, spread = np.array(TipTerms()), np.array(SPREAD)
    rounds = 0

    course, smooth = (poses[:0], places[:0]) if upright is None else upright
    surely = weight * ERR_PX / UPRIGHT_PX * np.sqrt(COURSE_SHARE * len(poses) / len(COURSE))

    def rows(terms: ndarray) -> ndarray:
        q = TipTerms(*terms)
        off = np.nan_to_num(weight * (tip.places_px(q, poses) - places))
        upright = surely * (tip.places_px(q, course) - smooth)
        return np.concatenate([off.ravel(), upright.ravel(), (terms - prior) / spread])

    def slopes(terms: ndarray) -> ndarray:
        nonlocal rounds
        rounds += 1
        progress("rounds", min(rounds, ROUNDS), ROUNDS)
        return _slopes(rows, terms, 1e-4 * spread)

    start = np.array(_oriented(tip, poses, places))
    found = least_squares(
        rows,
        start,
        jac=slopes,
        bounds=(MIN_TERMS, MAX_TERMS),
        x_scale=spread,
        max_nfev=ROUNDS,
        ftol=1e-5,
        xtol=1e-6,
    )
    J, own = found.jac, places.size
    by_tap = (len(poses), -1)
    scores = np.einsum("tri,tr->ti", J[:own].reshape(*by_tap, len(prior)), found.fun[:own].reshape(by_tap))
    bread = np.linalg.inv(J.T @ J)
    meat = scores.T @ scores + J[own:].T @ J[own:]
    return TipFit(tip, TipTerms(*found.x.tolist()), bread @ meat @ bread, len(poses))


def refuse_alike(poses: Poses) -> None:
    """Reject taps that share a component of the pose."""
    still = [name for name, spread in zip(_POSE_NAMES, np.ptp(poses, axis=0), strict=True) if not spread > 0]
    if still:
        raise InputError(f"all taps have the same {', '.join(still)}; vary it", code="pose-constant")


def upright_course(poses: Poses, places: Places) -> Course | None:
    """Return upright poses over the taps' depths with their smoothed pins [px]; None for too few taps."""
    if told_by(poses, COURSE_DEGREE) < COURSE_DEGREE:
        return None
    course = np.zeros((len(COURSE), poses.shape[1]))
    course[:, 0] = np.quantile(poses[:, 0], COURSE)
    return course, PosePolynomial.fitted(poses, places, COURSE_DEGREE).at(course)


def judge_tip(
    fit: TipFit,
    known: tuple[Poses, Places],
    new: tuple[Float[ndarray, "n 6"], Float[ndarray, "n p 2"]],
) -> TipJudgement:
    """Compare a tip with smooth regressions fitted to `known`, on new taps."""
    poses, places = new
    off = fit.tip.places_px(fit.terms, poses) - places
    floors = {}
    for degree in DEGREES:
        smooth = PosePolynomial.fitted(*known, degree)
        floors[degree] = _rms(smooth.at(poses) - places)
    best = min(floors, key=lambda degree: floors[degree])
    return TipJudgement(
        _rms(off),
        floors[best],
        best,
        _rms(places - fit.tip.rest_px),
        float(np.sqrt(np.mean(np.sum(np.nanmean(off, axis=1) ** 2, axis=1)))),
        np.sqrt(np.nanmean(np.sum(off**2, axis=2), axis=0)),
    )


def _oriented(tip: PosedTip, poses: Poses, places: Places) -> TipTerms:
    """Default terms with tilt, shear, and twist rotated to the image, in eighths of a turn."""
    some = np.linspace(0, len(poses) - 1, min(len(poses), 120)).astype(int)

    def nearest(candidates: Sequence[TipTerms]) -> TipTerms:
        return min(candidates, key=lambda q: _rms(tip.places_px(q, poses[some]) - places[some]))

    best = TipTerms()
    for what in ("shear", "tilt"):
        best = nearest([best._replace(**_turned(what, k, hand)) for k in range(8) for hand in (1, -1)])
    return nearest([best._replace(twist=twist) for twist in (0.8, -0.8)])


def _turned(what: str, eighths: int, hand: int) -> dict[str, float]:
    angle = eighths * np.pi / 4
    c, s = 0.8 * float(np.cos(angle)), 0.8 * float(np.sin(angle))
    return {f"{what}_xx": c, f"{what}_xy": -hand * s, f"{what}_yx": s, f"{what}_yy": hand * c}


def _slopes(rows: object, at: ndarray, steps: ndarray) -> ndarray:
    columns = [(rows(at + d) - rows(at - d)) / (2 * d.sum()) for d in np.diag(steps)]  # type: ignore[operator]
    return np.stack(columns, axis=1)


def _rms(off: ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=-1))))


_POSE_NAMES = ("depth", "tilt about x", "tilt about y", "shear along x", "shear along y", "twist")
