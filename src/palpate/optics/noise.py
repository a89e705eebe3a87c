"""What a camera adds: uneven light, photons that come one by one, read-out and steps."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.core.shapes import Float, Float32, UInt16

Electrons = Float[ndarray, "*n"]


def illumination(
    height: int, width: int, corner_loss: float, centre: tuple[float, float] = (0.5, 0.5)
) -> Float32[ndarray, "h w"]:
    """Light over the image, fixed to the camera: 1 at the centre, falling with the square of the distance.

    Args:
        height: of the image [px].
        width: of the image [px].
        corner_loss: share of the light lost at half the image's diagonal from the centre, 0 to 1.
        centre: of the light, in shares of the height and of the width.

    Raises:
        RangeError: the loss lies outside 0 to 1.
    """
    if not 0.0 <= corner_loss <= 1.0:
        raise RangeError(f"corner loss {corner_loss} lies outside 0 to 1")
    rows = np.arange(height) + 0.5 - centre[0] * height
    columns = np.arange(width) + 0.5 - centre[1] * width
    share = (rows[:, None] ** 2 + columns**2) / ((height**2 + width**2) / 4)
    return np.maximum(1 - corner_loss * share, 0).astype(np.float32)


def electrons(mean: Electrons, read_noise_e: float, rng: np.random.Generator) -> Float32[ndarray, "*n"]:
    """One exposure: shot and read noise together as one Gaussian of variance mean + read^2.

    The first two moments are exact. The third, which a Gaussian lacks, is mean / (mean + read^2)^1.5 standard
    deviations cubed: below 0.15 from 45 electrons on.

    Args:
        mean: expected electrons, not negative.
        read_noise_e: standard deviation of the read-out [electrons].
        rng: the only source of chance.
    """
    spread = np.sqrt(mean + np.float32(read_noise_e**2), dtype=np.float32)
    spread *= rng.standard_normal(mean.shape, dtype=np.float32)
    spread += mean
    return spread


def electrons_exact(mean: Electrons, read_noise_e: float, rng: np.random.Generator) -> Electrons:
    """The slow reference for `electrons`: Poisson's photons and a Gaussian read-out."""
    return rng.poisson(mean) + read_noise_e * rng.standard_normal(mean.shape)


def quantise(counts: Electrons, full_well_e: float, bits: int) -> UInt16[ndarray, "*n"]:
    """The converter's codes: 0 at no electrons, 2^bits - 1 at the full well, clipped at both ends."""
    top = 2**bits - 1
    return np.clip(np.rint(counts * np.float32(top / full_well_e)), 0, top).astype(np.uint16)
