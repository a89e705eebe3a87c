"""Read poses of taps by a fitted tip and its learned error, with intervals.

A pose is the most probable one, by damped Gauss-Newton steps from the middle of the range. Half widths are
leave-one-out conformal quantiles of the known taps' errors in standard deviations (R. J. Tibshirani and
others, Annals of Statistics 49 (2021) 486, doi:10.1214/20-AOS1965). Few taps are also left out of the tip's
fit, a fifth at a time; many only of the learned error.

A tip's reader on disk, and images read by it.

Error of a fitted tip's pins as a smooth function of the pose, learned from few taps.

In polynomial modes of the pin field (`FieldModes`) every tap leaves about forty amplitudes, modeled as
Gaussian processes of the pose with one kernel: a constant and a squared exponential whose length scales
maximize the marginal likelihood (C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning,
MIT Press 2006, chapter 5).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from palpate.core import Bool, Float, ImageError, InputError, Int, Progress, ndarray, silent, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.lattice.ring_layout import PinLayoutKind, name_pins
from palpate.sensors.tactip.posed_tip import POSE, PosedTip, TipTerms
from palpate.sensors.tactip.taps.tap_pins import NamedPins, placed, read_image, spots
from palpate.sensors.tactip.taps.tip_fit import (
    PosePolynomial,
    TipFit,
    fit_tip,
    monomials,
    refuse_alike,
    told_by,
    upright_course,
)

MODE_DEGREE = 5
LEADING = 12  # principal components for the kernel's choice
USUAL_LENGTH, LENGTH_SPREAD = (
    1.5,
    0.5,
)  # prior length scale in half ranges, and standard deviation of its logarithm
CONSTANT = 0.3  # relative prior variance of the constant part
SHRUNK_AS = 10  # weight of the covariance's shrinkage to the diagonal, in taps

Poses = Float[ndarray, "t 6"]
Modes = Float[ndarray, "t m"]


@dataclass(frozen=True)
class FieldModes:
    """Orthonormal polynomials over a field of pins, with the basis ``[p k]``."""

    basis: Float[ndarray, "p k"]

    @classmethod
    def over(cls, rest_px: Float[ndarray, "p 2"], degree: int = MODE_DEGREE) -> FieldModes:
        at = rest_px - np.median(rest_px, axis=0)
        return cls(np.linalg.qr(monomials(at / np.hypot(*at.T).max(), degree))[0])

    def of(self, moved_px: Float[ndarray, "t p 2"]) -> Modes:
        """Amplitudes of displacements along x and then y [px]; NaN pins do not count."""
        seen = np.isfinite(moved_px[..., 0])
        if seen.all():
            return np.concatenate([moved_px[..., 0] @ self.basis, moved_px[..., 1] @ self.basis], axis=1)
        return np.stack([self._seen(one, there) for one, there in zip(moved_px, seen, strict=True)])

    def _seen(self, moved_px: Float[ndarray, "p 2"], there: ndarray) -> Float[ndarray, " m"]:
        return np.asarray(np.linalg.lstsq(self.basis[there], moved_px[there], rcond=None)[0].T.ravel())

    def beside(self, moved_px: Float[ndarray, "t p 2"]) -> float:
        """Rms of a coordinate's displacement outside the modes [px]."""
        x, y = np.split(self.of(moved_px), 2, axis=1)
        return float(np.sqrt(np.nanmean((moved_px - self.field(x, y)) ** 2)))

    def field(self, x: Modes, y: Modes) -> Float[ndarray, "t p 2"]:
        """Displacements of amplitudes [px]."""
        return np.stack([x @ self.basis.T, y @ self.basis.T], axis=-1)


@dataclass(frozen=True)
class PoseScale:
    """Middle and half range of poses."""

    middle: Float[ndarray, " 6"]
    half: Float[ndarray, " 6"]

    @classmethod
    def of(cls, poses: Poses) -> PoseScale:
        low, high = poses.min(axis=0), poses.max(axis=0)
        return cls((low + high) / 2, (high - low) / 2)

    def scaled(self, poses: Poses) -> Poses:
        """Poses scaled to -1 to 1."""
        return np.asarray((poses - self.middle) / self.half)


@dataclass(frozen=True)
class TwinError:
    """A tip's error over poses.

    Attributes:
        known: Poses of the training taps.
        off: Amplitudes of the tip's error in these [px].
        lengths: Length scales in half ranges.
        amplitude, noise: Standard deviations of the process and of its noise, relative to the error.
    """

    scale: PoseScale
    known: Poses
    off: Modes
    lengths: Float[ndarray, " 6"]
    amplitude: float
    noise: float

    @classmethod
    def learnt(cls, poses: Poses, off: Modes) -> TwinError:
        """Fit the kernel of maximum posterior probability."""
        scale = PoseScale.of(poses)
        z = scale.scaled(poses)
        u, s, _ = np.linalg.svd(off, full_matrices=False)
        leading = u[:, : min(LEADING, len(off))] * s[: min(LEADING, len(off))]
        leading /= np.sqrt(np.mean(leading**2, axis=0))

        def against(words: Float[ndarray, " 8"]) -> float:
            K = _kernel(z, z, np.exp(words[:6]), np.exp(words[6])) + np.exp(2 * words[7]) * np.eye(len(z))
            lower, _ = factor = cho_factor(K + 1e-8 * np.eye(len(z)), lower=True)
            misfit = (leading * cho_solve(factor, leading)).sum() / 2
            size = leading.shape[1] * np.log(np.diag(lower)).sum()
            prior = (((words[:6] - np.log(USUAL_LENGTH)) / LENGTH_SPREAD) ** 2).sum() / 2
            return float(misfit + size + prior)

        start = np.append(np.full(6, np.log(USUAL_LENGTH)), [0.0, np.log(0.5)])
        found = minimize(against, start, method="L-BFGS-B", bounds=[(-2, 3)] * 6 + [(-4, 2)] * 2).x
        return cls(scale, poses, off, np.exp(found[:6]), float(np.exp(found[6])), float(np.exp(found[7])))

    @cached_property
    def inverse(self) -> Float[ndarray, "t t"]:
        """Inverse covariance of the taps."""
        z = self.scale.scaled(self.known)
        K = _kernel(z, z, self.lengths, self.amplitude)
        return np.linalg.inv(K + self.noise**2 * np.eye(len(z)))

    @cached_property
    def weights(self) -> Modes:
        return np.asarray(self.inverse @ self.off)

    @cached_property
    def left_out(self) -> Modes:
        """Leave-one-out residuals [px]."""
        return np.asarray(self.weights / np.diag(self.inverse)[:, None])

    @cached_property
    def covariance(self) -> Float[ndarray, "m m"]:
        """Covariance of the leave-one-out residuals, shrunk for few taps [px^2]."""
        off, count = self.left_out, len(self.left_out)
        C = off.T @ off / count
        share = SHRUNK_AS / (SHRUNK_AS + count)
        return np.asarray((1 - share) * C + share * np.diag(np.diag(C)))

    def at(self, poses: Poses, without: Int[ndarray, " t"] | None = None) -> Modes:
        """Amplitudes of the error at poses [px]; with `without`, each as if one known tap were unknown."""
        z, known = self.scale.scaled(poses), self.scale.scaled(self.known)
        k = _kernel(z, known, self.lengths, self.amplitude)
        told = k @ self.weights
        if without is not None:
            told -= np.einsum("ti,it->t", k, self.inverse[:, without])[:, None] * self.left_out[without]
        return np.asarray(told)


def _kernel(
    one: Float[ndarray, "a 6"], other: Float[ndarray, "b 6"], lengths: Float[ndarray, " 6"], amplitude: float
) -> Float[ndarray, "a b"]:
    apart = (((one[:, None] - other[None]) / lengths) ** 2).sum(axis=2)
    return np.asarray(CONSTANT + amplitude**2 * np.exp(-apart / 2))


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


FORMAT = "palpate tip reader 1"
FILE = "reader.json"


def reader_record(reader: TipReader, layout: NamedPins) -> dict[str, Any]:
    """Return a reader and its pin layout as plain values."""
    error = reader.error
    return {
        "format": FORMAT, "size": list(layout.size), "kind": layout.kind,
        "cells": [list(c) for c in layout.cells],
        "tip": reader.tip.tip, "gel_index": reader.tip.gel_index, "rest_depth_mm": reader.tip.rest_depth_mm,
        "rest_px": reader.tip.rest_px.tolist(), "terms": reader.terms._asdict(),
        "known_poses": error.known.tolist(), "off_px": error.off.tolist(), "lengths": error.lengths.tolist(),
        "amplitude": error.amplitude, "noise": error.noise, "pixel_px": reader.pixel_px,
        "widths": reader.widths.tolist(), "limit": reader.limit,
    }  # fmt: skip


@parser("tip reader", InputError)
def load_reader(folder: Path) -> tuple[TipReader, NamedPins]:
    """Load a reader and its pin layout from a fitted tip's folder."""
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"there is no {path}; `palpate calibrate --method tip-pose` makes one")
    with storage_errors(path):
        text = path.read_bytes()
    try:
        record = json.loads(text)
        reader, layout = _made(record)
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{path} is no tip reader: {type(e).__name__}: {e}", code="reader-damaged") from e
    return reader, layout


def _made(record: dict[str, Any]) -> tuple[TipReader, NamedPins]:
    if record["format"] != FORMAT:
        raise ValueError(f"its format is {record['format']!r}, not {FORMAT!r}")
    known, off, rest, widths, lengths = (
        np.array(record[name], np.float64)
        for name in ("known_poses", "off_px", "rest_px", "widths", "lengths")
    )
    cells = tuple((int(c), int(r)) for c, r in record["cells"])
    height, width = (int(one) for one in record["size"])
    if record["kind"] not in get_args(PinLayoutKind):
        raise ValueError(f"no layout is {record['kind']!r}")
    sound = known.shape == (len(off), len(POSE)) and rest.shape == (len(cells), 2) and len(known) > 1
    parts = (known, off, rest, widths, lengths)
    if not (
        sound and widths.shape == lengths.shape == (len(POSE),) and all(np.isfinite(p).all() for p in parts)
    ):
        raise ValueError("its arrays do not fit each other, or hold values that are not finite")
    error = TwinError(
        PoseScale.of(known), known, off, lengths, float(record["amplitude"]), float(record["noise"])
    )
    tip = PosedTip(rest, float(record["rest_depth_mm"]), str(record["tip"]), float(record["gel_index"]))
    reader = TipReader(
        tip, TipTerms(**record["terms"]), error, float(record["pixel_px"]), widths, float(record["limit"])
    )
    return reader, NamedPins((height, width), record["kind"], cells)


def read_images(
    reader: TipReader, layout: NamedPins, paths: Sequence[Path], progress: Progress = silent
) -> list[dict[str, Any]]:
    """Read poses of tap images, with intervals, validity, and reason."""
    rows = []
    for i, path in enumerate(paths):
        progress("reading taps", i, len(paths))
        image = read_image(path)
        if image.shape != layout.size:
            raise ImageError(
                f"{path} has {image.shape[1]} x {image.shape[0]} px; this tip was fitted to "
                f"{layout.size[1]} x {layout.size[0]} px",
                code="image-size",
            )
        found = spots(image)
        places = placed(found, name_pins(found, layout.size, layout.kind), layout.cells)
        rows.append({"image": str(path)} | _reading(reader, places))
    return rows


def _reading(reader: TipReader, places: np.ndarray) -> dict[str, Any]:
    read = reader.read(places[None])
    if not np.isfinite(read.poses[0, 0]):
        named = int(np.isfinite(places[:, 0]).sum())
        said = (
            f"{named} of {len(places)} pins could be named; is it a tap of this tip, binarised, pins bright?"
        )
        return {"valid": False, "why": said, "pose": None, "half_width": None}
    why = [] if read.within[0] else ["the pose is beyond the taps that the tip was fitted to"]
    if not read.like[0]:
        why.append("pins stand as in no tap that the tip was fitted to")
    return {
        "valid": bool(read.valid[0]), "why": "; ".join(why) or None,
        "pose": dict(zip(POSE, read.poses[0].tolist(), strict=True)),
        "half_width": dict(zip(POSE, read.half_widths[0].tolist(), strict=True)),
        "misfit": float(read.misfit[0]),
    }  # fmt: skip
