"""Perturbations of a camera frame at stated sizes: focus, mounting, light, storage, dirt.

Each is a pure function of frame, size, and a generator that draws direction, sign, and places; size 0 is the
frame itself. Frames of two grey levels are thresholded again after focus and mounting changes, and not after
softening, compression, and noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.core import Float, Float32, Image, InputError, Mask, RangeError

Rng = np.random.Generator
Sizes = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class PerturbationKind:
    """One kind of change, at five rising sizes.

    Attributes:
        change: frame, size, and generator to the changed frame.
        of_binary: True for frames of two grey levels only, False for others only; None for all.
    """

    unit: str
    sizes: Sizes
    change: Callable[[Image, float, Rng], Image]
    of_binary: bool | None = None


def perturbed(image: Image, kind: str, size: float, rng: Rng) -> Image:
    """Return a frame changed by one kind of perturbation.

    Args:
        image: 8-bit, grey ``[h w]`` or RGB ``[h w 3]``.
        kind: name in `KINDS`.
        size: in the kind's unit; 0 changes nothing.
    """
    if kind not in KINDS:
        raise InputError(
            f"no perturbation is called {kind!r}; there are {', '.join(KINDS)}", code="unknown-kind"
        )
    if not 0 <= size < math.inf:
        raise RangeError(
            f"a perturbation of size {size} {KINDS[kind].unit}; sizes are 0 or more, and finite",
            code="size-range",
        )
    return KINDS[kind].change(image, size, rng) if size else image.copy()


def kinds_for(image: Image) -> tuple[str, ...]:
    """Return the names of the kinds that apply to such frames."""
    binary = is_binary(image)
    return tuple(name for name, kind in KINDS.items() if kind.of_binary in (None, binary))


def is_binary(image: Image) -> bool:
    """Return whether a frame has two grey levels, as behind a threshold."""
    low, high = int(image.min()), int(image.max())
    return low < high and bool(np.isin(image, (low, high)).all())


def _behind_threshold(image: Image, changed: np.ndarray) -> Image:
    if not is_binary(image):
        return _as_8_bit(changed)
    low, high = image.min(), image.max()
    return np.where(changed > (float(low) + float(high)) / 2, high, low).astype(np.uint8)


def _as_8_bit(image: np.ndarray) -> Image:
    return np.asarray(np.clip(np.rint(image), 0, 255).astype(np.uint8))


def _blurred(image: Image, sigma_px: float) -> np.ndarray:
    return np.asarray(
        cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    )


def _focus(image: Image, sigma_px: float, rng: Rng) -> Image:
    return _behind_threshold(image, _blurred(image, sigma_px))


def _softening(image: Image, sigma_px: float, rng: Rng) -> Image:
    return _as_8_bit(_blurred(image, sigma_px))


def _sign(rng: Rng) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _warped(image: Image, matrix: Float[np.ndarray, "2 3"]) -> Image:
    """The frame moved by an affine map of its pixels (x, y), edges repeated."""
    height, width = image.shape[:2]
    moved = cv2.warpAffine(
        image.astype(np.float32),
        matrix,
        (width, height),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return _behind_threshold(image, moved)


def _shift(image: Image, px: float, rng: Rng) -> Image:
    angle = rng.uniform(0, 2 * math.pi)
    return _warped(image, np.array([[1, 0, px * math.cos(angle)], [0, 1, px * math.sin(angle)]]))


def _centre(image: Image) -> tuple[float, float]:
    return ((image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2)


def _turn(image: Image, deg: float, rng: Rng) -> Image:
    return _warped(image, cv2.getRotationMatrix2D(_centre(image), _sign(rng) * deg, 1.0))


def _zoom(image: Image, percent: float, rng: Rng) -> Image:
    return _warped(image, cv2.getRotationMatrix2D(_centre(image), 0.0, 1 + _sign(rng) * percent / 100))


def _brightness(image: Image, percent: float, rng: Rng) -> Image:
    return _as_8_bit(image.astype(np.float32) * (1 + _sign(rng) * percent / 100))


def _colour(image: Image, share: float, rng: Rng) -> Image:
    """Red and blue mixed, wholly exchanged at a share of 1; of a grey frame, another gamma."""
    if image.ndim == 3:
        return _as_8_bit((1 - share) * image.astype(np.float32) + share * image[..., ::-1])
    gamma = (1 + share) ** _sign(rng)
    return _as_8_bit(255 * (np.arange(256) / 255)[image] ** gamma)


def _compression(image: Image, below_100: float, rng: Rng) -> Image:
    """JPEG at a quality so far below 100."""
    quality = max(1, round(100 - below_100))
    _, data = cv2.imencode(".jpg", image[..., ::-1] if image.ndim == 3 else image, [1, quality])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR if image.ndim == 3 else cv2.IMREAD_GRAYSCALE)
    assert decoded is not None
    return np.ascontiguousarray(decoded[..., ::-1] if image.ndim == 3 else decoded)


def _noise(image: Image, sigma: float, rng: Rng) -> Image:
    return _as_8_bit(image + sigma * rng.standard_normal(image.shape, np.float32))


SPECK = 0.01  # radius of a speck, relative to the frame's shorter side


def _dust(image: Image, percent: float, rng: Rng) -> Image:
    height, width = image.shape[:2]
    radius = max(1, round(SPECK * min(height, width)))
    dark, bright = (np.zeros((height, width), np.uint8) for _ in range(2))
    while 100 * np.mean(dark | bright) < min(percent, 100):
        at = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.circle(dark if rng.random() < 0.5 else bright, at, radius, 1, cv2.FILLED)
    return _painted(_painted(image, dark > 0, int(image.min())), bright > 0, int(image.max()))


def _dead_columns(image: Image, count: float, rng: Rng) -> Image:
    width = image.shape[1]
    dead = rng.choice(width, min(round(count), width), replace=False)
    stuck = image.copy()
    stuck[:, dead] = np.where(rng.random(len(dead)) < 0.5, image.min(), image.max())[
        (None, slice(None), *(None,) * (image.ndim - 2))
    ]
    return stuck


def _painted(image: Image, where: Mask, level: int) -> Image:
    painted = image.copy()
    painted[where] = level
    return painted


def _marker_width(image: Image, px: float, rng: Rng) -> Image:
    """Bright patches whose outline moved outwards or inwards, as by another threshold or exposure."""
    low, high = image.min(), image.max()
    bright = (image == high).astype(np.uint8)
    if image.ndim == 3:
        bright = bright[..., 0]
    wider = np.where(_outside_px(bright) <= _sign(rng) * px, high, low).astype(np.uint8)
    return np.repeat(wider[..., None], 3, axis=2) if image.ndim == 3 else wider


OUTLINE_SIGMA_PX = 0.8


def _outside_px(bright: np.ndarray) -> Float32[np.ndarray, "h w"]:
    """Smoothed signed distance of pixels from the outline between bright and dark, negative inside [px]."""
    away, into = (
        cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for part in (1 - bright, bright)
    )
    stepped = np.where(bright > 0, 0.5 - into, away - 0.5).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(stepped, (0, 0), OUTLINE_SIGMA_PX, borderType=cv2.BORDER_REPLICATE))


_FINE: Sizes = (0.5, 1, 1.5, 2, 3)

# every kind of perturbation, by name; `known_changes.SIGNATURES` has what to do about each
KINDS: dict[str, PerturbationKind] = {
    "focus": PerturbationKind("px (sigma)", _FINE, _focus),
    "softening": PerturbationKind("px (sigma)", _FINE, _softening, of_binary=True),
    "shift": PerturbationKind("px", (0.5, 1, 2, 4, 8), _shift),
    "turn": PerturbationKind("deg", (0.25, 0.5, 1, 2, 4), _turn),
    "zoom": PerturbationKind("%", (0.25, 0.5, 1, 2, 4), _zoom),
    "brightness": PerturbationKind("%", (5, 10, 20, 30, 50), _brightness),
    "colour": PerturbationKind("share exchanged", (0.05, 0.1, 0.25, 0.5, 1), _colour, of_binary=False),
    "marker width": PerturbationKind("px", (0.25, 0.5, 1, 1.5, 2), _marker_width, of_binary=True),
    "compression": PerturbationKind("below JPEG quality 100", (5, 10, 20, 50, 80), _compression),
    "noise": PerturbationKind("grey levels (sigma)", (1, 2, 5, 10, 20), _noise),
    "dust": PerturbationKind("% of the frame", (0.1, 0.2, 0.5, 1, 2), _dust),
    "dead columns": PerturbationKind("columns", (1, 2, 4, 8, 16), _dead_columns),
}
