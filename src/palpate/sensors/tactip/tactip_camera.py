"""Grey images of the markers in the tip: refraction at the window, projection, discs, and noise."""

from __future__ import annotations

import math
from typing import no_type_check

import numba
import numpy as np

from palpate.core import Float, UInt8, ndarray
from palpate.sensors.tactip.tactip_spec import TacTipCamera

ITERATIONS = 30
SETTLED = 1e-15  # convergence of the tangent

Places = Float[ndarray, "p 3"]
Points = Float[ndarray, "p 2"]


def slopes(r: ndarray, depth: ndarray, air: float, index: float) -> ndarray:
    """Return the tangent at which the camera sees a point at r, `depth` below a window `air` below it.

    Snell's law: r = depth tan g + air tan a, sin a = index sin g, by Newton's method on tan a.
    """
    t = r / (depth + air)
    for _ in range(ITERATIONS):
        sin_g = t / np.sqrt(1 + t**2) / index
        tan_g = sin_g / np.sqrt(1 - sin_g**2)
        slope = (1 + tan_g**2) ** 1.5 / (index * (1 + t**2) ** 1.5)
        step = (depth * tan_g + air * t - r) / (depth * slope + air)
        t = t - step
        if np.abs(step).max(initial=0.0) < SETTLED:
            break
    return t


def projected(markers_m: Places, camera: TacTipCamera, base_m: float) -> tuple[Points, Float[ndarray, " p"]]:
    """Return the directions (tangents along x and y) of the markers, and the local scale [1/m]."""
    x, y, z = markers_m.T
    r, depth, air = np.hypot(x, y), base_m - z, camera.height_m - base_m
    t = slopes(r, depth, air, camera.gel_index)
    share = np.divide(t, r, out=1 / (depth / camera.gel_index + air), where=r > 1e-9)
    return np.stack([x * share, y * share], axis=-1), share


def rendered(
    points_px: Points,
    radius_px: Float[ndarray, " p"],
    camera: TacTipCamera,
    rng: np.random.Generator,
    light: float = 1.0,
) -> UInt8[ndarray, "h w"]:
    """Return one grey frame of bright discs with noise."""
    image = np.full((camera.size_px, camera.size_px), camera.dark * light, np.float64)
    _discs(image, points_px, radius_px, camera.dark * light, camera.bright * light, camera.edge_px)
    image += camera.noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _discs(image, points, radius, dark, bright, edge):
    h, w = image.shape
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        reach = int(radius[i] + edge) + 1
        for r in range(max(0, int(y) - reach), min(h, int(y) + reach + 2)):
            for c in range(max(0, int(x) - reach), min(w, int(x) + reach + 2)):
                share = (radius[i] - math.hypot(c - x, r - y)) / edge + 0.5
                if share > 0:
                    image[r, c] = max(image[r, c], dark + min(share, 1.0) * (bright - dark))
