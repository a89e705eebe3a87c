"""Images as brightness in [0, 1], and its derivatives over the eight-measurement cube of Horn and Schunck.

The smoothness weight alpha of the flow has the unit of a brightness difference, so it means nothing before
the scale of brightness is fixed: here black is 0 and the greatest value of the image's type is 1.

Reference: B. K. P. Horn, B. G. Schunck, Determining optical flow, Artificial Intelligence 17 (1981) 185-203,
doi:10.1016/0004-3702(81)90024-2, sections 7 and 8.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import ImageError, InputError
from palpate.core.shapes import Float, Shaped

WHITE = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}

Grey = Shaped[ndarray, "..."]  # [h w], which `brightness` checks: refusals are ours, with what to do
Brightness = Float[ndarray, "h w"]


def brightness(image: Grey) -> Brightness:
    """The image in double precision, black 0 and white 1.

    Raises:
        ImageError: not a grey image of 8 or 16 bits, nor one of floats in [0, 1].
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 2:
        raise ImageError(f"flow is of grey images [h w] of 2 x 2 px or more, got {list(image.shape)}")
    if image.dtype in WHITE:
        return image / WHITE[image.dtype]
    if not np.issubdtype(image.dtype, np.floating):
        raise ImageError(f"grey images are of uint8, uint16 or floats in [0, 1], got {image.dtype}")
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1):
        raise ImageError("an image of floats holds brightness in [0, 1], black to white; divide by its white")
    return image.astype(np.float64)


def check_pair(first: Grey, second: Grey) -> None:
    """Raise unless the two are of one shape and type."""
    if first.shape != second.shape or first.dtype != second.dtype:
        raise InputError(
            f"flow is between two images of one size and type, got {list(first.shape)} {first.dtype} and "
            f"{list(second.shape)} {second.dtype}"
        )


def derivatives(first: Brightness, second: Brightness) -> tuple[Brightness, Brightness, Brightness]:
    """E_x, E_y and E_t [1/px, 1/px, 1/frame], each the mean of four differences along the cube's edges.

    The cube stands between the pixels (r, c), (r+1, c), (r, c+1), (r+1, c+1) and the two frames, so the
    derivatives are half a pixel right of and below the pixel they are stored at. x is along columns, y along
    rows, downwards; beyond the border the last row and column are repeated.
    """
    a, b = (np.pad(image, ((0, 1), (0, 1)), mode="edge") for image in (first, second))
    cube = np.stack([a, b])
    across = cube[:, :, 1:] - cube[:, :, :-1]
    down = cube[:, 1:] - cube[:, :-1]
    later = b - a
    e_x = (across[:, :-1] + across[:, 1:]).sum(axis=0) / 4
    e_y = (down[:, :, :-1] + down[:, :, 1:]).sum(axis=0) / 4
    e_t = (later[:-1, :-1] + later[:-1, 1:] + later[1:, :-1] + later[1:, 1:]) / 4
    return e_x, e_y, e_t
