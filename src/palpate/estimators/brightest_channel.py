"""The brightest colour of every pixel, as most estimators of coloured patterns begin with it."""

from __future__ import annotations

from functools import reduce

import numpy as np

from palpate.core import Shaped, ndarray


def brightest_channel(image: Shaped[ndarray, ...]) -> Shaped[ndarray, "h w"]:
    """Return the greatest channel of every pixel; an image ``[h w]`` is returned as it is."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(reduce(np.maximum, np.moveaxis(image, 2, 0)))
