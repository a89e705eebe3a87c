"""Make the tables of probes without an axis pressed into a bonded layer, at finite strain, and study them.

    python tools/probe_tables.py solved                  # a folder a probe; depths that are there are kept
    python tools/probe_tables.py solved --out src/palpate/mechanics/tables
    python tools/probe_tables.py solved --mesh coarser   # the same on another mesh
    python tools/probe_tables.py solved --check          # the study of it, to tools/probe_study.json

A probe takes two to eight minutes of one core, with `--probe` that one alone. Lengths are in thicknesses of
the layer: of the palm's 10 mm.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.brick_reading import NodalField, Now
from finite_strain.rigid_probes import Balls, RoundedPrism
from off_centre import SOLID, deformed, triquadratic, with_middles
from probe_press import HALF_SIDE, ProbePress, Shape, graded, quarter

HERE = Path(__file__).parent
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


def solve(member: Member, folder: Path, finer: float = 1.0) -> None:
    """Press through the depths and keep every balance; stops early, and says so, where the solver does."""
    folder.mkdir(parents=True, exist_ok=True)
    press, started = press_of(member, finer), time.process_time()
    try:
        known = [(one.depth, one.state) for one in Solved.all_of(press, folder)]
        least = known[-1][0] + 1e-9 if known else 0.0
        for depth, u in press.through([d for d in member.depths if d > least], known):
            np.savez_compressed(folder / f"{depth:.3f}.npz", depth=depth, u=u)
            print(
                f"{folder.name} {depth:.3f} h: force {press.force(u, depth):.6f} E h^2, floor "
                f"{press.reaction(u):.6f}, {press.iterations} iterations, "
                f"{time.process_time() - started:.0f} s in all",
                flush=True,
            )
    except ArithmeticError as stop:
        print(f"stopped: {stop}", flush=True)


@dataclass(frozen=True)
class Solved:
    """One depth of one probe, in space."""

    press: ProbePress
    depth: float
    u: ndarray

    @classmethod
    def all_of(cls, press: ProbePress, folder: Path) -> Iterator[Solved]:
        for path in sorted(folder.glob("*.npz")):
            with np.load(path) as file:
                yield cls(press, float(file["depth"]), file["u"])

    @property
    def state(self) -> ndarray:
        return self.u[self.press.disc.unknown >= 0]

    @property
    def force(self) -> float:
        return self.press.force(self.u, self.depth)

    @property
    def energy(self) -> float:
        return 4.0 * self.press.energy(self.state, self.depth)

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
        s = SOLID.mu / J[..., None, None] * (F @ F.swapaxes(2, 3) - np.eye(3)) + p[..., None, None] * np.eye(
            3
        )
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


def write(path: Path, member: Member, press: ProbePress, folder: Path) -> None:
    """Write one table."""
    solved = list(Solved.all_of(press, folder))
    tops, stresses, peaks = zip(*(one.table() for one in solved), strict=True)
    x, y, zeta = map(with_middles, press.disc.knots)
    top_amount, top_mode = modes(np.stack(tops), TOP_QUANTUM)
    amount, mode = modes(np.stack(stresses), STRESS_QUANTUM)
    np.savez_compressed(
        path,
        shape=member.shape,
        radius=member.radius,
        length=member.length,
        rounding=member.rounding,
        poisson_ratio=0.49,
        half_side=HALF_SIDE,
        depth=np.array([one.depth for one in solved]),
        force=np.array([one.force for one in solved]),
        area=np.array([one.area for one in solved]),
        peak_pressure=np.array(peaks),
        x=x,
        y=y,
        zeta=zeta,
        surface_amount=top_amount,
        surface_mode=top_mode,
        stress_amount=amount,
        stress_mode=mode,
    )
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, {len(mode)} modes", flush=True)


def study(names: list[str], folder: Path) -> list[dict[str, float | str]]:
    """Force, energy, area and greatest pressure on every mesh."""
    rows: list[dict[str, float | str]] = []
    for name in names:
        for mesh, finer in {"table": 1.0, **CHECKED}.items():
            here = folder / (name if mesh == "table" else f"{name}-{mesh}")
            if not here.exists():
                continue
            press = press_of(MEMBERS[name], finer)
            for one in Solved.all_of(press, here):
                rows.append(
                    {
                        "probe": name,
                        "mesh": mesh,
                        "unknowns": int(press.disc.starts[-1]),
                        "depth": one.depth,
                        "force": round(one.force, 6),
                        "floor": round(-press.reaction(one.u), 6),
                        "energy": round(one.energy, 8),
                        "area": round(one.area, 5),
                        "peak_pressure": round(one.table()[2], 4),
                    }
                )
    return rows


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("solved", type=Path, help="folder of what was solved")
    parser.add_argument("--probe", choices=sorted(MEMBERS), action="append")
    parser.add_argument("--mesh", choices=sorted(CHECKED), help="solve on another mesh, for the study")
    parser.add_argument("--out", type=Path, help="folder for the tables; without it presses are solved")
    parser.add_argument("--check", action="store_true", help="write the study of what was solved")
    args = parser.parse_args()
    names = args.probe or sorted(MEMBERS)
    if args.check:
        held = {"lengths": "h", "stresses": "E", "forces": "E h^2", "meshes": study(names, args.solved)}
        (HERE / "probe_study.json").write_text(json.dumps(held, indent=1) + "\n")
        return
    for name in names:
        member, folder = MEMBERS[name], args.solved / (f"{name}-{args.mesh}" if args.mesh else name)
        if args.out is not None:
            write(args.out / f"probe-{name}.npz", member, press_of(member), folder)
        else:
            solve(member, folder, CHECKED.get(args.mesh, 1.0))


if __name__ == "__main__":
    main()
