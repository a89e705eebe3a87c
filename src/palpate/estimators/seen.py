"""What a calibration saw, and how far a new image lies from what is between those images.

A thumbnail of the image is made again from the calibration's nearest ones, as their mean with weights that
are not negative: so places between those recorded are known as well, and two touches at once are not, since a
mean of one touch here and one there shows half of each. What is left over is held, block by block, against
what was left of those nearest ones when their own groups were held out: little near the untouched skin, much
under a deep press. That is the idea of the local outlier factor (Breunig et al., SIGMOD 2000,
doi:10.1145/335191.335388); weights that rebuild a point from its neighbours are those of locally linear
embedding (Roweis and Saul, Science 2000, doi:10.1126/science.290.5500.2323), here without negative ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol, runtime_checkable

import cv2
import numpy as np
from scipy.optimize import nnls

from palpate.core.shapes import Float, Float16, Float32, Indices, Int, UInt8

THUMBNAIL_VALUES = 1024
"""A thumbnail holds about this many values, in one channel or in three."""

BLOCK = 3  # cells of a thumbnail along each side of a block
NEIGHBOURS = 24
AXES = 48  # principal axes along which neighbours are searched for
ROWS_FOR_AXES = 3000
RIDGE = 0.01  # of the neighbours' mean squared distance, so that near twins share their weight
FLOOR_GREY_LEVELS = 0.05
"""Means over a block never agree better than this: thumbnails are kept in whole grey levels."""

Prepared = UInt8[np.ndarray, "_ _ c"]
Thumbnail = Float32[np.ndarray, "h w c"]
Thumbnails = Float32[np.ndarray, "_ h w c"]
Kept = UInt8[np.ndarray, "_ h w c"]


def thumbnail(prepared: Prepared) -> Float32[np.ndarray, "h w c"]:
    """Area means of a prepared image, about as many values whatever its size and channels, grey levels."""
    height, width, channels = prepared.shape
    shrink = min(1.0, math.sqrt(THUMBNAIL_VALUES / prepared.size))
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    small = cv2.resize(prepared, size, interpolation=cv2.INTER_AREA)
    return small.reshape(size[1], size[0], channels).astype(np.float32)


def thumbnails(images: Iterable[Prepared]) -> Thumbnails:
    """Thumbnails of many prepared images of one size."""
    return np.stack([thumbnail(image) for image in images])


@dataclass(frozen=True)
class Seen:
    """The calibration's thumbnails, and what was left of each when it was rebuilt from other groups.

    Attributes:
        thumbs: in whole grey levels.
        left: squared means of what was left, over blocks and then over all of each channel ``[n m]``.
        centre, axes: of the space that neighbours are searched in ``[k]``, ``[k a]``.
    """

    thumbs: Kept
    left: Float16[np.ndarray, "n m"]
    centre: Float32[np.ndarray, " k"]
    axes: Float32[np.ndarray, "k a"]

    def strangeness(self, thumb: Thumbnail) -> Float[np.ndarray, " 2"]:
        """What is left of a thumbnail, over what was left of its neighbours: of its blocks, of its level.

        The first is the root mean square over blocks of the mean of all channels. The second is the largest
        over the channels, each as a whole: light that is brighter, darker or of another colour.
        """
        rebuilt = self.rebuilt(thumb)
        return _ratios(rebuilt.left, _usual(self.left[rebuilt.rows]), thumb.shape[2])

    def rebuilt(self, thumb: Thumbnail) -> Rebuilt:
        """Make a thumbnail again from its nearest ones."""
        flat = thumb.ravel()
        # By einsum, in one thread: where other work has the cores, BLAS's threads wait for each other, which
        # costs a frame many times what they save.
        at = np.einsum("k,ka->a", flat - self.centre, self.axes)
        away = self.squares - 2 * np.einsum("na,a->n", self.places, at)
        count = min(NEIGHBOURS, len(away))
        rows = np.argpartition(away, count - 1)[:count]
        apart = self.thumbs[rows].reshape(count, -1) - flat
        error = np.einsum("r,rk->k", _weights(apart), apart)
        return Rebuilt(rows, np.einsum("k,km->m", error, _means(thumb.shape)) ** 2)

    def among(self, rows: Indices) -> Seen:
        """Some of the thumbnails alone."""
        return replace(self, thumbs=self.thumbs[rows], left=self.left[rows])

    @cached_property
    def places(self) -> Float32[np.ndarray, "n a"]:
        flat = self.thumbs.reshape(len(self.thumbs), -1)
        parts = np.array_split(flat, math.ceil(len(flat) / ROWS_FOR_AXES))
        return np.concatenate([(part - self.centre) @ self.axes for part in parts])

    @cached_property
    def squares(self) -> Float32[np.ndarray, " n"]:
        return np.sum(self.places**2, axis=1)


def belong_together(thumbs: np.ndarray, left: np.ndarray, centre: np.ndarray, axes: np.ndarray) -> bool:
    """Whether arrays, read from a file, are those of one `Seen`."""
    types = (np.uint8, np.float16, np.float32, np.float32)
    if any(part.dtype != of for part, of in zip((thumbs, left, centre, axes), types, strict=True)):
        return False
    if thumbs.ndim != 4 or axes.ndim != 2 or not thumbs.size:
        return False
    k, m = _means(thumbs.shape[1:]).shape
    return left.shape == (len(thumbs), m) and centre.shape == (k,) and len(axes) == k


class Rebuilt(NamedTuple):
    """A thumbnail made again from its neighbours.

    Attributes:
        rows: the neighbours'.
        left: squared means of what is left, as in `Seen.left`.
    """

    rows: Int[np.ndarray, " r"]
    left: Float[np.ndarray, " m"]


@dataclass(frozen=True)
class AlsoSeen:
    """Images that a model has learnt from besides the recorded ones, such as rendered ones.

    Attributes:
        thumbs: of them, prepared as the recorded ones are.
        groups: those of one group, such as one press, are held out together.
    """

    thumbs: Kept
    groups: Int[np.ndarray, " n"]


@runtime_checkable
class SawMore(Protocol):
    """A fitted model that tells of such images."""

    @property
    def also_seen(self) -> AlsoSeen | None:
        """None where there were none."""
        ...


class Learnt(NamedTuple):
    """`Seen`, and how the same images look to it when their own fold is held out.

    Attributes:
        seen: of all of them.
        strangeness: of each ``[n 2]``.
        usual: what is usually left of a block about each of them [grey levels] ``[n]``.
    """

    seen: Seen
    strangeness: Float[np.ndarray, "n 2"]
    usual: Float[np.ndarray, " n"]


def learn(thumbs: Kept, folds: Sequence[Indices], rng: np.random.Generator) -> Learnt:
    """Rebuild each thumbnail from those of other folds, and keep what is left.

    Args:
        thumbs: in whole grey levels.
        folds: rows of each, every row in one; whole groups together. Two or more.
        rng: draws the rows that the axes are found from.
    """
    means, channels = _means(thumbs.shape[1:]).shape[1], thumbs.shape[3]
    seen = Seen(thumbs, np.zeros((len(thumbs), means), np.float16), *_axes(thumbs, rng))
    left, near = seen.left.copy(), [np.empty(0, np.int64)] * len(thumbs)
    for held in folds:
        others = np.setdiff1d(np.arange(len(thumbs)), held)
        rest = seen.among(others)
        for row in held:
            rebuilt = rest.rebuilt(thumbs[row].astype(np.float32))
            left[row], near[row] = rebuilt.left, others[rebuilt.rows]
    usual = [_usual(left[rows]) for rows in near]
    strange = [_ratios(*pair, channels) for pair in zip(left.astype(np.float32), usual, strict=True)]
    blocks = np.sqrt([squares[:-channels].mean() for squares in usual])
    return Learnt(replace(seen, left=left), np.stack(strange), blocks)


def _usual(around: Float16[np.ndarray, "r m"]) -> Float[np.ndarray, " m"]:
    """What is to be expected of a thumbnail, from what was left of its neighbours."""
    return np.asarray(around.mean(axis=0, dtype=np.float32) + FLOOR_GREY_LEVELS**2)


def _ratios(
    left: Float[np.ndarray, " m"], usual: Float[np.ndarray, " m"], channels: int
) -> Float[np.ndarray, " 2"]:
    blocks, level = np.split(left / usual, [-channels])
    return np.sqrt(np.array([blocks.mean(), level.max()], np.float64))


def _weights(apart: Float32[np.ndarray, "r k"]) -> Float[np.ndarray, " r"]:
    """Weights w of neighbours, none negative, together 1, that make w'Gw least, G their Gram matrix.

    Least squares of [L' ; s 1'] w = [0 ; s] with w >= 0 and LL' = G gives that very w up to its length.
    """
    gram = np.einsum("rk,qk->rq", apart, apart).astype(np.float64)
    size = np.trace(gram) / len(gram) + 1e-6
    gram[np.diag_indices_from(gram)] += RIDGE * size
    system = np.vstack([np.linalg.cholesky(gram).T, np.full(len(gram), math.sqrt(size))])
    w, _ = nnls(system, np.append(np.zeros(len(gram)), math.sqrt(size)))
    return np.asarray(w / w.sum(), dtype=np.float32)


@lru_cache(maxsize=4)
def _means(shape: tuple[int, int, int]) -> Float32[np.ndarray, "k m"]:
    """Matrix from a flat thumbnail to the means over its blocks and, after them, over each channel."""
    height, width, channels = shape
    down, across, of = np.indices(shape).reshape(3, -1)
    block = down // BLOCK * math.ceil(width / BLOCK) + across // BLOCK
    blocks = np.eye(math.ceil(height / BLOCK) * math.ceil(width / BLOCK), dtype=np.float32)[block]
    members = np.concatenate([blocks, np.eye(channels, dtype=np.float32)[of]], axis=1)
    return members / members.sum(axis=0)


def _axes(thumbs: Kept, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Their mean, and the principal axes of at most so many of them."""
    few = len(thumbs) <= ROWS_FOR_AXES
    drawn = thumbs if few else thumbs[rng.choice(len(thumbs), ROWS_FOR_AXES, replace=False)]
    flat = drawn.reshape(len(drawn), -1).astype(np.float32)
    centre = flat.mean(axis=0)
    _, axes = np.linalg.eigh((flat - centre).T @ (flat - centre))
    return centre, np.ascontiguousarray(axes[:, ::-1][:, :AXES])
