"""Rigid probes without an axis, as signed distances: their lowest point at the origin, z down into the skin.

An edge and a lying cylinder are a convex prism along x grown by a ball, which rounds all their edges by its
radius; two balls are alike about the plane x = 0, so that of the one at x > 0 is all there is at x >= 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

Points = Float[ndarray, "*n 3"]
Distance = tuple[Float[ndarray, "*n"], Points, Float[ndarray, "*n 3 3"]]
"""Signed distance, negative inside; its gradient, the outward normal; and the normal's own gradient."""

TINY = 1e-12


@dataclass(frozen=True)
class Balls:
    """Two balls of a radius whose lowest points are so far apart along x; one, if that is 0."""

    radius: float
    apart: float

    def distance(self, x: Points) -> Distance:
        away = x - np.array([self.apart / 2, 0.0, -self.radius])
        r = np.linalg.norm(away, axis=-1)
        n = away / r[..., None]
        return r - self.radius, n, (np.eye(3) - _outer(n)) / r[..., None, None]


@dataclass(frozen=True)
class RoundedPrism:
    """A prism along x, of a length over all, all its edges rounded.

    Attributes:
        radius: of a lying cylinder; 0 for an edge.
        slope: of an edge's sides against the skin [rad].
    """

    length: float
    rounding: float
    radius: float = 0.0
    slope: float = math.radians(30)

    def distance(self, x: Points) -> Distance:
        aside, normal, turning = self._section(x[..., 1], x[..., 2])
        sign = np.where(x[..., 0] < 0.0, -1.0, 1.0)
        along = np.abs(x[..., 0]) - (self.length / 2 - self.rounding)
        out, past = np.maximum(aside, 0.0), np.maximum(along, 0.0)
        r = np.hypot(out, past)
        far = r > TINY
        R = np.where(far, r, 1.0)
        ends = np.where(far, past / R, along > aside)  # cosine to the axis, inside that of the nearer face
        sides = np.where(far, out / R, along <= aside)
        n = sides[..., None] * normal
        n[..., 0] = ends * sign
        axis = np.zeros_like(n)
        axis[..., 0] = sign
        rim = sides[..., None] * axis - ends[..., None] * normal
        curved = far & (past > 0.0) & (out > 0.0)
        H = sides[..., None, None] * turning + np.where(curved, 1.0 / R, 0.0)[..., None, None] * _outer(rim)
        return np.where(far, r, np.maximum(aside, along)) - self.rounding, n, H

    def _section(self, y: ndarray, z: ndarray) -> Distance:
        """Of the inner prism's cross-section, in its plane."""
        n = np.zeros((*y.shape, 3))
        if self.radius:
            down = z + self.radius
            r = np.maximum(np.hypot(y, down), TINY)
            n[..., 1], n[..., 2] = y / r, down / r
            return r - (self.radius - self.rounding), n, _turning(n) / r[..., None, None]
        s, c = math.sin(self.slope), math.cos(self.slope)
        side, below = np.abs(y), z + self.rounding  # from the tip of the inner wedge
        flank = s * side + c * below  # over the flank's plane
        is_tip = c * side - s * below < 0.0
        r = np.maximum(np.hypot(side, below), TINY)
        sign = np.where(y < 0.0, -1.0, 1.0)
        n[..., 1] = np.where(is_tip, side / r, s) * sign
        n[..., 2] = np.where(is_tip, below / r, c)
        curvature = np.where(is_tip, 1.0 / r, 0.0)
        return np.where(is_tip, r, flank), n, _turning(n) * curvature[..., None, None]


def _outer(n: Points) -> Float[ndarray, "*n 3 3"]:
    return n[..., :, None] * n[..., None, :]


def _turning(n: Points) -> Float[ndarray, "*n 3 3"]:
    """Of a normal in the plane y, z: the square of the direction across it."""
    across = np.stack([np.zeros_like(n[..., 0]), -n[..., 2], n[..., 1]], axis=-1)
    return _outer(across)
