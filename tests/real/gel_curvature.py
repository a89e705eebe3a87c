"""Curvature of the bulge in a coated gel that is lit by lamps of several colours from its sides.

A camera behind an opaque, evenly coated gel sees slopes as colour: where the coat leans towards a lamp, that
lamp's colour grows. With h the height of the bulge towards the camera and l_k the direction of lamp k in the
image,

    dI_k = c - g l_k . grad h,

c common to all colours. Under an object of radius R that is stiff, h falls as r^2 / 2R from the middle, and
every colour's change is a plane that rises towards its lamp with g / R. In Hertz's contact of gel and object
the gel takes the share 1/E_g over 1/E_g + 1/E_o of the approach, so

    curvature = g / R * E_o / (E_o + E_g)

whatever the force: a soft object flattens instead of bulging the gel. The coat hides the object's own colour.

Where the contact is smaller than the region, wider than the gel, or as wide as the gel is thick, the
curvature changes with force after all, and only touches at equal force compare.

Reference, for shape from coloured light: M. K. Johnson, E. H. Adelson, Retrographic sensing for the
measurement of surface texture and shape, CVPR (2009), doi:10.1109/CVPR.2009.5206534.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, ImageError, InputError, Shaped, ndarray

WHITE = 255
MAX_CLIPPED = 0.01  # of the region's pixels, in one colour
MIN_PX = 8  # a side of the region
MIN_APART = 1e-3  # of lamps, below which no slope is told from even light

Image = Shaped[ndarray, "..."]  # [h w c], which `bulge` checks


@dataclass(frozen=True)
class Lamps:
    """Directions that the light of each colour comes from, in the order of the image's channels.

    Attributes:
        towards: unit vectors (x along columns, y along rows downwards) from the gel's middle to each lamp.
    """

    towards: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if not np.allclose(np.hypot(*np.transpose(self.towards)), 1.0, atol=1e-6):
            raise InputError(f"directions to lamps are unit vectors (x, y), got {self.towards}")
        if self.apart < MIN_APART:
            raise InputError("all lamps stand on one side; slopes are seen by colours from different sides")

    @property
    def apart(self) -> float:
        """1 less the squared length of their mean: 1 for lamps all around, 0 for all on one side."""
        return float(1 - np.sum(np.mean(self.towards, axis=0) ** 2))


@dataclass(frozen=True)
class ImprintRegion:
    """A rectangle of pixels: first column and row, width and height [px]."""

    x: int
    y: int
    w: int
    h: int


def bulge(untouched: Image, touched: Image, region: ImprintRegion, lamps: Lamps) -> float:
    """Mean curvature of the bulge over a region, times the light's gain [white / px].

    Args:
        untouched, touched: colour images of one size, 8 bits, channels in the lamps' order.
        region: of the gel's middle, away from its lit edges.
        lamps: of every channel.

    Returns:
        Positive where the gel bulges towards the camera; comparable between touches of one sensor only, since
        the gain is not known.

    Raises:
        ImageError: images that are no such pair, or clipped in the region.
        InputError: a region that is too small or leaves the image.
    """
    before, after = (_cut(image, region, lamps) for image in (untouched, touched))
    if np.shape(untouched) != np.shape(touched):
        raise ImageError(f"images of {np.shape(untouched)} and {np.shape(touched)}; give one size")
    planes = _slopes((after - before) / WHITE)
    own = planes - planes.mean(axis=0)  # what all colours share is no slope
    return float((own * np.asarray(lamps.towards)).sum(axis=1).mean() / lamps.apart)


def _cut(image: Image, region: ImprintRegion, lamps: Lamps) -> Float[ndarray, "h w c"]:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != len(lamps.towards):
        raise ImageError(
            f"an image of {list(image.shape)} {image.dtype}; give [h w {len(lamps.towards)}] of uint8, a "
            "channel a lamp"
        )
    x, y, w, h = region.x, region.y, region.w, region.h
    if min(w, h) < MIN_PX or min(x, y) < 0 or x + w > image.shape[1] or y + h > image.shape[0]:
        raise InputError(
            f"a region of {w} x {h} px at ({x}, {y}) in an image of {image.shape[1]} x {image.shape[0]} px; "
            f"inside it, {MIN_PX} px or more a side"
        )
    cut = image[y : y + h, x : x + w]
    clipped = ((cut == 0) | (cut == WHITE)).mean(axis=(0, 1)).max()
    if clipped > MAX_CLIPPED:
        raise ImageError(
            f"{clipped:.0%} of the region is black or white in one colour; slopes are lost there: set the "
            "exposure anew, or take a smaller region"
        )
    return cut.astype(np.float64)


def _slopes(change: Float[ndarray, "h w c"]) -> Float[ndarray, "c 2"]:
    """Slopes of the plane through every channel, along x and y [1/px]."""
    h, w, _ = change.shape
    x, y = (np.arange(n) - (n - 1) / 2 for n in (w, h))
    along_x = np.einsum("ijc,j->c", change, x) / (h * (x**2).sum())
    along_y = np.einsum("ijc,i->c", change, y) / (w * (y**2).sum())
    return np.stack([along_x, along_y], axis=1)
