"""Control model: prediction of the labels from the part of the picture outside the skin.

A prediction there indicates drift of the lamp with ordered labels, labels burnt into the picture, or light
that a press spreads to the rim, which predicts less than the skin does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.confounds.kernel_regression import Kernels, explained_share
from palpate.calibration.confounds.skin_region import SkinRegion
from palpate.core import Bool, Float, Float32, Indices, Int, Values

ASKED_FURTHER = 0.1  # R² of the outside from which skin and far regions are tested
CELLS = 8  # cells along the picture's longer side
FAR = 4  # cells, beyond which an equally predictive location is no part of the same text
ALIKE = 1e-4  # difference of unexplained variance ratios that counts as equal
COMPONENTS = 12
CELL_PENALTIES = np.logspace(-6, 0, 4)


@dataclass(frozen=True)
class OutsideControl:
    """Held-out R² of each label ``[t]`` by regressions on parts of the picture.

    Attributes:
        folds, blocks: outside, on the calibration's folds and on short interleaved blocks.
        far: a tenth of the picture away from the skin; −inf where there is nothing.
        inside: skin, on the calibration's folds.
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
        values: labels ``[n t]``.
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
    """Single location that predicts a label where its surroundings do not.

    Attributes:
        box: (x, y, width, height) [px of the small picture].
        share: its held-out R².
        around: R² two cells away (median), or elsewhere apart from the skin (maximum).
    """

    box: tuple[int, int, int, int]
    share: float
    around: float


def telling_cells(
    images: Float32[np.ndarray, "n h w c"], region: SkinRegion, values: Values, folds: Sequence[Indices]
) -> list[TellingCell | None]:
    """Return for each label the location outside the skin, or at the border, that predicts it best.

    Args:
        images: small pictures [grey levels].
        values: labels ``[n t]``.
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
    """Cell that stands out most from two cells away and from others as far out.

    `apart` is 0 for cells of the skin, and larger the farther they lie from it.
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
