"""Control points as published for NUSense: quadrilaterals of bright tiles, and midpoints of their corners.

Algorithm 1 of "NUSense: Shear Based Robust Optical Tactile Sensor" (section 3.3.2), step for step. Where text
and algorithm differ, both are kept: contrast is equalised (the algorithm alone says so) and edges become a
mask by a threshold (the text alone). What neither says is a field of `QuadSettings`. Its double loop pairs
each contour with itself and each pair twice; pairs are taken once here, since a set of midpoints holds no
more.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from palpate.core import Float, ImageError, RangeError, Shaped, UInt8, ndarray

Grey = UInt8[ndarray, "h w"]
Quads = Float[ndarray, "q 4 2"]
Points = Float[ndarray, "n 2"]


@dataclass(frozen=True)
class QuadSettings:
    """All numbers of the algorithm; the source gives none of them.

    Attributes:
        pitch_px: side of a tile [px], by which lengths are scaled.
        region: x, y, width and height of the crop [px]; the whole frame without.
        clip_limit, tiles: of CLAHE; its tiles across and down.
        diameter_px, colour_sigma, space_sigma: of the bilateral filter [px, grey levels, px].
        edge_threshold: Sobel gradient beyond which a pixel is an edge [sums of the 3 x 3 masks, grey levels].
        structure_px: side of the square by which edges are dilated, then eroded [px].
        bend: greatest distance of a contour from its quadrilateral, of its length.
        area: smallest and largest area of a quadrilateral, in squares of the pitch.
        c_th: greatest distance between the middles of two quadrilaterals that meet, in pitches: bright tiles
            that meet diagonally are 1.41 apart, the next ones 2.
    """

    pitch_px: float = 24.0
    region: tuple[int, int, int, int] | None = None
    clip_limit: float = 2.0
    tiles: tuple[int, int] = (8, 8)
    diameter_px: int = 9
    colour_sigma: float = 75.0
    space_sigma: float = 75.0
    edge_threshold: float = 60.0
    structure_px: int = 3
    dilations: int = 1
    erosions: int = 1
    bend: float = 0.06
    area: tuple[float, float] = (0.15, 1.5)
    c_th: float = 1.7

    def __post_init__(self) -> None:
        if not (self.pitch_px >= 8 and 1 < self.c_th < 2):
            raise RangeError(
                f"tiles of {self.pitch_px} px and c_th {self.c_th}; tiles are 8 px wide or more, and c_th "
                "lies between 1 and 2 pitches, as tiles that meet are 1.41 apart"
            )


@dataclass(frozen=True, eq=False)
class PublishedStages:
    """Pictures and points of every step, in the crop.

    Attributes:
        pictures: cropped, grey, equalised, filtered, edges, thresholded, dilated, eroded, in this order.
        quads: corners of the bright tiles' quadrilaterals ``[q 4 2]`` [px].
        midpoints: control points ``[n 2]`` [px], in the frame.
    """

    pictures: dict[str, Shaped[ndarray, ...]]
    quads: Quads
    midpoints: Points


def published_stages(frame: Shaped[ndarray, ...], settings: QuadSettings | None = None) -> PublishedStages:
    """Each step of Algorithm 1 on an undistorted frame, with its double loop over quadrilaterals.

    Args:
        frame: 8-bit RGB ``[h w 3]`` or grey ``[h w]``.
        settings: the numbers; the defaults if not given.
    """
    own = settings or QuadSettings()
    cropped = _cropped(frame, own)
    grey = cropped if cropped.ndim == 2 else cv2.cvtColor(cropped, cv2.COLOR_RGB2GRAY)
    equalised = cv2.createCLAHE(own.clip_limit, own.tiles).apply(grey)
    filtered = cv2.bilateralFilter(equalised, own.diameter_px, own.colour_sigma, own.space_sigma)
    gx, gy = (cv2.Sobel(filtered, cv2.CV_64F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    edges = np.hypot(gx, gy)
    mask = np.where(edges > _between(own.edge_threshold), 255, 0).astype(np.uint8)
    square = np.ones((own.structure_px,) * 2, np.uint8)
    dilated = cv2.dilate(mask, square, iterations=own.dilations)
    eroded = cv2.erode(dilated, square, iterations=own.erosions)
    contours, _ = cv2.findContours(255 - eroded, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    light = cv2.blur(filtered, (int(3 * own.pitch_px) | 1,) * 2)
    quads: list[np.ndarray] = []
    for contour in contours:
        corners = cv2.approxPolyDP(contour, own.bend * cv2.arcLength(contour, True), True)
        if len(corners) == 4 and _is_tile(corners, own) and _is_bright(corners, filtered, light):
            quads.append(corners[:, 0].astype(np.float64))
    midpoints = midpoints_by_pairs(quads, own.c_th * own.pitch_px)
    named = ("cropped", "grey", "equalised", "filtered", "edges", "thresholded", "dilated", "eroded")
    shown = np.clip(edges / 4, 0, 255).astype(np.uint8)
    pictures = dict(
        zip(named, (cropped, grey, equalised, filtered, shown, mask, dilated, eroded), strict=True)
    )
    return PublishedStages(pictures, np.array(quads).reshape(-1, 4, 2), midpoints + _origin(own))


def midpoints_by_pairs(quads: list[np.ndarray], c_th_px: float) -> Points:
    """Midpoints of the nearest corners of each two quadrilaterals, by a loop over both.

    Args:
        quads: four corners of each ``[4 2]`` [px].
        c_th_px: greatest distance of their middles [px].
    """
    middles = [quad.mean(axis=0) for quad in quads]
    found = []
    for i in range(len(quads)):
        for j in range(i + 1, len(quads)):
            if np.linalg.norm(middles[i] - middles[j]) <= c_th_px:
                apart = np.linalg.norm(quads[i][:, None] - quads[j][None], axis=2)
                a, b = np.unravel_index(apart.argmin(), apart.shape)
                found.append((quads[i][a] + quads[j][b]) / 2)
    return np.array(found, np.float64).reshape(-1, 2)


def _cropped(frame: Shaped[ndarray, ...], own: QuadSettings) -> Shaped[ndarray, ...]:
    if frame.dtype != np.uint8 or not (frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == 3)):
        raise ImageError(
            f"quadrilaterals are found in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}"
        )
    x, y, width, height = own.region or (0, 0, frame.shape[1], frame.shape[0])
    if min(x, y) < 0 or min(width, height) < 1 or x + width > frame.shape[1] or y + height > frame.shape[0]:
        raise ImageError(
            f"a region of {width} x {height} px at ({x}, {y}) in a frame of {frame.shape[1]} x "
            f"{frame.shape[0]} px; give one that lies within it"
        )
    return np.ascontiguousarray(frame[y : y + height, x : x + width])


def _origin(own: QuadSettings) -> Float[ndarray, " 2"]:
    return np.array(own.region[:2] if own.region else (0, 0), np.float64)


def _between(threshold: float) -> float:
    """A threshold that no root of a whole number equals, and so does not depend on how it is rounded."""
    return float(np.sqrt(np.floor(threshold**2) + 0.5))


def _is_tile(corners: np.ndarray, own: QuadSettings) -> bool:
    area = cv2.contourArea(corners) / own.pitch_px**2
    return own.area[0] <= area <= own.area[1] and cv2.isContourConvex(corners)


def _is_bright(corners: np.ndarray, filtered: Grey, light: Grey) -> bool:
    """Whether a quadrilateral is brighter than what lies around it: the source draws yellow tiles alone."""
    x, y = corners.sum(axis=(0, 1)) // 4
    return bool(filtered[y, x] > light[y, x])
