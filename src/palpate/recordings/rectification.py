"""Rectification of frames: what a pinhole without distortion would have seen, by maps made once."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from palpate.core import Float32, Image, Lens, Shaped

OUTSIDE_PX = -8.0  # a place outside every image: its pixel becomes black


def exact_maps(
    lens: Lens, onto: Lens | None = None
) -> tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]]:
    """Where in the lens's image each pixel of a rectified one lies: x and y [px].

    Args:
        onto: what is seen instead; None is the lens's `flat`.

    Returns:
        Maps for `cv2.remap`; outside the image where the lens has no answer.
    """
    onto = onto or lens.flat()
    height, width = onto.size_px
    column, row = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    places = lens.project(onto.rays(np.stack([column, row], axis=-1)))
    places = np.where(np.isfinite(places), places, OUTSIDE_PX).astype(np.float32)
    return np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])


@lru_cache(maxsize=8)
def fixed_maps(
    lens: Lens, onto: Lens | None = None
) -> tuple[Shaped[ndarray, "h w 2"], Shaped[ndarray, "h w"]]:
    """The same maps in fixed point, made once for a lens: 1/32 px, which `cv2.remap` reads fastest.

    Returns:
        Maps of CV_16SC2 and CV_16UC1; not to be written to.
    """
    whole, part = cv2.convertMaps(*exact_maps(lens, onto), cv2.CV_16SC2)
    for array in (whole, part):
        array.flags.writeable = False
    return whole, part


def rectified(image: Image, lens: Lens, onto: Lens | None = None) -> Image:
    """The image with straight lines straight; black where the lens saw nothing or has no answer.

    Args:
        image: grey or RGB, of the lens's own size.
        onto: what is seen instead; None is the lens's `flat`, of the same size and scale in the middle.
    """
    lens.check_size(image.shape[:2])
    flat = cv2.remap(
        image, *fixed_maps(lens, onto), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
    )
    return flat.reshape(*flat.shape[:2], *image.shape[2:])
