"""Read poses of taps by a fitted tip and its learned error, with intervals.

A pose is the most probable one, by damped Gauss-Newton steps from the middle of the range. Half widths are
leave-one-out conformal quantiles of the known taps' errors in standard deviations (R. J. Tibshirani and
others, Annals of Statistics 49 (2021) 486, doi:10.1214/20-AOS1965). Few taps are also left out of the tip's
fit, a fifth at a time; many only of the learned error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.core import Bool, Float, InputError, Int, Progress, ndarray, silent
from palpate.sensors.tactip.posed_tip import POSE, PosedTip, TipTerms
from palpate.sensors.tactip.taps.pose_polynomial import PosePolynomial, told_by
from palpate.sensors.tactip.taps.tip_fit import TipFit, fit_tip, refuse_alike, upright_course
from palpate.sensors.tactip.taps.twin_error import FieldModes, TwinError

COVERAGE = 0.9
MIN_LEARNT = 10  # minimum number of taps
STEPS = 12
REST_DEGREE = 4
MIN_MILD = 8  # minimum taps that determine the pins at rest
MILD_SHARE = 0.1
BEYOND = 1.1  # limit of poses in half ranges
MIN_PINS_SEEN = 0.6
FOLDS = 5
REFITTED_BELOW = 150  # number of taps below which the fit's optimism matters
UNLIKE = 0.99  # quantile of the known taps' misfit that sets the limit

Poses = Float[ndarray, "t 6"]
Places = Float[ndarray, "t p 2"]


@dataclass(frozen=True)
class PoseReadings:
    """Poses read.

    Attributes:
        poses: `POSE` in its units; NaN where no pins were identified.
        half_widths: Half widths of 90 % intervals.
        misfit: Squared Mahalanobis distance over the number of modes.
        within: Whether the pose is inside the range of the known taps.
        like: Whether the misfit is in the range of the known taps.
    """

    poses: Poses
    half_widths: Poses
    misfit: Float[ndarray, " t"]
    within: Bool[ndarray, " t"]
    like: Bool[ndarray, " t"]

    @property
    def valid(self) -> Bool[ndarray, " t"]:
        return self.within & self.like & np.isfinite(self.poses[:, 0])


@dataclass(frozen=True)
class TipReader:
    """A fitted tip that reads poses.

    Attributes:
        error: Learned error of the tip.
        pixel_px: Standard deviation of a pin's coordinate outside the modes.
        widths: Half widths over the readings' standard deviations.
        limit: Maximum misfit.
    """

    tip: PosedTip
    terms: TipTerms
    error: TwinError
    pixel_px: float
    widths: Float[ndarray, " 6"]
    limit: float

    @classmethod
    def learnt(cls, fit: TipFit, poses: Poses, places: Places, progress: Progress = silent) -> TipReader:
        """Build from a fitted tip and its taps."""
        if len(poses) < MIN_LEARNT:
            raise InputError(f"{len(poses)} taps; give {MIN_LEARNT} or more", code="too-few-taps")
        plain = cls.plain(fit, poses, places)
        read, spread, misfit = plain.told(places, np.arange(len(poses)))
        limit = float(np.quantile(misfit, UNLIKE))
        if len(poses) < REFITTED_BELOW:
            read, spread = _read_by_others(poses, places, progress)
        away = np.sort(np.abs(read - poses) / spread, axis=0)
        rank = min(len(poses), int(np.ceil((len(poses) + 1) * COVERAGE))) - 1
        return cls(fit.tip, fit.terms, plain.error, plain.pixel_px, away[rank], limit)

    @classmethod
    def plain(cls, fit: TipFit, poses: Poses, places: Places) -> TipReader:
        """Build without calibrated intervals."""
        modes = FieldModes.over(fit.tip.rest_px)
        off = places - fit.tip.places_px(fit.terms, poses)
        error = TwinError.learnt(poses, modes.of(off))
        return cls(fit.tip, fit.terms, error, modes.beside(off), np.ones(6), np.inf)

    @cached_property
    def modes(self) -> FieldModes:
        return FieldModes.over(self.tip.rest_px)

    @cached_property
    def precision(self) -> Float[ndarray, "m m"]:
        """Inverse covariance of a tap's amplitudes given its pose [1/px^2]."""
        C = self.error.covariance
        return np.linalg.inv(C + self.pixel_px**2 * np.eye(len(C)))

    def expected_px(self, poses: Poses) -> Places:
        """Pin positions at poses, corrected by the learned error [px]."""
        x, y = np.split(self.error.at(poses), 2, axis=1)
        return np.asarray(self.tip.places_px(self.terms, poses) + self.modes.field(x, y))

    def read(self, places: Places) -> PoseReadings:
        """Read the poses of taps from their pins [px]."""
        if places.ndim != 3 or places.shape[1:] != self.tip.rest_px.shape:
            raise InputError(
                f"places of shape {list(places.shape)}; this tip has [taps, {len(self.tip.rest_px)}, 2]"
            )
        enough = np.isfinite(places[..., 0]).mean(axis=1) >= MIN_PINS_SEEN
        shape = (len(places), len(POSE))
        poses, half, misfit = np.full(shape, np.nan), np.full(shape, np.nan), np.full(len(places), np.nan)
        if enough.any():
            poses[enough], spread, misfit[enough] = self.told(places[enough])
            half[enough] = self.widths * spread
        z = self.error.scale.scaled(poses)
        with np.errstate(invalid="ignore"):
            return PoseReadings(poses, half, misfit, (np.abs(z) <= 1).all(axis=1), misfit <= self.limit)

    def told(
        self, places: Places, without: Int[ndarray, " t"] | None = None
    ) -> tuple[Poses, Poses, Float[ndarray, " t"]]:
        """Poses, standard deviations, and misfits; with `without`, each as if one known tap were unknown."""
        seen, scale, S = self.modes.of(places - self.tip.rest_px), self.error.scale, self.precision
        prior = np.diag(3 / scale.half**2)  # of a uniform distribution over the range
        poses = np.repeat(scale.middle[None], len(places), axis=0)

        def expected(poses: Poses) -> Float[ndarray, "t m"]:
            moved = self.tip.places_px(self.terms, poses) - self.tip.rest_px
            return self.modes.of(moved) + self.error.at(poses, without)

        def cost(off: Float[ndarray, "t m"], poses: Poses) -> Float[ndarray, " t"]:
            misfit = np.einsum("ti,ij,tj->t", off, S, off)
            return np.asarray(
                misfit + np.einsum("ti,ij,tj->t", poses - scale.middle, prior, poses - scale.middle)
            )

        damping, off = np.full(len(places), 1e-2), seen - expected(poses)
        now = cost(off, poses)
        for _ in range(STEPS):
            J = np.stack(
                [(expected(poses + d) - (seen - off)) / d.max() for d in np.diag(1e-3 * scale.half)], 2
            )
            bend = np.einsum("tia,ij,tjb->tab", J, S, J) + prior
            pull = np.einsum("tia,ij,tj->ta", J, S, off) - (poses - scale.middle) @ prior
            held = bend + damping[:, None, None] * np.einsum("taa->ta", bend)[:, :, None] * np.eye(6)
            tried = poses + np.linalg.solve(held, pull[..., None])[..., 0]
            tried = np.clip(tried, scale.middle - BEYOND * scale.half, scale.middle + BEYOND * scale.half)
            new = seen - expected(tried)
            then = cost(new, tried)
            better = then < now
            poses[better], off[better], now[better] = tried[better], new[better], then[better]
            damping = np.where(better, damping / 4, damping * 6)
        spread = np.sqrt(np.einsum("taa->ta", np.linalg.inv(bend)))
        return poses, spread, np.einsum("ti,ij,tj->t", off, S, off) / len(S)


def _read_by_others(poses: Poses, places: Places, progress: Progress) -> tuple[Poses, Poses]:
    """Pose and standard deviation of every tap by a tip fitted to other taps."""
    read, spread = np.empty_like(poses), np.empty_like(poses)
    fold = np.arange(len(poses)) % FOLDS
    for k in range(FOLDS):
        mine = fold == k
        fit = fit_pins(poses[~mine], places[~mine], progress)
        reader = TipReader.plain(fit, poses[~mine], places[~mine])
        read[mine], spread[mine], _ = reader.told(places[mine])
    return read, spread


def fit_pins(
    poses: Poses, places: Places, progress: Progress = silent, *, closely_upright: bool = True
) -> TipFit:
    """Fit a tip with unknown pins at rest, which the mildest taps determine.

    Args:
        poses: Poses in the units of `POSE`.
        places: Pin positions; NaN where one was not found [px].
        progress: Callback for the rounds.
        closely_upright: Whether to use `upright_course`.
    """
    refuse_alike(poses)
    shallow = float(poses[:, 0].min())
    rest_pose = np.array([[shallow, 0, 0, 0, 0, 0]])
    rest = PosePolynomial.fitted(poses, places, told_by(poses, REST_DEGREE)).at(rest_pose)[0]
    course = upright_course(poses, places) if closely_upright else None
    if course is not None:
        return fit_tip(PosedTip(rest, shallow), poses, places, progress, upright=course)
    fit = fit_tip(PosedTip(rest, shallow), poses, places, progress)
    spread = poses.std(axis=0)
    mild = np.argsort(np.linalg.norm((poses - rest_pose) / spread, axis=1))
    mild = mild[: max(MIN_MILD, int(MILD_SHARE * len(poses)))]
    moved = fit.tip.places_px(fit.terms, poses[mild]) - fit.tip.rest_px
    rest = np.nanmean(places[mild] - moved, axis=0)
    return fit_tip(PosedTip(rest, shallow), poses, places, progress)
