"""Make the tables of probes without an axis pressed into a bonded layer, at finite strain, and study them.

    python tools/probe_tables.py solved --out src/palpate/mechanics/tables
    python tools/probe_tables.py solved --check    # on two other meshes as well, to tools/probe_study.json

A probe takes ten minutes and more of one core. Lengths are in thicknesses of the layer: of the palm's 10 mm.
Options are those of `table_runner`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.brick_reading import NodalField, Now
from finite_strain.rigid_probes import Balls, RoundedPrism
from off_centre import SOLID, deformed, triquadratic, with_middles
from probe_press import HALF_SIDE, ProbePress, Shape, graded, quarter
from table_runner import keep_states, kept, run, write, write_study

ROUNDING = 0.05  # h, of all edges of cylinders and edges
SLOPE = math.radians(30)  # of an edge's sides
STRESS_QUANTUM = 2.0**-13  # E; stress is rounded to it so that it packs
TOP_QUANTUM = 2.0**-13  # h, E
AWAY = 1e-3  # h from the probe, up to where skin counts as touching it in the table's pressure
LEFT_OUT = 3e-5  # E, h: root mean square of what modes beyond the last kept would add, at most

Knots = tuple[ndarray, ndarray, ndarray]
Line = list[tuple[float, float]]


@dataclass(frozen=True)
class Member:
    """One probe, the depths it is pressed to, and its mesh: fine cells along each axis, over `finer`."""

    shape: str
    radius: float
    length: float
    depths: tuple[float, ...]
    x: Line
    y: Line
    z: Line
    finer: float = 1.0

    @property
    def probe(self) -> Shape:
        if self.shape == "two-points":
            return Balls(self.radius, self.length)
        return RoundedPrism(self.length, ROUNDING, self.radius, SLOPE)

    @property
    def rounding(self) -> float:
        return 0.0 if self.shape == "two-points" else ROUNDING

    def knots(self, finer: float = 1.0) -> Knots:
        finer *= self.finer
        lines = ([(to, cell / finer) for to, cell in line] for line in (self.x, self.y, self.z))
        growth = 1.5 ** (1 / finer), 1.5 ** (1 / finer), 1.45 ** (1 / finer)
        ends = HALF_SIDE, HALF_SIDE, 1.0
        return tuple(graded(*each) for each in zip(lines, ends, growth, strict=True))


COARSE = 0.7
YOUNG = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.1)
MEMBERS = {
    "cylinder-6-12": Member(
        "cylinder", 0.3, 1.2, (*YOUNG, 0.13, 0.16, 0.19, 0.22, 0.25),
        [(0.36, 0.12), (0.48, 0.06), (0.66, 0.03)], [(0.03, 0.015), (0.12, 0.03), (0.36, 0.04)],
        [(0.06, 0.03)],
    ),
    "two-points-5-8": Member(
        "two-points", 0.25, 0.8, (0.01, 0.02, 0.04, 0.06, 0.08, 0.11, 0.15, 0.19, 0.23, 0.27, 0.31),
        [(0.2, 0.05), (0.7, 0.035)], [(0.28, 0.035)], [(0.07, 0.035)],
    ),
    "edge-12": Member(
        "edge", 0.0, 1.2, (*YOUNG, 0.13, 0.16, 0.19, 0.22),
        [(0.36, 0.12), (0.48, 0.06), (0.66, 0.03)], [(0.045, 0.015), (0.12, 0.025), (0.36, 0.04)],
        [(0.06, 0.03)], COARSE,
    ),
}  # fmt: skip
CHECKED = {"coarser": COARSE, "finer": 1.0 / COARSE}


def press_of(member: Member, finer: float = 1.0) -> ProbePress:
    """The member's press on its mesh."""
    return ProbePress(quarter(*member.knots(finer)), probe=member.probe)


def solve(path: Path, member: Member, finer: float = 1.0) -> None:
    """Press through the depths and keep every balance."""
    press = press_of(member, finer)
    found = ((depth, press.force(u, depth), u) for depth, u in press.through(member.depths))
    keep_states(path, found, ("depth", "force", "u"))


@dataclass(frozen=True)
class Solved:
    """One depth of one probe, in space."""

    press: ProbePress
    depth: float
    u: ndarray

    @classmethod
    def all_of(cls, press: ProbePress, path: Path) -> Iterator[Solved]:
        found = kept(path)
        for depth, u in zip(found["depth"], found["u"], strict=True):
            yield cls(press, float(depth), u)

    @property
    def force(self) -> float:
        return self.press.force(self.u, self.depth)

    @property
    def energy(self) -> float:
        return 4.0 * self.press.energy(self.u[self.press.disc.unknown >= 0], self.depth)

    @property
    def area(self) -> float:
        """Of the contact, from above."""
        x, w = np.polynomial.legendre.leggauss(12)
        knots = self.press.disc.knots[:2]
        at, share = zip(*((_gauss(k, x), _gauss_weights(k, w)) for k in knots), strict=True)
        X = np.stack(np.meshgrid(*at, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
        slope = self.now.place.at(X)[1]
        above = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
        return 4.0 * float((np.outer(*share).ravel() * above * (self._touching(X)[0] > 0.0)).sum())

    @cached_property
    def now(self) -> Now:
        d = self.press.disc
        return Now(NodalField(d.knots, d.nodes + self.u))

    @cached_property
    def stress(self) -> NodalField:
        """Cauchy stress at the nodes, from straight fits within bricks, meaned over those that meet there."""
        d, press = self.press.disc, self.press
        F, J, _, p = deformed(press, self.u)
        s = SOLID.mu / J[..., None, None] * (F @ F.swapaxes(2, 3) - np.eye(3))
        s = s + p[..., None, None] * np.eye(3)
        s = np.stack([s[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))], axis=-1)
        places = triquadratic(3)[3]
        corners = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(27, 3)
        onto = _linear(corners) @ np.linalg.pinv(_linear(places))
        nodal = np.einsum("aq,eqc->eac", onto, s)
        flat, share = d.bricks.ravel(), np.repeat(press.w.sum(axis=1), 27)
        total = np.bincount(flat, share)
        mean = [np.bincount(flat, share * part) / total for part in nodal.reshape(-1, 6).T]
        values = np.stack(mean, axis=-1).reshape(*d.nodes.shape[:3], 6)
        values[0][..., [4, 5]] = 0.0  # xz and xy, of which the other side of the plane x = 0 has the opposite
        values[:, 0][..., [3, 5]] = 0.0  # yz and xy, on y = 0
        return NodalField(d.knots, values)

    def _touching(self, X: ndarray) -> tuple[ndarray, ndarray]:
        """How far places of the top are in the probe, and the probe's normal there."""
        away, n, _ = self.press.probe.distance(self.now.place.at(X)[0] - np.array([0.0, 0.0, self.depth]))
        return -away, n

    def _pressure(self, X: ndarray) -> ndarray:
        """-n.s.n on the top where it touches."""
        deep, n = self._touching(X)
        xx, yy, zz, yz, xz, xy = self.stress.at(X)[0].T
        a, b, c = n.T
        normal = a * a * xx + b * b * yy + c * c * zz + 2 * (b * c * yz + a * c * xz + a * b * xy)
        return np.where(deep > -AWAY, np.maximum(-normal, 0.0), 0.0)

    def table(self) -> tuple[ndarray, ndarray, float]:
        """Top and pressure ``[2 ny nx]``, stress ``[6 m ny nx]``, and the greatest pressure.

        The pressure is scaled to sum to the force; the greatest one is not.
        """
        x, y, zeta = map(with_middles, self.press.disc.knots)
        gx, gy = np.meshgrid(x, y)
        X = self.now.tops(gx.ravel(), gy.ravel())
        top = self.now.place.at(X)[0][:, 2].reshape(gx.shape)
        pressure = self._pressure(X).reshape(gx.shape)
        peak = float(pressure.max())
        pressure *= self.force / (4.0 * np.trapezoid(np.trapezoid(pressure, x, axis=1), y))
        places = [
            np.stack([gx, gy, top + share * (1.0 - top)], axis=-1).reshape(-1, 3) for share in zeta
        ]  # fmt: skip
        before = self.now.before(np.concatenate(places))
        stress = self.stress.at(before)[0].reshape(len(zeta), *gx.shape, 6)
        return np.stack([top, pressure]), np.moveaxis(stress, -1, 0), peak


def _linear(at: ndarray) -> ndarray:
    x, y, z = at.T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * y * z], axis=1)


def _gauss(knots: ndarray, x: ndarray) -> ndarray:
    return ((knots[1:] + knots[:-1])[:, None] / 2 + np.diff(knots)[:, None] / 2 * x).ravel()


def _gauss_weights(knots: ndarray, w: ndarray) -> ndarray:
    return (np.diff(knots)[:, None] / 2 * w).ravel()


def modes(values: Float[ndarray, "d ..."], quantum: float) -> tuple[ndarray, ndarray]:
    """Amounts, and modes as whole numbers, whose product is the values to a quantum."""
    flat = values.reshape(len(values), -1)
    U, s, V = np.linalg.svd(flat, full_matrices=False)
    rest = np.sqrt(np.cumsum(s[::-1] ** 2)[::-1] / flat.size)
    keep = int(np.sum(rest > LEFT_OUT))
    amount = U[:, :keep] * quantum
    size = np.abs(amount).max(axis=0) / quantum  # so that every mode is held to the same stress
    whole = np.round(V[:keep] * (s[:keep] * size / quantum)[:, None])
    return amount / size, whole.astype(np.int16).reshape(keep, *values.shape[1:])


def tables(folder: Path, out: Path) -> None:
    """Write those that are solved."""
    for name, member in MEMBERS.items():
        if not (path := folder / f"probe-{name}.npz").exists():
            continue
        press = press_of(member)
        solved = list(Solved.all_of(press, path))
        tops, stresses, peaks = zip(*(one.table() for one in solved), strict=True)
        arrays = dict(zip(("x", "y", "zeta"), map(with_middles, press.disc.knots), strict=True))
        arrays |= {of: np.array([getattr(one, of) for one in solved]) for of in ("depth", "force", "area")}
        for of, values, quantum in (("surface", tops, TOP_QUANTUM), ("stress", stresses, STRESS_QUANTUM)):
            arrays[f"{of}_amount"], arrays[f"{of}_mode"] = modes(np.stack(values), quantum)
        fixed = {of: getattr(member, of) for of in ("shape", "radius", "length", "rounding")}
        fixed |= {"poisson_ratio": 0.49, "half_side": HALF_SIDE, "peak_pressure": np.array(peaks)}
        write(out / path.name, arrays | fixed)


def study(folder: Path) -> None:
    """Force, energy, area and greatest pressure on every mesh."""
    rows = []
    for name, member in MEMBERS.items():
        for mesh, finer in {"table": 1.0, **CHECKED}.items():
            press, at = press_of(member, finer), f"probe-{name}" + (f"-{mesh}" if mesh in CHECKED else "")
            for one in Solved.all_of(press, folder / f"{at}.npz"):
                row = {"probe": name, "mesh": mesh, "unknowns": press.disc.unknowns, "depth": one.depth}
                row |= {"force": round(one.force, 6), "floor": round(-press.reaction(one.u), 6)}
                row |= {"energy": round(one.energy, 8), "area": round(one.area, 5)}
                rows.append(row | {"peak_pressure": round(one.table()[2], 4)})
    write_study("probe", {"lengths": "h", "stresses": "E", "forces": "E h^2", "meshes": rows})


if __name__ == "__main__":
    presses = {f"probe-{name}": partial(solve, member=member) for name, member in MEMBERS.items()}
    studied = {
        f"probe-{name}-{mesh}": partial(solve, member=member, finer=finer)
        for name, member in MEMBERS.items() for mesh, finer in CHECKED.items()
    }  # fmt: skip
    run(__doc__ or "", presses, tables, study, studied)
