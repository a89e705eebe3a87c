"""From a balanced disc to what a table holds: smooth Cauchy stress and the surface, at places in space.

The stress at quadrature points is projected onto continuous biquadratic shapes in the least-squares sense,
weighted by deformed volume, then read at (r, z) of the deformed body by inverting the deformation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from .disc import Disc
from .neo_hookean import NeoHookean, cauchy, deformation, volume_ratio
from .press import Balanced, Press, strained

SAMPLES = 24  # a cell, along the deformed top
INVERSIONS = 40
EDGE_TERMS = 6
LOST = 1e-4  # R; a chord of the sampled top passes a few 1e-6 R from the curved one

Knots = Float[ndarray, " n"]


@dataclass(frozen=True)
class Grid:
    """A field on the mesh's tensor grid, biquadratic: values ``[... 2 nr + 1, 2 nz + 1]``."""

    knots: tuple[Knots, Knots]
    values: Float[ndarray, "c nr nz"]

    def at(self, R: ndarray, Z: ndarray) -> tuple[Float[ndarray, "c p"], Float[ndarray, "c 2 p"]]:
        """Values and gradient at unloaded places."""
        (i, x, dx), (j, y, dy) = (_local(k, s) for k, s in zip(self.knots, (R, Z), strict=True))
        Nx, Ny, Dx, Dy = _quadratic(x), _quadratic(y), _slope(x) / dx, _slope(y) / dy
        patch = self.values[:, 2 * i + np.arange(3)[:, None, None], 2 * j + np.arange(3)[None, :, None]]
        value = np.einsum("cabp,ap,bp->cp", patch, Nx, Ny)
        gradient = np.stack(
            [np.einsum("cabp,ap,bp->cp", patch, Dx, Ny), np.einsum("cabp,ap,bp->cp", patch, Nx, Dy)], axis=1
        )
        return value, gradient


@dataclass(frozen=True)
class Deformed:
    """A balanced disc seen in space."""

    place: Grid  # r and z [R]
    stress: Grid  # Cauchy rr, tt, zz, rz [E]
    disc: Disc

    def top(self) -> tuple[Knots, Knots]:
        """The deformed top surface, r and z, densely sampled from the axis outwards."""
        R = np.unique(np.concatenate([np.linspace(a, b, SAMPLES) for a, b in pairwise(self.disc.knots[0])]))
        (r, z), _ = self.place.at(R, np.zeros_like(R))
        return r, z

    def surface(self, r: Knots) -> Knots:
        """Height z of the top at spatial radius r; past the rim, that of the rim."""
        at, z = self.top()
        return np.interp(r, at, z)

    def unloaded(self, r: ndarray, z: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """Where the points at (r, z) were before loading, and how far the nearest body point is."""
        Rk, Zk = self.disc.knots
        corners = self.place.values[:, ::2, ::2].reshape(2, -1)
        home = np.stack(np.meshgrid(Rk, Zk, indexing="ij")).reshape(2, -1)
        guess = LinearNDInterpolator(corners.T, home.T)(r, z)
        lost = np.isnan(guess[:, 0])
        guess[lost] = NearestNDInterpolator(corners.T, home.T)(r[lost], z[lost])
        R, Z = guess.T
        for _ in range(INVERSIONS):
            (x, y), D = self.place.at(R, Z)
            er, ez = r - x, z - y
            det = D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]
            R = np.clip(R + (D[1, 1] * er - D[0, 1] * ez) / det, 0.0, Rk[-1])
            Z = np.clip(Z + (D[0, 0] * ez - D[1, 0] * er) / det, 0.0, Zk[-1])
        (x, y), _ = self.place.at(R, Z)
        return R, Z, np.hypot(r - x, z - y)

    def stress_at(self, r: Knots, zeta: Knots) -> Float[ndarray, "4 m n"]:
        """Cauchy stress at spatial radius r and at the fraction zeta from the top to the base."""
        top = self.surface(r)
        z = top + zeta[:, None] * (self.disc.thickness - top)
        rr = np.broadcast_to(r, z.shape)
        R, Z, miss = self.unloaded(rr.ravel(), z.ravel())
        # the free side barely moves; a point just past it is given the side's stress
        inside = rr.ravel() < 0.97 * self.disc.radius
        if miss[inside].max() > LOST:
            raise RuntimeError(f"a point was not found in the deformed body: {miss[inside].max():g} R away")
        read, _ = self.stress.at(R, Z)
        return read.reshape(4, *z.shape)


def deformed(press: Press, balanced: Balanced) -> Deformed:
    """Project the stress and lay the nodes out on the mesh's tensor grid."""
    disc = press.disc
    stress = _projected(disc, press.solid, balanced)
    middles = tuple(np.sort(np.concatenate([k, (k[1:] + k[:-1]) / 2])) for k in disc.knots)
    node = tensor_order(disc.cells.doflocs, *middles)
    n = disc.nodes
    place = disc.cells.doflocs + np.stack([balanced.state[:n], balanced.state[n : 2 * n]])
    return Deformed(Grid(disc.knots, place[:, node]), Grid(disc.knots, stress[:, node]), disc)


def edge(press: Press, balanced: Balanced) -> tuple[float, float]:
    """The last point that touches and the first that does not, spatial radii [R]: the edge lies between."""
    r, touching = press.top(balanced.state)[..., 0].ravel(), balanced.touch.touching.ravel()
    last = int(np.flatnonzero(touching)[-1])
    return float(r[last]), float(r[last + 1])


def contact_radii(depth: Knots, edges: Float[ndarray, "n 2"]) -> Knots:
    """Contact radius at every depth [R]: a smooth a = s (1 + c1 s + ... + c6 s^6), s = sqrt(d), Hertz at 0.

    One depth knows its edge only to the spacing of the quadrature points; a curve through the edges of all
    depths knows it better.
    """
    s = np.sqrt(depth)
    powers = s[:, None] ** np.arange(1, EDGE_TERMS + 1)
    middle, width = edges.mean(axis=1), np.diff(edges, axis=1)[:, 0]
    weight = s / width
    c, *_ = np.linalg.lstsq(powers * weight[:, None], (middle / s - 1.0) * weight, rcond=None)
    return s * (1.0 + powers @ c)


def _projected(disc: Disc, solid: NeoHookean, balanced: Balanced) -> Float[ndarray, "4 nodes"]:
    H, p = strained(disc, balanced.state)
    weight = disc.weight * volume_ratio(deformation(H))
    s = projection(disc, weight)(cauchy(solid, H, p))
    s[3, np.isclose(disc.cells.doflocs[0], 0.0)] = 0.0  # no shear on the axis
    return s


def projection(disc: Disc, weight: Float[ndarray, "cells q"]) -> Callable[[ndarray], ndarray]:
    """From values ``[cells q k]`` at the quadrature points to the nearest continuous field, by its nodes."""
    N, dofs, n = disc.shapes, disc.cells.element_dofs.T, disc.nodes
    mass = np.einsum("cq,cqa,cqb->cab", weight, N, N)
    rows = np.broadcast_to(dofs[:, :, None], mass.shape)
    columns = np.broadcast_to(dofs[:, None, :], mass.shape)
    factors = spl.splu(sp.csc_matrix((mass.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)))

    def nodal(values: Float[ndarray, "cells q k"]) -> Float[ndarray, "k nodes"]:
        load = np.einsum("cq,cqa,cqk->kca", weight, N, values)
        b = [np.bincount(dofs.ravel(), one.ravel(), minlength=n) for one in load]
        return np.asarray(factors.solve(np.stack(b, axis=1)).T)

    return nodal


def tensor_order(places: ndarray, R: Knots, Z: Knots) -> Int[ndarray, "nr nz"]:
    """Number of the node at each corner and middle of the mesh's tensor grid."""
    i = np.abs(places[0][:, None] - R).argmin(axis=1)
    j = np.abs(places[1][:, None] - Z).argmin(axis=1)
    order = np.empty((len(R), len(Z)), dtype=int)
    order[i, j] = np.arange(places.shape[1])
    return order


def _local(knots: Knots, s: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    i = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
    size = knots[i + 1] - knots[i]
    return i, (s - knots[i]) / size, size


def _quadratic(x: ndarray) -> Float[ndarray, "3 p"]:
    return np.stack([(2 * x - 1) * (x - 1), 4 * x * (1 - x), x * (2 * x - 1)])


def _slope(x: ndarray) -> Float[ndarray, "3 p"]:
    return np.stack([4 * x - 3, 4 - 8 * x, 4 * x - 1])
