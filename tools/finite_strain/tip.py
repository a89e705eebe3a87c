"""A hemispherical tip, gel under a skin, pressed head-on on a bonded cylinder, domed or flat, soft or rigid.

Lengths in mm, stresses in MPa, forces in N. The middle of the specimen's unloaded top is z = 0, and z points
to the camera; the tip's axis is r = 0, its centre (0, R), its equator and a small core around the centre are
held and move down by the approach. The cylinder's base is bonded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Float, Int
from numpy import ndarray

from .meeting import Meeting, Touch
from .revolved import Displacement, InsideOutError, Revolved, tensor_mesh

RESIDUAL = 2e-7  # N over 2 pi, the greatest force left out of balance
ITERATIONS = 25
PATIENT, SETTLED = 12, 4e-4  # after so many, single points that come and go at the edge may remain
MAX_MOVE = 1.0  # mm, of one Newton step
SHORTEST_STEP = 2e-3  # mm of approach
GROWTH = 100.0  # a changed contact may raise the residual for an iteration or two, but not by more
CORE = 1.0  # mm
DENSE_TO = np.deg2rad(60.0)  # polar angle up to which skin cells are fine
DENSE_TO_MM = 18.0  # radius up to which the specimen's are


class ConvergenceError(ArithmeticError):
    """Newton's method found no balance at this approach."""


@dataclass(frozen=True)
class Tip:
    """Geometry [mm] and Young's moduli [MPa] of gel and skin."""

    skin_mpa: float
    gel_mpa: float
    radius: float = 20.0
    skin: float = 1.0


@dataclass(frozen=True)
class Specimen:
    """A cylinder bonded to its base, its top flat or a cap of a sphere [mm, MPa].

    Attributes:
        mpa: Young's modulus, `inf` for a rigid one.
        height: on the axis; of a layer its thickness.
        dome: radius of curvature of the top, `inf` for a flat one; no less than `radius`.
    """

    mpa: float
    height: float = 40.0
    radius: float = 20.0
    dome: float = np.inf

    @property
    def rigid(self) -> bool:
        return not np.isfinite(self.mpa)

    def top(self, r: Float[ndarray, " k"]) -> Float[ndarray, " k"]:
        """Height of the unloaded top over its middle."""
        if not np.isfinite(self.dome):
            return np.zeros_like(r)
        return np.sqrt(np.maximum(self.dome**2 - r**2, 0.0)) - self.dome


@dataclass(frozen=True)
class Balanced:
    """Both bodies in balance."""

    approach: float  # mm
    u: Displacement
    touch: Touch


@dataclass
class TipPress:
    """One tip against one specimen."""

    tip: Tip
    specimen: Specimen
    poisson_ratio: float = 0.48
    cells: int = 60  # of the skin up to 60 degrees
    iterations: int = field(default=0, init=False)

    @cached_property
    def tip_body(self) -> Revolved:
        t, n = self.tip, self.cells
        inner = t.radius - t.skin
        phi = np.concatenate(
            [np.linspace(0, DENSE_TO, n + 1), np.linspace(DENSE_TO, np.pi / 2, n // 5 + 1)[1:]]
        )
        # cells of the gel grow inwards from the skin
        depth = np.cumsum(1.18 ** np.arange(n // 5))
        rho = np.concatenate(
            [inner - depth[::-1] / depth[-1] * (inner - CORE), np.linspace(inner, t.radius, 3)]
        )

        def place(x: Float[ndarray, "2 k"]) -> Float[ndarray, "2 k"]:
            return np.stack([x[1] * np.sin(x[0]), t.radius - x[1] * np.cos(x[0])])

        mesh = tensor_mesh(phi, rho, place)
        middle = mesh.doflocs[:, mesh.t].mean(axis=1)
        out = np.hypot(middle[0], middle[1] - t.radius)
        return Revolved(mesh, np.where(out > inner, t.skin_mpa, t.gel_mpa), self.poisson_ratio)

    @cached_property
    def specimen_body(self) -> Revolved:
        s, n = self.specimen, self.cells
        near = min(0.9 * s.radius, DENSE_TO_MM)
        r = np.concatenate([np.linspace(0, near, round(0.65 * n) + 1), np.linspace(near, s.radius, 6)[1:]])
        down = np.cumsum(1.25 ** np.arange(n // 5 + 1))
        z = np.concatenate([-down[::-1] / down[-1] * s.height, [0.0]])

        def place(x: Float[ndarray, "2 k"]) -> Float[ndarray, "2 k"]:
            return np.stack([x[0], x[1] + (1 + x[1] / s.height) * s.top(x[0])])

        mesh = tensor_mesh(r, z, place)
        return Revolved(mesh, np.full(mesh.t.shape[1], s.mpa), self.poisson_ratio)

    @property
    def bodies(self) -> tuple[tuple[Revolved, int], ...]:
        """Those that deform, and the number of the first node of each."""
        both = ((self.tip_body, 0), (self.specimen_body, len(self.tip_body.places)))
        return both[:1] if self.specimen.rigid else both

    @cached_property
    def places(self) -> Float[ndarray, "nodes 2"]:
        return np.concatenate([self.tip_body.places, self.specimen_body.places])

    def _polar(self) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
        """Polar angle and distance from the centre of the tip's nodes."""
        r, z = self.tip_body.places.T
        return np.arctan2(r, self.tip.radius - z), np.hypot(r, z - self.tip.radius)

    def shell(self, distance: float) -> Int[ndarray, " n"]:
        """The tip's nodes at a distance from its centre, from the axis outwards."""
        phi, rho = self._polar()
        at = np.flatnonzero(np.isclose(rho, distance, atol=1e-6))
        return at[np.argsort(phi[at])]

    @cached_property
    def meeting(self) -> Meeting:
        skin = self.shell(self.tip.radius)
        first = len(self.tip_body.places)
        r, z = self.specimen_body.places.T
        top = np.flatnonzero(np.isclose(z, self.specimen.top(r), atol=1e-9))
        return Meeting(self.places, _facets(skin), _facets(first + top[np.argsort(r[top])]))

    @cached_property
    def base(self) -> Int[ndarray, " n"]:
        """The tip's nodes that are held."""
        phi, rho = self._polar()
        return np.flatnonzero(np.isclose(phi, np.pi / 2) | np.isclose(rho, CORE))

    @cached_property
    def free(self) -> Int[ndarray, " n"]:
        """Degrees of freedom that are not held."""
        axis = np.flatnonzero(np.isclose(self.places[:, 0], 0.0))
        first = len(self.tip_body.places)
        still = np.arange(first, len(self.places))
        if not self.specimen.rigid:
            still = still[np.isclose(self.places[still, 1], -self.specimen.height)]
        held = np.concatenate([self.base, still])
        return np.setdiff1d(
            np.arange(2 * len(self.places)), np.concatenate([2 * held, 2 * held + 1, 2 * axis])
        )

    def untouched(self) -> Balanced:
        u = np.zeros_like(self.places)
        return Balanced(0.0, u, self.meeting.touch(u))

    def through(self, approaches: Iterable[float]) -> Iterator[Balanced]:
        """Balance at each of the ascending approaches [mm], by shorter steps where one does not converge."""
        now = self.untouched()
        for approach in approaches:
            step = approach - now.approach
            while now.approach < approach - 1e-9:
                try:
                    now = self._balance(now, min(approach, now.approach + step))
                except ConvergenceError:
                    step /= 2
                    if step < SHORTEST_STEP:
                        raise
            yield now

    def force(self, balanced: Balanced) -> float:
        """Force between the two [N]."""
        return float(2 * np.pi * (self.meeting.weight * balanced.touch.pressure).sum())

    def _balance(self, last: Balanced, approach: float) -> Balanced:
        """Newton's method; its first step moves the base along with all that hangs on it."""
        u, free = last.u.copy(), self.free
        out, K, touch = self._assemble(u)
        move = np.zeros_like(u)
        move[self.base] = 0.0, last.approach - approach
        pull = K @ move.ravel()
        before = np.inf
        for iteration in range(ITERATIONS):
            self.iterations += 1
            step = spl.splu(K[free][:, free], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
            move.ravel()[free] = step.solve(-(out + pull)[free])
            u = u + (1.0 if iteration == 0 else min(1.0, MAX_MOVE / np.abs(move).max())) * move
            out, K, touch = self._assemble(u)
            move, pull = np.zeros_like(u), np.zeros(u.size)
            worst = float(np.abs(out[free]).max())
            if worst < (RESIDUAL if iteration < PATIENT else SETTLED):
                return Balanced(approach, u, touch)
            if not worst < GROWTH * max(before, 1e-2):
                break
            before = worst
        raise ConvergenceError(f"approach {approach:g} mm: {worst:.1e} N left out of balance")

    def _assemble(self, u: Displacement) -> tuple[ndarray, sp.csc_matrix, Touch]:
        touch = self.meeting.touch(u)
        dofs, forces, blocks = [touch.dofs], [touch.force], [touch.stiffness]
        for body, first in self.bodies:
            try:
                force, block = body.balance(u[first : first + len(body.places)])
            except InsideOutError:
                raise ConvergenceError("a cell turned inside out") from None
            dofs.append(body.dofs_of + 2 * first)
            forces.append(force)
            blocks.append(block)
        n = u.size
        out = sum(np.bincount(d.ravel(), f.ravel(), n) for d, f in zip(dofs, forces, strict=True))
        rows = np.concatenate([np.repeat(d, d.shape[1], axis=1).ravel() for d in dofs])
        columns = np.concatenate([np.tile(d, (1, d.shape[1])).ravel() for d in dofs])
        K = sp.csc_matrix((np.concatenate([b.ravel() for b in blocks]), (rows, columns)), shape=(n, n))
        return out, K, touch


def _facets(nodes: Int[ndarray, " n"]) -> Int[ndarray, "f 3"]:
    """Ends and middle of every facet along a row of nodes."""
    return np.stack([nodes[:-2:2], nodes[1:-1:2], nodes[2::2]], axis=1)
