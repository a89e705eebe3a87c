"""A graded mesh of the disc's meridian half-plane, and what its elements know before any load.

Biquadratic quadrilaterals for the displacement and bilinear continuous ones for the pressure (Taylor-Hood),
on a tensor grid that is finest under the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from skfem import CellBasis, ElementQuad1, ElementQuad2, FacetBasis, MeshQuad  # type: ignore[import-untyped]

from .revolved import GAUSS_ORDER, Meridian

DISC_RADIUS = 5.7
DENSE_TO = 1.15  # material radius under which the mesh is finest; the deepest contact reaches about 0.9


def graded(length: float, cell: float, dense_to: float, growth: float) -> Float[ndarray, " n"]:
    """Knots from 0 to `length`: cells of size `cell` to `dense_to`, each next one `growth` times larger."""
    dense = np.linspace(0.0, dense_to, round(dense_to / cell) + 1)
    rest = length - dense[-1]
    count = int(np.ceil(np.log1p(rest / cell * (growth - 1.0) / growth) / np.log(growth)))
    steps = growth ** np.arange(1, count + 1)
    return np.concatenate([dense, dense[-1] + rest * np.cumsum(steps) / steps.sum()])


def graded_inwards(cell: float, dense_from: float, growth: float) -> Float[ndarray, " n"]:
    """Knots from 0 to below `dense_from`, where cells of size `cell` begin: each `growth` times the next."""
    return np.append(0.0, dense_from - graded(dense_from, cell, 0.0, growth)[-2:0:-1])


@dataclass(frozen=True)
class Disc(Meridian):
    """Mesh and precomputed shape functions of one disc.

    Attributes:
        thickness: h [R].
        cell: size of the finest cells [R].
        radius: of the disc [R].
        dense: material radii between which the mesh is finest [R].
        growth: of a cell over the one before, outside them and down; None for one that keeps the same total
            of cells a dense cell, so that halving `cell` halves every cell.
    """

    thickness: float
    cell: float
    radius: float = DISC_RADIUS
    dense: tuple[float, float] = (0.0, DENSE_TO)
    growth: float | None = None

    @cached_property
    def knots(self) -> tuple[Float[ndarray, " nr"], Float[ndarray, " nz"]]:
        """Cell borders along r and z [R]."""
        growth = self.growth or 1.0 + 7.0 * self.cell
        first, last = self.dense
        inner = graded_inwards(self.cell, first, growth) if first else np.zeros(0)
        outer = first + graded(self.radius - first, self.cell, last - first, growth)
        return (np.concatenate([inner, outer]), graded(self.thickness, self.cell, 3.0 * self.cell, growth))

    @cached_property
    def mesh(self) -> MeshQuad:
        return MeshQuad.init_tensor(*self.knots)

    @cached_property
    def cells(self) -> CellBasis:
        return CellBasis(self.mesh, ElementQuad2(), intorder=GAUSS_ORDER)

    @cached_property
    def corners(self) -> CellBasis:
        return self.cells.with_element(ElementQuad1())

    @cached_property
    def top(self) -> FacetBasis:
        facets = self.mesh.facets_satisfying(lambda x: np.isclose(x[1], 0.0), boundaries_only=True)
        order = np.argsort(self.mesh.p[0, self.mesh.facets[:, facets]].min(axis=0))
        return FacetBasis(self.mesh, ElementQuad2(), facets=facets[order], intorder=GAUSS_ORDER)

    @property
    def nodes(self) -> int:
        return int(self.cells.N)

    @property
    def unknowns(self) -> int:
        """u_r and u_z at every node, then the pressure at every corner."""
        return 2 * self.nodes + int(self.corners.N)

    @cached_property
    def displacement_dofs(self) -> Int[ndarray, "cells 18"]:
        nodes = self.cells.element_dofs.T
        return np.hstack([nodes, nodes + self.nodes])

    @cached_property
    def pressure_dofs(self) -> Int[ndarray, "cells 4"]:
        return self.corners.element_dofs.T + 2 * self.nodes

    @cached_property
    def top_dofs(self) -> Int[ndarray, "facets 18"]:
        nodes = self.top.element_dofs.T
        return np.hstack([nodes, nodes + self.nodes])

    @cached_property
    def shapes(self) -> Float[ndarray, "cells q 9"]:
        return _values(self.cells)

    @cached_property
    def corner_shapes(self) -> Float[ndarray, "cells q 4"]:
        return _values(self.corners)

    @cached_property
    def top_shapes(self) -> Float[ndarray, "facets q 9"]:
        return _values(self.top)

    @cached_property
    def top_radius(self) -> Float[ndarray, "facets q"]:
        return np.asarray(self.top.global_coordinates())[0]

    @cached_property
    def top_weight(self) -> Float[ndarray, "facets q"]:
        """R dR of every quadrature point of the unloaded top."""
        return self.top_radius * self.top.dx

    @cached_property
    def free(self) -> Int[ndarray, " n"]:
        """Unknowns not held: the base is bonded, the axis does not move sideways."""
        R, Z = self.cells.doflocs
        axis = np.flatnonzero(np.isclose(R, 0.0))
        base = np.flatnonzero(np.isclose(Z, self.thickness))
        held = np.concatenate([axis, base, base + self.nodes])
        return np.setdiff1d(np.arange(self.unknowns), held)


def _values(basis: CellBasis | FacetBasis) -> Float[ndarray, "cells q n"]:
    return np.stack([np.broadcast_to(np.asarray(s[0]), basis.dx.shape) for s in basis.basis], axis=-1)
