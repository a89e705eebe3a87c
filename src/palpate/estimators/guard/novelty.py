"""Novelty detector: distance of a new image from those that a calibration was trained on.

A thumbnail is rebuilt as the mean of its nearest calibration thumbnails with non-negative weights. Its
residual is compared, block by block, with those of its neighbors when their groups were held out (local
outlier factor: Breunig et al., SIGMOD 2000, doi:10.1145/335191.335388; reconstruction weights: Roweis and
Saul, Science 2000, doi:10.1126/science.290.5500.2323). Two numbers with limits reject a stated ratio of the
calibration's frames; known camera changes (`known_changes`) decide where they were tested.

Discriminator of sensor units along Fisher's axis: 0 is the unit adapted to, 1 the former.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import cv2
import numpy as np
from scipy.optimize import nnls

from palpate.core import CertificateError, Drift, Float, Float16, Float32, Indices, InputError, Int, UInt8
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.parsing import parser
from palpate.estimators.guard.guard_features import frame_features
from palpate.estimators.guard.known_changes import (
    EXCHANGED,
    FLIPS,
    KnownChanges,
    Verdict,
    flipped,
    told_flip,
    unflipped,
)

# greatest regression slope of red less blue on its reconstruction: 1 is equal, -1 exchanged
MAX_SLOPE = -0.3
MAX_CORRELATION = -0.3  # between both after brightness is taken out
# RMS residual below which a picture has too little color [gray levels]
MIN_COLOUR_GREY_LEVELS = 1.0

Picture = Float32[np.ndarray, "h w c"]


def channels_exchanged(picture: Picture, rebuilt: Picture) -> bool:
    """Return whether red and blue seem exchanged relative to the reconstruction [gray levels].

    Red less blue must be inverted both as it is and after regression on brightness, because another lamp
    changes it too.
    """
    if picture.shape[2] != 3:
        return False
    seen, known = _red_less_blue(picture), _red_less_blue(rebuilt)
    pure, pure_known = _beside_brightness(seen, picture), _beside_brightness(known, rebuilt)
    size, size_known = _size(pure), _size(pure_known)
    if min(size, size_known) < MIN_COLOUR_GREY_LEVELS:
        return False
    slope = float(seen @ known) / float(known @ known)
    correlation = float(pure @ pure_known) / (size * size_known * len(seen))
    return slope < MAX_SLOPE and correlation < MAX_CORRELATION


def colour_size(picture: Picture) -> float:
    """Return the RMS of red less blue [gray levels]."""
    return _size(_red_less_blue(picture))


def _red_less_blue(picture: Picture) -> Float[np.ndarray, " n"]:
    return np.asarray(picture[..., 0] - picture[..., 2], np.float64).ravel()


def _beside_brightness(difference: Float[np.ndarray, " n"], picture: Picture) -> Float[np.ndarray, " n"]:
    """Residual of a difference after linear regression on brightness."""
    bright = picture.mean(axis=2, dtype=np.float64).ravel()
    bright -= bright.mean()
    difference = difference - difference.mean()
    square = float(bright @ bright)
    return np.asarray(difference - (float(difference @ bright) / square * bright if square else 0.0))


def _size(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


THUMBNAIL_VALUES = 1024  # a thumbnail holds about this many values, in one channel or in three

BLOCK = 3  # cells of a thumbnail along each side of a block
NEIGHBOURS = 24
AXES = 48  # principal axes along which neighbours are searched for
ROWS_FOR_AXES = 3000
RIDGE = 0.01  # of the neighbours' mean squared distance, so that near twins share their weight
# noise floor of block means of integer thumbnails
FLOOR_GREY_LEVELS = 0.05

# greatest ratio of the red-less-blue residual, exchanged back over as it is, that counts as exchanged
MAX_EXCHANGED_BACK = 0.75
# greatest ratio of a mirrored frame's residual to that of an exchanged one at which it may be mirrored
MAX_MIRRORED = 1.1
# least atypicality of a frame with exchanged channels
EXCHANGED_ATYPICALITY = 2.0

Prepared = UInt8[np.ndarray, "_ _ c"]
Thumbnail = Float32[np.ndarray, "h w c"]
Thumbnails = Float32[np.ndarray, "_ h w c"]
Kept = UInt8[np.ndarray, "_ h w c"]


def thumbnail(prepared: Prepared) -> Float32[np.ndarray, "h w c"]:
    """Return area means of a prepared image, of about constant number [gray levels]."""
    height, width, channels = prepared.shape
    shrink = min(1.0, math.sqrt(THUMBNAIL_VALUES / prepared.size))
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    small = cv2.resize(prepared, size, interpolation=cv2.INTER_AREA)
    return small.reshape(size[1], size[0], channels).astype(np.float32)


def thumbnails(images: Iterable[Prepared]) -> Thumbnails:
    """Return thumbnails of prepared images of one size."""
    return np.stack([thumbnail(image) for image in images])


@dataclass(frozen=True)
class NeighbourModel:
    """Thumbnails of a calibration, and the residual of each when rebuilt from other groups.

    Attributes:
        thumbs: Whole gray levels.
        residual: Squared means over blocks, then over each channel ``[n m]``.
        centre, axes: Space of the neighbor search ``[k]``, ``[k a]``.
    """

    thumbs: Kept
    residual: Float16[np.ndarray, "n m"]
    centre: Float32[np.ndarray, " k"]
    axes: Float32[np.ndarray, "k a"]

    def novelty_score(self, thumb: Thumbnail) -> Float[np.ndarray, " 2"]:
        """Return the residual relative to its neighbors': RMS over blocks, maximum over channels."""
        return self.novelty_of(self.reconstruct(thumb), thumb.shape[2])

    def novelty_of(self, rebuilt: Reconstruction, channels: int) -> Float[np.ndarray, " 2"]:
        return _ratios(rebuilt.residual, _expected_residual(self.residual[rebuilt.rows]), channels)

    def reconstruct(self, thumb: Thumbnail) -> Reconstruction:
        """Rebuild a thumbnail from its nearest ones."""
        flat = thumb.ravel()
        # By einsum, in one thread: where other work has the cores, BLAS's threads wait for each other, which
        # costs a frame many times what they save.
        at = np.einsum("k,ka->a", flat - self.centre, self.axes)
        away = self.squares - 2 * np.einsum("na,a->n", self.places, at)
        count = min(NEIGHBOURS, len(away))
        rows = np.argpartition(away, count - 1)[:count]
        apart = self.thumbs[rows].reshape(count, -1) - flat
        error = np.einsum("r,rk->k", _weights(apart), apart)
        residual = np.einsum("k,km->m", error, _means(thumb.shape)) ** 2
        return Reconstruction(rows, residual, -error.reshape(thumb.shape))

    def among(self, rows: Indices) -> NeighbourModel:
        return replace(self, thumbs=self.thumbs[rows], residual=self.residual[rows])

    @cached_property
    def places(self) -> Float32[np.ndarray, "n a"]:
        flat = self.thumbs.reshape(len(self.thumbs), -1)
        parts = np.array_split(flat, math.ceil(len(flat) / ROWS_FOR_AXES))
        return np.concatenate([(part - self.centre) @ self.axes for part in parts])

    @cached_property
    def squares(self) -> Float32[np.ndarray, " n"]:
        return np.sum(self.places**2, axis=1)


def arrays_fit(thumbs: np.ndarray, residual: np.ndarray, centre: np.ndarray, axes: np.ndarray) -> bool:
    """Return whether arrays are those of one `NeighbourModel`."""
    types = (np.uint8, np.float16, np.float32, np.float32)
    if any(part.dtype != of for part, of in zip((thumbs, residual, centre, axes), types, strict=True)):
        return False
    if thumbs.ndim != 4 or axes.ndim != 2 or not thumbs.size:
        return False
    k, m = _means(thumbs.shape[1:]).shape
    return residual.shape == (len(thumbs), m) and centre.shape == (k,) and len(axes) == k


class Reconstruction(NamedTuple):
    """Thumbnail rebuilt from its neighbors.

    Attributes:
        rows: Neighbors.
        residual: Squared means, as in `NeighbourModel.residual`.
        unlike: Thumbnail less its reconstruction.
    """

    rows: Int[np.ndarray, " r"]
    residual: Float[np.ndarray, " m"]
    unlike: Thumbnail


@dataclass(frozen=True)
class RenderedImages:
    """Thumbnails of further training images, such as rendered ones, held out by group."""

    thumbs: Kept
    groups: Int[np.ndarray, " n"]


@runtime_checkable
class LearnsFromRendered(Protocol):
    """Fitted model that was also trained on such images."""

    @property
    def rendered_images(self) -> RenderedImages | None: ...


class FittedNeighbours(NamedTuple):
    """A `NeighbourModel`, with scores ``[n 2]`` and block residuals [gray levels] of its held-out images."""

    model: NeighbourModel
    novelty_score: Float[np.ndarray, "n 2"]
    expected_residual: Float[np.ndarray, " n"]


def fit_neighbours(thumbs: Kept, folds: Sequence[Indices], rng: np.random.Generator) -> FittedNeighbours:
    """Rebuild each thumbnail from those of other folds, and keep the residual.

    Args:
        thumbs: Whole gray levels.
        folds: Rows of each of two or more folds, whole groups together.
        rng: Draws the rows that determine the axes.
    """
    means, channels = _means(thumbs.shape[1:]).shape[1], thumbs.shape[3]
    model = NeighbourModel(thumbs, np.zeros((len(thumbs), means), np.float16), *_axes(thumbs, rng))
    residual, near = model.residual.copy(), [np.empty(0, np.int64)] * len(thumbs)
    for fold in folds:
        others = np.setdiff1d(np.arange(len(thumbs)), fold)
        rest = model.among(others)
        for row in fold:
            rebuilt = rest.reconstruct(thumbs[row].astype(np.float32))
            residual[row], near[row] = rebuilt.residual, others[rebuilt.rows]
    expected = [_expected_residual(residual[rows]) for rows in near]
    scores = [_ratios(*pair, channels) for pair in zip(residual.astype(np.float32), expected, strict=True)]
    blocks = np.sqrt([squares[:-channels].mean() for squares in expected])
    return FittedNeighbours(replace(model, residual=residual), np.stack(scores), blocks)


def _expected_residual(around: Float16[np.ndarray, "r m"]) -> Float[np.ndarray, " m"]:
    """Expected squared residual of a thumbnail, from its neighbors'."""
    return np.asarray(around.mean(axis=0, dtype=np.float32) + FLOOR_GREY_LEVELS**2)


def _ratios(
    residual: Float[np.ndarray, " m"], expected: Float[np.ndarray, " m"], channels: int
) -> Float[np.ndarray, " 2"]:
    ratios = residual / expected
    return np.sqrt(np.array([ratios[:-channels].mean(), ratios[-channels:].max()], np.float64))


def _weights(apart: Float32[np.ndarray, "r k"]) -> Float[np.ndarray, " r"]:
    """Non-negative weights w of sum 1 that minimize w'Gw, G the neighbors' Gram matrix."""
    gram = _gram(apart).astype(np.float64)
    count = len(gram)
    size = float(gram.trace()) / count + 1e-6
    gram.flat[:: count + 1] += RIDGE * size
    system, wanted = np.empty((count + 1, count)), np.zeros(count + 1)
    system[:count], system[count], wanted[count] = (
        np.linalg.cholesky(gram).T,
        math.sqrt(size),
        math.sqrt(size),
    )
    w, _ = nnls(system, wanted)
    return np.asarray(w / w.sum(), dtype=np.float32)


COLUMNS_AT_ONCE = 256  # few enough for BLAS to take one thread: see `NeighbourModel.reconstruct`


def _gram(apart: Float32[np.ndarray, "r k"]) -> Float32[np.ndarray, "r r"]:
    """Gram matrix of rows; exact in float32 up to 2^24 because differences are whole gray levels."""
    parts = (apart[:, at : at + COLUMNS_AT_ONCE] for at in range(0, apart.shape[1], COLUMNS_AT_ONCE))
    return np.asarray(sum(part @ part.T for part in parts))


@lru_cache(maxsize=4)
def _means(shape: tuple[int, int, int]) -> Float32[np.ndarray, "k m"]:
    """Matrix from a flat thumbnail to its block means and channel means."""
    height, width, channels = shape
    down, across, of = np.indices(shape).reshape(3, -1)
    block = down // BLOCK * math.ceil(width / BLOCK) + across // BLOCK
    blocks = np.eye(math.ceil(height / BLOCK) * math.ceil(width / BLOCK), dtype=np.float32)[block]
    members = np.concatenate([blocks, np.eye(channels, dtype=np.float32)[of]], axis=1)
    return members / members.sum(axis=0)


def _axes(thumbs: Kept, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Mean and principal axes of a limited number of thumbnails."""
    few = len(thumbs) <= ROWS_FOR_AXES
    drawn = thumbs if few else thumbs[rng.choice(len(thumbs), ROWS_FOR_AXES, replace=False)]
    flat = drawn.reshape(len(drawn), -1).astype(np.float32)
    centre = flat.mean(axis=0)
    _, axes = np.linalg.eigh((flat - centre).T @ (flat - centre))
    return centre, np.ascontiguousarray(axes[:, ::-1][:, :AXES])


MAX_KEPT = 2000  # recorded frames
FALSE_ALARMS = 0.03  # ratio of good frames that may be rejected

# noise floor of averages of one scene
MIN_DRIFT_SPREAD_GREY_LEVELS = 0.5

FEW_REFERENCES = 5
# drift limit with fewer than five no-contact frames, in their spread
MAX_DRIFT_OF_FEW = 3.0


@dataclass(frozen=True, slots=True)
class NoveltyDetector:
    """Detector of atypical images and of drift.

    Attributes:
        limits: Limits of the two numbers of `NeighbourModel.novelty_score`.
        reference: Mean no-contact thumbnail ``[h w c]``; None if none was recorded.
        reference_spread: RMS distance of no-contact thumbnails from their mean [gray levels].
        drift_limit: Drift statistic above which the calibration is stale.
        changes: Known camera changes; None if not tested.
    """

    neighbours: NeighbourModel
    limits: Float[np.ndarray, " 2"]
    reference: Thumbnail | None
    reference_spread: float
    drift_limit: float
    changes: KnownChanges | None = None

    def atypicality(self, prepared: Prepared) -> float:
        """Return the novelty of the image over its limit; above 1 it is refused."""
        return self.judge(prepared).atypicality

    def judge(self, prepared: Prepared) -> Verdict:
        """Return the atypicality of the image, and the change that it resembles."""
        thumb = thumbnail(prepared)
        novelty, unlike = self.novelty(thumb)
        if channels_exchanged(thumb, thumb - unlike):
            back, unlike_back = self.novelty(np.ascontiguousarray(thumb[..., ::-1]))
            left = colour_size(unlike_back)
            if back <= 1.0 and left <= MAX_EXCHANGED_BACK * colour_size(unlike):
                kind = "" if self._may_be_mirrored(thumb, left) else EXCHANGED
                return Verdict(max(novelty, EXCHANGED_ATYPICALITY), kind)
        verdict = self._by_changes(prepared, thumb, novelty, unlike)
        flip = self._flip_of(thumb) if verdict.atypicality > 1 else ""
        return Verdict(verdict.atypicality, flip) if flip else verdict

    def _by_changes(self, prepared: Prepared, thumb: Thumbnail, novelty: float, unlike: Thumbnail) -> Verdict:
        """Verdict by the harm of known changes, if tested."""
        if self.changes is None:
            return Verdict(novelty)
        asked = unlike if self.changes.local else None
        return self.changes.judge(frame_features(prepared, thumb, self.changes.registration, asked), novelty)

    def _flip_of(self, thumb: Thumbnail) -> str:
        """Kind of flip of a refused thumbnail, or ""."""
        if self.reference is None:
            return ""
        back = unflipped(thumb, self.reference)
        return told_flip({kind: self.novelty(one)[0] for kind, one in back.items()})

    def _may_be_mirrored(self, thumb: Thumbnail, left: float) -> bool:
        """Whether a mirror explains a thumbnail as well as exchanged channels do."""
        for code in FLIPS.values():
            novelty, unlike = self.novelty(flipped(thumb, code))
            if novelty <= 1.0 and colour_size(unlike) <= MAX_MIRRORED * left:
                return True
        return False

    def novelty(self, thumb: Thumbnail) -> tuple[float, Thumbnail]:
        """Return the novelty of a thumbnail over its limit, and its residual."""
        rebuilt = self.neighbours.reconstruct(thumb)
        score = self.neighbours.novelty_of(rebuilt, thumb.shape[2])
        return float(np.max(score / self.limits)), rebuilt.unlike

    def drift(self, untouched: Prepared) -> Drift | None:
        """Return the drift of the reference since calibration; None without a reference."""
        if self.reference is None:
            return None
        moved = np.sqrt(np.mean((thumbnail(untouched) - self.reference) ** 2))
        return Drift(float(moved / self.reference_spread), self.drift_limit)

    def save(self, path: Path) -> None:
        parts = {
            "thumbs": self.neighbours.thumbs,
            "left": self.neighbours.residual,
            "centre": self.neighbours.centre,
            "axes": self.neighbours.axes,
            "limits": self.limits,
            "reference": np.empty(0, np.float32) if self.reference is None else self.reference,
            "drift": np.array([self.reference_spread, self.drift_limit]),
        }
        changes = {} if self.changes is None else self.changes.arrays()
        np.savez_compressed(path, **(parts | changes))  # type: ignore[arg-type]

    @classmethod
    @parser("novelty guard", CertificateError, max_bytes=MAX_ARRAY_BYTES)
    def load(cls, path: Path) -> NoveltyDetector:
        try:
            parts = read_arrays(path)
            _check(path, parts)
            neighbours = NeighbourModel(parts["thumbs"], parts["left"], parts["centre"], parts["axes"])
            reference = parts["reference"] if parts["reference"].size else None
            spread, limit = (float(v) for v in parts["drift"])
            changes = KnownChanges.of_arrays(parts)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(
                f"{path} is no guard ({e}); calibrate again", code=getattr(e, "code", "file-damaged")
            ) from e
        _ = neighbours.squares  # so that the first frame does not wait for them
        return cls(neighbours, parts["limits"], reference, spread, limit, changes)


def _check(path: Path, parts: Mapping[str, np.ndarray]) -> None:
    if "stray" in parts:
        raise CertificateError(
            f"{path} is a guard of an earlier palpate; calibrate again", code="guard-version"
        )
    thumbs, reference = parts["thumbs"], parts["reference"]
    fits = arrays_fit(thumbs, parts["left"], parts["centre"], parts["axes"])
    untouched = reference.size == 0 or reference.shape == thumbs.shape[1:]
    if not fits or not untouched or parts["limits"].shape != (2,):
        raise CertificateError(f"{path}: the guard's arrays do not fit each other; calibrate again")
    for name in ("left", "centre", "axes", "limits", "reference", "drift"):
        if parts[name].dtype.kind != "f" or not np.isfinite(parts[name]).all():
            raise CertificateError(f"{path}: the guard's {name} are not finite numbers; calibrate again")
    if min(*parts["limits"], *parts["drift"]) <= 0:
        raise CertificateError(f"{path}: the guard's limits are not above 0; calibrate again")


def fit_novelty_detector(
    thumbs: Thumbnails,
    folds: Sequence[Indices],
    untouched: Thumbnails,
    *,
    also: RenderedImages | None = None,
    seed: int = 0,
) -> NoveltyDetector:
    """Keep thumbnails, and set the limits from the novelty of frames relative to other folds.

    Args:
        thumbs: Thumbnails of every calibration frame.
        folds: Held-out rows of each fold, whole groups together.
        untouched: Thumbnails of no-contact frames; may be empty.
        also: Further good images, used if the detector then passes less.
        seed: Random seed of the draw of kept frames.
    """
    if len(thumbs) < 6:
        raise InputError(f"{len(thumbs)} frames are too few; record 6 or more", code="too-few-frames")
    fold = np.zeros(len(thumbs), np.int64)
    for k, rows in enumerate(folds):
        fold[rows] = k
    rng = np.random.default_rng(seed)
    rows_kept = _drawn(len(thumbs), rng)
    thumbs, fold = thumbs[rows_kept], fold[rows_kept]
    _, fold = np.unique(fold, return_inverse=True)
    if fold.max() == 0:
        raise InputError("all frames are of one group; record two or more", code="too-few-groups")
    thumbs_8bit = np.round(thumbs).astype(np.uint8)
    sets = [(thumbs_8bit, fold)]
    if also is not None:
        sets.append((np.concatenate([thumbs_8bit, also.thumbs]), _joint_folds(fold, also)))
    models = [
        fit_neighbours(images, [np.flatnonzero(dealt == k) for k in range(fold.max() + 1)], rng)
        for images, dealt in sets
    ]
    limits = [_limits(one.novelty_score[: len(thumbs_8bit)]) for one in models]
    lets_pass = [
        one.expected_residual[: len(thumbs_8bit)] * limit[0]
        for one, limit in zip(models, limits, strict=True)
    ]
    best = int(np.argmin([np.median(grey) for grey in lets_pass]))
    return NoveltyDetector(models[best].model, limits[best], *_untouched(untouched))


def kept_rows(count: int, seed: int = 0) -> Indices:
    """Return the rows whose thumbnails `fit_novelty_detector` keeps, in order."""
    return _drawn(count, np.random.default_rng(seed))


def _drawn(count: int, rng: np.random.Generator) -> Indices:
    if count <= MAX_KEPT:
        return np.arange(count)
    return np.sort(rng.choice(count, MAX_KEPT, replace=False))


def _joint_folds(fold: Indices, also: RenderedImages) -> Indices:
    """Folds of the recorded frames, then of the others by group."""
    _, group = np.unique(also.groups, return_inverse=True)
    return np.concatenate([fold, group % (fold.max() + 1)])


def _limits(novelty_score: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " 2"]:
    """Limits that refuse the stated ratio of frames, half by each number; at least 1."""
    each = np.quantile(novelty_score, 1 - FALSE_ALARMS / 2, axis=0)
    each = np.maximum(each, 1e-3)
    both = np.quantile(np.max(novelty_score / each, axis=1), 1 - FALSE_ALARMS, method="higher")
    return np.asarray(np.maximum(each * both, 1.0))


def _untouched(untouched: Thumbnails) -> tuple[np.ndarray | None, float, float]:
    """Mean no-contact thumbnail, its spread, and the limit: 1.5 times the widest."""
    r = len(untouched)
    if r == 0:
        return None, MIN_DRIFT_SPREAD_GREY_LEVELS, MAX_DRIFT_OF_FEW
    mean = untouched.mean(axis=0)
    # With r frames the mean follows each of them; r / (r - 1) undoes that.
    moved = np.sqrt(np.mean((untouched - mean) ** 2, axis=1)) * (r / (r - 1) if r > 1 else 1.0)
    spread = max(float(np.median(moved)), MIN_DRIFT_SPREAD_GREY_LEVELS)
    widest = 1.5 * max(float(moved.max()) / spread, 1.0)
    return mean, spread, widest if r >= FEW_REFERENCES else max(widest, MAX_DRIFT_OF_FEW)


@dataclass(frozen=True, slots=True)
class CopyDiscriminator:
    """Discriminator of sensor units.

    Attributes:
        axis: Weights of flat thumbnails ``[k]`` [per gray level].
        limit: Position beyond which an image is assigned to the former unit.
    """

    axis: Float[np.ndarray, " k"]
    offset: float
    limit: float

    def place(self, prepared: Prepared) -> float:
        """Return an image's position on the axis: 0 for this unit's mean, 1 for the former's."""
        return float(np.dot(self.axis, thumbnail(prepared).ravel())) - self.offset

    def is_of_former(self, prepared: Prepared) -> bool:
        """Return whether the image resembles the former unit's."""
        return self.place(prepared) > self.limit

    def save(self, path: Path) -> None:
        np.savez_compressed(path, axis=self.axis, offset=self.offset, limit=self.limit)

    @classmethod
    @parser("copy discriminator", CertificateError, max_bytes=MAX_ARRAY_BYTES)
    def load(cls, path: Path, size: int) -> CopyDiscriminator:
        """Read what `save` wrote, for thumbnails of `size` values."""
        try:
            arrays = read_arrays(path)
            axis, offset, limit = (arrays[name] for name in ("axis", "offset", "limit"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(
                f"{path} tells no copies apart ({e}); adapt again", code="file-damaged"
            ) from e
        numbers = np.concatenate([axis.ravel(), offset.ravel(), limit.ravel()])
        if axis.shape != (size,) or numbers.dtype != np.float64 or not np.isfinite(numbers).all():
            raise CertificateError(
                f"{path} does not fit the calibration's thumbnails; adapt again", code="file-misfit"
            )
        return cls(axis, float(offset), float(limit))
