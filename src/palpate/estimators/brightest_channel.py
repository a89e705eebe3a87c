"""The brightest colour of every pixel, as most estimators of coloured patterns begin with it."""

from __future__ import annotations

from functools import reduce

import numpy as np

from palpate.core import Shaped, ndarray


def brightest_channel(image: Shaped[ndarray, ...]) -> Shaped[ndarray, "h w"]:
    """Greatest of the channels of every pixel, of an image ``[h w c]``; of one ``[h w]`` the image itself.

    Channel by channel, which takes a tenth of the time of a maximum over the last axis.
    """
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(reduce(np.maximum, np.moveaxis(image, 2, 0)))
