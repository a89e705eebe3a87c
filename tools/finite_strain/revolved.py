"""A body of revolution in biquadratic cells, each with its own linear pressure, which its balance eliminates.

The energy is that of `neo_hookean`. A cell's pressure p = P . (1, xi, eta) answers to its own displacements
alone, int N (J - 1 - p / lambda) = 0, so P is known once they are and the body's unknowns are displacements
only (the element Q2/P-1). Pressure may jump from cell to cell, as it does between a skin and a gel.

Units are the caller's: lengths and Young's moduli as given, forces in modulus times length squared over 2 pi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from skfem import CellBasis, ElementQuad2, MeshQuad, MeshQuad2  # type: ignore[import-untyped]

from .neo_hookean import deformation, first_piola, volume_ratio

GAUSS_ORDER = 5  # three points a direction

Displacement = Float[ndarray, "nodes 2"]


class InsideOutError(Exception):
    """A cell's volume became negative."""


class Meridian:
    """What biquadratic cells of a meridian half-plane know before any load."""

    cells: CellBasis

    @cached_property
    def distance(self) -> Float[ndarray, "cells q"]:
        """From the axis, of every quadrature point."""
        return np.asarray(self.cells.global_coordinates())[0]

    @cached_property
    def weight(self) -> Float[ndarray, "cells q"]:
        """Area times r at every quadrature point; times 2 pi it is the reference volume."""
        return self.distance * self.cells.dx

    @cached_property
    def gradient(self) -> Float[ndarray, "cells q 5 18"]:
        """From a cell's displacements to the parts rr, rz, zr, zz, tt of their gradient."""
        B = np.zeros((*self.weight.shape, 5, 18))
        for a, shape in enumerate(self.cells.basis):
            N, dN = np.asarray(shape[0]), shape[0].grad
            B[..., 0, a], B[..., 1, a] = dN[0], dN[1]
            B[..., 2, a + 9], B[..., 3, a + 9] = dN[0], dN[1]
            B[..., 4, a] = N / self.distance
        return B


@dataclass(frozen=True)
class Revolved(Meridian):
    """A mesh of the meridian half-plane and the elasticity of its cells."""

    mesh: MeshQuad2
    youngs_modulus: Float[ndarray, " cells"]
    poisson_ratio: float

    @cached_property
    def cells(self) -> CellBasis:
        return CellBasis(self.mesh, ElementQuad2(), intorder=GAUSS_ORDER)

    @property
    def places(self) -> Float[ndarray, "nodes 2"]:
        """Unloaded places (r, z) of the nodes."""
        return np.asarray(self.mesh.doflocs.T)

    @cached_property
    def nodes_of(self) -> Int[ndarray, "cells 9"]:
        return np.asarray(self.cells.element_dofs.T)

    @cached_property
    def dofs_of(self) -> Int[ndarray, "cells 18"]:
        """Degree 2 n is u_r of node n, 2 n + 1 its u_z; all u_r come first here."""
        return np.hstack([2 * self.nodes_of, 2 * self.nodes_of + 1])

    @cached_property
    def mu(self) -> Float[ndarray, "cells 1"]:
        return (self.youngs_modulus / (2 * (1 + self.poisson_ratio)))[:, None]

    @cached_property
    def lame(self) -> Float[ndarray, "cells 1"]:
        nu = self.poisson_ratio
        return 2 * self.mu * nu / (1 - 2 * nu)

    @cached_property
    def linear(self) -> Float[ndarray, "q 3"]:
        """1, xi, eta at the quadrature points of any cell."""
        xi, eta = self.cells.X - 0.5
        return np.stack([np.ones_like(xi), xi, eta], axis=-1)

    @cached_property
    def averaging(self) -> Float[ndarray, "cells 3 q"]:
        """From values at the quadrature points to the coefficients of the nearest linear field."""
        N = self.linear
        mass = np.einsum("cq,qa,qb->cab", self.weight, N, N)
        return np.linalg.solve(mass, np.einsum("cq,qa->caq", self.weight, N))

    def strained(self, u: Displacement) -> tuple[Float[ndarray, "cells q 5"], Float[ndarray, "cells q"]]:
        """Displacement gradient and pressure at every quadrature point."""
        H = (self.gradient @ _flat(u[self.nodes_of])[:, None, :, None])[..., 0]
        J = volume_ratio(deformation(H))
        if not (J > 0).all():
            raise InsideOutError
        p = self.lame * ((self.averaging @ (J - 1)[..., None])[..., 0] @ self.linear.T)
        return H, p

    def balance(self, u: Displacement) -> tuple[Float[ndarray, "cells 18"], Float[ndarray, "cells 18 18"]]:
        """Forces of every cell on its nodes' displacements, and its stiffness."""
        H, p = self.strained(u)
        P, A, JG, _ = first_piola(self.mu, H, p)
        B, w = self.gradient, self.weight[..., None, None]
        cells, q = self.weight.shape
        wBt = np.swapaxes((w * B).reshape(cells, q * 5, 18), 1, 2)
        force = (wBt @ P.reshape(cells, q * 5, 1))[..., 0]
        volume = (JG[..., None, :] @ B)[..., 0, :]  # dJ / du
        mean = self.averaging @ volume  # of the linear field nearest to dJ / du
        spread = np.swapaxes(self.weight[..., None] * volume, 1, 2) @ self.linear
        stiffness = wBt @ (A @ B).reshape(cells, q * 5, 18)
        return force, stiffness + self.lame[..., None] * (spread @ mean)

    def strain_energy(self, u: Displacement) -> Float[ndarray, "cells q"]:
        """Strain energy an unloaded volume at every quadrature point."""
        H, p = self.strained(u)
        F = deformation(H)
        J = volume_ratio(F)
        stretch = (F**2).sum(axis=(-1, -2))
        return self.mu / 2 * (stretch - 3 - 2 * np.log(J)) + p**2 / (2 * self.lame)


def _flat(u: Float[ndarray, "cells 9 2"]) -> Float[ndarray, "cells 18"]:
    return np.concatenate([u[..., 0], u[..., 1]], axis=1)


def tensor_mesh(
    first: Float[ndarray, " m"],
    second: Float[ndarray, " n"],
    place: Callable[[Float[ndarray, "2 k"]], Float[ndarray, "2 k"]] = lambda x: x,
) -> MeshQuad2:
    """Cells between knots along two coordinates, whose nodes a function then puts where they belong."""
    flat = MeshQuad2.from_mesh(MeshQuad.init_tensor(first, second))
    return MeshQuad2(place(flat.doflocs), flat.t)
