"""Near-duplicate frames after gain, noise, or a small shift, in any temporal order.

In a cloud of D dimensions the neighbor distances r₁ < r₂ < … have P(r₍ₖ₊₁₎/rₖ > x) = x^(−kD) (E. Facco et
al., Sci. Rep. 7, 12140 (2017), doi:10.1038/s41598-017-11873-y); D is taken from the fifth to eighth
neighbors. Equal labels add evidence as far as they are rare.

Train/test overlap of a run with a calibration, by the thumbnails that its guard keeps.

Recompressed copies lie within 0.6 of a kept frame's distance to the next. A simulation repeated with the same
seed gives the same presses with other noise, which is tested for simulated runs alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.neighbors import NearestNeighbors

from palpate.calibration.coverage.grouped_rates import press_groups
from palpate.core import Float, Float32, Indices, Int, Shaped, Values
from palpate.estimators.certified import Estimator, checked_file
from palpate.estimators.guard import NoveltyDetector, thumbnail
from palpate.recordings import Run

NEIGHBOURS = 8  # frames compared in detail with a held-out one
CLOSE = 3  # nearest neighbors that may be copies; the others state what is usual
LONE_RATIO, LONE_CHANCE = 6.0, 0.05
MIN_RATIO = 3.0  # least ratio of the next frame's distance to a copy's
MIN_RATIO_OF_EQUALS = 1.5  # the same with equal labels that are rare
MAX_EQUAL = 0.01  # ratio of other neighbors with equal labels, above which these are no evidence
RATE = 0.005  # expected false discovery rate (Benjamini and Hochberg)
GAINS = (0.6, 1.6)
MAX_OFFSET = 2.0  # offset by clipped noise; more may be a deeper touch [grey levels]
FLOOR = 0.05  # distance below which small 8-bit pictures are equal [grey levels]
MARGIN = 0.06  # ratio of the longer side left out at the border, for shifts
MIN_FRAMES = 40
MAX_DIMENSIONS = 4.0  # presses at different positions are equally far apart, as in many dimensions


@dataclass(frozen=True)
class NearCopies:
    """Held-out rows with an altered copy among the trained rows.

    Attributes:
        held, twin: the rows, and the copy of each.
        dimensions: D of the cloud of frames.
        lone: held-out rows with a neighbor at least six times nearer than the next, beyond chance.
    """

    held: Int[np.ndarray, " m"]
    twin: Int[np.ndarray, " m"]
    dimensions: float
    lone: Int[np.ndarray, " l"]


def find_near_copies(
    small: Float32[np.ndarray, "n h w"],
    sides: Sequence[tuple[Indices, Indices]],
    most_shift: float,
    labels: Values | None = None,
) -> NearCopies:
    """Find held-out frames that are altered copies of trained ones.

    Args:
        small: area means of every frame [grey levels].
        sides: for each fold, rows held out and rows trained on, without no-contact rows.
        most_shift: largest shift [px of the small images].
        labels: of every frame ``[n k]``.
    """
    nothing = np.empty(0, np.int64)
    held, others, apart = [], [], []
    for queries, trained in sides:
        if len(queries) and len(trained) > NEIGHBOURS:
            near, distances = _neighbours(small, queries, trained, most_shift, labels)
            held.append(queries)
            others.append(near)
            apart.append(distances)
    if not held or sum(map(len, held)) < MIN_FRAMES:
        return NearCopies(nothing, nothing, float("nan"), nothing)
    rows, near, distances = map(np.concatenate, (held, others, apart))
    steps = np.log(distances[:, 1:] / distances[:, :-1]) * np.arange(1, NEIGHBOURS)
    dimensions = _dimensions(steps[:, CLOSE + 1 :], distances)
    close = steps[:, :CLOSE]
    place = close.argmax(axis=1)
    jump = close[np.arange(len(rows)), place]
    chance = 1 - (1 - np.exp(-dimensions * np.maximum(jump, 0))) ** CLOSE
    ratio = np.exp(jump / (place + 1))
    least = np.full(len(rows), MIN_RATIO)
    if labels is not None and labels.shape[1]:
        equal = (labels[near] == labels[rows][:, None]).all(axis=2)
        by_chance = (1 + equal[:, 1:].sum()) / (1 + equal[:, 1:].size)
        chance = np.where(equal[:, 0], chance * by_chance, chance)
        least = np.where(equal[:, 0] & (by_chance <= MAX_EQUAL), MIN_RATIO_OF_EQUALS, MIN_RATIO)
    found = _significant(np.where(ratio >= least, chance, 1.0))
    return NearCopies(
        rows[found], near[found, 0], dimensions, rows[(ratio >= LONE_RATIO) & (chance <= LONE_CHANCE)]
    )


def _neighbours(
    small: Float32[np.ndarray, "n h w"],
    queries: Indices,
    trained: Indices,
    most_shift: float,
    labels: Values | None,
) -> tuple[Int[np.ndarray, "q k"], Float[np.ndarray, "q k"]]:
    flat = small.reshape(len(small), -1)
    even = flat - flat.mean(axis=1, keepdims=True)
    even = even / np.maximum(np.linalg.norm(even, axis=1, keepdims=True), 1e-6)
    search = NearestNeighbors(n_neighbors=NEIGHBOURS, algorithm="brute").fit(even[trained])
    near = trained[search.kneighbors(even[queries], return_distance=False)]
    if labels is not None and labels.shape[1]:
        near = _with_equals(near, queries, trained, labels)
    distances = np.concatenate(
        [
            _aligned_distance(small[queries[part]], small[near[part]], most_shift)
            for part in np.array_split(np.arange(len(queries)), 1 + len(queries) // 64)
        ]
    )
    order = np.argsort(distances, axis=1, kind="stable")
    return np.take_along_axis(near, order, axis=1), np.take_along_axis(distances, order, axis=1)


def _with_equals(
    near: Int[np.ndarray, "q k"], queries: Indices, trained: Indices, labels: Values
) -> Int[np.ndarray, "q k"]:
    """The same, with a frame of equal labels for the last where none is among them: a shift may hide it."""
    equal = {labels[row].tobytes(): row for row in trained}
    for place, query in enumerate(queries):
        twin = equal.get(labels[query].tobytes())
        if twin is not None and twin not in near[place]:
            near[place, -1] = twin
    return near


def _aligned_distance(
    frames: Float32[np.ndarray, "q h w"], others: Float32[np.ndarray, "q k h w"], most_shift: float
) -> Float[np.ndarray, "q k"]:
    """RMS difference of frames after gain, offset, and shift of the other (Taylor series to second order)."""
    down, across = np.gradient(others, axis=(2, 3))
    (down_down, down_across), across_across = np.gradient(down, axis=(2, 3)), np.gradient(across, axis=3)
    terms = (others, np.ones_like(others), across, down, across_across, down_across, down_down)
    inner = _inner(frames.shape[1:])
    columns = np.stack([term[:, :, *inner] for term in terms], axis=2)
    columns = columns.reshape(*others.shape[:2], len(terms), -1)
    asked = frames[:, *inner].reshape(len(frames), 1, -1)
    wanted = np.broadcast_to(asked, (*others.shape[:2], asked.shape[2]))
    products = columns @ columns.transpose(0, 1, 3, 2)
    sizes = np.trace(products, axis1=2, axis2=3)[..., None, None]
    products = products + 1e-7 * sizes * np.eye(len(terms), dtype=np.float32)
    factors = np.linalg.solve(products, columns @ wanted[..., None])
    left = np.sqrt(np.mean((wanted - (factors.transpose(0, 1, 3, 2) @ columns)[:, :, 0]) ** 2, axis=2))
    plain = np.sqrt(np.mean((wanted - columns[:, :, 0]) ** 2, axis=2))
    gain, offset, shift = factors[..., 0, 0], factors[..., 1, 0], factors[..., 2:4, 0]
    bends, scale = np.abs(factors[..., 4:, 0]).max(axis=-1), np.maximum(np.abs(gain), 1e-6)
    # How far the alignment goes beyond what a copy needs, in units of its limits: the likeness of frames of
    # one series fades there, since one that ended abruptly would set a neighbour apart as copies are.
    beyond = np.max(
        [
            np.abs(gain - np.mean(GAINS)) / (np.ptp(GAINS) / 2),
            np.abs(offset) / MAX_OFFSET,
            bends / (most_shift**2 * scale),
            np.abs(shift).max(axis=-1) / (most_shift * scale),
        ],
        axis=0,
    )
    fading = np.clip(beyond - 1, 0.0, 1.0)
    return np.maximum(left + fading * (plain - left), FLOOR).astype(np.float64)


def _inner(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """The part of a small picture that its border has no share in; all of one that is very small."""
    margin = round(MARGIN * max(shape))
    return tuple(slice(margin, side - margin) if side > 4 * margin else slice(None) for side in shape)


def _dimensions(steps: Float[np.ndarray, "q s"], distances: Float[np.ndarray, "q k"]) -> float:
    """D by the median of k ln(r₍ₖ₊₁₎/rₖ), which is ln 2 / D; the lower of all rows and the sparser half."""
    sparse = distances[:, CLOSE + 1] >= np.median(distances[:, CLOSE + 1])
    medians = max(float(np.median(steps)), float(np.median(steps[sparse])))
    return float(min(np.log(2) / max(medians, 1e-3), MAX_DIMENSIONS))


def _significant(chances: Float[np.ndarray, " q"]) -> Int[np.ndarray, " m"]:
    order = np.argsort(chances, kind="stable")
    passed = chances[order] <= RATE * np.arange(1, len(chances) + 1) / len(chances)
    count = int(np.flatnonzero(passed).max(initial=-1)) + 1
    return np.sort(order[:count])


MAX_ASKED = 400  # compared frames of a run, evenly spaced
MIN_EQUAL_FRAMES, MAX_EQUAL_SHARE = (
    2,
    0.05,
)  # number and ratio of frames with kept thumbnails, above which it overlaps
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
    if found >= MIN_EQUAL_FRAMES and equal > MAX_EQUAL_SHARE * expected:
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
