"""The disc under a sphere that presses and is pulled aside: to first order in the pull, exact in depth.

About the pressed, axisymmetric balance every increment that a pull along x makes has the form (U cos t, V
sin t, W cos t) along (r, t, z), with t the angle from x, and its pressure is cos t times a function of (R,
Z): one harmonic, which the meridian's mesh holds. The tangent is that of the pressed state, so that
stretch, stress, pressure and the steep sides of the contact are all in it.

The sphere's springs of `sphere.py` give way along the normal. Along the surface a point sticks to the
sphere by TANGENT times the way it lags behind, up to friction times its pressure. Over t both parts of that
traction are of the one harmonic; what is limited is its root mean square over t, which where the traction
points along x all round, as under Cattaneo and Mindlin, is its size everywhere.

Lengths in R, stresses in E. Of integrals over t the common factor pi is left out but in the force.

Reference: K. L. Johnson, Contact Mechanics (1985), sec. 7.2, doi:10.1017/CBO9781139171731.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from .disc import Disc
from .neo_hookean import deformation, inverse_transpose, volume_ratio
from .press import Balanced, Press, strained

NINE = tuple((i, j) for i in range(3) for j in range(3))  # parts of the gradient over (r, z, t)
TANGENT = 2000.0  # E/R
SETTLED = 1e-5  # of the greatest limit
ROUNDS = 20000

Points = Float[ndarray, " p"]
Pairs = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class Increment:
    """What one pull adds; amplitudes of the harmonic.

    Attributes:
        shift: of the sphere along x [R].
        force: of the sphere on the skin along x [E R^2].
        traction: along the surface at the touching points, meridian and hoop, per unloaded area [E].
        sticking: points whose traction is below friction's limit.
        state: U, V, W at every node, then the pressure at every corner.
    """

    shift: float
    force: float
    traction: Pairs
    sticking: Bool[ndarray, " p"]
    state: Float[ndarray, " n"]


@dataclass
class Pull:
    """The first harmonic about one balance of a press without friction."""

    press: Press
    balanced: Balanced

    @property
    def disc(self) -> Disc:
        return self.press.disc

    @cached_property
    def gradient(self) -> Float[ndarray, "cells q 9 27"]:
        """From a cell's U, V, W to the parts of the displacement's gradient, in the order of NINE."""
        d = self.disc
        cells, q = d.weight.shape
        B = np.zeros((cells, q, 9, 27))
        over_r = d.shapes / d.distance[..., None]
        slope = np.stack([np.asarray(shape[0].grad) for shape in d.cells.basis], axis=-1)  # [2 cells q 9]
        U, V, W = (slice(9 * k, 9 * k + 9) for k in range(3))
        B[..., 0, U], B[..., 1, U] = slope
        B[..., 2, U], B[..., 2, V] = -over_r, -over_r
        B[..., 3, W], B[..., 4, W] = slope
        B[..., 5, W] = -over_r
        B[..., 6, V], B[..., 7, V] = slope
        B[..., 8, U], B[..., 8, V] = over_r, over_r
        return B

    @cached_property
    def pressed(self) -> tuple[ndarray, ndarray, ndarray, ndarray]:
        """F, F^-T, J and pressure of the balance at the quadrature points."""
        H, p = strained(self.disc, self.balanced.state)
        F = deformation(H)
        return F, inverse_transpose(F), volume_ratio(F), p

    @cached_property
    def touching(self) -> Bool[ndarray, "facets q"]:
        return self.balanced.touch.touching

    @cached_property
    def _axes(self) -> tuple[Pairs, Pairs]:
        """Normal and meridian's tangent (r, z) of the sphere at the touching points."""
        angle = self.balanced.touch.angle[self.touching]
        n = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        return n, np.stack([n[:, 1], -n[:, 0]], axis=-1)

    @cached_property
    def _bases(self) -> tuple[Float[ndarray, "p 2 3"], Int[ndarray, "p 27"], Points, Float[ndarray, "p 9"]]:
        """Meridian and hoop directions over (U, V, W); dofs, weight and shapes of every touching point."""
        d, n = self.disc, self.disc.nodes
        facet, _ = np.nonzero(self.touching)
        _, t = self._axes
        along = np.zeros((len(facet), 2, 3))
        along[:, 0, 0], along[:, 0, 2], along[:, 1, 1] = t[:, 0], t[:, 1], 1.0
        nodes = d.top.element_dofs.T[facet]
        dofs = np.concatenate([nodes, nodes + n, nodes + 2 * n], axis=1)
        return along, dofs, d.top_weight[self.touching], d.top_shapes[self.touching]

    @cached_property
    def limit(self) -> Points:
        """Pressure of the touching points, per unloaded area [E]."""
        return self.balanced.touch.pressure[self.touching]

    @cached_property
    def _regular(self) -> sp.csr_matrix:
        """From free unknowns to all: the base held, and on the axis V = -U, W = 0 and no pressure."""
        d, n = self.disc, self.disc.nodes
        total = 3 * n + d.unknowns - 2 * n
        R, Z = d.cells.doflocs
        axis, base = np.flatnonzero(np.isclose(R, 0.0)), np.flatnonzero(np.isclose(Z, d.thickness))
        corner = np.flatnonzero(np.isclose(d.corners.doflocs[0], 0.0))
        held = np.concatenate([base, base + n, base + 2 * n, axis + n, axis + 2 * n, corner + 3 * n])
        free = np.setdiff1d(np.arange(total), held)
        T = sp.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(total, len(free)))
        inner = np.setdiff1d(axis, base)
        column = np.searchsorted(free, inner)
        return T + sp.csr_matrix((-np.ones(len(inner)), (inner + n, column)), shape=T.shape)

    @cached_property
    def _factors(self) -> spl.SuperLU:
        T = self._regular
        K = (T.T @ (self._solid + self._springs) @ T).tocsc()
        return spl.splu(
            K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
        )

    @cached_property
    def _solid(self) -> sp.csr_matrix:
        """Tangent of the body."""
        d, (_, g, J, p), B, w = self.disc, self.pressed, self.gradient, self.disc.weight
        mu, pJ = self.press.solid.mu, p * J
        A = np.empty((*p.shape, 9, 9))
        for a, (i, j) in enumerate(NINE):
            for b, (k, m) in enumerate(NINE):
                A[..., a, b] = (mu - pJ) * g[..., i, m] * g[..., k, j] + pJ * g[..., i, j] * g[..., k, m]
            A[..., a, a] += mu
        wB, N = w[..., None, None] * B, d.corner_shapes
        cells, q = w.shape
        Kuu = np.swapaxes(wB, 2, 3).transpose(0, 2, 1, 3).reshape(cells, 27, q * 9) @ (A @ B).reshape(
            cells, q * 9, 27
        )
        swell = np.stack([J * g[..., i, j] for i, j in NINE], axis=-1)
        Kpu = np.einsum("cqm,cqk,cqka->cma", N, swell, wB, optimize=True)
        Kpp = -np.einsum("cq,cqm,cqn->cmn", w, N, N) / self.press.solid.lame
        n, nodes = d.nodes, d.cells.element_dofs.T
        u, c = np.hstack([nodes, nodes + n, nodes + 2 * n]), d.corners.element_dofs.T + 3 * n
        blocks = ((u, u, Kuu), (c, u, Kpu), (u, c, np.swapaxes(Kpu, 1, 2)), (c, c, Kpp))
        return _summed(blocks, 3 * n + d.unknowns - 2 * n)

    @cached_property
    def _springs(self) -> sp.csr_matrix:
        """-d (pressure times normal) / d place, of the sphere at rest."""
        d, now, n = self.disc, self.balanced.touch, self.disc.nodes
        S = np.zeros((*now.touching.shape, 3, 3))
        S[..., ::2, ::2] = now.stiffness
        S[..., 1, 1] = -now.pressure  # a point on the sphere turns with it; its distance from the centre is 1
        M = d.top_shapes
        K = np.einsum("fq,fqa,fqij,fqb->fiajb", d.top_weight, M, S, M, optimize=True)
        nodes = d.top.element_dofs.T
        dofs = np.hstack([nodes, nodes + n, nodes + 2 * n])
        return _summed(((dofs, dofs, K.reshape(len(dofs), 27, 27)),), 3 * n + d.unknowns - 2 * n)

    @cached_property
    def _aside(self) -> Float[ndarray, " n"]:
        """Every node moved by 1 along x."""
        n = self.disc.nodes
        return np.concatenate([np.ones(n), -np.ones(n), np.zeros(n), np.zeros(self.disc.unknowns - 2 * n)])

    def solved(self, load: ndarray) -> ndarray:
        """The increment under a load on all unknowns, one or many in columns."""
        T = self._regular
        return np.asarray(T @ self._factors.solve(np.asarray(T.T @ load)))

    @cached_property
    def _spread(self) -> sp.csr_matrix:
        """From tractions of the touching points, meridian and hoop in turn, to loads on all unknowns."""
        along, dofs, weight, shapes = self._bases
        value = np.einsum("p,pki,pa->pkia", weight, along, shapes)
        column = np.arange(2 * len(weight)).reshape(-1, 2)[:, :, None, None]
        row = dofs.reshape(-1, 1, 3, 9)
        row, column = np.broadcast_arrays(row, column)[0], np.broadcast_to(column, value.shape)
        row = np.broadcast_to(row, value.shape)
        total = len(self._aside)
        return sp.csr_matrix(
            (value.ravel(), (row.ravel(), column.ravel())), shape=(total, value[..., 0, 0].size)
        )

    @cached_property
    def _compliance(self) -> tuple[ndarray, ndarray, ndarray]:
        """Lag of the touching points behind the sphere."""
        weight = np.repeat(self._bases[2], 2)
        free = self.solved(self._springs @ self._aside)
        states = self.solved(self._spread.toarray())
        read = sp.diags(1.0 / weight) @ self._spread.T
        lag = read @ (free - self._aside)
        return lag, np.asarray(read @ states), np.column_stack([free, states])

    def slipping(self, shift: float, friction: float = 1.0) -> Increment:
        """The sphere shifted by so much, in one go from none.

        Args:
            shift: along x [R].
            friction: Coulomb's coefficient; infinite where nothing slips, 0 where all does.
        """
        lag, G, states = self._compliance
        count = len(self.limit)
        bound = friction * self.limit if np.isfinite(friction) else np.full(count, np.inf)
        q = np.zeros(2 * count)
        if not np.isfinite(friction):
            q = np.linalg.solve(np.eye(2 * count) + TANGENT * G, -TANGENT * shift * lag)
        elif friction > 0.0:
            q = self._limited(shift * lag, bound)
        state = shift * states[:, 0] + states[:, 1:] @ q
        pairs = q.reshape(-1, 2)
        return Increment(
            shift=shift,
            force=self.force(state, shift, q),
            traction=pairs,
            sticking=np.sqrt((pairs**2).mean(axis=1)) < bound * (1 - 1e-6),
            state=state,
        )

    @cached_property
    def _principal(self) -> tuple[Points, Float[ndarray, "n n"]]:
        """Compliance of the touching points with their tangential springs, in tractions times root weight."""
        root = np.sqrt(np.repeat(self._bases[2], 2))
        G = root[:, None] * self._compliance[1] / root
        values, vectors = np.linalg.eigh((G + G.T) / 2)
        return values + 1.0 / TANGENT, vectors

    def _limited(self, lag: Points, bound: Points) -> Points:
        """Tractions q of the least q.A q / 2 + q.lag within their bounds."""
        values, vectors = self._principal
        root = np.sqrt(np.repeat(self._bases[2], 2))
        lag, most = root * lag, bound * np.sqrt(2.0 * self._bases[2])
        firm = math.sqrt(values[0] * values[-1])
        held, missed = np.zeros_like(lag), np.zeros_like(lag)
        for _ in range(ROUNDS):
            free = vectors @ ((vectors.T @ (firm * (held - missed) - lag)) / (values + firm))
            wanted = (1.6 * free - 0.6 * held + missed).reshape(-1, 2)
            size = np.maximum(np.hypot(*wanted.T), 1e-300)
            before, held = held, (wanted * np.minimum(1.0, most / size)[:, None]).ravel()
            missed = wanted.ravel() - held
            if max(np.abs(free - held).max(), np.abs(held - before).max()) < SETTLED * most.max():
                return held / root
        raise RuntimeError(f"{np.abs(free - held).max():.1e} E of traction did not settle in {ROUNDS} rounds")

    def force(self, state: ndarray, shift: float, q: ndarray) -> float:
        """Force of the sphere on the skin along x, its turned pressure with it [E R^2]."""
        load = self._spread @ q - self._springs @ (state - shift * self._aside)
        return float(np.pi * (self._aside @ load))

    def reaction(self, state: ndarray) -> float:
        """Force of the body on its bonded base along x, which balances that of the sphere [E R^2]."""
        _, Z = self.disc.cells.doflocs
        n = self.disc.nodes
        base = np.flatnonzero(np.isclose(Z, self.disc.thickness))
        out = self._solid @ state
        return float(-np.pi * (out[base].sum() - out[base + n].sum()))

    def cauchy(self, one: Increment) -> Float[ndarray, "cells q 6"]:
        """What it adds to Cauchy's stress at places that move along: rr, tt, zz, rz, and of sin t rt, tz."""
        d, (F, g, J, _), n = self.disc, self.pressed, self.disc.nodes
        nodes = d.cells.element_dofs.T
        H = (self.gradient @ one.state[np.hstack([nodes, nodes + n, nodes + 2 * n])][:, None, :, None])[
            ..., 0
        ]
        dF = H.reshape(*H.shape[:2], 3, 3)
        p = np.einsum("cqa,ca->cq", d.corner_shapes, one.state[d.corners.element_dofs.T + 3 * n])
        swell = np.einsum("cqij,cqij->cq", g, dF)
        stretch = dF @ np.swapaxes(F, 2, 3)
        excess = F @ np.swapaxes(F, 2, 3) - np.eye(3)
        over = (self.press.solid.mu / J)[..., None, None]
        s = over * (stretch + np.swapaxes(stretch, 2, 3) - swell[..., None, None] * excess)
        s = s + p[..., None, None] * np.eye(3)
        return np.stack([s[..., i, j] for i, j in ((0, 0), (2, 2), (1, 1), (0, 1), (0, 2), (2, 1))], axis=-1)


def _summed(blocks: tuple[tuple[ndarray, ndarray, ndarray], ...], total: int) -> sp.csr_matrix:
    rows = np.concatenate([np.broadcast_to(a[:, :, None], K.shape).ravel() for a, _, K in blocks])
    columns = np.concatenate([np.broadcast_to(b[:, None, :], K.shape).ravel() for _, b, K in blocks])
    values = np.concatenate([K.ravel() for _, _, K in blocks])
    return sp.csr_matrix((values, (rows, columns)), shape=(total, total))
