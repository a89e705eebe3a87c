"""Order of color channels: whether a frame has red where the calibration's frames have blue.

Red less blue is compared with that of the reconstruction from calibration frames, before and after regression
on brightness (another lamp). Both must agree, and the frame exchanged back must be typical.
"""

from __future__ import annotations

import numpy as np

from palpate.core import Float, Float32

# of the frame's difference of red and blue on that of its reconstruction: 1 is the same, -1 exchanged
MAX_SLOPE = -0.3
MAX_CORRELATION = -0.3  # between both after brightness is taken out
# root mean square of what remains then, below which a picture has too little colour to tell
MIN_COLOUR_GREY_LEVELS = 1.0

Picture = Float32[np.ndarray, "h w c"]


def channels_exchanged(picture: Picture, rebuilt: Picture) -> bool:
    """Whether red and blue seem exchanged relative to the reconstruction [gray levels]."""
    if picture.shape[2] != 3:
        return False
    seen, known = _red_less_blue(picture), _red_less_blue(rebuilt)
    pure, pure_known = _beside_brightness(seen, picture), _beside_brightness(known, rebuilt)
    size, size_known = _size(pure), _size(pure_known)
    if min(size, size_known) < MIN_COLOUR_GREY_LEVELS:
        return False
    slope = float(seen @ known) / float(known @ known)
    correlation = float(pure @ pure_known) / (size * size_known * len(seen))
    return slope < MAX_SLOPE and correlation < MAX_CORRELATION


def colour_size(picture: Picture) -> float:
    """Return the RMS of red less blue [gray levels]."""
    return _size(_red_less_blue(picture))


def _red_less_blue(picture: Picture) -> Float[np.ndarray, " n"]:
    return np.asarray(picture[..., 0] - picture[..., 2], np.float64).ravel()


def _beside_brightness(difference: Float[np.ndarray, " n"], picture: Picture) -> Float[np.ndarray, " n"]:
    """Residual of a difference after linear regression on brightness."""
    bright = picture.mean(axis=2, dtype=np.float64).ravel()
    bright -= bright.mean()
    difference = difference - difference.mean()
    square = float(bright @ bright)
    return np.asarray(difference - (float(difference @ bright) / square * bright if square else 0.0))


def _size(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
