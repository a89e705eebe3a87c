"""Imperfections of the views: dirt and texture under the mirror's view, and glare. All sizes are assumed.

Dirt and texture dim what the mirror shows at fixed positions. Glare adds lamp light at fixed image positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from palpate.core import Float32, InputError, RangeError, ndarray

if TYPE_CHECKING:
    from palpate.sensors.palm.palm_spec import PalmSpec, View

MAX_SPECKS = 500
MAX_SPOTS = 20
SPECK_DIMS = 0.6  # light lost in the middle of the darkest speck; others lose at least 0.3 of it (assumed)
FRINGES, MIRROR = 0, 1  # random streams of the two regions

Grey = Float32[ndarray, "h w"]
Light = Float32[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class MirrorDirt:
    """Dust and texture in the mirror's view.

    Attributes:
        specks: Number of dust specks, 0 to 500.
        speck_m: Half-strength radius of the largest speck [m]; others have at least 0.3 of it.
        texture: Rms relative change of brightness by a mottled surface, 0 to 0.3.
        texture_m: Correlation length of the texture [m].
    """

    specks: int = 0
    speck_m: float = 0.4e-3
    texture: float = 0.0
    texture_m: float = 2e-3
    seed: int = 0

    def __post_init__(self) -> None:
        _check_whole("specks", self.specks, MAX_SPECKS)
        sizes = 1e-5 <= self.speck_m <= 1e-2 and 2e-4 <= self.texture_m <= 0.1
        if not (sizes and 0 <= self.texture <= 0.3):
            raise RangeError(
                f"dirt of specks to {self.speck_m} m and texture {self.texture} over {self.texture_m} m; "
                "give 1e-5 to 1e-2 m, 0 to 0.3 and 2e-4 to 0.1 m",
                code="dirt-range",
            )


@dataclass(frozen=True, slots=True)
class Glare:
    """Reflections of the lamp in both regions.

    Attributes:
        spots: Number in each region, 0 to 20.
        peak: Maximum light of the brightest spot over the lamp's maximum; others have at least 0.3 of it.
        width_m: Standard deviation of the widest spot on the membrane [m]; others have at least 0.3 of it.
    """

    spots: int = 0
    peak: float = 0.1
    width_m: float = 1.5e-3
    seed: int = 0

    def __post_init__(self) -> None:
        _check_whole("spots", self.spots, MAX_SPOTS)
        if not (0 <= self.peak <= 10 and 1e-5 <= self.width_m <= 0.1):
            raise RangeError(
                f"glare of {self.peak} and {self.width_m} m; give 0 to 10 over the lamp's, and 1e-5 to 0.1 m",
                code="glare-range",
            )


def _check_whole(name: str, value: int, greatest: int) -> None:
    if not (isinstance(value, int) and 0 <= value <= greatest):
        raise InputError(f"{name} are {value!r}; give a whole number, 0 to {greatest}", code="spot-count")


def dirt_over(spec: PalmSpec) -> Grey:
    """Return the transmission of dirt and texture in the mirror's region."""
    sine = math.sin(spec.mirror_elevation_rad)
    return _dirt(spec.dirt, spec.mirror, sine, spec.radius_m)


@lru_cache(maxsize=8)
def _dirt(dirt: MirrorDirt, view: View, sine: float, radius_m: float) -> Grey:
    x, y = np.meshgrid(view.x_m, view.down_m / sine)
    left = np.ones(x.shape)
    for across, down, size, strength in np.random.default_rng([dirt.seed, 0]).uniform(size=(dirt.specks, 4)):
        radius = dirt.speck_m * (0.3 + 0.7 * size)
        away2 = (x - radius_m * (2 * across - 1)) ** 2 + (y - radius_m * (2 * down - 1)) ** 2
        left *= 1 - SPECK_DIMS * (0.3 + 0.7 * strength) * 0.5 ** (away2 / radius**2)
    if dirt.texture:
        left *= np.maximum(1 + dirt.texture * mottled(dirt, x, y, radius_m), 0.0)
    return np.asarray(left, np.float32)


def mottled(dirt: MirrorDirt, x_m: ndarray, y_m: ndarray, radius_m: float) -> ndarray:
    """Return the texture at positions on the underside, with zero mean and unit variance
    over many membranes.
    """
    half = math.ceil(1.2 * radius_m / dirt.texture_m) + 2
    knots = np.random.default_rng([dirt.seed, 1]).standard_normal((2 * half + 1, 2 * half + 1))
    at = np.stack([y_m / dirt.texture_m + half, x_m / dirt.texture_m + half])
    # Linear interpolation between independent knots loses variance, which is restored here.
    share = at - np.floor(at)
    kept = np.prod(share**2 + (1 - share) ** 2, axis=0)
    return np.asarray(map_coordinates(knots, at, order=1, mode="nearest") / np.sqrt(kept))


def glare_in(glare: Glare, view: View, stream: int) -> Grey:
    """Return the light that reflections add in one region, over the lamp's maximum."""
    return _glare(glare, view, stream)


@lru_cache(maxsize=8)
def _glare(glare: Glare, view: View, stream: int) -> Grey:
    x, z = view.x_m[None, :], view.down_m[:, None]
    light = np.zeros((view.size_px[1], view.size_px[0]))
    drawn = np.random.default_rng([glare.seed, stream]).uniform(size=(glare.spots, 5))
    for across, down, strength, wide, high in drawn:
        at_x, at_z = (
            axis.min() + (axis.max() - axis.min()) * part for axis, part in ((x, across), (z, down))
        )
        sx, sz = (glare.width_m * (0.3 + 0.7 * part) for part in (wide, high))
        shape = np.exp(-(((x - at_x) / sx) ** 2 + ((z - at_z) / sz) ** 2) / 2)
        light += glare.peak * (0.3 + 0.7 * strength) * shape
    return light.astype(np.float32)


def registered(light: Light, view: View) -> Light:
    """Return a region's image rotated and translated as its view specifies."""
    if not (view.turn_rad or any(view.shift_px)):
        return light
    (cx, cy), c, s = view.middle_px, math.cos(view.turn_rad), math.sin(view.turn_rad)
    middle = np.array([cx - 0.5, cy - 0.5])
    turn = np.array([[c, -s], [s, c]])
    move = np.column_stack([turn, middle - turn @ middle + np.array(view.shift_px)])
    return np.asarray(
        cv2.warpAffine(light, move, view.size_px, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )
