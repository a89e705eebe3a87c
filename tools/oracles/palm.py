"""The palm as a whole: its two ways, its slices, its two mechanics, its mirror, its chance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy import ndarray

from oracles import Oracle
from palpate.core import Pose, Probe
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec, fringe_view, mirror_view

SMALL = palm.small()
GRID_MM = tuple((x, y) for x in range(-21, 22, 7) for y in range(-21, 22, 7) if x**2 + y**2 <= 23.5**2)
"""The report's 37 points: a square grid, as far as a 10 mm ball stays on a 57 mm disc. Its pitch is not
printed: 6.6 to 7.4 mm give 37 points, and 7 mm is assumed."""


def inside(light: ndarray, spec: PalmSpec, depth_m: float) -> ndarray:
    """Of the fringe view, rows in the membrane below the dimple."""
    down = spec.fringes.down_m
    return light[(down > depth_m) & (down < spec.thickness_m)][..., :3]


def slices(depth_m: float) -> float:
    """Light with twice the slices, 999 of 1000 pixels below the dimple."""
    one, two = (
        fringe_view.march_fringes(SMALL, depth_m, 0.0, 0.0, n)
        for n in (fringe_view.SLICES, 2 * fringe_view.SLICES)
    )
    return float(np.quantile(np.abs(inside(one - two, SMALL, depth_m)), 0.999))


def bands() -> float:
    """Light with twice the bands, 999 of 1000 pixels, at 5 mm."""
    one, two = (fringe_view.march_fringes(replace(SMALL, bands=n), 5e-3, 0.0, 0.0) for n in (31, 62))
    return float(np.quantile(np.abs(inside(one - two, SMALL, 5e-3)), 0.999))


def two_ways(x_m: float, y_m: float) -> float:
    """Root mean square of what the fast way differs from the exact one by at 3 mm, below the dimple."""
    contact = palm.press(SMALL, Pose(x_m, y_m, 3e-3))
    fast, exact = (palm.render_clean(contact, SMALL, exact=which)[0] for which in (False, True))
    return float(np.sqrt(np.mean(inside(fast - exact, SMALL, 3e-3) ** 2)))


def two_mechanics() -> float:
    """A ball at 0.3 mm: the finite-strain table with its march, against linear layers with theirs; rms."""
    pose = Pose(0.0, 0.0, 0.3e-3)
    nearly_still = palm.press(
        SMALL, pose, Probe("sphere", 5e-3), (1e-6, 0.0)
    )  # a lateral load asks for layers
    linear, _ = palm.render_clean(nearly_still, SMALL)
    finite, _ = palm.render_clean(palm.press(SMALL, pose), SMALL, exact=True)
    return float(np.sqrt(np.mean(inside(linear - finite, SMALL, 0.6e-3) ** 2)))


def mirrored() -> float:
    """A contact on the right is that on the left, mirrored, at a polariser of 45 degrees."""
    left, right = (fringe_view.march_fringes(SMALL, 3e-3, x, 2e-3) for x in (-6e-3, 6e-3))
    return float(np.abs(inside(left - right[:, ::-1], SMALL, 3e-3)).max())


def under_the_ball() -> float:
    """Pixels between where the mirror shows the ball's lowest point and where Snell's law puts it."""
    spec, depth, at = palm.palm(), 3e-3, (4e-3, -3e-3)
    grey = mirror_view.trace_mirror(spec, depth, *at)
    lean = math.asin(math.cos(spec.mirror_elevation_rad) / spec.refractive_index)
    enters = at[1] + (spec.thickness_m - depth) * math.tan(lean)
    wanted = np.array([at[0], enters * math.sin(spec.mirror_elevation_rad)]) / spec.mirror.pitch_m
    x, down = np.meshgrid(spec.mirror.x_m, spec.mirror.down_m)
    near = np.hypot(x / spec.mirror.pitch_m - wanted[0], down / spec.mirror.pitch_m - wanted[1]) < 60
    brightest = near & (grey > 0.995 * grey[near].max())
    found = np.array([x[brightest].mean(), down[brightest].mean()]) / spec.mirror.pitch_m
    return float(np.hypot(*(found - wanted)))


def chance() -> float:
    """Grey levels between two frames drawn with the same seed."""
    contact = palm.press(SMALL, Pose(3e-3, 2e-3, 2e-3))
    one, two = (palm.render(contact, SMALL, np.random.default_rng(7)).image for _ in range(2))
    return float(np.abs(one.astype(int) - two).max())


ORACLES = (
    Oracle("Slices, 3 mm: light of 999 in 1000 pixels", "twice as many", 3.9e-3, lambda: slices(3e-3)),
    Oracle("Slices, 5 mm: light of 999 in 1000 pixels", "twice as many", 3.9e-3, lambda: slices(5e-3)),
    Oracle("Bands, 5 mm: light of 999 in 1000 pixels", "62 for 31", 1e-3, bands),
    Oracle(
        "Fast way, contact in the middle, 3 mm: light, rms", "the exact way", 1e-2, lambda: two_ways(0.0, 0.0)
    ),
    Oracle(
        "Fast way, 14 mm to the side, 3 mm: light, rms", "the exact way", 1e-2, lambda: two_ways(14e-3, 0.0)
    ),
    Oracle("Table and its march, 0.3 mm: light, rms", "linear layers and theirs", 5e-3, two_mechanics),
    Oracle("A contact to the right", "to the left, mirrored", 1e-4, mirrored),
    Oracle("Mirror: the ball's lowest point, px", "Snell's law", 1.0, under_the_ball),
    Oracle("Two frames of one seed, grey levels", "each other", 0.0, chance),
)
