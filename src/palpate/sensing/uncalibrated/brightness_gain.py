"""Brightness of a frame over that of the untouched sensor, which a touch hardly moves."""

from __future__ import annotations

import numpy as np

from palpate.core import Float, Shaped, ndarray

Box = tuple[int, int, int, int]

MIN_LIT = 8.0  # grey levels: darker pixels tell nothing of a change of brightness
SATURATED = 250.0  # grey levels
EVERY = 4  # pixel along each axis that tells it
MIN_PX = 12
MIN_GAIN, MAX_GAIN = 0.05, 20.0  # that is told


class BrightnessGain:
    """Median over lit pixels, each channel by itself.

    Args:
        mean: the untouched sensor ``[h w c]`` [grey levels].
        but: x, y, width and height of what does not tell it, as a part that a touch lights [px].
    """

    def __init__(self, mean: Shaped[ndarray, "h w c"], but: Box | None = None) -> None:
        lit = (mean > MIN_LIT) & (mean < SATURATED)
        if but is not None:
            x, y, wide, high = but
            lit[y : y + high, x : x + wide] = False
        lit = lit[::EVERY, ::EVERY]
        some = mean[::EVERY, ::EVERY]
        self._lit = [np.nonzero(lit[..., c]) for c in range(mean.shape[2])]
        self._levels = [some[..., c][which] for c, which in enumerate(self._lit)]

    def of(self, picture: Shaped[ndarray, "h w c"]) -> Float[ndarray, " c"]:
        """Brightness over the untouched sensor's; 1 where too little is lit."""
        some = picture[::EVERY, ::EVERY]
        pairs = ((some[..., c][which], self._levels[c]) for c, which in enumerate(self._lit))
        gains = [float(np.median(now / then)) if len(then) > MIN_PX else 1.0 for now, then in pairs]
        return np.clip(np.array(gains), MIN_GAIN, MAX_GAIN)
