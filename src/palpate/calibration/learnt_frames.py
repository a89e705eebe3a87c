"""Train/test overlap of a run with a calibration, by the thumbnails that its guard keeps.

Recompressed copies lie within 0.6 of a kept frame's distance to the next. A simulation repeated with the same
seed gives the same presses with other noise, which is tested for simulated runs alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.calibration.coverage.counted_groups import press_groups
from palpate.core import Float, Indices, Shaped, Values
from palpate.estimators.certified import Estimator, checked_file
from palpate.estimators.guard import NoveltyDetector, thumbnail
from palpate.recordings import Run

MAX_ASKED = 400  # compared frames of a run, evenly spaced
MIN_EQUAL, MAX_EQUAL = 2, 0.05  # number and ratio of frames with kept thumbnails, above which it overlaps
MIN_NEAR, MAX_NEAR = 30, 0.75  # number and ratio of frames near a kept one, above which they are copies
NEAR = 0.6  # distance over the kept one's distance to the next kept one
MIN_REPEATED, MAX_REPEATED = 10, 0.75  # simulated presses, and ratio of repeated ones
REPEATED = 0.3  # distance to a kept frame over that to the run's other presses
REPEATED_NOISE = 2.0  # distance over the median distance within a press
SAY_NOTHING = "these scores say nothing about new presses"


@dataclass(frozen=True)
class LearntFrames:
    """Overlap of a run with the training data of a calibration.

    Attributes:
        compared: number of touch frames compared.
        equal: frames whose thumbnails are kept ones to the last digit.
        presses, repeated: a simulated run's presses, and those trained on with other noise.
        why: why the run tests nothing new; empty where it does.
    """

    compared: int = 0
    equal: int = 0
    presses: int = 0
    repeated: int = 0
    why: str = ""


def find_learnt_frames(estimator: Estimator, run: Run, rows: Indices) -> LearntFrames:
    """Compare a run's touch frames `rows` with those that a calibration's guard keeps."""
    card = estimator.card
    kept = NoveltyDetector.load(checked_file(estimator.folder, card.guard)).neighbours.thumbs
    asked = np.asarray(rows)[np.unique(np.linspace(0, len(rows) - 1, min(MAX_ASKED, len(rows))).astype(int))]
    images = ((int(row), run.frame(int(row)).image) for row in asked)
    seen = {
        row: np.round(thumbnail(card.input.preparation.apply(image))).ravel()
        for row, image in images
        if image.shape[:2] == card.input.frame_px
    }
    if len(seen) < 2 or len(kept) < 2:
        return LearntFrames(len(seen))
    thumbs, known = np.array(list(seen.values()), float), kept.reshape(len(kept), -1).astype(float)
    presses = repeated = 0
    if card.is_simulated and run.manifest.is_simulated:
        groups = press_groups(run.labels)[list(seen)]
        presses, repeated = repeated_presses(thumbs, groups, known, len(run) / max(card.run.frames, 1))
    equal, near = shares_of_copies(thumbs, known)
    found = round(equal * len(seen))
    expected = min(1.0, len(kept) / max(card.run.frames, 1))  # of a run whose thumbnails were drawn from
    why = ""
    if found >= MIN_EQUAL and equal > MAX_EQUAL * expected:
        why = (
            f"{found} of {len(seen)} frames of touches are, as far as thumbnails tell, frames that the "
            f"calibration has learnt from: {SAY_NOTHING}"
        )
    elif presses >= MIN_REPEATED and repeated > MAX_REPEATED * presses:
        why = (
            f"{repeated} of {presses} presses are ones that the calibration has learnt from, simulated again "
            f"with other noise: {SAY_NOTHING}"
        )
    elif near > MAX_NEAR and len(seen) >= MIN_NEAR:
        why = (
            f"{100 * near:.0f} % of its frames are altered copies, such as compressed ones, of frames that "
            "the calibration has learnt from"
        )
    return LearntFrames(len(seen), found, presses, repeated, why)


def shares_of_copies(thumbs: Float[np.ndarray, "n k"], kept: Float[np.ndarray, "m k"]) -> tuple[float, float]:
    """Return the ratios of frames that are kept ones, and that are much nearer to one than it is to the next.

    Args:
        thumbs, kept: flat, in whole grey levels.
    """
    nearest = _squares(thumbs, kept).argmin(axis=1)
    apart = np.sqrt(np.mean((thumbs - kept[nearest]) ** 2, axis=1))
    among = _squares(kept[nearest], kept)
    among[np.arange(len(nearest)), nearest] = np.inf
    gap = np.sqrt(np.maximum(among.min(axis=1), 0.0) / thumbs.shape[1])
    told = gap > 1e-3  # else the kept frame has a twin of its own
    return float(np.mean(told & (apart == 0))), float(np.mean(told & (apart <= NEAR * gap)))


def repeated_presses(
    thumbs: Float[np.ndarray, "n k"],
    groups: Shaped[np.ndarray, " n"],
    kept: Float[np.ndarray, "m k"],
    share: float,
) -> tuple[int, int]:
    """Return the number of presses, and of those whose frames are kept ones but for noise.

    Args:
        thumbs, kept: flat, in whole grey levels.
        groups: press of each.
        share: frames of the run over those trained on: the nearest of more kept ones is nearer by chance.
    """
    presses = np.unique(groups)
    same, among = groups[:, None] == groups, np.maximum(_squares(thumbs, thumbs), 0.0)
    np.fill_diagonal(among, np.inf)
    own, others = (np.sqrt(np.where(one, among, np.inf).min(axis=1)) for one in (same, ~same))
    nearest = np.sqrt(np.maximum(_squares(thumbs, kept).min(axis=1), 0.0))
    if len(presses) < 2 or not np.isfinite(own).any():
        return len(presses), 0
    noise = np.median(own[np.isfinite(own)])
    near = (nearest < REPEATED * min(1.0, share) * others) & (nearest <= REPEATED_NOISE * noise)
    return len(presses), sum(bool(near[groups == one].mean() > 0.5) for one in presses)


def _squares(a: Float[np.ndarray, "n k"], b: Float[np.ndarray, "m k"]) -> Values:
    squares: Values = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return squares
