"""Linear elastic body of revolution under any surface load, one Fourier mode at a time.

With displacements U cos m t, W cos m t (along r and z) and V sin m t (around), loads even about t = 0
decouple into modes m = 0, 1, 2, ... in the meridian half-plane. Cells are Q2/P-1 against volumetric locking.

Reference: E. L. Wilson, Structural analysis of axisymmetric solids, AIAA Journal 3 (1965) 2269,
doi:10.2514/3.3356.

A probe pressed on a viscoelastic body, by its elastic law at an effective modulus.

With the elastic law d(F, E) and the creep C(t) = int_0^t J(t - s) dF(s), E_eff(t) = F(t) / C(t), and
d(t) = d(F(t), E_eff(t)) is solved for F at every sample: exact for Hertz contacts that do not shrink (Lee and
Radok), and quasi-linear viscoelasticity otherwise.

References: R. M. Christensen, Theory of Viscoelasticity (1982), ch. 1, Academic Press; E. H. Lee and J. R. M.
Radok, J. Appl. Mech. 27 (1960) 438, doi:10.1115/1.3644020; Y. C. Fung, Biomechanics (1993), ch. 7,
doi:10.1007/978-1-4757-2257-4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy.optimize import brentq
from skfem import CellBasis, ElementQuad2, MeshQuad, MeshQuad2

from palpate.core import Float, InputError, Int, RangeError, ndarray
from palpate.mechanics.half_space.hertz import positive

GAUSS_ORDER = 5  # three points per direction

Knots = Float[ndarray, " _"]
Nodes = Int[ndarray, " _"]


def tensor_mesh(
    first: Knots, second: Knots, place: Callable[[Float[ndarray, "2 k"]], Float[ndarray, "2 k"]] = lambda x: x
) -> MeshQuad2:
    """Return cells between knots along two coordinates, mapped by a function."""
    flat = MeshQuad2.from_mesh(MeshQuad.init_tensor(first, second))
    return MeshQuad2(place(flat.doflocs), flat.t)


@dataclass(frozen=True)
class RevolvedBody:
    """Mesh of the meridian half-plane (r, z) [m] with modulus per cell [Pa], Poisson's ratio, and fixed
    nodes.
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
        """Amplitudes (U, V, W) [m] at read nodes by unit loads (r, around, z) [N/rad] of a mode at loaded
        nodes.
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
        """Free degrees of freedom of a mode, 3 n + (0 for U, 1 for V, 2 for W)."""
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
        parts = np.array([2, 2, 2, 1, 1, 1])[:, None] * B  # twice the shear energy over mu
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


@dataclass(frozen=True, slots=True)
class Prony:
    """A relaxation modulus E(t) = E_inf + sum_i E_i exp(-t / tau_i).

    Attributes:
        equilibrium_pa: E_inf, positive [Pa].
        moduli_pa: E_i, positive [Pa].
        times_s: tau_i, positive [s].
    """

    equilibrium_pa: float
    moduli_pa: tuple[float, ...]
    times_s: tuple[float, ...]

    def __post_init__(self) -> None:
        positive("the equilibrium modulus", self.equilibrium_pa, "Pa")
        if len(self.moduli_pa) != len(self.times_s):
            raise RangeError(
                f"{len(self.moduli_pa)} moduli and {len(self.times_s)} relaxation times do not pair up; give "
                "one time in s for each modulus in Pa"
            )
        for modulus, time in zip(self.moduli_pa, self.times_s, strict=True):
            positive("a branch's modulus", modulus, "Pa")
            positive("a relaxation time", time, "s")

    @property
    def instantaneous_pa(self) -> float:
        """E(0) [Pa]."""
        return self.equilibrium_pa + math.fsum(self.moduli_pa)

    def retardation(self) -> tuple[Float[ndarray, " m"], Float[ndarray, " m"]]:
        """Weights [1/Pa] and rates [1/s] of J(t) = 1/E_inf - sum w_i exp(-r_i t)."""
        E, E0 = self._moduli, self.instantaneous_pa
        root = np.sqrt(E / self._times)
        # with q = sqrt(E tau) v the rates are symmetric
        rates = np.diag(1 / self._times) - np.outer(root, root) / E0
        values, vectors = np.linalg.eigh(rates)
        start = vectors.T @ (np.sqrt(E / self._times) / E0)  # v = q / sqrt(E tau), q(0) = E / E0
        weights = vectors.T @ np.sqrt(E * self._times)
        return weights * start / self.equilibrium_pa, values

    @property
    def _moduli(self) -> Float[ndarray, " m"]:
        return np.array(self.moduli_pa, dtype=float)

    @property
    def _times(self) -> Float[ndarray, " m"]:
        return np.array(self.times_s, dtype=float)


Approach = Callable[[float, float], float]
"""Approach [m] by force [N] and modulus [Pa], rising with the force."""


@dataclass
class CreepingPress:
    """A press, sample by sample.

    Attributes:
        approach_m: Elastic law.
        body: Viscoelastic body.
        most_n: Maximum force of the law, to which larger ones are limited [N].
    """

    approach_m: Approach
    body: Prony
    most_n: float
    force_n: float = field(default=0.0, init=False)
    modulus_pa: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._weights, self._rates = self.body.retardation()
        self.leave()

    def leave(self) -> None:
        """Reset after the probe has left."""
        self.force_n, self.modulus_pa = 0.0, self.body.instantaneous_pa
        self._held = np.zeros(len(self._rates))

    def to(self, depth_m: float, step_s: float) -> float:
        """Force at the next sample [N]."""
        if depth_m <= 0.0:
            self.leave()
            return 0.0
        x = self._rates * step_s
        faded, gain = np.exp(-x) * self._held, -np.expm1(-x) / x

        def yielded(force_n: float) -> float:
            held = faded + gain * (force_n - self.force_n)
            return force_n / self.body.equilibrium_pa - float(self._weights @ held)

        def short(force_n: float) -> float:
            return self.approach_m(force_n, force_n / yielded(force_n)) - depth_m

        low = 1e-9 * self.most_n
        if short(low) >= 0.0:
            force = low
        elif short(self.most_n) <= 0.0:
            force = self.most_n
        else:
            force = float(brentq(short, low, self.most_n, xtol=1e-9, rtol=1e-12))
        self._held = faded + gain * (force - self.force_n)
        self.modulus_pa, self.force_n = force / yielded(force), force
        return force
