"""Light touch of a rigid non-axisymmetric probe by linear layers, which the tables' bricks do not resolve.

The probe is pressed into a linear layer on a box around its overlap with the flat surface. Lengths are in
thicknesses h of the layer, stresses in its Young's modulus E, forces in E h^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from palpate.core import Field, Float, ndarray
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack

WEDGE_SLOPE = math.radians(30)  # slope of both sides of a wedge
ACROSS = 32  # cells across the box
MAX_LIGHT = 0.03  # maximum depth of a light press [h]
MIN_LIGHT = MAX_LIGHT / 3**4  # minimum solved depth [h]; power laws below
LAW_DEPTHS = MIN_LIGHT * 3.0 ** np.arange(5)  # solved depths of the power laws [h]

Knots = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class RoundedBody:
    """A tabled rigid probe, x along its length; lengths in h.

    Attributes:
        shape: "cylinder", "edge", or "two-points".
        rounding: Edge radius; 0 for balls.
    """

    shape: str
    radius: float
    length: float
    rounding: float

    def height(self, x: Float[ndarray, "#ny #nx"], y: Float[ndarray, "#ny #nx"]) -> Field:
        """Height of the underside over its lowest point at (along, across); infinite where there is none."""
        along, across = np.abs(x), np.abs(y)
        if self.shape == "two-points":
            return _over(self.radius, self.radius, np.hypot(along - self.length / 2, across))
        past = np.maximum(along - self.length / 2 + self.rounding, 0.0)
        left = np.sqrt(np.maximum(self.rounding**2 - past**2, 0.0))  # remaining radius of the rounding
        if self.shape == "cylinder":
            found = _over(self.radius, self.radius - self.rounding + left, across)
        else:
            flank = self.rounding - left / math.cos(WEDGE_SLOPE) + across * math.tan(WEDGE_SLOPE)
            found = np.where(across < left * math.sin(WEDGE_SLOPE), _over(self.rounding, left, across), flank)
        return np.where(past <= self.rounding, found, np.inf)

    def reach(self, depth: float) -> tuple[float, float]:
        """Extent along and across of the overlap with the flat surface at a depth below `MAX_LIGHT`."""
        if self.shape == "two-points":
            return self.length / 2 + _chord(self.radius, depth), _chord(self.radius, depth)
        along = self.length / 2 - self.rounding + _chord(self.rounding, depth)
        if self.shape == "cylinder":
            return along, _chord(self.radius, depth)
        tip = self.rounding * (1.0 - math.cos(WEDGE_SLOPE))
        flank = max(depth - tip, 0.0) / math.tan(WEDGE_SLOPE)
        return along, _chord(self.rounding, min(depth, tip)) + flank

    def sharpest(self, depth: float) -> float:
        """Half length along x over which the contact's end vanishes."""
        return _chord(self.rounding or self.radius, depth)


def _over(top: float, radius: float | ndarray, away: ndarray) -> ndarray:
    """Height of a circle's underside, with its centre at `top`."""
    left = np.asarray(radius) ** 2 - away**2
    return np.where(left >= 0.0, top - np.sqrt(np.maximum(left, 0.0)), np.inf)


def _chord(radius: float, depth: float) -> float:
    return math.sqrt(depth * (2 * radius - depth))


@dataclass(frozen=True, slots=True, eq=False)
class LightTouch:
    """A press in the probe's frame: cells, pressure, force, and contact area."""

    x: Float[ndarray, " nx"]
    y: Float[ndarray, " ny"]
    pressure: Field
    force: float
    area: float


@lru_cache(maxsize=64)
def light_touch(body: RoundedBody, poisson_ratio: float, depth: float) -> LightTouch:
    """Press a body into a bonded linear layer to a depth up to `MAX_LIGHT`; depths below `MIN_LIGHT` are
    raised to it.
    """
    solved = max(depth, MIN_LIGHT)
    (along, across), side = body.reach(solved), body.sharpest(solved)
    share = 2 if body.rounding else 1  # contact vanishes in less than a rounded end
    x, y = _cells(along, 2 * math.ceil(along * ACROSS / (2 * share * side))), _cells(across, ACROSS)
    layer, gap = Stack((ElasticLayer(1.0, 1.0, poisson_ratio),)), body.height(x[None, :], y[:, None])
    found = press_stack(layer, gap, x, y, depth_m=solved)
    return LightTouch(x, y, found.pressure_pa, found.force_n, found.area_m2)


def _cells(half: float, count: int) -> Knots:
    """Centres of equal cells from -half to half, and one beyond either end."""
    return (np.arange(count + 2) - (count + 1) / 2) * (2 * half / count)


@dataclass(frozen=True, slots=True, eq=False)
class LightLaw:
    """Force, area, and maximum pressure over depth, by power laws between solved depths."""

    powers: PchipInterpolator
    first: Float[ndarray, " 3"]
    rate: Float[ndarray, " 3"]

    def __call__(self, depth: Knots) -> Float[ndarray, "3 n"]:
        at = np.log(np.maximum(depth, 1e-300) / MIN_LIGHT)[:, None]
        below = self.first + self.rate * np.minimum(at, 0.0)
        found = np.where(at < 0.0, below, self.powers(np.maximum(at[:, 0], 0.0)))
        return np.asarray(np.where(depth > 0.0, np.exp(found).T, 0.0))


@lru_cache(maxsize=16)
def light_law(body: RoundedBody, poisson_ratio: float) -> LightLaw:
    """Return the law of a body from presses at `LAW_DEPTHS` (cached)."""
    touches = [light_touch(body, poisson_ratio, float(depth)) for depth in LAW_DEPTHS]
    logs = np.log([(one.force, one.area, one.pressure.max()) for one in touches])
    powers = PchipInterpolator(np.log(LAW_DEPTHS / MIN_LIGHT), logs)
    return LightLaw(powers, logs[0], powers(0.0, 1))
