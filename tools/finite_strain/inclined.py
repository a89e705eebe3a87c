"""A hemispherical tip, gel under a skin, pressed along its axis on an inclined top, at finite strain.

Lengths in mm, stresses in MPa, forces in N, in the tip's own frame: its apex, untouched, is the origin, z
points along its axis to its base, which is at rest, and the top rises by the approach. The top's normal
leans from z towards -x by the tilt, so that it first touches the tip on its side +x, at that angle. Without
friction. All is even about the plane y = 0; half is solved.

The half dome is meshed by angles around the line y through its centre: `across` from the base at +x through
the apex to the base at -x, `aside` from the plane y = 0 to the line itself, which the base holds. So the mesh
has no pole where anything moves.

A rigid top is a plane. A compliant one is a cylinder at finite strain too, in its own frame: x up its slope,
z along its axis, the middle of its untouched top the origin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from .bricks import OUTSIDE, Bricks, gauss, serendipity
from .cylinder import Cylinder
from .frontal import Elements, eliminated
from .meeting import penalty
from .press import extrapolated
from .revolved import InsideOutError
from .surface_contact import Below, below, pressed
from .tip import CORE, ConvergenceError, Tip

RESIDUAL = 1e-5  # N, of a node on a plate
# On a cylinder, and as much again a mm of approach; single precision leaves 3e-5 there.
RESIDUAL_ON_CYLINDER = 2e-4
# After so many moves what comes and goes at the contact's edge may remain.
ITERATIONS, PATIENT, SETTLED = 15, 8, 4e-3
MAX_MOVE = 1.0  # mm, of one move
# Of what is out of balance: beyond so many times what it was, only a part of a move is made.
GROWTH, PARTS = 10.0, (1.0, 0.5, 0.25, 0.125)
FIRST_STEP, SHORTEST_STEP, LONGEST_STEP = 0.4, 4e-3, 0.75  # mm of approach
QUICK = 10  # moves after which the next step may be longer
FACE_POINTS = 5  # a direction, of a skin's face
SMOOTH = 5e-4  # mm of gap over which the penalty sets in
PRESSING = 2.8e-4  # MPa above which a point touches: as much as the head-on tables' points have there
TOUCHES = 1e-9  # MPa/mm of a penalty's stiffness, below which there is no contact


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
    normal: Float[ndarray, "f q 3"]  # of the top, by its slope, in the tip's frame


@dataclass(frozen=True)
class Inclined:
    """Tip and top in balance."""

    approach: float  # mm
    u: Float[ndarray, "nodes 3"]  # of the tip, in its frame
    top: Float[ndarray, "others 3"]  # of the cylinder, in its own; none of a plate
    touched: Touched


@dataclass
class InclinedPress:
    """One tip against one inclined top; None is a rigid plate."""

    tip: Tip
    top: Cylinder | None
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

    def _over(self, u: ndarray, approach: float) -> tuple[Float[ndarray, "f q 3"], Float[ndarray, "f q 3"]]:
        """Deformed places of the skin's points, in the tip's frame and in the top's."""
        N, nodes, _ = self._surface
        x = np.einsum("qa,fai->fqi", N, (self.body.places + u)[nodes])
        centre = np.array([0.0, 0.0, self.tip.radius])
        raised = np.array([0.0, 0.0, self.tip.radius]) - approach * self.axes[:, 2]
        return x, (x - centre) @ self.axes.T + raised

    def touch(self, u: ndarray, top: ndarray, approach: float) -> tuple[Touched, ndarray, Below | None]:
        """The contact, how stiff it is, and where on a compliant top it is."""
        x, local = self._over(u, approach)
        gap, normal, found = local[..., 2], np.broadcast_to(self.axes[2], x.shape), None
        if self.top is not None:
            places = (self.top.body.places + top)[self.top.facet_nodes]
            found = below(local.reshape(-1, 3), places)
            gap = found.gap.reshape(gap.shape)
            normal = (found.normal @ self.axes).reshape(x.shape)
        pressure, stiff = penalty(gap, SMOOTH)
        return Touched(gap, pressure, x, normal), stiff, found

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
        """Balance at ever greater approaches, in steps as long as Newton's method likes."""
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
        u, top = np.zeros_like(self.body.places), np.zeros((0, 3))
        if self.top is not None:
            top = np.zeros_like(self.top.body.places)
        return Inclined(0.0, u, top, self.touch(u, top, 0.0)[0])

    def _balance(self, past: list[Inclined], approach: float) -> Inclined:
        """Newton's method from the curve through the last states."""
        u, top = (
            extrapolated([(p.approach, getattr(p, name)) for p in past], approach) for name in ("u", "top")
        )
        out, answer = self._assemble(u, top, approach)
        balanced = RESIDUAL if self.top is None else RESIDUAL_ON_CYLINDER * (1 + approach)
        for iteration in range(ITERATIONS):
            worst = float(np.abs(out).max())
            if worst < (balanced if iteration < PATIENT else SETTLED):
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
            there, on_top = u.copy(), top.copy()
            there.ravel()[self.body.free] += part * move[:n]
            if self.top is not None:
                on_top.ravel()[self.top.body.free] += part * move[n:]
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
        bodies, moved = [self.body], [u]
        if self.top is not None:
            bodies, moved = [self.body, self.top.body], [u, top]
        try:
            forces, stiffness = zip(*(b.balance(m) for b, m in zip(bodies, moved, strict=True)), strict=True)
        except InsideOutError:
            raise ConvergenceError("a cell turned inside out") from None
        touched, stiff, found = self.touch(u, top, approach)
        contact, pressing = self._contact(touched, stiff, found)
        out = np.concatenate([b.assembled(f) for b, f in zip(bodies, forces, strict=True)])
        out += np.bincount(contact.unknowns.ravel() + 1, pressing.ravel(), len(out) + 1)[1:]
        kinds = [Elements(self.body.dofs_of, stiffness[0], 2 * self._layer(self.body))]
        if self.top is not None:
            dofs = self.top.body.dofs_of
            group = 2 * self._beside(u, top, approach)[self._layer(self.top.body)] + 1
            kinds.append(Elements(np.where(dofs < 0, -1, dofs + len(self.body.free)), stiffness[1], group))

        def answer() -> ndarray:
            try:
                factors = eliminated([*kinds, contact], len(out))
            except np.linalg.LinAlgError:
                if found is None:
                    raise
                # far from balance the top's turning may make it so; without it a move still leads there
                straight, _ = self._contact(touched, stiff, found, turning=False)
                factors = eliminated([*kinds, straight], len(out))
            return factors.solve(-out)

        return out, answer

    def _contact(
        self, touched: Touched, stiff: ndarray, found: Below | None, turning: bool = True
    ) -> tuple[Elements, Float[ndarray, "e k"]]:
        """What presses, and its stiffness, of every face of the skin with every facet it is over."""
        N, _, weight = self._surface
        face, point = np.nonzero(stiff > TOUCHES)
        load, k = (weight * touched.pressure)[face, point], (weight * stiff)[face, point]
        unknowns, group = self._skin_unknowns, 2 * self._layer(self.body)[self.faces]
        if found is None or self.top is None:
            first = (N[point][..., None] * self.axes[2]).reshape(-1, 24)
            out, K = -load[:, None] * first, k[:, None, None] * first[:, :, None] * first[:, None]
            return _summed(unknowns, group, face, out, K)
        here = found.taken(face * len(N) + point)
        out, K = pressed(here, N[point], self.axes, load, k, turning)
        pairs, which = np.unique(face * len(self.top.facets) + here.facet, return_inverse=True)
        face, facet = np.divmod(pairs, len(self.top.facets))
        of_top = self.top.body.dofs_of[self.top.facets][:, _DIRECTIONS][facet]
        of_top = np.where(of_top < 0, -1, of_top + len(self.body.free))
        return _summed(np.concatenate([unknowns[face], of_top], axis=1), group[face], which, out, K)

    @cached_property
    def _skin_unknowns(self) -> Int[ndarray, "f 24"]:
        return self.body.dofs_of[self.faces][:, _DIRECTIONS]

    @staticmethod
    def _layer(body: Bricks) -> Int[ndarray, " cells"]:
        """Of every cell its number along the first coordinate."""
        layers = len(body.knots[0]) - 1
        return np.repeat(np.arange(layers), len(body.nodes_of) // layers)

    def _beside(self, u: ndarray, top: ndarray, approach: float) -> Int[ndarray, " layers"]:
        """The tip's layer that each of the cylinder's is nearest to, up the slope."""
        x = self._over(u, approach)[1].mean(axis=1)[:, 0]
        layer = self._layer(self.body)[self.faces]
        which = np.unique(layer)
        at = np.array([x[layer == i].mean() for i in which])
        places = (self.top.body.places + top)[self.top.facet_nodes].mean(axis=1)[:, 0]
        middles = places.reshape(self.top.across, -1).mean(axis=1)
        return which[np.abs(at - middles[:, None]).argmin(axis=1)]


_DIRECTIONS = (3 * OUTSIDE[:, None] + np.arange(3)).ravel()


def _summed(
    unknowns: Int[ndarray, "e k"],
    group: Int[ndarray, " e"],
    element: Int[ndarray, " p"],
    out: Float[ndarray, "p k"],
    K: Float[ndarray, "p k k"],
) -> tuple[Elements, Float[ndarray, "e k"]]:
    """Points put together by the elements they belong to."""
    order = np.argsort(element, kind="stable")
    which, starts = np.unique(element[order], return_index=True)
    if len(which):
        out, K = (np.add.reduceat(values[order], starts) for values in (out, K))
    return Elements(unknowns[which], K, group[which]), out


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
