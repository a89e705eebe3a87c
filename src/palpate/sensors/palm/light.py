"""Light that is not as at set-up: a lamp of another colour, and room light that gets into the housing."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy import ndarray

from palpate.core.shapes import Float, Float32
from palpate.optics.colour import Spectrum

SECOND_RADIATION_M_K = 1.438777e-2
"""Planck's c2 = hc/k [m K]."""

ROOM_FALL = 0.4
"""By how much less room light there is at the frame's lower right than at its upper left. Assumed."""


def lamp_tint(mired: float, spectrum: Spectrum) -> Float32[ndarray, " 3"]:
    """Each channel's light under a warmer or colder lamp, over that of the lamp the camera is balanced to.

    The lamp's spectrum is multiplied by exp(-c2 m / lambda), which moves a black body of any temperature T to
    1 / (1/T + m), in Wien's approximation. Green is kept, as an exposure set anew would.

    Args:
        mired: m, the change of 1e6 K over the colour temperature; positive is warmer.
        spectrum: of lamp and camera.
    """
    filtered = np.exp(-SECOND_RADIATION_M_K * mired * 1e-6 / spectrum.wavelength_m) @ spectrum.weight
    return np.asarray(filtered / filtered[1], dtype=np.float32)


@lru_cache(maxsize=4)
def room_light(frame_px: tuple[int, int]) -> Float32[ndarray, "h w 1"]:
    """Over the whole frame: 1 in its upper left corner, falling gently to the lower right."""
    across, down = (np.linspace(0, ROOM_FALL / 2, size, dtype=np.float32) for size in frame_px)
    return np.asarray((1 - down[:, None] - across)[..., None])


def in_box(shade: Float[ndarray, "h w 1"], box_px: tuple[int, int, int, int]) -> Float32[ndarray, "u v 1"]:
    """What of it lies in a region of the frame."""
    x, y, w, h = box_px
    return shade[y : y + h, x : x + w]
