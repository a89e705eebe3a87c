"""A rigid probe without an axis pressed into a bonded layer, in three dimensions at finite strain.

A quarter of a square layer is meshed, between the probe's two planes of symmetry, with the bricks of
`off_centre.py` on a graded grid of planes; material and method are those of that tool. Lengths are in
thicknesses of the layer, stresses in Young's moduli.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.rigid_probes import Distance, Points
from off_centre import SOLID, Cells, HalfDisc, OffCentre, deformed, quadratic, stretched, with_middles

NORMAL = 4000.0  # E/h, springs of the contact; they give by less than 1e-3 h
HALF_SIDE = 2.85  # h, of the square: the palm's rim, 28.5 mm from the middle of 10 mm
FACE_POINTS = 4  # of contact, each way on a brick's top


class Shape(Protocol):
    """A probe; see `finite_strain.rigid_probes`."""

    def distance(self, x: Points) -> Distance:
        """Signed distance and its first two gradients."""
        ...


def graded(fine: list[tuple[float, float]], end: float, growth: float = 1.35) -> Float[ndarray, " n"]:
    """Knots from 0: even to each place of `fine` in cells as given there, then growing to the end."""
    knots = [0.0]
    for to, cell in fine:
        count = max(1, round((to - knots[-1]) / cell))
        knots += list(np.linspace(knots[-1], to, count + 1)[1:])
    first, rest = fine[-1][1] * growth, end - knots[-1]
    count = max(1, round(np.log1p(rest * (growth - 1) / first) / np.log(growth)))
    return np.concatenate([knots, knots[-1] + stretched(rest, first, count)[1:]])


@dataclass(frozen=True)
class Quarter(HalfDisc):
    """A quarter of the square layer, its bricks between planes; the first ones of x and y are symmetry's.

    Attributes:
        knots: planes across x, y and z [h].
    """

    knots: tuple[ndarray, ndarray, ndarray] = field(default=(), compare=False)

    @cached_property
    def nodes(self) -> Float[ndarray, "x y z 3"]:
        return np.stack(np.meshgrid(*map(with_middles, self.knots), indexing="ij"), axis=-1)

    @cached_property
    def unknown(self) -> Int[ndarray, "x y z 3"]:
        free = np.ones(self.nodes.shape, dtype=bool)
        free[:, :, -1] = False
        free[0, :, :, 0] = False
        free[:, 0, :, 1] = False
        return np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)


def quarter(x: ndarray, y: ndarray, z: ndarray) -> Quarter:
    """The layer between these planes."""
    return Quarter(float(z[-1]), 0.0, Cells(len(x) - 1, 0, len(y) - 1, len(z) - 1), (x, y, z))


@dataclass
class ProbePress(OffCentre):
    """A probe pressed into the middle of the layer."""

    probe: Shape = None
    normal: ClassVar[float] = NORMAL

    def __post_init__(self) -> None:
        super().__post_init__()
        d = self.disc
        x, w = np.polynomial.legendre.leggauss(FACE_POINTS)
        N, _ = quadratic(x)
        self.top_shapes = np.einsum("qa,rb->qrab", N, N).reshape(FACE_POINTS**2, 9)
        along, across = (np.diff(k) / 2 for k in d.knots[:2])
        self.top_area = (along[:, None, None, None] * across[:, None, None] * np.outer(w, w)).reshape(
            -1, FACE_POINTS**2
        )

    def touch(self, u: ndarray, depth: float, stress: float = 1.0) -> tuple[ndarray, ndarray]:
        away, n, turning = self.probe.distance(self.top_places(u) - np.array([0.0, 0.0, depth]))
        p = self.normal * np.maximum(-away, 0.0)
        stiff = np.where(p > 0.0, self.normal, 0.0)[..., None, None] * n[..., :, None] * n[..., None, :]
        return p[..., None] * n, stiff - stress * p[..., None, None] * turning

    def force(self, u: ndarray, depth: float) -> float:
        """Of the whole probe into the layer [E h^2]."""
        traction, _ = self.touch(u, depth)
        return 4.0 * float((self.top_area * traction[..., 2]).sum())

    def reaction(self, u: ndarray) -> float:
        """Of the whole floor on the layer, from the stress of the bricks above it [E h^2]."""
        F, J, g, p = deformed(self, u)
        P = SOLID.mu * (F - g) + (p * J)[..., None, None] * g
        out = np.einsum("eqaj,eqij->eai", self.G * self.w[..., None, None], P, optimize=True)
        held = np.zeros(self.disc.nodes.shape[:3], bool)
        held[:, :, -1] = True
        return 4.0 * float(out[..., 2][held.ravel()[self.disc.bricks]].sum())
