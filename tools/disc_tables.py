"""Make the tables of a rigid sphere or a rounded punch in a bonded elastomer disc, at finite strain.

    python tools/disc_tables.py solved --out src/palpate/mechanics/tables
    python tools/disc_tables.py solved --check     # the mesh studies, to mesh_study.json and punch_study.json

Needs scikit-fem. A press takes one to three minutes of one core, the study some ten more. What was solved
between a table's depths is written beside it, so that a test can measure interpolation: tests/mechanics has
it. Options are those of `table_runner`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain import sphere
from finite_strain.disc import DISC_RADIUS, Disc
from finite_strain.neo_hookean import NeoHookean
from finite_strain.press import Balanced, Press
from finite_strain.recover import contact_radii, deformed, edge
from finite_strain.rounded_punch import EDGE, PunchPress, punch_disc
from table_runner import keep_states, kept, run, write, write_study

QUANTUM = 2.0**-16  # E; stress is rounded to it so that it packs, far below the mesh's own error
BELOW = 0.05  # R under the top: where the greatest shear is read, clear of the contact's edge
YOUNG = (0.005, 0.01, 0.02, 0.03)  # depths before the even steps, where the force bends most
NAMES = ("depth", "force", "energy", "state")


def even(step: float, first: int, last: int) -> tuple[float, ...]:
    """Depths at these multiples of a step."""
    return tuple(step * k for k in range(first, last + 1))


def graded_fractions(thickness: float, first: float, count: int) -> Float[ndarray, " m"]:
    """Fractions of the way from the top to the base, `count` and two before it, the first `first` R down."""
    u = np.linspace(0.0, 1.0, count)
    first /= thickness

    def knots(stretch: float) -> Float[ndarray, " m"]:
        return np.expm1(stretch * u) / np.expm1(stretch)

    low, high = 1e-3, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if knots(middle)[1] > first else (low, middle)
    grown = knots(low)
    return np.sort(np.concatenate([grown, [0.5 * (grown[-2] + 1.0), 0.25 * grown[-2] + 0.75]]))


@dataclass(frozen=True)
class Member:
    """A sphere in one disc; stops at `deepest` of its depths.

    Attributes:
        cells: a sphere's radius.
        wider: the disc than those of the tables, times.
        finer: steps of depth, times.
    """

    thickness: float
    friction: float = 0.0
    cells: int = 48
    poisson_ratio: float = 0.49
    wider: float = 1.0
    deepest: float = 1.2
    finer: int = 1

    kept = (*YOUNG, 0.04, 0.06, 0.08, *even(0.04, 3, 30))
    between = (0.1, 0.14, 0.22, 0.3, 0.5, 0.7, 0.9, 1.1)
    every = 4  # knots each way that are written between depths
    study_depths = (0.2, 0.6, 1.0)

    @property
    def depths(self) -> tuple[float, ...]:
        steps = (*YOUNG, *even(0.02, 2, 60))
        if self.finer > 1:
            halfway = (round(d + 0.01, 6) for d in steps if 0.04 <= d < self.deepest - 0.01)
            steps = tuple(sorted({*steps, *halfway}))
        return tuple(d for d in steps if d <= self.deepest + 1e-3)

    @cached_property
    def press(self) -> Press:
        disc = Disc(self.thickness, 1.0 / self.cells, self.wider * DISC_RADIUS)
        return Press(disc, NeoHookean(self.poisson_ratio), self.friction)

    @property
    def radii(self) -> Float[ndarray, " n"]:
        """Of a table [R]: dense under and around the contact, and again at the bonded rim."""
        near = np.concatenate([np.linspace(0.0, 0.2, 17), np.linspace(0.2, 1.2, 51)[1:]])
        far = 1.2 + 3.9 * np.expm1(np.linspace(0.0, 2.4, 27)[1:]) / np.expm1(2.4)
        return np.concatenate([near, far, DISC_RADIUS - np.array([0.45, 0.32, 0.22, 0.14, 0.07, 0.03, 0.0])])

    @property
    def fractions(self) -> Float[ndarray, " m"]:
        return graded_fractions(self.thickness, 0.016, 46)

    def solve(self, path: Path) -> None:
        """Press through the depths and keep every balance."""
        balances = self.press.through(self.depths)
        keep_states(path, ((b.depth, self.press.force(b), self.energy(b), b.state) for b in balances), NAMES)

    def energy(self, balanced: Balanced) -> float:
        """Strain energy, where it is studied."""
        return np.nan

    def touch(self, state: ndarray, depth: float) -> sphere.Touch:
        """What touches, as if without friction."""
        none = np.full(self.press.disc.top_radius.shape, np.nan)
        return self.press.touch(self.press.top(state), depth, 0.0, none, 0.0)

    def contact_radii(self, depth: ndarray, edges: Float[ndarray, "n 2"]) -> ndarray:
        return contact_radii(depth, edges)

    def pressed(self, radius: float, surface: ndarray) -> tuple[ndarray, ndarray]:
        """Radii at which the pressure is read, and the top's slope there."""
        r = self.radii
        return r[r < radius], np.gradient(surface, r)[r < radius]


@dataclass(frozen=True)
class Punch(Member):
    """A rounded punch of unit radius in a disc as wide as the palm's."""

    cells: int = 160
    deepest: float = 1.0  # beyond, the cells about the edge are crushed

    kept = (*YOUNG, *even(0.02, 2, 5), *even(0.04, 3, 25))
    between = (0.14, 0.18, 0.22, 0.3, 0.42, 0.58, 0.74, 0.9)
    every = 3
    study_depths = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)

    @cached_property
    def press(self) -> Press:
        return PunchPress(punch_disc(self.thickness, 1.0 / self.cells), NeoHookean(self.poisson_ratio))

    @property
    def radii(self) -> Float[ndarray, " n"]:
        """Dense about the edge, none at 1, where skin lies on the upright side."""
        out = self.press.disc.radius
        under = np.concatenate([np.linspace(0.0, 0.7, 11), np.arange(0.725, 0.89, 0.025)])
        about = np.concatenate([np.arange(0.89, 0.981, 0.01), [0.985, 0.99, 0.995, 1.005, 1.01, 1.015, 1.02]])
        side = np.array([1.03, 1.04, 1.055, 1.07, 1.09, 1.11, 1.14, 1.17, 1.21, 1.25, 1.3])
        far = 1.3 + (out - 1.8) * np.expm1(np.linspace(0.0, 2.4, 23)[1:]) / np.expm1(2.4)
        return np.concatenate([under, about, side, far, out - np.array([0.4, 0.28, 0.18, 0.1, 0.04, 0.0])])

    @property
    def fractions(self) -> Float[ndarray, " m"]:
        return graded_fractions(self.thickness, 0.008, 42)

    def energy(self, balanced: Balanced) -> float:
        return self.press.energy(balanced)

    def contact_radii(self, depth: ndarray, edges: Float[ndarray, "n 2"]) -> ndarray:
        return np.maximum.accumulate(np.minimum(edges.mean(axis=1), 1.0))

    def pressed(self, radius: float, surface: ndarray) -> tuple[ndarray, ndarray]:
        r = np.linspace(0.0, min(radius, 0.998), 1001)
        sine = np.clip((r - (1.0 - EDGE)) / EDGE, 0.0, 1.0)
        return r, -sine / np.sqrt(1.0 - sine**2)


class Solved:
    """Every depth of one file, with what a table needs of it."""

    def __init__(self, member: Member, path: Path) -> None:
        self.member, found = member, kept(path)
        self.depth, self.force, self.energy, self.state = (found[name] for name in NAMES)
        edges = [edge(member.press, self.balanced(i)) for i in range(len(self.depth))]
        self.radius = member.contact_radii(self.depth, np.array(edges))

    def balanced(self, i: int) -> Balanced:
        depth, state = float(self.depth[i]), self.state[i]
        return Balanced(depth, state, self.member.touch(state, depth))

    def at(self, depths: tuple[float, ...]) -> list[int]:
        """Numbers of these depths."""
        return [i for i, depth in enumerate(self.depth) if np.isclose(depth, depths).any()]

    def field(self, i: int, r: ndarray, zeta: ndarray) -> tuple[ndarray, ndarray, float]:
        """Surface, stress, and the greatest pressure at the top, -n.s.n [E]."""
        body, none = deformed(self.member.press, self.balanced(i)), np.zeros(1)
        if (np.diff(body.top()[0]) <= 0.0).any() and not isinstance(self.member, Punch):
            raise RuntimeError(f"the surface folds over itself at depth {self.depth[i]:g} R")
        at, slope = self.member.pressed(float(self.radius[i]), body.surface(self.member.radii))
        rr, _, zz, rz = body.stress_at(at, none)[:, 0]
        pressure = -(slope**2 * rr - 2.0 * slope * rz + zz) / (1.0 + slope**2)
        return body.surface(r), body.stress_at(r, zeta), float(pressure.max())

    def table(self, depths: tuple[float, ...], every: int = 1) -> dict[str, object]:
        """The chosen depths, and depth 0 before them in a full table."""
        m, chosen = self.member, self.at(depths)
        r, zeta = m.radii[::every], m.fractions[::every]
        surface, stress, peak = zip(*(self.field(i, r, zeta) for i in chosen), strict=True)
        rows = {name: getattr(self, name)[chosen] for name in ("depth", "force")}
        rows |= {"contact_radius": self.radius[chosen], "peak_pressure": np.array(peak)}
        rows |= {"surface": np.stack(surface), "stress": np.stack(stress)}
        if depths is m.kept:
            rows = {name: np.concatenate([np.zeros_like(v[:1]), v]) for name, v in rows.items()}
        for name in ("surface", "stress"):
            rows[name] = (np.round(rows[name] / QUANTUM) * QUANTUM).astype(np.float32)
        fixed = {name: getattr(m, name) for name in ("thickness", "poisson_ratio", "friction")}
        return {**fixed, "disc_radius": m.press.disc.radius, **rows, "r": r, "zeta": zeta}

    def rows(self) -> Iterator[dict[str, object]]:
        """What a study says of a mesh."""
        m, r, zeta = self.member, self.member.radii, self.member.fractions
        for i in self.at(m.study_depths):
            surface, stress, peak = self.field(i, r, zeta)
            told = {
                "thickness": (m.thickness, 6),
                "friction": (m.friction, 6),
                "cells_per_radius": (m.cells, 0),
            }
            told |= {"unknowns": (m.press.disc.unknowns, 0), "depth": (self.depth[i], 6)}
            told |= {"force": (self.force[i], 6), "contact_radius": (self.radius[i], 5)}
            told |= {"peak_pressure": (peak, 5)}
            if isinstance(m, Punch):
                told |= {"energy": (self.energy[i], 7), "deepest": (self.depth[-1], 6)}
            else:
                deep = zeta[:, None] * (m.thickness - surface) > BELOW
                told |= {"greatest_shear_below": ((shear(stress) * deep).max(), 5)}
            yield {name: round(float(v), places) if places else int(v) for name, (v, places) in told.items()}


def shear(stress: Float[ndarray, "4 m n"]) -> Float[ndarray, "m n"]:
    """Greatest shear stress, half the difference of the outer principal stresses [E]."""
    rr, tt, zz, rz = stress
    centre, half = (rr + zz) / 2, np.hypot((rr - zz) / 2, rz)
    return (np.maximum(centre + half, tt) - np.minimum(centre - half, tt)) / 2


SPHERES = {f"sphere-h{h:g}-mu0".replace(".", ""): Member(h) for h in (1.8, 2.0, 2.2, 2.5, 4.0)}
SPHERES |= {f"sphere-h{h:g}-mu05": Member(h, 0.5) for h in (2.0, 4.0)}
PUNCHES = {f"punch-h{name}-mu0": Punch(h) for name, h in (("2", 2.0), ("25", 2.5), ("33", 10.0 / 3.0))}
SHIPPED = SPHERES | PUNCHES
MESHES = {f"mesh-{n}-mu{mu:g}": Member(2.0, mu, n, deepest=1.0) for mu in (0.0, 0.5) for n in (32, 48, 72)}
COARSE = Member(2.0, cells=28, deepest=1.0)
ASIDES = {
    "as the tables, coarse": COARSE,
    "Poisson's ratio 0.495": replace(COARSE, poisson_ratio=0.495),
    "Poisson's ratio 0.499": replace(COARSE, poisson_ratio=0.499),
    "disc twice as wide": replace(COARSE, wider=2.0),
    "friction 0.2": replace(COARSE, friction=0.2),
    "friction 0.5": replace(COARSE, friction=0.5),
    "friction 0.5, half the steps' length": replace(COARSE, friction=0.5, finer=2),
}
PUNCH_MESHES = {f"punch-h25-{n}": Punch(2.5, cells=n) for n in (80, 112)}
STUDIED = MESHES | ASIDES | PUNCH_MESHES


def tables(solved: Path, out: Path) -> None:
    """Of those that are solved, all depths of the table and some between them."""
    for name, member in SHIPPED.items():
        if (path := solved / f"{name}.npz").exists():
            found = Solved(member, path)
            write(out / f"{name}.npz", found.table(member.kept))
            write(out / f"between-{name}.npz", found.table(member.between, member.every))


def study(solved: Path) -> None:
    """Force, contact radius and greatest stress on every mesh, and what else a force depends on."""

    def rows(members: dict[str, Member]) -> list[dict[str, object]]:
        return [
            ({"what": name} if name in ASIDES else {}) | row
            for name, member in members.items() for row in Solved(member, solved / f"{name}.npz").rows()
        ]  # fmt: skip

    units = {"lengths": "R", "stresses": "E", "forces": "E R^2"}
    write_study("mesh", {**units, "meshes": rows(MESHES), "asides": rows(ASIDES)})
    punches = {"punch-h25-mu0": SHIPPED["punch-h25-mu0"], **PUNCH_MESHES}
    write_study("punch", {**units, "meshes": rows(punches)})


if __name__ == "__main__":
    presses = {name: member.solve for name, member in SHIPPED.items()}
    run(__doc__ or "", presses, tables, study, {name: member.solve for name, member in STUDIED.items()})
