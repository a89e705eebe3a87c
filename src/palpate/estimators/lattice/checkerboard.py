"""Control points of a checkerboard skin, each named by its cell.

Corners are located by the image around them and named by their lattice; missing or torn tiles remove only
their own.

Corners where two tiles of one color meet diagonally, located to a fraction of a pixel.

The image around a corner is invariant under half a turn; its position is where the gradients of its edges
cross (Förstner and Gülch 1987), with a standard error from the gradients and the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, ImageError, Int, RangeError, Shaped, ndarray
from palpate.estimators.lattice.dotted_skin import Axis, PigmentAxis, find_axis, noise_near
from palpate.estimators.lattice.lattice_growth import (
    MAX_MOVE,
    ControlPoints,
    GrownLattice,
    grow_lattices,
    named_as,
)

Points = Float[ndarray, "n 2"]

SADDLE_PEAK = 2 / np.pi  # cross derivative of an ideal corner, half its contrast over its squared blur
MIN_PEAK = 0.5  # of that, for a candidate
MIN_CONTRAST = 4.0  # half contrast over noise
RING = 16  # positions around a corner
RING_REACH = 0.33  # of the pitch
MIN_HALF_TURN = 0.96  # correlation of the ring with itself after half a turn, in all channels, but for noise
MIN_FOURFOLD = 0.5
WINDOW = 0.16  # standard deviation of the weights, of the pitch
MIN_WINDOW_PX, MAX_WINDOW_PX = 1.3, 2.5
ROUNDS, STILL_PX = 6, 0.002
STEP = 0.82  # of the way: the mean gradient, taken out, makes a whole step too long by a fifth
MAX_SADDLE_MOVE = 0.3  # of the pitch, from where a corner was looked for


@dataclass(frozen=True, eq=False)
class SaddleCorners:
    """Corners of one image, unordered.

    Attributes:
        places: (x, y) ``[n 2]`` [px].
        sigma: Standard error along each axis ``[n]`` [px].
        turn: Twice the angle of the bright diagonal ``[n]`` [rad].
        contrast: Half the difference between the pigments [levels of the axis].
    """

    places: Points
    sigma: Float[ndarray, " n"]
    turn: Float[ndarray, " n"]
    contrast: Float[ndarray, " n"]

    def kept(self, which: Bool[ndarray, " n"]) -> SaddleCorners:
        return SaddleCorners(self.places[which], self.sigma[which], self.turn[which], self.contrast[which])


def find_corners(axis: Axis, pitch_px: float, frame: Shaped[ndarray, ...] | None = None) -> SaddleCorners:
    """Return the corners of a pattern of about this pitch.

    Args:
        axis: Image along the line of the two pigments.
        pitch_px: Side of a tile within about a third [px].
        frame: Frame behind the axis, to exclude a third color.
    """
    spread = local_spread(axis, pitch_px)
    noise = noise_near(axis, 0.06 * spread, round(pitch_px))
    places = _candidates(axis, spread, noise, pitch_px)
    turn, contrast, _ = look_of(ring_levels(axis, places, pitch_px)[..., 0])
    spread_there = _at(spread, places)
    good = contrast > MIN_CONTRAST * _at(noise, places)
    good &= contrast > 0.3 * spread_there
    placed, gain, sound = refined(axis, places[good], pitch_px)
    # Where it was found may have been some pixels off, and what lies around it is judged where it is.
    turn, contrast, fourfold = look_of(ring_levels(axis, placed, pitch_px)[..., 0])
    own_noise = _at(noise, placed)
    alike = half_turn(ring_levels(axis if frame is None else frame, placed, pitch_px))
    by_noise = (own_noise / np.maximum(contrast, 1.0)) ** 2
    sound &= (fourfold > MIN_FOURFOLD) & (alike > MIN_HALF_TURN - by_noise)
    sigma = gain * own_noise
    return _apart(SaddleCorners(placed, sigma, turn, contrast).kept(sound), 0.4 * pitch_px)


def noise_at(axis: Axis, places: Points, pitch_px: float) -> Float[ndarray, " n"]:
    """Return the standard deviation of the noise around positions, without edges."""
    return _at(noise_near(axis, 0.06 * local_spread(axis, pitch_px), round(pitch_px)), places)


def local_spread(axis: Axis, pitch_px: float) -> Float[ndarray, "h w"]:
    """Return the standard deviation within a pitch of each pixel (half the contrast)."""
    window = (2 * round(pitch_px) + 1,) * 2
    mean = cv2.blur(np.float32(axis), window)
    square = cv2.sqrBoxFilter(axis, cv2.CV_32F, window)
    return np.sqrt(np.maximum(square - mean**2, 1.0))


def _candidates(
    axis: Axis, spread: Float[ndarray, "h w"], noise: Float[ndarray, "h w"], pitch_px: float
) -> Points:
    """Pixels with the strongest saddle within reach, nearly that of an ideal corner."""
    width = max(1.2, 0.1 * pitch_px)
    smooth = cv2.GaussianBlur(np.float32(axis), (0, 0), width)
    xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (0, 2), (1, 1)))
    saddle = (xy**2 - xx * yy) / 16  # Sobel's masks sum to 4 times a second derivative
    peak = SADDLE_PEAK * spread / width**2
    reach = 2 * max(1, round(0.25 * pitch_px)) + 1
    top = cv2.dilate(saddle, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    good = (saddle >= top) & (saddle > (MIN_PEAK * peak) ** 2) & (spread > 2 * noise)
    y, x = np.nonzero(good)
    return np.stack([x, y], axis=1).astype(np.float64)


def _at(image: Float[ndarray, "h w"], places: Points) -> Float[ndarray, " n"]:
    x, y = np.rint(places).astype(int).T
    return image[np.clip(y, 0, image.shape[0] - 1), np.clip(x, 0, image.shape[1] - 1)].astype(np.float64)


def ring_levels(image: Shaped[ndarray, ...], places: Points, pitch_px: float) -> Float[ndarray, "n k c"]:
    """Return levels of each channel on a ring around each position, less their mean."""
    channels = 1 if image.ndim == 2 else image.shape[2]
    if not len(places):
        return np.zeros((0, RING, channels))
    angle = 2 * np.pi * np.arange(RING) / RING
    out = RING_REACH * pitch_px * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, y = (places[:, None] + out).astype(np.float32).transpose(2, 0, 1)
    levels = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    levels = levels.reshape(*x.shape, channels).astype(np.float64)
    return levels - levels.mean(axis=1, keepdims=True)


def look_of(
    ring: Float[ndarray, "n k"],
) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Return twice the bright diagonal's angle [rad], half the contrast, and the fourfold variance ratio."""
    second = ring @ np.exp(4j * np.pi * np.arange(RING) / RING)
    power = np.maximum((ring**2).mean(axis=1), 1e-9)
    return np.angle(second), np.sqrt(power), 2 * (np.abs(second) / RING) ** 2 / power


def half_turn(ring: Float[ndarray, "n k c"]) -> Float[ndarray, " n"]:
    """Return the similarity of each ring to itself after half a turn: 1 between four intact tiles."""
    power = np.einsum("nkc,nkc->n", ring, ring)
    turned = np.einsum("nkc,nkc->n", ring, np.roll(ring, RING // 2, axis=1))
    return turned / np.maximum(power, 1e-9)


def refined(
    image: Shaped[ndarray, ...],
    places: Points,
    pitch_px: float,
    rounds: int = ROUNDS,
    gains: bool = True,
    weights: Float[ndarray, "1 c1"] | None = None,
) -> tuple[Points, Float[ndarray, " n"], Bool[ndarray, " n"]]:
    """Return corners refined to where their edges' gradients cross.

    Args:
        image: Axis ``[h w]``, or a frame ``[h w c]`` with its weights.
        places: Positions within a third of the pitch.
        pitch_px: Side of a tile [px].
        rounds: Greatest number of iterations.
        gains: Whether standard errors are needed; NaN otherwise.
        weights: Channel weights of the frame (`PigmentAxis`).

    Returns:
        Positions ``[n 2]`` [px], standard error for noise of one level ``[n]`` [px], and validity.
    """
    if not len(places):
        return places, np.empty(0), np.empty(0, bool)
    width = float(np.clip(WINDOW * pitch_px, MIN_WINDOW_PX, MAX_WINDOW_PX))
    half = int(np.ceil(2.2 * width)) + 1
    high, wide = image.shape[:2]
    xy = places.copy()
    inside = ((xy > half + 2) & (xy < np.array([wide, high]) - half - 3)).all(axis=1)
    xy[~inside] = half + 3
    patches, corner = _patches(image, np.rint(xy).astype(int), half + 2, weights)
    patches = _smooth(patches)
    gx = patches[:, 1:-1, 2:] - patches[:, 1:-1, :-2]
    gy = patches[:, 2:, 1:-1] - patches[:, :-2, 1:-1]
    corner = corner + 2
    steps = np.arange(2 * half + 1, dtype=np.float32)
    moved = np.full(len(xy), np.inf)
    for _ in range(rounds):
        dx, dy, wx, wy = _weights(xy, corner, steps, width)
        both = wy.sum(axis=1) * wx.sum(axis=1)
        for g in (gx, gy):  # light that falls off evenly is a constant gradient, which a saddle has not
            g -= (_sums(g, wx, wy) / both)[:, None, None]
        a, b = _normal_equations((gx * gx, gx * gy, gy * gy), dx, dy, wx, wy)
        move = STEP * _solved(a, b)
        xy = xy + np.clip(np.nan_to_num(move), -2, 2)
        moved = np.abs(move).max(axis=1)
        if not (moved > STILL_PX).any():
            break
    near = np.hypot(*(xy - places).T) < MAX_SADDLE_MOVE * pitch_px
    sound = inside & near & np.isfinite(moved) & (moved < 0.25)
    gain = _gain(gx, gy, xy, corner, steps, width) if gains else np.full(len(xy), np.nan)
    return xy, gain, sound


def _patches(
    image: Shaped[ndarray, ...],
    middle: Int[ndarray, "n 2"],
    half: int,
    weights: Float[ndarray, "1 c1"] | None,
) -> tuple[Float[ndarray, "n k k"], Int[ndarray, "n 2"]]:
    """Image squares around each position, and the index of their first pixel."""
    side, corner = 2 * half + 1, middle - half
    channels = 1 if image.ndim == 2 else image.shape[2]
    rows = image.reshape(len(image), -1)
    views = np.lib.stride_tricks.sliding_window_view(rows, (side, channels * side))
    squares = views[corner[:, 1], channels * corner[:, 0]]
    if weights is not None:  # only what is looked at becomes the axis, which takes a fifth of the time
        squares = cv2.transform(squares.reshape(-1, side, channels), weights).reshape(-1, side, side)
    return squares.astype(np.float32), corner


def _smooth(patches: np.ndarray) -> np.ndarray:
    """Patches smoothed by 1 2 1, a pixel smaller on each side, against aliasing."""
    across = patches[:, :, :-2] + 2 * patches[:, :, 1:-1] + patches[:, :, 2:]
    return (across[:, :-2] + 2 * across[:, 1:-1] + across[:, 2:]) / 16


def _weights(xy: Points, corner: np.ndarray, steps: np.ndarray, width: float) -> tuple[np.ndarray, ...]:
    """Distances of rows and columns of a patch from a position, and their weights."""
    away = (xy - corner).astype(np.float32)
    dx, dy = steps - away[:, :1], steps - away[:, 1:]
    return dx, dy, np.exp(-0.5 * (dx / width) ** 2), np.exp(-0.5 * (dy / width) ** 2)


def _sums(product: np.ndarray, along_x: np.ndarray, along_y: np.ndarray) -> np.ndarray:
    return np.matmul(along_y[:, None], np.matmul(product, along_x[:, :, None]))[:, 0, 0]


def _normal_equations(
    products: tuple[np.ndarray, ...], dx: np.ndarray, dy: np.ndarray, wx: np.ndarray, wy: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix ``[n 2 2]`` and right side ``[n 2]`` of the point where gradients cross."""
    right = np.stack([wx, wx * dx], axis=2)
    left = np.stack([wy, wy * dy], axis=1)
    xx, xy, yy = (np.matmul(left, np.matmul(p, right)) for p in products)  # [n, by 1 or dy, by 1 or dx]
    a = np.stack([xx[:, 0, 0], xy[:, 0, 0], xy[:, 0, 0], yy[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    b = np.stack([xx[:, 0, 1] + xy[:, 1, 0], xy[:, 0, 1] + yy[:, 1, 0]], axis=1)
    return a.astype(np.float64), b.astype(np.float64)


def _inverse(a: np.ndarray) -> np.ndarray:
    """Inverses ``[n 2 2]``; NaN if edges have one direction only."""
    (p, q), (o, r) = a.transpose(1, 2, 0)
    det = p * r - q * o
    det = np.where(det > 1e-3 * (p + r) ** 2, det, np.nan)
    return np.stack([r / det, -q / det, -o / det, p / det], axis=1).reshape(-1, 2, 2)


def _solved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", _inverse(a), b)


def _gain(
    gx: np.ndarray, gy: np.ndarray, xy: Points, corner: np.ndarray, steps: np.ndarray, width: float
) -> Float[ndarray, " n"]:
    """Standard error of a position for pixel noise of one level."""
    dx, dy, wx, wy = _weights(xy, corner, steps, width)
    w = wy[:, :, None] * wx[:, None, :]
    d = (np.broadcast_to(dx[:, None, :], w.shape), np.broadcast_to(dy[:, :, None], w.shape))
    g = (gx, gy)
    total = w.sum(axis=(1, 2))
    radial = gx * d[0] + gy * d[1]
    factors = [[w * ((i == k) * radial + g[i] * d[k]) for k in range(2)] for i in range(2)]
    sums = np.array([[f.sum(axis=(1, 2)) for f in row] for row in factors]).transpose(2, 0, 1)
    shares = [
        _adjoint(*(f - w * (s / total)[:, None, None] for f, s in zip(row, sums[:, i].T, strict=True)))
        for i, row in enumerate(factors)
    ]
    middle = np.array([[np.einsum("nk,nk->n", p, q) for q in shares] for p in shares]).transpose(2, 0, 1)
    a, _ = _normal_equations((gx * gx, gx * gy, gy * gy), dx, dy, wx, wy)
    mean_by_step = _moments(w, g, d) / (width**2 * total)[:, None, None]
    by_weights = _moments(w, (gx * radial, gy * radial), d) / width**2
    j = a + np.matmul(sums, mean_by_step) - by_weights
    inverse = _inverse(j)
    spread = np.einsum("nij,njk,nlk->nil", inverse, middle.astype(np.float64), inverse)
    return np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2)


def _moments(w: np.ndarray, rows: tuple[np.ndarray, ...], columns: tuple[np.ndarray, ...]) -> np.ndarray:
    return np.array([[np.einsum("nyx,nyx,nyx->n", w, p, q) for q in columns] for p in rows]).transpose(
        2, 0, 1
    )


def _adjoint(by_x: np.ndarray, by_y: np.ndarray) -> np.ndarray:
    """Weight of each pixel ``[n k]`` in a sum of smoothed differences."""
    share = np.zeros((len(by_x), by_x.shape[1] + 6, by_x.shape[2] + 6), np.float32)
    share[:, 3:-3, 4:-2] += by_x
    share[:, 3:-3, 2:-4] -= by_x
    share[:, 4:-2, 3:-3] += by_y
    share[:, 2:-4, 3:-3] -= by_y
    return _smooth(share).reshape(len(by_x), -1)


def _apart(corners: SaddleCorners, least_px: float) -> SaddleCorners:
    """Corners without the worse of two close ones."""
    drop = np.zeros(len(corners.places), bool)
    for i, j in cKDTree(corners.places).query_pairs(least_px) if len(drop) else ():
        drop[i if corners.sigma[i] > corners.sigma[j] else j] = True
    return corners.kept(~drop & np.isfinite(corners.sigma))


MIN_POINTS = 12
MIN_SEEN = 0.3  # of the reference's points: with fewer the frame is not believed
MAX_SIDE = 0.25  # of the reference's points, missing along one side
MAX_SIGMA = 0.02  # of the pitch; a corner that is known less well is left out
SAME_PITCH = 1.35  # ratio within which a pitch that was given is right


@dataclass(frozen=True, eq=False)
class CheckerboardFind:
    """Checkerboard of a frame.

    Attributes:
        axis: Line of the two pigments, by which later frames are read.
        pitch: Median side of a tile [px].
    """

    points: ControlPoints
    axis: PigmentAxis
    pitch: float


def find_checkerboard(
    frame: Shaped[ndarray, ...], pitch_px: float = 24.0, reference: ControlPoints | None = None
) -> CheckerboardFind:
    """Return the corners of a frame's checkerboard.

    Args:
        frame: 8-bit RGB ``[h w 3]`` or gray ``[h w]``.
        pitch_px: Side of a tile, within a factor of 1.6 [px].
        reference: Points whose names are kept. By default the first column and row are 0, and tile (i, j),
            whose first corner has that cell, is bright if i + j is even.
    """
    if not pitch_px >= 5:
        raise RangeError(f"tiles of {pitch_px} px; corners are found where tiles are 5 px wide or more")
    for _ in range(3):
        axis = find_axis(frame, pitch_px)
        corners = find_corners(axis.of(frame), pitch_px, frame)
        corners = corners.kept(corners.sigma < MAX_SIGMA * pitch_px)
        lattices = grow_lattices(corners.places, "square", corners.turn) if len(corners.places) else []
        if not lattices or max(pitch_px, lattices[0].pitch) < SAME_PITCH * min(pitch_px, lattices[0].pitch):
            break
        pitch_px = lattices[0].pitch
    if not lattices or len(lattices[0].cells) < MIN_POINTS:
        raise ImageError(
            f"{len(corners.places)} corners, {sum(len(g.cells) for g in lattices)} on a lattice, and "
            f"{MIN_POINTS} are needed; check focus, light, and the pitch of {pitch_px:.0f} px"
        )
    points = _first_names(corners, lattices[0]) if reference is None else _same(corners, lattices, reference)
    return CheckerboardFind(points, axis, lattices[0].pitch)


def _first_names(corners: SaddleCorners, lattice: GrownLattice) -> ControlPoints:
    """Points of the largest lattice, cells from 0, shifted by one if tiles would change color."""
    turn = corners.turn[lattice.marks]
    # At an even corner the bright tile begins there: bright lies along the diagonal of both axes.
    across = np.where(lattice.cells.sum(axis=1) % 2, -1.0, 1.0) * np.exp(1j * turn)
    cells = lattice.cells + np.array([int(_diagonal(corners, lattice, across.sum()) < 0), 0])
    return ControlPoints(cells, corners.places[lattice.marks], corners.sigma[lattice.marks])


def _diagonal(corners: SaddleCorners, lattice: GrownLattice, bright: complex) -> float:
    """Sign of the even corners' bright diagonal: 1 for (0, 0) to (1, 1), else -1."""
    places, cells = corners.places[lattice.marks], lattice.cells
    fit, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(cells)), cells]), places, rcond=None)
    main = fit[1] + fit[2]
    return float((bright * np.conj(complex(*main) ** 2)).real)


def _same(corners: SaddleCorners, lattices: list[GrownLattice], reference: ControlPoints) -> ControlPoints:
    cells, marks = named_as(reference, lattices, corners.places, "square", MAX_MOVE)
    if len(cells) < max(MIN_POINTS, MIN_SEEN * len(reference)):
        raise ImageError(
            f"{len(cells)} of the reference's {len(reference)} points are seen, {100 * MIN_SEEN:.0f} % are "
            f"needed; give a nearer reference, within {MAX_MOVE} of a tile"
        )
    points = ControlPoints(cells, corners.places[marks], corners.sigma[marks])
    _refuse_shifted(points, reference)
    return points


def _refuse_shifted(points: ControlPoints, reference: ControlPoints) -> None:
    """Refuse names if a whole side is missing, as in a pattern shifted by whole tiles."""
    low, high = points.cells.min(axis=0), points.cells.max(axis=0)
    beyond = max((reference.cells < low).sum(axis=0).max(), (reference.cells > high).sum(axis=0).max())
    if beyond > MAX_SIDE * len(reference):
        raise ImageError(
            f"a side of the pattern, {beyond} of the reference's {len(reference)} points, is missing "
            f"({100 * MAX_SIDE:.0f} % may be); take a new reference"
        )
