"""Finite elements across a stack of layers for motion that is a wave along it.

A motion (U, i V, W)(x, z) exp(i k y) on the half strip x > 0 has strains

    xx = U,x    yy = -k V    zz = W,z    xy = k U + V,x    yz = k W + V,z    xz = U,z + W,x,

so the stiffness is real and K0 + k K1 + k^2 K2. Elements are Q2-P1 against volumetric locking (D. Boffi, F.
Brezzi and M. Fortin, Mixed Finite Element Methods and Applications, 2013, section 8.6.3,
doi:10.1007/978-3-642-36519-5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from palpate.core import Bool, Float, InputError, Int, ndarray

NODES = 3  # along each side of an element
GAUSS_AT = (-(0.6**0.5), 0.0, 0.6**0.5)
GAUSS_WEIGHT = (5 / 9, 8 / 9, 5 / 9)

Columns = Float[ndarray, " x"]
Rows = Float[ndarray, " z"]
Matrix = Any  # of scipy.sparse, by columns


@dataclass(frozen=True, slots=True, eq=False)
class StripMesh:
    """Rectangles of nine nodes; node (column, row) has the number column * rows + row.

    Attributes:
        sides_m: Element sides along x, from 0 [m].
        levels_m: Element sides along z, from the surface to the rigid floor [m].
        mu_pa, lambda_pa: Lamé constants of each row [Pa].
    """

    sides_m: Columns
    levels_m: Rows
    mu_pa: Float[ndarray, " rows"]
    lambda_pa: Float[ndarray, " rows"]

    @property
    def x_m(self) -> Columns:
        return _with_middles(self.sides_m)

    @property
    def z_m(self) -> Rows:
        return _with_middles(self.levels_m)

    @property
    def count(self) -> int:
        """Number of unknowns: U, V, W of each node."""
        return 3 * len(self.x_m) * len(self.z_m)

    def unknowns(self, column: int, part: int) -> Int[ndarray, " z"]:
        """U (0), V (1), or W (2) of a column of nodes, from the surface down."""
        rows = len(self.z_m)
        return 3 * (column * rows + np.arange(rows)) + part

    def row(self, row: int) -> Int[ndarray, "3 x"]:
        """U, V, W of a row of nodes."""
        nodes = np.arange(len(self.x_m)) * len(self.z_m) + row
        return 3 * nodes + np.arange(3)[:, None]

    @property
    def held(self) -> Bool[ndarray, " n"]:
        """Unknowns that are 0: on the floor and at the far end."""
        fixed = np.zeros((len(self.x_m), len(self.z_m), 3), bool)
        fixed[:, -1] = fixed[-1] = True
        return fixed.ravel()


def _with_middles(edges: ndarray) -> ndarray:
    nodes = np.empty(2 * len(edges) - 1)
    nodes[::2], nodes[1::2] = edges, (edges[1:] + edges[:-1]) / 2
    return nodes


def graded(first_m: float, growth: float, last_m: float, end_m: float) -> Columns:
    """Return element sides from 0 to an end that grow from a first to a last size [m]."""
    if not (0 < first_m <= last_m <= end_m and growth >= 1):
        raise InputError(
            f"elements from {first_m:g} to {last_m:g} m, growing by {growth:g}, up to {end_m:g} m; give "
            "sizes above 0 that rise and a growth of 1 or more"
        )
    sides, size = [0.0], first_m
    while sides[-1] < end_m:
        sides.append(sides[-1] + size)
        size = min(size * growth, last_m)
    return np.array(sides) * (end_m / sides[-1])


class StripStiffness:
    """Stiffness of a mesh at any wavenumber along the strip."""

    def __init__(self, mesh: StripMesh) -> None:
        self.mesh = mesh

    def at(self, k: float) -> Matrix:
        """Stiffness per length along y at a wavenumber [1/m]."""
        constant, linear, square = self._powers
        return sparse.csc_matrix(constant + k * linear + k**2 * square)

    @cached_property
    def _powers(self) -> tuple[Matrix, Matrix, Matrix]:
        mesh = self.mesh
        nx, nz = len(mesh.sides_m) - 1, len(mesh.levels_m) - 1
        wide, high = np.diff(mesh.sides_m), np.diff(mesh.levels_m)
        stiff = [np.zeros((nx, nz, 27, 27)) for _ in range(3)]
        for i, size_x in enumerate(wide):
            for j, size_z in enumerate(high):
                for part, element in zip(
                    stiff, _element(size_x, size_z, mesh.mu_pa[j], mesh.lambda_pa[j]), strict=True
                ):
                    part[i, j] = element
        rows = len(mesh.z_m)
        corner = (2 * np.arange(nx)[:, None] * rows + 2 * np.arange(nz))[..., None]
        inside = (np.arange(NODES)[:, None] * rows + np.arange(NODES)).ravel()
        of = (3 * (corner + inside)[..., None] + np.arange(3)).reshape(nx, nz, 27)
        down = np.broadcast_to(of[..., :, None], stiff[0].shape).ravel()
        across = np.broadcast_to(of[..., None, :], stiff[0].shape).ravel()
        shape = (mesh.count, mesh.count)
        constant, linear, square = (
            sparse.csc_matrix((part.ravel(), (down, across)), shape=shape) for part in stiff
        )
        return constant, linear, square


def _shapes(at: float) -> tuple[ndarray, ndarray]:
    """Three quadratic shapes and their slopes on -1 to 1."""
    return (
        np.array([at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2]),
        np.array([at - 0.5, -2 * at, at + 0.5]),
    )


def _element(wide: float, high: float, mu: float, lam: float) -> Sequence[ndarray]:
    """Stiffness of one rectangle, for the powers 0, 1, and 2 of k."""
    weights = mu * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    stiff = [np.zeros((27, 27)) for _ in range(3)]
    grown, mass = [np.zeros((3, 27)), np.zeros((3, 27))], np.zeros((3, 3))
    for a, weight_a in zip(GAUSS_AT, GAUSS_WEIGHT, strict=True):
        for b, weight_b in zip(GAUSS_AT, GAUSS_WEIGHT, strict=True):
            area = weight_a * weight_b * wide * high / 4
            (along, slope), (down, steep) = _shapes(a), _shapes(b)
            N = np.outer(along, down).ravel()
            N_x, N_z = np.outer(slope, down).ravel() * 2 / wide, np.outer(along, steep).ravel() * 2 / high
            still, waved = np.zeros((6, 27)), np.zeros((6, 27))
            still[0, 0::3], still[2, 2::3] = N_x, N_z
            still[3, 1::3], still[4, 1::3] = N_x, N_z
            still[5, 0::3], still[5, 2::3] = N_z, N_x
            waved[1, 1::3], waved[3, 0::3], waved[4, 2::3] = -N, N, N
            once = still.T @ (weights[:, None] * waved)
            stiff[0] += area * still.T @ (weights[:, None] * still)
            stiff[1] += area * (once + once.T)
            stiff[2] += area * waved.T @ (weights[:, None] * waved)
            linear = np.array([1.0, a, b])
            mass += area * np.outer(linear, linear)
            for sum_of, strain in zip(grown, (still, waved), strict=True):
                sum_of += area * np.outer(linear, strain[:3].sum(axis=0))
    inverse = lam * np.linalg.inv(mass)
    still, waved = grown
    once = still.T @ inverse @ waved
    return (
        stiff[0] + still.T @ inverse @ still,
        stiff[1] + once + once.T,
        stiff[2] + waved.T @ inverse @ waved,
    )
