"""Checkerboards and dotted skins whose every mark is known: rendered by no code of palpate's.

A view maps pixels to the lattice's own coordinates, in cells, in closed form; marks lie where both are
whole. Where a mark is in the image is found by Newton's method on that map. The image is the pattern's mean
over each pixel (by samples inside it), blurred, lit and made noisy.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

YELLOW, RED = (205.0, 175.0, 45.0), (150.0, 40.0, 35.0)
FULL_WELL, READ_NOISE = 15_000.0, 5.0  # electrons, as the camera of docs/explanations/verification.md
WIDTH, HEIGHT = 640, 480


@dataclass(frozen=True)
class View:
    """How a lattice lies in an image.

    Attributes:
        pitch: of the lattice at the middle [px].
        turn, shear: angle [rad] and shear of the lattice in the image.
        barrel: share by which a radius of half the image's width is shortened, as a fisheye does.
        bulge, at, reach: outward displacement of a press [px], its middle and its radius [px].
        shift: of the whole lattice [px].
        size: width and height [px].
        hexagonal: rows of a hexagonal lattice rather than a square one.
    """

    pitch: float = 24.0
    turn: float = 0.0
    shear: float = 0.0
    barrel: float = 0.12
    bulge: float = 0.0
    at: tuple[float, float] = (300.0, 230.0)
    reach: float = 60.0
    shift: tuple[float, float] = (0.0, 0.0)
    size: tuple[int, int] = (WIDTH, HEIGHT)
    hexagonal: bool = False

    def lattice(self, xy: np.ndarray) -> np.ndarray:
        """Coordinates in cells of places in the image ``[... 2]``."""
        middle = (np.array(self.size) - 1) / 2
        d = xy - np.array(self.at)
        r2 = (d**2).sum(axis=-1, keepdims=True) / self.reach**2
        xy = xy - self.bulge * d / self.reach * np.exp(0.5 - 0.5 * r2)
        d = (xy - middle - np.array(self.shift)) / (self.size[0] / 2)
        flat = d * (1 + self.barrel * (d**2).sum(axis=-1, keepdims=True)) * self.size[0] / 2
        c, s = np.cos(self.turn), np.sin(self.turn)
        u = flat @ np.array([[c, -s], [s, c]])
        u = u @ np.array([[1.0, 0.0], [self.shear, 1.0]]) / self.pitch
        if self.hexagonal:
            v = u[..., 1] / np.sqrt(0.75)
            u = np.stack([u[..., 0] - v / 2, v], axis=-1)
        return u + 0.37

    def places(self, cells: np.ndarray) -> np.ndarray:
        """Places in the image of lattice coordinates ``[n 2]``, by Newton's method."""
        xy = np.tile((np.array(self.size) - 1) / 2.0, (len(cells), 1))
        for _ in range(60):
            off = self.lattice(xy) - cells
            jac = np.stack(
                [(self.lattice(xy + step) - self.lattice(xy - step)) / 2e-3 for step in 1e-3 * np.eye(2)],
                axis=-1,
            )
            move = np.linalg.solve(jac, off[..., None])[..., 0]
            xy = xy - np.clip(move, -self.pitch, self.pitch)
        return np.where(np.abs(off).max(axis=1, keepdims=True) < 1e-9, xy, np.nan)

    def marks(self, extent: tuple[int, int], margin: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
        """Cells within an extent about the middle whose place is in the image, and these places."""
        half = np.array(extent) // 2
        cells = np.stack(
            np.meshgrid(np.arange(-half[0], half[0] + 1), np.arange(-half[1], half[1] + 1)), axis=-1
        ).reshape(-1, 2)
        xy = self.places(cells.astype(float))
        low, high = margin, np.array(self.size) - 1 - margin
        seen = ((xy > low) & (xy < high)).all(axis=1)
        return cells[seen], xy[seen]


def board(
    view: View,
    *,
    extent: tuple[int, int] = (20, 15),
    blur: float = 0.8,
    uneven: float = 0.0,
    painted: tuple[tuple[int, int], ...] = (),
    torn: tuple[float, float, float] | None = None,
    samples: int = 3,
) -> np.ndarray:
    """A red and yellow checkerboard without noise ``[h w 3]``, grey levels as floats.

    Args:
        view: how it lies.
        extent: corners across and down; tiles reach one further.
        blur: of the lens [px].
        uneven: share by which light falls from the image's left to its right, and half of it downwards.
        painted: yellow tiles painted over, red; tile (i, j) lies between corners (i, j) and (i + 1, j + 1).
        torn: first column, last column and first row, in cells, of a strip that shows the black of beyond.
        samples: along each side of a pixel.
    """
    width, height = view.size
    inside = (np.arange(samples) + 0.5) / samples - 0.5
    xs = (np.arange(width)[:, None] + inside).ravel()
    ys = (np.arange(height)[:, None] + inside).ravel()
    uv = view.lattice(np.stack(np.meshgrid(xs, ys), axis=-1))
    tile = np.floor(uv).astype(int)
    yellow = 0.5 + 0.5 * _alternating(uv[..., 0]) * _alternating(uv[..., 1])
    over = np.zeros(yellow.shape, np.uint8)
    for i, j in painted:
        if (i + j) % 2 == 0:
            over[(tile[..., 0] == i) & (tile[..., 1] == j)] = 1
    yellow[cv2.dilate(over, np.ones((3, 3), np.uint8)) > 0] = 0.0  # with the samples that its edges pass
    half = np.array(extent) // 2 + 1
    beyond = (np.abs(uv) > half).any(axis=-1)
    if torn is not None:
        beyond |= (uv[..., 0] > torn[0]) & (uv[..., 0] < torn[1]) & (uv[..., 1] > torn[2])
    colour = yellow[..., None] * (np.float32(YELLOW) - np.float32(RED)) + np.float32(RED)
    colour[beyond] = 12.0
    if blur:
        colour = cv2.GaussianBlur(colour, (0, 0), blur * samples)
    colour = cv2.resize(colour, view.size, interpolation=cv2.INTER_AREA)
    light = 1 - uneven * np.arange(width) / width - 0.5 * uneven * np.arange(height)[:, None] / height
    return colour * light[..., None]


def _alternating(u: np.ndarray) -> np.ndarray:
    """Square wave of whole numbers, with the sample's share of each side where an edge passes through it."""
    slope = np.hypot(*np.gradient(u))  # cells a sample
    to_edge = (u - np.rint(u)) / slope
    rising = 1 - 2 * (np.rint(u) % 2)
    return (rising * np.clip(2 * to_edge, -1, 1)).astype(np.float32)


def dots(
    view: View,
    *,
    extent: tuple[int, int] = (12, 9),
    radius: float = 0.2,
    dark: bool = True,
    lost: frozenset[tuple[int, int]] = frozenset(),
) -> np.ndarray:
    """A grey dotted skin without noise ``[h w]``; the radius of a dot in cells."""
    cells, places = view.marks(extent, margin=-50.0)
    image = np.full((view.size[1], view.size[0]), 170.0 if dark else 25.0)
    r, fine = radius * view.pitch, (np.arange(6) + 0.5) / 6 - 0.5
    for cell, (x, y) in zip(cells.tolist(), places, strict=True):
        left, top, side = int(x - r) - 2, int(y - r) - 2, int(2 * r) + 5
        if tuple(cell) in lost or min(left, top) < 0:
            continue
        xs, ys = ((at + np.arange(side)[:, None] + fine).ravel() for at in (left, top))
        over = 6 * (r - np.hypot(xs - x, ys[:, None] - y)) + 0.5
        share = np.clip(over, 0, 1).reshape(side, 6, side, 6).mean(axis=(1, 3))
        part = image[top : top + side, left : left + side]
        part += (-130.0 if dark else 180.0) * share[: part.shape[0], : part.shape[1]]
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def noisy(clean: np.ndarray, rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """The frame that a camera gives of it: shot and read noise, times a scale, in whole levels."""
    electrons = np.clip(clean, 0, 255) * FULL_WELL / 255
    spread = scale * np.sqrt(electrons + READ_NOISE**2) * 255 / FULL_WELL
    return np.clip(np.rint(clean + spread * rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)
