"""The guard: is this image of the kind the estimator was calibrated on, and has the sensor drifted?

How strange an image is, `seen` says by two numbers. Each has a limit, and both limits together are such that
a stated share of the calibration's frames, each held against other groups, would have been turned away.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core.errors import CertificateError, InputError
from palpate.core.reading import Drift
from palpate.core.shapes import Float, Indices
from palpate.estimators.seen import (
    AlsoSeen,
    Prepared,
    Seen,
    Thumbnail,
    Thumbnails,
    belong_together,
    learn,
    thumbnail,
    thumbnails,
)

__all__ = ["Guard", "fit_guard", "thumbnails"]

FLOOR_GREY_LEVELS = 0.5
"""Two averages of one scene never agree better than this, whatever a few references suggest."""

FEW_REFERENCES = 5
DRIFT_LIMIT_OF_FEW = 3.0
"""Fewer no-contact frames than five say little of how far such frames wander: three times their spread."""


@dataclass(frozen=True, slots=True)
class Guard:
    """Judges images against what a calibration saw.

    Attributes:
        seen: the calibration's thumbnails.
        limits: of the two numbers of `Seen.strangeness`.
        reference: mean thumbnail of the untouched sensor ``[h w c]``; None where none was recorded.
        reference_spread: how far its own no-contact thumbnails lie from their mean [grey levels, rms].
        drift_limit: the drift statistic above which the calibration is stale.
    """

    seen: Seen
    limits: Float[np.ndarray, " 2"]
    reference: Thumbnail | None
    reference_spread: float
    drift_limit: float

    def atypicality(self, prepared: Prepared) -> float:
        """How far the image is from all that was calibrated on; beyond 1 it should not be trusted."""
        return float(np.max(self.seen.strangeness(thumbnail(prepared)) / self.limits))

    def drift(self, untouched: Prepared) -> Drift | None:
        """How far the untouched sensor has moved since calibration; None where that had no view of it."""
        if self.reference is None:
            return None
        moved = np.sqrt(np.mean((thumbnail(untouched) - self.reference) ** 2))
        return Drift(float(moved / self.reference_spread), self.drift_limit)

    def save(self, path: Path) -> None:
        """Write the guard as plain arrays."""
        absent = np.empty(0, np.float32)
        np.savez_compressed(
            path,
            thumbs=self.seen.thumbs,
            left=self.seen.left,
            centre=self.seen.centre,
            axes=self.seen.axes,
            limits=self.limits,
            reference=absent if self.reference is None else self.reference,
            drift=np.array([self.reference_spread, self.drift_limit]),
        )

    @classmethod
    def load(cls, path: Path) -> Guard:
        """Read a guard that `save` wrote.

        Raises:
            CertificateError: the file is not one, or of the kind before decision 0010.
        """
        try:
            # Opened here, since numpy leaves a file that is no archive to the garbage collector.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
                parts = {name: held[name] for name in held.files}
            _check(path, parts)
            seen = Seen(parts["thumbs"], parts["left"], parts["centre"], parts["axes"])
            reference = parts["reference"] if parts["reference"].size else None
            spread, limit = (float(v) for v in parts["drift"])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(f"{path} is not a guard that palpate wrote ({e}); calibrate again") from e
        _ = seen.squares  # so that the first frame does not wait for them
        return cls(seen, parts["limits"], reference, spread, limit)


def _check(path: Path, parts: Mapping[str, np.ndarray]) -> None:
    if "stray" in parts:
        raise CertificateError(
            f"{path} is of a calibration by an earlier palpate, whose guard let two touches at once pass; "
            "calibrate again"
        )
    thumbs, reference = parts["thumbs"], parts["reference"]
    fits = belong_together(thumbs, parts["left"], parts["centre"], parts["axes"])
    untouched = reference.size == 0 or reference.shape == thumbs.shape[1:]
    if not fits or not untouched or parts["limits"].shape != (2,):
        raise CertificateError(f"{path}: the guard's arrays do not fit each other; calibrate again")


def fit_guard(
    thumbs: Thumbnails,
    folds: Sequence[Indices],
    untouched: Thumbnails,
    *,
    also: AlsoSeen | None = None,
    false_alarms: float = 0.03,
    most: int = 2000,
    seed: int = 0,
) -> Guard:
    """Keep thumbnails, and set the limits from how strange frames look to those of other folds.

    Args:
        thumbs: of every calibration frame.
        folds: held-out rows of each fold, whole groups together.
        untouched: thumbnails of the no-contact frames; may be empty.
        also: images known to be good besides. The limits are set by recorded frames alone, and where these
            are too unlike the others, a guard without the others lets less pass, and is taken.
        false_alarms: share of good frames that may be turned away.
        most: recorded frames kept, at most.
        seed: of the draw when there are more.

    Raises:
        InputError: fewer than six frames, or fewer than two folds.
    """
    if len(thumbs) < 6:
        raise InputError(f"{len(thumbs)} frames are too few to learn what frames look like; record 6 or more")
    fold = np.zeros(len(thumbs), np.int64)
    for k, held in enumerate(folds):
        fold[held] = k
    rng = np.random.default_rng(seed)
    if len(thumbs) > most:
        drawn = np.sort(rng.choice(len(thumbs), most, replace=False))
        thumbs, fold = thumbs[drawn], fold[drawn]
    _, fold = np.unique(fold, return_inverse=True)
    if fold.max() == 0:
        raise InputError(
            "all frames are of one group; what new ones look like shows in others: record two or more"
        )
    kept = np.round(thumbs).astype(np.uint8)
    known = [(kept, fold)]
    if also is not None:
        known.append((np.concatenate([kept, also.thumbs]), _dealt(fold, also)))
    learnt = [learn(images, _rows_of(dealt), rng) for images, dealt in known]
    limits = [_limits(one.strangeness[: len(kept)], false_alarms) for one in learnt]
    lets_pass = [one.usual[: len(kept)] * limit[0] for one, limit in zip(learnt, limits, strict=True)]
    best = int(np.argmin([np.median(grey) for grey in lets_pass]))
    return Guard(learnt[best].seen, limits[best], *_untouched(untouched))


def _rows_of(fold: Indices) -> list[Indices]:
    return [np.flatnonzero(fold == k) for k in range(fold.max() + 1)]


def _dealt(fold: Indices, also: AlsoSeen) -> Indices:
    """The recorded frames' folds, then those of the others, whose groups are dealt out to the same folds."""
    _, group = np.unique(also.groups, return_inverse=True)
    return np.concatenate([fold, group % (fold.max() + 1)])


def _limits(strangeness: Float[np.ndarray, "n 2"], false_alarms: float) -> Float[np.ndarray, " 2"]:
    """Limits that so many are beyond, of one or the other, each by itself of half as many.

    Never below 1: what leaves no more than its neighbours did is not strange.
    """
    each = np.quantile(strangeness, 1 - false_alarms / 2, axis=0)
    each = np.maximum(each, 1e-3)
    both = np.quantile(np.max(strangeness / each, axis=1), 1 - false_alarms, method="higher")
    return np.asarray(np.maximum(each * both, 1.0))


def _untouched(untouched: Thumbnails) -> tuple[np.ndarray | None, float, float]:
    """Mean no-contact thumbnail, the spread around it, and the limit: half as far again as the widest."""
    r = len(untouched)
    if r == 0:
        return None, FLOOR_GREY_LEVELS, DRIFT_LIMIT_OF_FEW
    mean = untouched.mean(axis=0)
    # With r frames the mean follows each of them; r / (r - 1) undoes that.
    moved = np.sqrt(np.mean((untouched - mean) ** 2, axis=1)) * (r / (r - 1) if r > 1 else 1.0)
    spread = max(float(np.median(moved)), FLOOR_GREY_LEVELS)
    widest = 1.5 * max(float(moved.max()) / spread, 1.0)
    return mean, spread, widest if r >= FEW_REFERENCES else max(widest, DRIFT_LIMIT_OF_FEW)
