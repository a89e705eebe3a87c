"""Control model: what the part of the picture that is no skin predicts of the labels.

It should predict nothing. Where it does, it shows the clock (a lamp that drifts while labels are taken in
order), the label itself (a text burnt into the picture), or light that a press spreads to the rim, which
predicts less than the skin does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.confounds.kernel_regression import Kernels, explained_share
from palpate.calibration.confounds.skin_region import SkinRegion
from palpate.core import Bool, Float, Float32, Indices, Int, Values

ASKED_FURTHER = 0.1
"""R² of the outside from which it is asked what the skin tells, and what lies far from it."""
CELLS = 8
"""Cells along the picture's longer side that are asked one by one."""
FAR = 4
"""Cells from a place, beyond which another that tells as much is no part of the same text."""
ALIKE = 1e-4
"""Share of the variance left by which two places are not told apart."""
COMPONENTS = 12
CELL_PENALTIES = np.logspace(-6, 0, 4)


@dataclass(frozen=True)
class OutsideControl:
    """Held-out R² of each label ``[t]`` by regressions on parts of the picture.

    Attributes:
        folds, blocks: of the outside, on the folds of the calibration and on short interleaved blocks.
        far: of what lies a tenth of the picture away from the skin; −inf where nothing does.
        inside: of the skin, on the folds of the calibration.
    """

    folds: Float[np.ndarray, " t"]
    blocks: Float[np.ndarray, " t"]
    far: Float[np.ndarray, " t"]
    inside: Float[np.ndarray, " t"]


def outside_control(
    images: Float32[np.ndarray, "n h w c"],
    region: SkinRegion,
    values: Values,
    folds: Sequence[Indices],
    blocks: Sequence[Indices],
) -> OutsideControl:
    """Regress every label on the outside, and on the skin.

    Args:
        images: small pictures [grey levels].
        region: of the skin in them.
        values: ``[n t]``.
        folds, blocks: of the calibration, and interleaved; in rows of `images`.
    """

    def told(mask: Bool[np.ndarray, "h w"], parts: Sequence[Sequence[Indices]]) -> list[np.ndarray]:
        kernels = Kernels.of(images[:, mask].reshape(len(images), -1))
        return [explained_share(values, kernels.held_out(values, part)) for part in parts]

    by_folds, by_blocks = told(region.outside, (folds, blocks))
    nothing = np.full(values.shape[1], -np.inf)
    if by_folds.max() < ASKED_FURTHER:
        return OutsideControl(by_folds, by_blocks, nothing, nothing)
    far = region.far_outside
    return OutsideControl(
        by_folds,
        by_blocks,
        told(far, (folds,))[0] if far.any() else nothing,
        told(region.inside, (folds,))[0],
    )


@dataclass(frozen=True, slots=True)
class TellingCell:
    """A place by itself that tells a label, where the places around it do not.

    Attributes:
        box: (x, y, width, height) [px of the small picture].
        share: R², held out, of what it tells.
        around: the same two cells away (the median), or elsewhere apart from the skin (the most).
    """

    box: tuple[int, int, int, int]
    share: float
    around: float


def telling_cells(
    images: Float32[np.ndarray, "n h w c"], region: SkinRegion, values: Values, folds: Sequence[Indices]
) -> list[TellingCell | None]:
    """For each label the location outside the skin, or at the border, that predicts it best by itself.

    Args:
        images: small pictures [grey levels].
        region: of the skin in them.
        values: ``[n t]``.
        folds: in rows of `images`.
    """
    down, across = _edges(images.shape[1:3])
    rows, columns = len(down) - 1, len(across) - 1
    inside = np.sort(np.concatenate(list(folds)))
    parts = [(fold, np.setdiff1d(inside, fold)) for fold in folds]
    shares = np.zeros((rows, columns, values.shape[1]))
    border, near, far = 1, 2, 3
    apart = np.zeros((rows, columns), dtype=np.int64)
    far_outside = region.far_outside
    for i in range(rows):
        for j in range(columns):
            block = np.s_[down[i] : down[i + 1], across[j] : across[j + 1]]
            frames, beyond = images[:, block[0], block[1]], region.outside[block]
            if beyond.mean() > 0.5:
                apart[i, j] = far if far_outside[block].mean() > 0.5 else near
                frames = frames[:, beyond]  # the skin in the cell's other half may tell what it likes
            elif i in (0, rows - 1) or j in (0, columns - 1):
                apart[i, j] = border
            shares[i, j] = explained_share(values, _linear(frames.reshape(len(frames), -1), values, parts))
    return [_best(shares[..., t], apart, down, across) for t in range(values.shape[1])]


def _edges(shape: tuple[int, ...]) -> tuple[Int[np.ndarray, " y"], Int[np.ndarray, " x"]]:
    side = max(shape) / CELLS
    counts = [max(1, round(length / side)) for length in shape]
    down, across = (np.linspace(0, n, k + 1).round().astype(int) for n, k in zip(shape, counts, strict=True))
    return down, across


def _best(
    shares: Float[np.ndarray, "y x"],
    apart: Int[np.ndarray, "y x"],
    down: Int[np.ndarray, " d"],
    across: Int[np.ndarray, " a"],
) -> TellingCell | None:
    """The cell that stands out most from what two cells away, and others as far out, predict.

    Light that a press spreads is found all along the rim; a text in one location. `apart` is 0 for cells of
    the skin, and larger the farther they lie from it.
    """
    best, contrast = None, -np.inf
    for i, j in np.argwhere(apart).tolist():
        distance = _distance(shares.shape, i, j)
        elsewhere = shares[(apart >= apart[i, j]) & (distance >= FAR)]
        around = max(float(np.median(shares[distance == 2])), float(elsewhere.max(initial=0.0)), 0.0)
        stands_out = float(np.log((1 - around + ALIKE) / (1 - shares[i, j] + ALIKE)))
        if stands_out > contrast:
            box = (across[j], down[i], across[j + 1] - across[j], down[i + 1] - down[i])
            contrast = stands_out
            best = TellingCell(tuple(map(int, box)), float(shares[i, j]), around)  # type: ignore[arg-type]
    return best


def _distance(shape: tuple[int, ...], i: int, j: int) -> Int[np.ndarray, "y x"]:
    rows, columns = np.indices(shape)
    return np.maximum(np.abs(rows - i), np.abs(columns - j))


def _linear(
    cell: Float32[np.ndarray, "n p"], values: Values, parts: Sequence[tuple[Indices, Indices]]
) -> Values:
    """Held-out estimates by ridge regression on a cell's main components; the best of a few penalties."""
    centred = (cell - cell.mean(axis=0)).astype(np.float64)
    vectors, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    if not sizes[0] > 0:
        return np.broadcast_to(values.mean(axis=0), values.shape)
    scores = (vectors * (sizes / sizes[0]))[:, :COMPONENTS] * np.sqrt(len(cell))
    penalties = (CELL_PENALTIES * len(cell))[:, None, None] * np.eye(scores.shape[1])
    guess = np.full((len(penalties), *values.shape), np.nan)
    for fold, learnt in parts:
        mean, x = values[learnt].mean(axis=0), scores[learnt]
        weights = np.linalg.solve(x.T @ x + penalties, x.T @ (values[learnt] - mean))
        guess[:, fold] = mean + scores[fold] @ weights
    least = np.nanmean((guess - values) ** 2, axis=1).argmin(axis=0)
    return np.take_along_axis(guess, least[None, None], axis=0)[0]
