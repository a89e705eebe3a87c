"""A rigid sphere pressed off the centre of a bonded disc, in three dimensions at finite strain.

    python tools/off_centre.py    # solve, and write off_centre.json; under an hour on one core

The press tables are axisymmetric; palpate moves them to where the sphere is. This tells what that costs near
the rim. Half the disc is meshed, up to the plane through its axis and the sphere's, with triquadratic bricks
on rays from the sphere's axis to the rim; the pressure is linear within a brick and discontinuous. Material
and contact are the tables' own (no friction), mesh and solver share nothing with them. Lengths are in sphere
radii, stresses in Young's moduli; x points from the disc's axis to the sphere's, z into the layer.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from numpy.linalg import LinAlgError
from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.disc import DISC_RADIUS
from finite_strain.frontal import Elements, Factors, eliminated
from finite_strain.neo_hookean import NeoHookean
from finite_strain.press import extrapolated

OUT = Path(__file__).parent.parent / "src/palpate/mechanics/tables/off_centre.json"
SOLID = NeoHookean(0.49)
NORMAL = 2000.0  # E/R, springs of the contact; they give by less than 1e-3 R
RESIDUAL = 1e-7  # E R^2, the greatest force left out of balance at any unknown
ROUNDING = 1e-12  # E R^3
ITERATIONS = 30
MAX_MOVE = 0.2  # R, of one Newton step
SHORTEST_STEP = 5e-3  # R of depth
EXACT = 1e-4  # of what is out of balance: left by conjugate gradients
FEW, MANY = 40, 200  # of their steps with an old stiffness eliminated, and with the present one
DENSE_TO = 1.05  # R from the sphere's axis, before loading
MAX_DENSE = 0.8  # of a ray's length, where the rim is nearer than that
OFFSETS = (0.0, 1.4, 2.8, 3.96, 4.2, 4.427, 4.7)  # 0, 7, 14, 19.8, 21, 22.14, 23.5 mm if R is 5 mm
BETWEEN = 4.6  # solved to see what reading between them costs
THICKNESSES = (2.0, 4.0)
DEPTHS = (0.2, 0.4, 0.6, 0.8, 1.0)
STEPS = (0.05, 0.1, *DEPTHS)

Field = Float[ndarray, " n"]


@dataclass(frozen=True)
class Cells:
    """How many bricks: under the sphere, from there to the rim, around the half circle, and deep."""

    under: int = 8
    outside: int = 8
    around: int = 6
    deep: int = 7

    @property
    def radial(self) -> int:
        return self.under + self.outside


MAIN, FINE = Cells(), Cells(10, 9, 8, 8)


def stretched(length: float, first: float, cells: int) -> Float[ndarray, " n"]:
    """Knots from 0 to `length`: the first cell as given or shorter, each next one longer by one factor."""
    t = np.linspace(0.0, 1.0, cells + 1)
    if first * cells >= length:
        return length * t

    def knots(b: float) -> Float[ndarray, " n"]:
        return length * np.expm1(b * t) / np.expm1(b)

    return knots(brentq(lambda b: knots(b)[1] - first, 1e-9, 50.0))


def with_middles(knots: ndarray) -> ndarray:
    """Knots along the first axis, and halfway between them."""
    both = np.empty((2 * len(knots) - 1, *knots.shape[1:]))
    both[::2], both[1::2] = knots, (knots[1:] + knots[:-1]) / 2
    return both


def quadratic(x: Float[ndarray, " q"]) -> tuple[Float[ndarray, "q 3"], Float[ndarray, "q 3"]]:
    """Lagrange's shapes on -1, 0, 1 and their slopes."""
    return (
        np.stack([x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2], axis=1),
        np.stack([x - 0.5, -2 * x, x + 0.5], axis=1),
    )


def triquadratic(points: int) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Shapes [q, 27], slopes [q, 27, 3], weights [q] and places [q, 3] of Gauss points in a unit brick."""
    x, w = np.polynomial.legendre.leggauss(points)
    N, D = quadratic(x)
    shapes = np.einsum("qa,rb,sc->qrsabc", N, N, N).reshape(points**3, 27)
    slopes = [
        np.einsum("qa,rb,sc->qrsabc", *f).reshape(points**3, 27) for f in ((D, N, N), (N, D, N), (N, N, D))
    ]
    places = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    return shapes, np.stack(slopes, axis=-1), np.einsum("q,r,s->qrs", w, w, w).ravel(), places


@dataclass(frozen=True)
class HalfDisc:
    """Nodes, bricks and unknowns; nodes are counted ring by ring outwards from the sphere's axis.

    Attributes:
        thickness: h [R].
        offset: of the sphere's axis from the disc's [R].
    """

    thickness: float
    offset: float
    cells: Cells

    @cached_property
    def nodes(self) -> Float[ndarray, "ring ray level 3"]:
        c, n = self.offset, self.cells
        size = DENSE_TO / n.under
        angle = np.linspace(0.0, np.pi, 2 * n.around + 1)
        length = np.sqrt(DISC_RADIUS**2 - (c * np.sin(angle)) ** 2) - c * np.cos(angle)
        dense = np.linspace(0.0, 1.0, n.under + 1)
        reach = np.minimum(DENSE_TO, MAX_DENSE * length)
        rays = [
            np.concatenate([to * dense, to + stretched(far - to, 1.25 * size, n.outside)[1:]])
            for to, far in zip(reach, length, strict=True)
        ]
        rho = with_middles(np.stack(rays, axis=1))
        z = with_middles(stretched(self.thickness, size, n.deep))
        flat = np.stack([c + rho * np.cos(angle), rho * np.sin(angle)], axis=-1)
        X = np.zeros((*rho.shape, len(z), 3))
        X[..., :2], X[..., 2] = flat[:, :, None], z
        return X

    @cached_property
    def unknown(self) -> Int[ndarray, "ring ray level 3"]:
        """Number of every displacement; -1 where held: the base, and y on the plane of symmetry."""
        shape = self.nodes.shape
        free = np.ones(shape, dtype=bool)
        free[:, :, -1] = False
        free[:, [0, -1], :, 1] = False
        free[0, 1:], free[0, :, :, 1] = False, False  # one point on the axis, on every ray
        number = np.where(free, np.cumsum(free).reshape(shape) - 1, -1)
        number[0, 1:] = number[0, :1]
        return number

    @property
    def unknowns(self) -> int:
        return int(self.unknown.max()) + 1

    @cached_property
    def bricks(self) -> Int[ndarray, "e 27"]:
        """Flat node numbers, all bricks of one ring of bricks after the other, the top one first on a ray."""
        n, shape = self.cells, self.nodes.shape[:3]
        first = np.stack(
            np.meshgrid(*(2 * np.arange(k) for k in (n.radial, n.around, n.deep)), indexing="ij"), -1
        )
        inside = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(27, 3)
        at = first.reshape(-1, 1, 3) + inside
        return np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), shape)

    @cached_property
    def dofs(self) -> Int[ndarray, "e 27 3"]:
        return self.unknown.reshape(-1, 3)[self.bricks]

    def slopes(self, points: int) -> tuple[Float[ndarray, "e q 27 3"], Float[ndarray, "e q"]]:
        """Slopes of the shapes before loading, and volume, at a brick's Gauss points."""
        _, D, w, _ = triquadratic(points)
        dX = np.einsum("qak,eai->eqik", D, self.nodes.reshape(-1, 3)[self.bricks])
        return D @ np.linalg.inv(dX), np.linalg.det(dX) * w


@dataclass
class OffCentre:
    """The sphere pressed at one place of one disc, and Newton's method on it."""

    disc: HalfDisc
    iterations: int = field(default=0, init=False)
    factors: Factors | None = field(default=None, init=False)
    normal: ClassVar[float] = NORMAL

    def __post_init__(self) -> None:
        d = self.disc
        self.G, self.w = d.slopes(3)
        at = triquadratic(3)[3]
        self.modes = np.concatenate([np.ones((27, 1)), at], axis=1)  # of the pressure
        mass = np.einsum("eq,qm,qn->emn", self.w, self.modes, self.modes)
        self.bulk = SOLID.lame * np.linalg.inv(mass)
        self.tops = np.arange(0, len(d.bricks), d.cells.deep)
        x, w = np.polynomial.legendre.leggauss(3)
        N, D = quadratic(x)
        self.top_shapes = np.einsum("qa,rb->qrab", N, N).reshape(9, 9)
        X = self.top_places(np.zeros_like(d.nodes))
        corners = d.nodes.reshape(-1, 3)[d.bricks[self.tops].reshape(-1, 9, 3)[..., 0]]
        dr = np.einsum("qrab,eabi->eqri", np.einsum("qa,rb->qrab", D, N), corners.reshape(-1, 3, 3, 3))
        dt = np.einsum("qrab,eabi->eqri", np.einsum("qa,rb->qrab", N, D), corners.reshape(-1, 3, 3, 3))
        area = dr[..., 0] * dt[..., 1] - dr[..., 1] * dt[..., 0]
        self.top_area = (area * np.outer(w, w)).reshape(X.shape[:2])

    def through(
        self, depths: Sequence[float], known: Sequence[tuple[float, Field]] = ()
    ) -> Iterator[tuple[float, ndarray]]:
        """Displacement of every node, balanced at each of the ascending depths, beyond those known."""
        past = [(0.0, np.zeros(self.disc.unknowns)), *known][-3:]
        for depth in depths:
            step = depth - past[-1][0]
            while past[-1][0] < depth - 1e-9:
                target = min(depth, past[-1][0] + step)
                try:
                    past = [*past[-2:], (target, self._balance(extrapolated(past, target), target))]
                except ArithmeticError:
                    step /= 2
                    if step < SHORTEST_STEP:
                        raise
            yield depth, self.displacement(past[-1][1])

    def displacement(self, state: Field) -> Float[ndarray, "ring ray level 3"]:
        return np.append(state, 0.0)[self.disc.unknown]

    def top_places(self, u: ndarray) -> Float[ndarray, "e 9 3"]:
        """Deformed places of the top's quadrature points."""
        x = (self.disc.nodes + u).reshape(-1, 3)[self.disc.bricks[self.tops].reshape(-1, 9, 3)[..., 0]]
        return self.top_shapes @ x

    def away(self, u: ndarray, depth: float) -> ndarray:
        """Places of the top's points from the sphere's centre."""
        return self.top_places(u) - np.array([self.disc.offset, 0.0, depth - 1.0])

    def touch(self, u: ndarray, depth: float, stress: float = 1.0) -> tuple[ndarray, ndarray]:
        """Traction on the top per unloaded area, and -d traction / d displacement."""
        away = self.away(u, depth)
        distance = np.linalg.norm(away, axis=-1)[..., None]
        n = away / distance
        p = self.normal * np.maximum(1.0 - distance, 0.0)
        nn = n[..., :, None] * n[..., None, :]
        stiff = np.where(p > 0.0, self.normal, 0.0)[..., None] * nn - stress * (p / distance)[..., None] * (
            np.eye(3) - nn
        )
        return p * n, stiff

    def load(self, u: ndarray, depth: float) -> tuple[ndarray, float]:
        """Force of the whole sphere on the skin along x and z, and how far its centre lies from the axis."""
        traction, _ = self.touch(u, depth)
        share = self.top_area[..., None] * traction
        centre = (share[..., 2] * self.top_places(u)[..., 0]).sum() / share[..., 2].sum()
        return 2.0 * share.sum(axis=(0, 1))[[0, 2]], float(centre) - self.disc.offset

    def _balance(self, state: Field, depth: float) -> Field:
        """Newton's method from a guess, each step shortened until it lowers the energy."""
        for _ in range(ITERATIONS):
            out, K = self._assemble(state, depth)
            if np.abs(out).max() < RESIDUAL:
                return state
            self.iterations += 1
            try:
                move = self._solved(K, -out)
            except LinAlgError:  # a poor guess is pressed too hard to be stable
                move = self._solved(self._assemble(state, depth, stress=0.0)[1], -out)
            length, now = min(1.0, MAX_MOVE / np.abs(move).max()), self.energy(state, depth)
            while self.energy(state + length * move, depth) > now + 1e-4 * length * (move @ out) + ROUNDING:
                length /= 2
                if length < 1e-4:
                    raise ArithmeticError(f"depth {depth:g} R: no step lowers the energy")
            state = state + length * move
        raise ArithmeticError(f"depth {depth:g} R: {np.abs(out).max():.1e} left out of balance")

    def energy(self, state: Field, depth: float) -> float:
        """Of the half disc and the springs of its contact [E R^3]; infinite where a brick is inside out."""
        u = self.displacement(state)
        F, J, _, p = deformed(self, u)
        if not (J > 0.0).all():
            return np.inf
        stretched_by = (F**2).sum(axis=(2, 3)) - 3.0
        solid = self.w * (SOLID.mu * (stretched_by / 2 - np.log(J)) + p**2 / SOLID.lame / 2)
        return float(solid.sum() + (self.top_area * self.stored(u, depth)).sum())

    def stored(self, u: ndarray, depth: float) -> ndarray:
        """Energy of the springs at the top's points, per area."""
        traction, _ = self.touch(u, depth)
        return (traction**2).sum(axis=-1) / self.normal / 2

    def _assemble(
        self, state: Field, depth: float, stress: float = 1.0
    ) -> tuple[Field, Float[ndarray, "e 81 81"]]:
        d, G, w, mu = self.disc, self.G, self.w, SOLID.mu
        u = self.displacement(state)
        F, J, g, p = deformed(self, u)
        if not (J > 0.0).all():
            raise ArithmeticError(f"depth {depth:g} R: a brick turned inside out")
        P = mu * (F - g) + (p * J)[..., None, None] * g
        out = np.einsum("eqaj,eqij->eai", G * w[..., None, None], P, optimize=True)
        e, q = w.shape
        K = np.empty((e, 27, 3, 27, 3))
        wG = (w[..., None, None] * G).swapaxes(2, 3).reshape(e, q * 3, 27)
        Gt, held = G.swapaxes(2, 3), stress * p * J
        for i in range(3):
            for k in range(i, 3):
                A = (stress * mu - held)[..., None, None] * g[..., k, :, None] * g[..., i, None, :]
                A += held[..., None, None] * g[..., i, :, None] * g[..., k, None, :]
                A += mu * np.eye(3) * (i == k)
                K[:, :, i, :, k] = wG.swapaxes(1, 2) @ (A @ Gt).reshape(e, q * 3, 27)
                K[:, :, k, :, i] = K[:, :, i, :, k].swapaxes(1, 2)
        swell = G @ (g.swapaxes(2, 3) * (J * w)[..., None, None])
        H = np.einsum("qm,eqai->emai", self.modes, swell, optimize=True).reshape(e, 4, 81)
        K = K.reshape(e, 81, 81) + H.swapaxes(1, 2) @ self.bulk @ H

        traction, stiff = self.touch(u, depth, stress)
        M = self.top_shapes
        out[self.tops] -= _on_top(np.einsum("eq,qa,eqi->eai", self.top_area, M, traction, optimize=True))
        near = np.flatnonzero((traction != 0.0).any(axis=(1, 2)))
        Kt = np.einsum("eq,qa,eqij,qb->eaibj", self.top_area[near], M, stiff[near], M, optimize=True)
        top = (3 * 3 * np.arange(9)[:, None] + np.arange(3)).ravel()  # level 0 of a brick, its x, y, z
        K[np.ix_(self.tops[near], top, top)] += Kt.reshape(-1, 27, 27)
        flat = d.dofs.reshape(-1)
        total = np.bincount(flat[flat >= 0], out.reshape(-1)[flat >= 0], minlength=len(state))
        return total, K

    def _solved(self, K: Float[ndarray, "e 81 81"], b: Field) -> Field:
        """Conjugate gradients, led by the last stiffness that was eliminated while that leads fast."""
        if self.factors is not None:
            try:
                return self._led(K, b, FEW)
            except ArithmeticError:
                pass
        group = np.repeat(np.arange(self.disc.cells.radial), len(K) // self.disc.cells.radial)
        self.factors = None  # makes room
        self.factors = eliminated([Elements(self.disc.dofs.reshape(len(K), 81), K, group)], len(b))
        return self._led(K, b, MANY)

    def _led(self, K: Float[ndarray, "e 81 81"], b: Field, most: int) -> Field:
        dofs, n = self.disc.dofs.reshape(len(K), 81), len(b)
        free, at = dofs >= 0, np.where(dofs >= 0, dofs, n)

        def times(x: Field) -> Field:
            y = np.einsum("eij,ej->ei", K, np.append(x, 0.0)[at])
            return np.bincount(dofs[free], y[free], minlength=n)

        x, r = np.zeros(n), b.copy()
        z = self.factors.solve(r)
        p, rz, end = z, r @ z, EXACT * np.linalg.norm(b)
        for _ in range(most):
            Kp = times(p)
            if not p @ Kp > 0.0:
                raise LinAlgError("the stiffness is not positive definite")
            a = rz / (p @ Kp)
            x, r = x + a * p, r - a * Kp
            if np.linalg.norm(r) < end:
                return x
            z = self.factors.solve(r)
            rz, before = r @ z, rz
            p = z + rz / before * p
        raise ArithmeticError("conjugate gradients do not end")


def deformed(press: OffCentre, u: ndarray) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """F, its determinant, F^-T and the pressure (tension positive) at the quadrature points."""
    F = np.eye(3) + u.reshape(-1, 3)[press.disc.bricks].swapaxes(1, 2)[:, None] @ press.G
    J = np.linalg.det(F)
    swollen = np.einsum("eq,qm,eq->em", press.w, press.modes, J - 1.0)
    p = np.einsum("emn,en,qm->eq", press.bulk, swollen, press.modes, optimize=True)
    return F, J, np.linalg.inv(F).swapaxes(2, 3), p


def _on_top(values: Float[ndarray, "e 9 3"]) -> Float[ndarray, "e 27 3"]:
    out = np.zeros((len(values), 9, 3, 3))
    out[:, :, 0] = values
    return out.reshape(-1, 27, 3)


def presses(thickness: float, offset: float, cells: Cells = MAIN) -> Iterator[dict[str, float]]:
    """One press, depth by depth: force into the disc, force towards its axis, and where it acts."""
    disc = HalfDisc(thickness, offset, cells)
    press = OffCentre(disc)
    for depth, u in press.through(STEPS):
        (side, force), centre = press.load(u, depth)
        yield {
            "thickness": thickness,
            "offset": offset,
            "depth": depth,
            "unknowns": disc.unknowns,
            "force": round(float(force), 6),
            "side_force": round(float(side), 6),
            "centre": round(centre, 5),
        }


def main() -> int:
    """Solve every place, some of them on a finer mesh, and one between them."""
    jobs = [(h, c, "presses", MAIN) for h in THICKNESSES for c in OFFSETS]
    jobs += [(h, BETWEEN, "between", MAIN) for h in THICKNESSES]
    jobs += [(2.0, c, "finer", FINE) for c in (0.0, 4.2, 4.7)]
    made: dict[str, list[dict[str, float]]] = {"presses": [], "finer": [], "between": []}
    for thickness, offset, name, cells in jobs:
        for row in presses(thickness, offset, cells):
            print(row, flush=True)
            made[name].append(row)
    OUT.write_text(json.dumps({"lengths": "R", "forces": "E R^2", **made}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
