"""Press step by step: Newton's method on the whole disc at every depth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Float, Int
from numpy import ndarray

from .disc import Disc
from .neo_hookean import NeoHookean, first_piola
from .sphere import NORMAL, Touch, touch

RESIDUAL = 1e-9  # the greatest force left out of balance at any unknown, in E R^2 / 2 pi
ITERATIONS = 30
CAUTIOUS_FROM = 6  # iterations: from then on friction takes its cautious stiffness
MAX_MOVE = 0.15  # R, of one Newton step
SHORTEST_STEP = 2e-4  # R of depth
GROWTH = 30.0  # a changed contact may raise the residual for an iteration or two, but not by more

State = Float[ndarray, " n"]


class ConvergenceError(ArithmeticError):
    """Newton's method found no balance at this depth."""


@dataclass(frozen=True)
class Balanced:
    """A disc in balance under the sphere."""

    depth: float
    state: State
    touch: Touch


@dataclass
class Press:
    """One disc, one friction, one indenter; remembers the pattern of its stiffness and counts its work."""

    disc: Disc
    solid: NeoHookean
    friction: float
    touch: Callable[..., Touch] = touch
    iterations: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        d = self.disc
        u, p, t = d.displacement_dofs, d.pressure_dofs, d.top_dofs
        rows, columns = zip(*(_pairs(a, b) for a, b in ((u, u), (p, u), (u, p), (p, p), (t, t))), strict=True)
        self._fit_pattern(np.concatenate(rows), np.concatenate(columns))

    def _fit_pattern(self, rows: Int[ndarray, " k"], columns: Int[ndarray, " k"]) -> None:
        place = np.full(self.disc.unknowns, -1)
        place[self.disc.free] = np.arange(len(self.disc.free))
        i, j = place[rows], place[columns]
        self._kept = (i >= 0) & (j >= 0)
        n = len(self.disc.free)
        keys, self._slot = np.unique(j[self._kept] * n + i[self._kept], return_inverse=True)
        self._indices = (keys % n).astype(np.int32)
        self._indptr = np.searchsorted(keys // n, np.arange(n + 1)).astype(np.int32)

    def untouched(self) -> Balanced:
        """The disc before first touch."""
        state = np.zeros(self.disc.unknowns)
        none = np.full(self.disc.top_radius.shape, np.nan)
        return Balanced(
            0.0, state, self.touch(self.top(state), 0.0, self.friction, none, self._stiffness(0.0))
        )

    def through(self, depths: Iterable[float]) -> Iterator[Balanced]:
        """Balance at each of the ascending depths, by shorter steps where a step does not converge."""
        past = [self.untouched()]
        for depth in depths:
            step = depth - past[-1].depth
            while past[-1].depth < depth - 1e-12:
                target = min(depth, past[-1].depth + step)
                try:
                    guess = extrapolated([(b.depth, b.state) for b in past], target)
                    past = [*past[-2:], self._balance(past[-1], target, guess)]
                except ConvergenceError:
                    step /= 2
                    if step < SHORTEST_STEP:
                        raise
            yield past[-1]

    def force(self, balanced: Balanced) -> float:
        """Force on the sphere [E R^2]."""
        return float(2.0 * np.pi * (self.disc.top_weight * balanced.touch.traction[..., 1]).sum())

    def _stiffness(self, pressure: float) -> float:
        return max(NORMAL, 2.0 * pressure**2 / (self.solid.mu * self.disc.cell))

    def _balance(self, last: Balanced, depth: float, state: State) -> Balanced:
        """Newton's method from a guess."""
        free, anchor = self.disc.free, last.touch.anchor
        normal = self._stiffness(float(last.touch.pressure.max()))
        out, K, now = self._assemble(state, depth, anchor, normal)
        for iteration in range(ITERATIONS):
            if np.abs(out).max() < RESIDUAL:
                return Balanced(depth, state, now)
            self.iterations += 1
            move = np.zeros_like(state)
            move[free] = _solve(K, -out)
            length = min(1.0, MAX_MOVE / np.abs(move[: 2 * self.disc.nodes]).max())
            state = state + length * move
            before = np.abs(out).max()
            out, K, now = self._assemble(state, depth, anchor, normal, iteration + 1 >= CAUTIOUS_FROM)
            if not np.abs(out).max() < GROWTH * max(before, 1e-3):
                break
        raise ConvergenceError(f"depth {depth:g} R: {np.abs(out).max():.1e} left out of balance")

    def top(self, state: State) -> Float[ndarray, "facets q 2"]:
        """Deformed places (r, z) of the top's quadrature points [R]."""
        d, n = self.disc, self.disc.nodes
        nodes = d.top.element_dofs.T
        u = np.stack([state[:n][nodes], state[n : 2 * n][nodes]], axis=-1)
        x = np.einsum("fqa,fai->fqi", d.top_shapes, u)
        x[..., 0] += d.top_radius
        return x

    def _assemble(
        self,
        state: State,
        depth: float,
        anchor: Float[ndarray, "facets q"],
        normal: float,
        cautious: bool = False,
    ) -> tuple[State, sp.csc_matrix, Touch]:
        d = self.disc
        B, w, N = d.gradient, d.weight, d.corner_shapes
        cells, q = w.shape
        H, p = strained(d, state)
        P, A, JG, J = first_piola(self.solid.mu, H, p)
        if not (J > 0.0).all():
            raise ConvergenceError(f"depth {depth:g} R: a cell turned inside out")
        wB = (w[..., None, None] * B).reshape(cells, q * 5, 18)
        Bt = np.swapaxes(wB, 1, 2)
        Kuu = Bt @ (A @ B).reshape(cells, q * 5, 18)
        Kpu = np.swapaxes(N, 1, 2) @ (np.swapaxes(JG[..., None], -1, -2) @ (w[..., None, None] * B))[:, :, 0]
        wN = w[..., None] * N
        Kpp = -np.swapaxes(wN, 1, 2) @ N / self.solid.lame
        fu = (Bt @ P.reshape(cells, q * 5, 1))[..., 0]
        fp = (np.swapaxes(wN, 1, 2) @ (J - 1.0 - p / self.solid.lame)[..., None])[..., 0]

        now = self.touch(self.top(state), depth, self.friction, anchor, normal, cautious)
        M, tw = d.top_shapes, d.top_weight
        ft = -np.einsum("fq,fqa,fqi->fia", tw, M, now.traction).reshape(len(tw), 18)
        Kt = np.einsum("fq,fqa,fqij,fqb->fiajb", tw, M, now.stiffness, M, optimize=True)

        out = np.bincount(d.displacement_dofs.ravel(), fu.ravel(), minlength=d.unknowns)
        out += np.bincount(d.pressure_dofs.ravel(), fp.ravel(), minlength=d.unknowns)
        out += np.bincount(d.top_dofs.ravel(), ft.ravel(), minlength=d.unknowns)
        blocks = (Kuu, Kpu, np.swapaxes(Kpu, 1, 2), Kpp, Kt)
        values = np.concatenate([block.ravel() for block in blocks])
        data = np.bincount(self._slot, values[self._kept], minlength=len(self._indices))
        n = len(d.free)
        return out[d.free], sp.csc_matrix((data, self._indices, self._indptr), shape=(n, n)), now


def strained(d: Disc, state: State) -> tuple[Float[ndarray, "cells q 5"], Float[ndarray, "cells q"]]:
    """Displacement gradient and pressure at every quadrature point."""
    H = (d.gradient @ state[d.displacement_dofs][:, None, :, None])[..., 0]
    return H, np.einsum("cqa,ca->cq", d.corner_shapes, state[d.pressure_dofs])


def _pairs(a: Int[ndarray, "c i"], b: Int[ndarray, "c j"]) -> tuple[Int[ndarray, " k"], Int[ndarray, " k"]]:
    shape = (len(a), a.shape[1], b.shape[1])
    return np.broadcast_to(a[:, :, None], shape).ravel(), np.broadcast_to(b[:, None, :], shape).ravel()


def extrapolated(past: Sequence[tuple[float, ndarray]], to: float) -> ndarray:
    """The polynomial through the last states, by their places; a straight line while the contact is young."""
    known = past[-2:] if to < 0.15 else past[-3:]
    z = np.array([at for at, _ in known])
    share = [np.prod((to - np.delete(z, i)) / (z[i] - np.delete(z, i))) for i in range(len(z))]
    return sum((s * state for s, (_, state) in zip(share, known, strict=True)), np.zeros_like(past[0][1]))


def _solve(K: sp.csc_matrix, b: State) -> State:
    # nearly symmetric and strong on the diagonal: its own pivots keep the factors sparse
    factors = spl.splu(K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True})
    return np.asarray(factors.solve(b))
