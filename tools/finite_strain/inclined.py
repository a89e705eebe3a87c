"""A hemispherical tip, gel under a skin, pressed along its axis on an inclined top, at finite strain.

Lengths in mm, stresses in MPa, forces in N, in the tip's own frame: its apex, untouched, is the origin, z
points along its axis to its base, which is at rest, and the top rises by the approach. The top's normal
leans from z towards -x by the tilt, so that it first touches the tip on its side +x, at that angle. Without
friction. All is even about the plane y = 0; half is solved.

The half dome is meshed by angles around the line y through its centre: `across` from the base at +x through
the apex to the base at -x, `aside` from the plane y = 0 to the line itself, which the base holds. So the mesh
has no pole where anything moves.

A rigid top is a plane. A compliant one is a linear cylinder, bonded to its base, by its Fourier modes: its
top's height is unknown beside the tip's displacement, and pressure acts along the normal of the deformed top.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from .bricks import AT, Bricks, gauss, serendipity
from .linear_top import LinearTop
from .meeting import penalty
from .revolved import InsideOutError
from .tip import CORE, ConvergenceError, Tip

RESIDUAL = 1e-5  # N
# After so many moves what comes and goes, at the contact's edge or over a ring of the top, may remain.
ITERATIONS, PATIENT, SETTLED = 15, 8, 4e-3
MAX_MOVE = 1.0  # mm, of one move
# Of what is out of balance: beyond so many times what it was, only a part of a move is made.
GROWTH, PARTS = 10.0, (1.0, 0.5, 0.25, 0.125)
FIRST_STEP, SHORTEST_STEP, LONGEST_STEP = 0.4, 4e-3, 0.9  # mm of approach
QUICK = 10  # moves after which the next step may be longer
FACE_POINTS = 5  # a direction, of a skin's face
SMOOTH = 5e-4  # mm of gap over which the penalty sets in
PRESSING = 2.8e-4  # MPa above which a point touches: as much as the head-on tables' points have there
OUTSIDE = np.flatnonzero(AT[:, 2] == 1)


@dataclass(frozen=True)
class Fineness:
    """Numbers of cells of the half dome.

    Attributes:
        degrees: of a cell of the skin where it may touch.
        gel: layers of cells below the skin, which has two.
        widest: of a cell elsewhere [deg].
    """

    degrees: float = 6.0
    gel: int = 2
    widest: float = 6.5


@dataclass(frozen=True)
class Touched:
    """The contact of one state, at the skin's points."""

    gap: Float[ndarray, "f q"]  # mm
    pressure: Float[ndarray, "f q"]  # MPa, on the unloaded skin
    places: Float[ndarray, "f q 3"]  # deformed
    normal: Float[ndarray, "f q 3"]  # of the top, by its slope


@dataclass(frozen=True)
class Inclined:
    """Tip and top in balance."""

    approach: float  # mm
    u: Float[ndarray, "nodes 3"]
    top: Float[ndarray, " t"]
    touched: Touched


@dataclass
class InclinedPress:
    """One tip against one inclined top; None is a rigid plate."""

    tip: Tip
    top: LinearTop | None
    tilt: float  # rad
    poisson_ratio: float = 0.48
    fineness: Fineness = field(default_factory=Fineness)
    reach: float = np.deg2rad(52.0)  # of the fine cells, from the first touch
    iterations: int = field(default=0, init=False)

    @cached_property
    def body(self) -> Bricks:
        t, n = self.tip, self.fineness
        inner, cell = t.radius - t.skin, np.deg2rad(n.degrees)
        first = np.pi / 2 - self.tilt  # of `across` where the tip first touches
        low, high = max(first - self.reach, 0.0), min(first + self.reach, np.pi)
        widest = np.deg2rad(n.widest)
        across = _graded(0.0, np.pi, low, high, cell, widest)
        aside = _graded(0.0, np.pi / 2, 0.0, self.reach, cell, widest)
        depth = np.cumsum(2.0 ** np.arange(n.gel))
        gel = inner - depth[::-1] / depth[-1] * (inner - CORE)
        rho = np.concatenate([gel, np.linspace(inner, t.radius, 3)])
        E = np.full((len(across) - 1, len(aside) - 1, len(rho) - 1), t.gel_mpa)
        E[:, :, -2:] = t.skin_mpa
        return Bricks((across, aside, rho), self._place, E, self.poisson_ratio, self._held)

    def _place(self, at: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        a, b, rho = at.T
        x, z = np.cos(b) * np.cos(a), -np.cos(b) * np.sin(a)
        return np.stack([rho * x, rho * np.sin(b), self.tip.radius + rho * z], axis=1)

    def _held(self, at: Float[ndarray, "n 3"]) -> ndarray:
        a, b, rho = at.T
        base = np.isclose(np.sin(a), 0.0) | np.isclose(b, np.pi / 2) | np.isclose(rho, CORE)
        held = np.repeat(base[:, None], 3, axis=1)
        held[:, 1] |= np.isclose(b, 0.0)
        return held

    @property
    def axes(self) -> Float[ndarray, "3 3"]:
        """Up the top's slope, y, and its normal."""
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    @cached_property
    def faces(self) -> Int[ndarray, " f"]:
        """Cells whose outside may touch."""
        shape = self.body.youngs_modulus.shape
        skin = np.arange(np.prod(shape)).reshape(shape)[:, :, -1].ravel()
        out = self.body.places[self.body.nodes_of[skin]].mean(axis=1) - [0.0, 0.0, self.tip.radius]
        out /= np.linalg.norm(out, axis=1)[:, None]
        return skin[out @ -self.axes[2] > np.cos(self.reach + 0.1)]

    @cached_property
    def _surface(self) -> tuple[ndarray, Int[ndarray, "f 8"], Float[ndarray, "f q"]]:
        """Shape functions of the outside's nodes at its points, these nodes, and unloaded areas [mm^2]."""
        at, weight = gauss(FACE_POINTS, 2)
        N, D = serendipity(np.column_stack([at, np.ones(len(at))]))
        nodes = self.body.nodes_of[self.faces][:, OUTSIDE]
        along = np.einsum("qad,fai->fqdi", D[:, OUTSIDE, :2], self.body.places[nodes])
        normal = np.cross(along[:, :, 0], along[:, :, 1])
        self._slopes = D[:, OUTSIDE, :2]
        return N[:, OUTSIDE], nodes, np.linalg.norm(normal, axis=-1) * weight

    def touch(self, u: ndarray, top: ndarray, approach: float) -> tuple[Touched, ndarray, list[ndarray]]:
        """The contact, how stiff it is, and its answer to the top's unknowns."""
        N, nodes, _ = self._surface
        x = np.einsum("qa,fai->fqi", N, (self.body.places + u)[nodes])
        centre = np.array([0.0, 0.0, self.tip.radius])
        local = (x - centre) @ self.axes.T
        local[..., 2] += self.tip.radius
        local -= approach * self.axes[:, 2]
        gap = local[..., 2].copy()
        normal = np.broadcast_to(self.axes[2], x.shape)
        parts: list[ndarray] = []
        if self.top is not None:
            parts = self.top.at(local[..., :2])
            height, slope = parts[0] @ top, parts[1] @ top
            gap = np.where(self.top.beyond(local[..., :2]), np.inf, gap - height)
            normal = normal - slope @ self.axes[:2]
        pressure, stiff = penalty(gap, SMOOTH)
        return Touched(gap, pressure, x, normal), stiff, parts

    def force(self, state: Inclined) -> Float[ndarray, 3]:
        """On the whole tip [N]."""
        _, _, weight = self._surface
        half = np.einsum("fq,fq,fqi->i", weight, state.touched.pressure, state.touched.normal)
        return 2.0 * half * [1.0, 0.0, 1.0]

    def area(self, state: Inclined) -> float:
        """Of the contact, on the top's plane [mm^2]."""
        _, nodes, _ = self._surface
        _, w = gauss(FACE_POINTS, 2)
        along = np.einsum("qad,fai->fqdi", self._slopes, (self.body.places + state.u)[nodes])
        flat = -np.cross(along[:, :, 0], along[:, :, 1]) @ self.axes[2]
        return float(2.0 * (np.abs(flat) * w)[state.touched.pressure > PRESSING].sum())

    def states(self) -> Iterator[Inclined]:
        """Balance at ever greater approaches, in steps as long as Newton's method likes.

        Raises:
            ConvergenceError: even the shortest step fails.
        """
        past, step = [self.untouched()], FIRST_STEP
        while True:
            before = self.iterations
            try:
                past = [*past[-2:], self._balance(past, past[-1].approach + step)]
            except ConvergenceError:
                step /= 2
                if step < SHORTEST_STEP:
                    raise
                continue
            yield past[-1]
            quick = self.iterations - before <= QUICK
            step = min(step * (1.6 if quick else 1.0), LONGEST_STEP)

    def untouched(self) -> Inclined:
        u, top = np.zeros_like(self.body.places), np.zeros(self.top.size if self.top else 0)
        return Inclined(0.0, u, top, self.touch(u, top, 0.0)[0])

    def _balance(self, past: list[Inclined], approach: float) -> Inclined:
        """Newton's method from the curve through the last states."""
        u, top = (_onwards(past, [getattr(p, name) for p in past], approach) for name in ("u", "top"))
        out, answer = self._assemble(u, top, approach)
        for iteration in range(ITERATIONS):
            worst = float(np.abs(out).max())
            if worst < (RESIDUAL if iteration < PATIENT else SETTLED):
                return Inclined(approach, u, top, self.touch(u, top, approach)[0])
            self.iterations += 1
            try:
                move = answer()
            except np.linalg.LinAlgError:
                raise ConvergenceError(f"approach {approach:g} mm: unstable") from None
            move *= min(1.0, MAX_MOVE / np.abs(move).max())
            u, top, out, answer = self._moved(u, top, move, approach, GROWTH * float(np.linalg.norm(out)))
        raise ConvergenceError(f"approach {approach:g} mm: {worst:.1e} N left out of balance")

    def _moved(self, u: ndarray, top: ndarray, move: ndarray, approach: float, most: float):
        """After a move, or a part of it where more than `most` would be out of balance."""
        n = len(self.body.free)
        for part in PARTS:
            there = u.copy()
            there.ravel()[self.body.free] += part * move[:n]
            on_top = top + part * move[n:]
            try:
                out, answer = self._assemble(there, on_top, approach)
            except ConvergenceError:
                if part == PARTS[-1]:
                    raise
                continue
            if np.linalg.norm(out) < most:
                break
        return there, on_top, out, answer

    def _assemble(self, u: ndarray, top: ndarray, approach: float):
        """Forces out of balance, and how to find the move that brings them into it."""
        try:
            force, K = self.body.balance(u)
        except InsideOutError:
            raise ConvergenceError("a cell turned inside out") from None
        touched, stiff, parts = self.touch(u, top, approach)
        N, _, weight = self._surface
        near = (stiff > 1e-9).any(axis=1)
        w, p, k, n = weight[near], touched.pressure[near], stiff[near], touched.normal[near]
        first = np.einsum("qa,fqi->fqai", N, n).reshape(*w.shape, 24)  # of the gap, by the skin
        at = (3 * OUTSIDE[:, None] + np.arange(3)).ravel()
        cells = self.faces[near]
        force[cells[:, None], at] -= np.einsum("fq,fqa->fa", w * p, first)
        K[cells[:, None, None], at[:, None], at] += np.swapaxes(first * (w * k)[..., None], 1, 2) @ first
        if self.top is None:
            out = self.body.assembled(force)
            return out, lambda: self.body.factored(K).solve(-out[:, None])[:, 0]
        return self._with_top(force, K, top, (w, p, k), first, [part[near] for part in parts], cells, at)

    def _with_top(self, force, K, top, contact, first, parts, cells, at):
        """The same beside a compliant top, whose unknowns border those of the tip."""
        (w, p, k), (N_top, slope), N = contact, parts, self._surface[0]
        size = self.top.size
        out_top = self.top.stiffness @ top + np.einsum("fq,fqt->t", w * p, N_top)
        D = self.top.stiffness + np.einsum("fq,fqs,fqt->st", w * k, N_top, N_top, optimize=True)
        sloped = np.einsum("fqst,si->fqit", slope, self.axes[:2])  # d2 gap / du dtop = - N_a of it
        cross = -np.einsum("fqa,fqt->fat", first * (w * k)[..., None], N_top, optimize=True)
        cross += np.einsum("qa,fqit->fait", N, sloped * (w * p)[..., None, None], optimize=True).reshape(
            len(cells), 24, size
        )
        n = len(self.body.free)
        B = np.zeros((n + 1, size))
        np.add.at(B, self.body.dofs_of[cells][:, at], cross)
        B = B[:n]  # the last row took what is held
        out = self.body.assembled(force)

        def answer() -> ndarray:
            X = self.body.factored(K).solve(np.column_stack([B, -out]))
            rest = np.linalg.solve(D - B.T @ X[:, :-1], -out_top - B.T @ X[:, -1])
            return np.concatenate([X[:, -1] - X[:, :-1] @ rest, rest])

        return np.concatenate([out, out_top]), answer


def _onwards(past: list[Inclined], values: list[ndarray], approach: float) -> ndarray:
    """The polynomial through the last states."""
    z = np.array([p.approach for p in past])
    share = [np.prod((approach - np.delete(z, i)) / (z[i] - np.delete(z, i))) for i in range(len(z))]
    return sum((s * v for s, v in zip(share, values, strict=True)), np.zeros_like(values[0]))


def _graded(
    start: float, end: float, low: float, high: float, cell: float, widest: float
) -> Float[ndarray, " n"]:
    """Knots, even between low and high, growing outside."""
    even = np.linspace(low, high, round((high - low) / cell) + 1)
    before, after = (_growing(length, cell, widest) for length in (low - start, end - high))
    return np.concatenate([low - before[::-1], even, high + after])


def _growing(length: float, cell: float, widest: float) -> Float[ndarray, " n"]:
    """Distances of knots beyond an even stretch, by cells that grow by a quarter up to the widest."""
    if length < 0.3 * cell:
        return np.array([length] if length > 1e-9 else [])
    sizes = [min(1.25 * cell, widest)]
    while sum(sizes) < length:
        sizes.append(min(1.25 * sizes[-1], widest))
    if len(sizes) > 1 and length - sum(sizes[:-1]) < 0.4 * sizes[-1]:
        sizes.pop()
    return np.cumsum(sizes) * length / sum(sizes)
