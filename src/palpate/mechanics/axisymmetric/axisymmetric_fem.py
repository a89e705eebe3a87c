"""A linear elastic body of revolution under any load on its surface, one Fourier mode at a time.

With displacements U cos m t, W cos m t (along r and z) and V sin m t (around), loads that are even about
the plane t = 0 come apart into modes m = 0, 1, 2, ... that do not know of each other, and each is a problem
in the meridian half-plane. Cells are biquadratic and carry their own linear dilatation (Q2/P-1), which keeps
a nearly incompressible gel from locking.

Reference: E. L. Wilson, Structural analysis of axisymmetric solids, AIAA Journal 3 (1965) 2269,
doi:10.2514/3.3356.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from skfem import CellBasis, ElementQuad2, MeshQuad, MeshQuad2

from palpate.core import Float, InputError, Int, ndarray

GAUSS_ORDER = 5  # three points a direction

Knots = Float[ndarray, " _"]
Nodes = Int[ndarray, " _"]


def tensor_mesh(
    first: Knots, second: Knots, place: Callable[[Float[ndarray, "2 k"]], Float[ndarray, "2 k"]] = lambda x: x
) -> MeshQuad2:
    """Cells between knots along two coordinates, whose nodes a function then puts where they belong."""
    flat = MeshQuad2.from_mesh(MeshQuad.init_tensor(first, second))
    return MeshQuad2(place(flat.doflocs), flat.t)


@dataclass(frozen=True)
class RevolvedBody:
    """A mesh of the meridian half-plane (r, z) [m] and what holds it.

    Attributes:
        mesh: of biquadratic cells.
        youngs_modulus_pa: of every cell [Pa].
        poisson_ratio: of all, below 1/2.
        fixed: nodes that do not move.
    """

    mesh: MeshQuad2
    youngs_modulus_pa: Float[ndarray, " cells"]
    poisson_ratio: float
    fixed: Nodes

    @cached_property
    def places_m(self) -> Float[ndarray, "nodes 2"]:
        """(r, z) of the nodes [m]."""
        return np.asarray(self.mesh.doflocs.T)

    def compliance(self, mode: int, loaded: Nodes, read: Nodes) -> Float[ndarray, "a 3 b 3"]:
        """Amplitudes of displacement at the read nodes, for unit amplitudes of load at the loaded ones.

        Args:
            mode: m, 0 or more.
            loaded: nodes where a force acts, spread around the axis as cos m t along r and z and as sin m t
                around it, its amplitude per radian.
            read: nodes whose displacement is wanted.

        Returns:
            (U, V, W) [m] by (r, around, z) [N/rad]. In mode 0 what is around the axis is zero.
        """
        if mode < 0:
            raise InputError(f"mode {mode}; modes around the axis are 0, 1, 2, ...")
        n = len(self.places_m)
        free = self._free(mode)
        factors = spl.splu(
            self._stiffness(mode)[free][:, free], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )
        dofs = (3 * loaded[:, None] + np.arange(3)).ravel()
        loads = np.zeros((3 * n, len(dofs)))
        loads[dofs, np.arange(len(dofs))] = 1.0
        motion = np.zeros_like(loads)
        motion[free] = factors.solve(loads[free])
        return motion.reshape(n, 3, len(loaded), 3)[read]

    def _free(self, mode: int) -> Nodes:
        """Degrees of freedom, 3 n + (0 for U, 1 for V, 2 for W), that a mode moves."""
        fixed = [3 * self.fixed, 3 * self.fixed + 1, 3 * self.fixed + 2]
        axis = np.flatnonzero(np.isclose(self.places_m[:, 0], 0.0, atol=1e-9))
        if mode == 0:
            fixed += [3 * axis, 3 * np.arange(len(self.places_m)) + 1]
        else:
            fixed += [3 * axis + 2]
        if mode > 1:
            fixed += [3 * axis, 3 * axis + 1]
        return np.setdiff1d(np.arange(3 * len(self.places_m)), np.concatenate(fixed))

    def _stiffness(self, mode: int) -> sp.csc_matrix:
        basis, n = self._basis, 3 * len(self.places_m)
        mu, lame = self._moduli
        r = np.asarray(basis.global_coordinates())[0]
        w = r * basis.dx
        B = self._strains(mode, r)
        cells, q = w.shape
        parts = np.array([2, 2, 2, 1, 1, 1])[:, None] * B  # twice the energy of shear strains, over mu
        weighted = np.swapaxes((w[..., None, None] * parts).reshape(cells, q * 6, 27), 1, 2)
        K = mu * (weighted @ B.reshape(cells, q * 6, 27))
        dilatation = B[:, :, :3].sum(axis=2)
        linear = np.stack([np.ones(q), *(basis.X - 0.5)], axis=-1)
        mass = np.einsum("cq,qa,qb->cab", w, linear, linear)
        spread = np.swapaxes(w[..., None] * dilatation, 1, 2) @ linear
        K += lame * (spread @ np.linalg.solve(mass, np.swapaxes(spread, 1, 2)))
        nodes = basis.element_dofs.T
        dofs = np.concatenate([3 * nodes, 3 * nodes + 1, 3 * nodes + 2], axis=1)
        rows, columns = np.repeat(dofs, 27, axis=1).ravel(), np.tile(dofs, (1, 27)).ravel()
        return sp.csc_matrix((K.ravel(), (rows, columns)), shape=(n, n))

    def _strains(self, mode: int, r: Float[ndarray, "cells q"]) -> Float[ndarray, "cells q 6 27"]:
        """Matrix from a cell's U, V, W to its strains rr, tt, zz and twice rz, rt, zt."""
        B = np.zeros((*r.shape, 6, 27))
        for a, shape in enumerate(self._basis.basis):
            N, (dr, dz) = np.asarray(shape[0]), shape[0].grad
            u, v, w = a, a + 9, a + 18
            B[..., 0, u], B[..., 2, w] = dr, dz
            B[..., 1, u], B[..., 1, v] = N / r, mode * N / r
            B[..., 3, u], B[..., 3, w] = dz, dr
            B[..., 4, u], B[..., 4, v] = -mode * N / r, dr - N / r
            B[..., 5, v], B[..., 5, w] = dz, -mode * N / r
        return B

    @cached_property
    def _basis(self) -> CellBasis:
        return CellBasis(self.mesh, ElementQuad2(), intorder=GAUSS_ORDER)

    @property
    def _moduli(self) -> tuple[Float[ndarray, "cells 1 1"], Float[ndarray, "cells 1 1"]]:
        """Lamé's mu and lambda [Pa]."""
        nu = self.poisson_ratio
        mu = (self.youngs_modulus_pa / (2 * (1 + nu)))[:, None, None]
        return mu, 2 * mu * nu / (1 - 2 * nu)
