"""Contact of a tip's skin with a specimen's top, both of revolution, without friction.

Quadrature points of the unloaded skin look straight down at the deformed top: with z_s(r) its height at the
point's own radius, the gap is g = z - z_s(r), and the energy is the integral over the unloaded skin of a
penalty that rises smoothly where g < 0. It depends on the gap alone, so the force is along the normal of the
top.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

POINTS = 5  # Gauss points a facet
STIFFNESS = 2.0  # MPa/mm: at 0.05 MPa the skin sinks 25 um in
SMOOTH = 2e-4  # mm of gap over which the penalty sets in

Points = Float[ndarray, " p"]


@dataclass(frozen=True)
class Touch:
    """The contact of one state."""

    gap: Points  # mm
    pressure: Points  # MPa, on the unloaded skin
    radius: Points  # mm, deformed
    force: Float[ndarray, "c 12"]  # on the degrees of freedom, N over 2 pi
    stiffness: Float[ndarray, "c 12 12"]
    dofs: Int[ndarray, "c 12"]


@dataclass(frozen=True)
class Meeting:
    """Two surfaces by their nodes: facets [f 3], each first end, middle, second end, in order from the axis.

    Attributes:
        places: unloaded (r, z) of all nodes of both bodies [mm].
    """

    places: Float[ndarray, "nodes 2"]
    skin: Int[ndarray, "f 3"]
    top: Int[ndarray, "t 3"]

    @cached_property
    def _gauss(self) -> tuple[Points, Points]:
        x, w = np.polynomial.legendre.leggauss(POINTS)
        return np.tile(x, len(self.skin)), np.tile(w, len(self.skin))

    @cached_property
    def shapes(self) -> Float[ndarray, "p 3"]:
        return _shapes(self._gauss[0])

    @cached_property
    def nodes(self) -> Int[ndarray, "p 3"]:
        return np.repeat(self.skin, POINTS, axis=0)

    @cached_property
    def weight(self) -> Points:
        """R ds of every point of the unloaded skin [mm^2]."""
        at = self.places[self.nodes]
        along = np.einsum("pa,pai->pi", _slopes(self._gauss[0]), at)
        r = np.einsum("pa,pa->p", self.shapes, at[..., 0])
        return self._gauss[1] * np.hypot(*along.T) * r

    def under(self, u: Float[ndarray, "nodes 2"]) -> tuple[Float[ndarray, "p 2"], Int[ndarray, " p"], Points]:
        """Where the points are, which facet of the top is under each (-1 beyond it), and where on it."""
        x = np.einsum("pa,pai->pi", self.shapes, (self.places + u)[self.nodes])
        ends = (self.places + u)[self.top]
        facet = np.searchsorted(ends[:, 2, 0], x[:, 0])
        beyond = facet >= len(self.top)
        r = ends[np.where(beyond, 0, facet), :, 0]
        bend, rise = (r[:, 0] + r[:, 2]) / 2 - r[:, 1], (r[:, 2] - r[:, 0]) / 2
        xi = np.zeros(len(x))
        for _ in range(8):  # a quadratic that is nearly straight
            xi -= (bend * xi**2 + rise * xi + r[:, 1] - x[:, 0]) / (2 * bend * xi + rise)
        return x, np.where(beyond, -1, facet), np.where(beyond, 0.0, xi)

    def touch(self, u: Float[ndarray, "nodes 2"]) -> Touch:
        """Pressure, and what it does to the nodes of both bodies."""
        x, facet, xi = self.under(u)
        here = facet >= 0
        top = self.top[facet]
        at = (self.places + u)[top]
        N, D = _shapes(xi), _slopes(xi)
        gap = np.where(here, x[:, 1] - np.einsum("pa,pa->p", N, at[..., 1]), np.inf)
        p, k = penalty(gap)
        (r1, z1), (r2, z2) = np.einsum("pa,pai->ip", D, at), _bends(at).T
        m = z1 / r1
        # derivatives of the gap, of the place on the top, and of the top's slope, by the 12 displacements
        first, moved, tilted = np.zeros((3, len(x), 12))
        first[:, 0:6:2], first[:, 1:6:2] = -m[:, None] * self.shapes, self.shapes
        first[:, 6::2], first[:, 7::2] = m[:, None] * N, -N
        moved[:, 0:6:2], moved[:, 6::2] = self.shapes / r1[:, None], -N / r1[:, None]
        tilted[:, 6::2], tilted[:, 7::2] = -m[:, None] * D, D
        curved = (z2 - m * r2)[:, None, None]
        cross = tilted[:, :, None] * moved[:, None, :]
        second = cross + np.swapaxes(cross, 1, 2) + curved * moved[:, :, None] * moved[:, None, :]
        w = self.weight[:, None]
        force = -(w * p[:, None]) * first
        stiffness = w[..., None] * (
            k[:, None, None] * first[:, :, None] * first[:, None, :] + p[:, None, None] * second
        )
        dofs = _dofs(self.nodes, top)
        kept = here & (k > STIFFNESS * 1e-9)
        return Touch(gap, p, x[:, 0], force[kept], stiffness[kept], dofs[kept])


def penalty(gap: Points, smooth: float = SMOOTH) -> tuple[Points, Points]:
    """Pressure and its stiffness: STIFFNESS times the overlap, its corner rounded over a gap [mm]."""
    y = np.clip(-gap / smooth, -60.0, None)
    soft = np.where(y > 30.0, y, np.log1p(np.exp(np.minimum(y, 30.0))))
    return STIFFNESS * smooth * soft, STIFFNESS / (1.0 + np.exp(-np.minimum(y, 60.0)))


def _shapes(xi: Points) -> Float[ndarray, "p 3"]:
    return np.stack([-xi * (1 - xi) / 2, 1 - xi**2, xi * (1 + xi) / 2], axis=1)


def _slopes(xi: Points) -> Float[ndarray, "p 3"]:
    return np.stack([xi - 0.5, -2 * xi, xi + 0.5], axis=1)


def _bends(at: Float[ndarray, "p 3 2"]) -> Float[ndarray, "p 2"]:
    return at[:, 0] - 2 * at[:, 1] + at[:, 2]


def _dofs(skin: Int[ndarray, "p 3"], top: Int[ndarray, "p 3"]) -> Int[ndarray, "p 12"]:
    both = np.concatenate([skin, top], axis=1)
    return np.stack([2 * both, 2 * both + 1], axis=-1).reshape(len(both), 12)
