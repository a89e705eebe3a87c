"""Dots of a skin, found by a short description and named by their cell.

A dot is a dark or bright patch of known radius. Its position is the Gaussian-weighted centroid of its
difference from the plane of light around it; the standard error follows from that sum and the noise.

Color frames as one number for each pixel: the position on the line between two pigments.

The line follows differences between neighboring pixels, so that slow changes of light do not rotate it;
channels are weighted by contrast over noise (Fisher's discriminant).
"""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, ImageError, InputError, PathText, RangeError, Shaped, UInt8, ndarray
from palpate.core.parsing import parser
from palpate.estimators.fringe_light import brightest_channel
from palpate.estimators.lattice.lattice_growth import ControlPoints, LatticeKind, grow_lattices, named_as

Axis = UInt8[ndarray, "h w"]

LOW, HIGH = 12.0, 243.0  # where the darkest and brightest thousandth of the axis come to lie
MIN_PIGMENT_CONTRAST = 6.0  # grey levels between the pigments, and times the noise
DARK, BRIGHT = 16, 250
MAX_CLIPPED = 0.5  # greatest ratio of saturated pixels
LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # its output has 6 times the noise
HALF_NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True, eq=False)
class PigmentAxis:
    """Channel weights and offset of the two-pigment axis, the brighter pigment high."""

    weights: Float[ndarray, "1 c1"]
    size: tuple[int, int]

    def of(self, frame: Shaped[ndarray, ...]) -> Axis:
        channels = self.weights.shape[1] - 1
        if frame.dtype != np.uint8 or frame.shape[:2] != self.size or channels_of(frame) != channels:
            raise ImageError(
                f"a frame {frame.dtype} {list(frame.shape)}; give 8-bit frames of {list(self.size)} px, "
                f"{channels} channels"
            )
        return cv2.transform(frame, self.weights).reshape(self.size)


def channels_of(frame: Shaped[ndarray, ...]) -> int:
    """Return the number of a frame's channels, 1 for gray."""
    return 1 if frame.ndim == 2 else frame.shape[-1]


def find_axis(frame: Shaped[ndarray, ...], pitch_px: float) -> PigmentAxis:
    """Return the line between the pigments of an 8-bit frame with tiles of about this size."""
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or channels_of(frame) not in (1, 3):
        raise ImageError(
            f"a pattern is found in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}"
        )
    if min(frame.shape[:2]) < 4 * pitch_px:
        raise ImageError(
            f"a frame of {frame.shape[1]} x {frame.shape[0]} px is too small for tiles of {pitch_px:.0f} px"
        )
    _refuse_ends(frame)
    planes = np.float32(frame).reshape(*frame.shape[:2], -1)
    wide = int(2 * pitch_px) | 1
    local = planes - cv2.blur(planes, (wide, wide)).reshape(planes.shape)
    flat = local[::2, ::2].reshape(-1, planes.shape[2])
    noise = np.array([noise_of(planes[..., k]) for k in range(planes.shape[2])]) + 0.3
    _, along = np.linalg.eigh(np.cov((flat / noise).T).reshape(len(noise), -1))
    weights = along[:, -1] / noise
    weights *= np.sign(weights.sum()) / np.abs(weights).sum()
    return PigmentAxis(_stretched(planes @ weights, weights), frame.shape[:2])


def _refuse_ends(frame: Shaped[ndarray, ...]) -> None:
    grey = brightest_channel(frame)
    if np.percentile(grey, 99) < DARK:
        raise ImageError(f"the frame is dark: 99 % of it lies below {DARK} of 255; look at the light")
    if (grey > BRIGHT).mean() > MAX_CLIPPED:
        raise ImageError(
            f"{100 * (grey > BRIGHT).mean():.0f} % of the frame is saturated; lower light or exposure"
        )


def _stretched(axis: Float[ndarray, "h w"], weights: Float[ndarray, " c"]) -> Float[ndarray, "1 c1"]:
    """Weights that stretch the axis over an 8-bit range."""
    low, high = np.percentile(axis[::2, ::2], [0.1, 99.9])
    if high - low < MIN_PIGMENT_CONTRAST:
        raise ImageError(
            f"the frame's colours differ by {high - low:.1f} grey levels; {MIN_PIGMENT_CONTRAST:.0f} are "
            "needed"
        )
    scale = (HIGH - LOW) / (high - low)
    return np.append(scale * weights, LOW - scale * low)[None].astype(np.float64)


def noise_of(plane: Shaped[ndarray, "h w"]) -> float:
    """Return an image's pixel noise (median of Immerkaer's mask, doi:10.1006/cviu.1996.0060)."""
    rough = np.abs(cv2.filter2D(plane, cv2.CV_32F, LAPLACIAN))
    return float(np.median(rough)) / (6 * HALF_NORMAL_MEDIAN)


def noise_near(axis: Axis, smooth_below: Float[ndarray, "h w"], reach_px: int) -> Float[ndarray, "h w"]:
    """Return the local standard deviation of the noise, from pixels that are no edges.

    Args:
        axis: Image.
        smooth_below: Gradient below which a pixel is no edge [levels/px].
        reach_px: Half-side of the window [px].
    """
    blurred = cv2.GaussianBlur(axis, (0, 0), 1.5)
    gx, gy = cv2.spatialGradient(blurred)
    flat = np.float32(np.abs(np.float32(gx)) + np.abs(np.float32(gy)) < 8 * smooth_below)
    flat = cv2.erode(flat, np.ones((3, 3), np.uint8))
    square = cv2.filter2D(axis, cv2.CV_32F, LAPLACIAN) ** 2 * flat
    window = (2 * reach_px + 1,) * 2
    count = cv2.blur(flat, window)
    everywhere = square.sum() / max(float(flat.sum()), 1.0)
    near = np.where(count > 0.02, cv2.blur(square, window) / np.maximum(count, 0.02), everywhere)
    return np.sqrt(near / 36)


Points = Float[ndarray, "n 2"]
Offsets = tuple[np.ndarray, np.ndarray]

MIN_ROUND = 0.1  # product of a dot's curvatures over their sum squared; 0.25 is a circle
MIN_DOTS = 9
MIN_CONTRAST = 5.0  # times the noise
MIN_LEVEL = 100  # pixels of a gray level needed to estimate its noise
RING = 1.8, 2.8  # of the radius, between which the ground is seen
WEIGHT = 0.9  # standard deviation of the weights, of the radius
ROUNDS, STILL_PX = 12, 0.003
MAX_MOVE = 1.2  # of the radius, from where a dot was looked for
MAX_ANGLE = 1.4  # rad from a fisheye's axis, beyond which straightening stands still
NO_PEAK = 1e12  # derivative of a patch without a peak, which then does not move


@dataclass(frozen=True)
class DottedSkin:
    """Description of a dotted skin in its camera's image.

    Attributes:
        pitch_px: Approximate distance of neighboring dots at the center [px].
        radius_px: Approximate radius of a dot there [px].
        region: x, y, width, and height of the search area [px]; the whole frame by default.
        min_contrast: Contrast of a dot relative to the ground's brightness.
        fisheye: x and y of the center and focal length of an equidistant lens [px], to straighten the lattice
            for naming; positions stay those of the frame.
        pitch_mm: Distance of neighboring dots on the skin [mm], if known.
    """

    kind: LatticeKind = "square"
    pitch_px: float = 40.0
    radius_px: float = 4.0
    colour: Literal["dark", "bright"] = "dark"
    region: tuple[int, int, int, int] | None = None
    min_contrast: float = 0.08
    fisheye: tuple[float, float, float] | None = None
    pitch_mm: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("square", "hexagonal") or self.colour not in ("dark", "bright"):
            raise InputError(
                f'a skin of kind {self.kind!r}, colour {self.colour!r}; allowed: "square", "hexagonal"; '
                '"dark", "bright"'
            )
        if not (1 <= self.radius_px <= 0.4 * self.pitch_px):
            raise RangeError(
                f"dots of radius {self.radius_px} px, {self.pitch_px} px apart; allowed: 1 px to 0.4 of the "
                "pitch"
            )
        if self.region is not None and (len(self.region) != 4 or min(self.region[2:]) < 1):
            raise InputError(f"a region {self.region}; give x, y, width and height in px")
        if self.fisheye is not None and not (len(self.fisheye) == 3 and self.fisheye[2] > 0):
            raise InputError(f"a fisheye {self.fisheye}; give x and y of its middle and focal length in px")
        if self.pitch_mm is not None and not 0 < self.pitch_mm < math.inf:
            raise RangeError(f"dots {self.pitch_mm} mm apart; give a distance above 0 mm")

    def straightened(self, places: Points) -> Points:
        """Return positions ``[n 2]`` without lens distortion [px]."""
        if self.fisheye is None:
            return places
        *middle, focal = self.fisheye
        away = places - np.array(middle)
        angle = np.hypot(*away.T) / focal
        bounded = np.minimum(angle, MAX_ANGLE)
        return np.array(middle) + away * (np.tan(bounded) / np.maximum(bounded, 1e-9))[:, None]


@parser("skin file", InputError)
def read_skin(path: PathText) -> DottedSkin:
    """Read a skin's description from JSON or TOML with the keys of `DottedSkin`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
        found = tomllib.loads(text) if file.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as e:
        raise InputError(f"{file} is not a skin's description: {e}; give JSON, or TOML named .toml") from e
    known = {field.name for field in fields(DottedSkin)}
    if not isinstance(found, dict) or set(found) - known:
        other = sorted(set(found) - known) if isinstance(found, dict) else type(found).__name__
        raise InputError(f"{file} has {other}; a skin's description has {sorted(known)}")
    try:
        for key in ("region", "fisheye"):
            if found.get(key) is not None:
                found[key] = tuple(found[key])
        return DottedSkin(**found)
    except TypeError as e:
        raise InputError(f"{file}: {e}; lengths are numbers, in px but for pitch_mm") from e


def find_dots(
    frame: Shaped[ndarray, ...], skin: DottedSkin, reference: ControlPoints | None = None
) -> ControlPoints:
    """Return the dots of an 8-bit frame on the skin's lattice, named as in the reference or from 0."""
    if frame.dtype != np.uint8 or not (frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == 3)):
        raise ImageError(f"dots are found in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}")
    grey = np.ascontiguousarray(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY))
    places, sigma = placed_dots(grey, _candidates(grey, skin), skin)
    straight = skin.straightened(places)
    lattices = grow_lattices(straight, skin.kind)
    if not lattices or len(lattices[0].cells) < MIN_DOTS:
        raise ImageError(
            f"{len(places)} dots, fewer than {MIN_DOTS} on a {skin.kind} lattice; check focus, light, and "
            f"{skin}"
        )
    cells, marks = lattices[0].cells, lattices[0].marks
    if reference is not None:
        flat = replace(reference, places=skin.straightened(reference.places))
        cells, marks = named_as(flat, lattices, straight, skin.kind)
    if len(cells) < MIN_DOTS:
        raise ImageError(
            f"{len(cells)} dots lie near the reference's; give a nearer reference of the same skin"
        )
    return ControlPoints(cells, places[marks], sigma[marks])


def _candidates(grey: Shaped[ndarray, "h w"], skin: DottedSkin) -> Points:
    """Pixels of the region in the middle of dot-like patches."""
    found = round_patches(grey, skin.radius_px, skin.colour, skin.min_contrast)
    if skin.region is None:
        return found
    x, y, wide, high = skin.region
    low, end = np.array([max(x, 0), max(y, 0)]), np.array([x + wide, y + high])
    return found[((found >= low) & (found < end)).all(axis=1)]


def round_patches(
    grey: Shaped[ndarray, "h w"], radius_px: float, colour: Literal["dark", "bright"], min_contrast: float
) -> Points:
    """Return the pixels (x, y) ``[n 2]`` at which a round patch differs most from its surroundings.

    Args:
        grey: 8-bit image.
        radius_px: Approximate radius of a patch [px].
        colour: Patches darker or brighter than their ground.
        min_contrast: Contrast relative to the brighter of the two.
    """
    sign = 1.0 if colour == "dark" else -1.0
    image = grey.astype(np.float32)
    width = max(1.0, 0.6 * radius_px)
    smooth = cv2.GaussianBlur(image, (0, 0), width)
    ground = cv2.GaussianBlur(image, (0, 0), 2 * radius_px)
    differs = sign * (ground - smooth)
    xx, yy, xy = (sign * cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (0, 2), (1, 1)))
    round_ = (xx * yy - xy**2) / np.maximum((xx + yy) ** 2, 1e-6)
    reach = 2 * max(1, round(1.2 * radius_px)) + 1
    top = cv2.dilate(differs, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    light = ground if colour == "dark" else smooth
    good = (differs >= top) & (differs > min_contrast * light) & (xx + yy > 0) & (round_ > MIN_ROUND)
    good &= differs > MIN_CONTRAST / 2 * noise_of(image)
    rows, columns = np.nonzero(good)
    return np.stack([columns, rows], axis=1).astype(np.float64)


def placed_dots(
    grey: Shaped[ndarray, "h w"], near: Points, skin: DottedSkin
) -> tuple[Float[ndarray, "m 2"], Float[ndarray, " m"]]:
    """Return centroids and standard errors [px] of the dots present near the given positions."""
    half = int(np.ceil(RING[1] * skin.radius_px))
    high, wide = grey.shape
    # Beyond the frame's edge there is nothing to see: such a dot is left out.
    inside = ((near > half) & (near < np.array([wide, high]) - half - 1)).all(axis=1)
    start = near[inside]
    if not len(start):
        return np.empty((0, 2)), np.empty(0)
    corner = np.rint(start).astype(int) - half
    views = np.lib.stride_tricks.sliding_window_view(grey, (2 * half + 1,) * 2)
    raised = _above_ground(views[corner[:, 1], corner[:, 0]].astype(np.float64), skin, half)
    xy, moved = start.copy(), np.full(len(start), np.inf)
    steps = np.arange(2 * half + 1.0)
    for _ in range(ROUNDS):
        d, w = _weights(xy - corner, steps, WEIGHT * skin.radius_px)
        move = _step(raised, d, w, WEIGHT * skin.radius_px)
        moved = np.hypot(*move.T)
        xy = xy + move * np.minimum(1, 1 / np.maximum(moved, 1e-9))[:, None]
        if not (moved > STILL_PX).any():
            break
    d, w = _weights(xy - corner, steps, WEIGHT * skin.radius_px)
    noise = noise_of(grey.astype(np.float32))
    variance = _variance_by_level(grey)[views[corner[:, 1], corner[:, 0]]]
    sigma = _error(raised, variance, d, w, skin)
    contrast = (w * raised).sum(axis=(1, 2)) / w.sum(axis=(1, 2))
    sound = _is_there(xy - start, moved, contrast, sigma, noise, skin)
    return _one_each(xy[sound], sigma[sound], skin.radius_px)


def _is_there(
    step: Points, moved: np.ndarray, contrast: np.ndarray, sigma: np.ndarray, noise: float, skin: DottedSkin
) -> Bool[ndarray, " n"]:
    near = np.hypot(*step.T) < MAX_MOVE * skin.radius_px
    return near & (moved < 0.1) & (contrast > noise) & (sigma < 0.3 * skin.radius_px)


def _above_ground(patches: np.ndarray, skin: DottedSkin, half: int) -> np.ndarray:
    """Difference of a dot from the plane through its ground."""
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    ring = (np.hypot(x, y) >= RING[0] * skin.radius_px) & (np.hypot(x, y) <= RING[1] * skin.radius_px)
    plane = np.stack([np.ones_like(x), x, y], axis=-1)
    there, basis = patches[:, ring], plane[ring]
    fit = there @ np.linalg.pinv(basis).T
    for _ in range(2):  # once more without what is no ground, such as a neighbour
        off = np.abs(there - fit @ basis.T)
        ground = np.float64(off <= 3 * np.median(off, axis=1, keepdims=True) + 1)
        normal = np.einsum("nk,ki,kj->nij", ground, basis, basis)
        sides = np.einsum("nk,nk,ki->ni", ground, there, basis)
        fit = np.linalg.solve(normal, sides[..., None])[..., 0]
    sign = 1.0 if skin.colour == "dark" else -1.0
    return sign * (np.einsum("nk,yxk->nyx", fit, plane) - patches)


def _weights(away: Points, steps: np.ndarray, width: float) -> tuple[Offsets, np.ndarray]:
    dx, dy = steps - away[:, :1], steps - away[:, 1:]
    w = np.exp(-0.5 * (dy / width) ** 2)[:, :, None] * np.exp(-0.5 * (dx / width) ** 2)[:, None, :]
    return (np.broadcast_to(dx[:, None, :], w.shape), np.broadcast_to(dy[:, :, None], w.shape)), w


def _jacobian(raised: np.ndarray, d: Offsets, w: np.ndarray, width: float) -> np.ndarray:
    """Derivative of the weighted sum of distances by the position ``[n 2 2]``, positive."""
    ws = w * raised
    spread = np.array([[np.einsum("nyx,nyx,nyx->n", ws, p, q) for q in d] for p in d]).transpose(2, 0, 1)
    j = ws.sum(axis=(1, 2))[:, None, None] * np.eye(2) - spread / width**2
    lost = ~(np.linalg.det(j) > 1e-9) | ~(np.trace(j, axis1=1, axis2=2) > 0)
    j[lost] = NO_PEAK * np.eye(2)
    return j


def _step(raised: np.ndarray, d: Offsets, w: np.ndarray, width: float) -> Points:
    sums = np.stack([(w * raised * axis).sum(axis=(1, 2)) for axis in d], axis=1)
    return np.linalg.solve(_jacobian(raised, d, w, width), sums[..., None])[..., 0]


def _error(
    raised: np.ndarray, variance: np.ndarray, d: Offsets, w: np.ndarray, skin: DottedSkin
) -> Float[ndarray, " n"]:
    """Standard error of a centroid from pixel noise; infinite without a peak."""
    j = _jacobian(raised, d, w, WEIGHT * skin.radius_px)
    ww = w * w * variance
    middle = np.array([[np.einsum("nyx,nyx,nyx->n", ww, p, q) for q in d] for p in d]).transpose(2, 0, 1)
    inner, outer = (r * skin.radius_px for r in RING)
    ring_moment = np.pi / 4 * (outer**4 - inner**4)
    by_tilt = (w * (d[0] ** 2 + d[1] ** 2)).sum(axis=(1, 2)) ** 2 / 4 / ring_moment
    middle += (by_tilt * np.median(variance, axis=(1, 2)))[:, None, None] * np.eye(2)
    inverse = np.linalg.inv(j)
    spread = np.einsum("nij,njk,nlk->nil", inverse, middle, inverse)
    error = np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2)
    return np.where(j[:, 0, 0] >= NO_PEAK, np.inf, error)


def _variance_by_level(grey: Shaped[ndarray, "h w"]) -> Float[ndarray, 256]:
    """Noise variance by gray level, a line as for shot noise."""
    rough = np.abs(cv2.filter2D(grey, cv2.CV_32F, LAPLACIAN)) / (6 * HALF_NORMAL_MEDIAN)
    level = cv2.blur(grey, (3, 3))
    square = np.ones((3, 3), np.uint8)
    range_ = cv2.subtract(cv2.dilate(level, square), cv2.erode(level, square))
    flat = range_ <= 4 * np.median(rough) + 2  # no edge of a dot
    x, y, count = [], [], []
    for low in range(0, 256, 16):
        here = (level >= low) & (level < low + 16) & flat
        if here.sum() > MIN_LEVEL:
            x.append(level[here].mean())
            y.append(np.median(rough[here]) ** 2)
            count.append(np.sqrt(here.sum()))
    if not x:
        return np.full(256, max(float(np.median(rough)) ** 2, 1 / 12))
    weight = np.array(count)
    basis = np.stack([np.ones(len(x)), x], axis=1)
    (dark, slope), _ = nnls(basis * weight[:, None], np.array(y) * weight)
    return np.maximum(dark + slope * np.arange(256), 1 / 12)


def _one_each(
    places: Points, sigma: Float[ndarray, " n"], radius_px: float
) -> tuple[Float[ndarray, "m 2"], Float[ndarray, " m"]]:
    """Dots without duplicates of the same position."""
    keep = np.ones(len(places), bool)
    for i, j in sorted(cKDTree(places).query_pairs(radius_px)) if len(places) else ():
        keep[j if sigma[j] >= sigma[i] else i] = False
    return places[keep], sigma[keep]
