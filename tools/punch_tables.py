"""Make the tables of a rounded punch in a bonded elastomer disc, at finite strain, and study them.

    python tools/punch_tables.py solved                  # a file a thickness; those that are there are kept
    python tools/punch_tables.py solved --out src/palpate/mechanics/tables
    python tools/punch_tables.py solved --check          # the mesh study, to tools/punch_study.json

Needs scikit-fem. A thickness takes one to three minutes of one core, the study as long. With `--between`
the generator also writes what it solved between the table's depths, so that a test can measure interpolation.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.neo_hookean import NeoHookean
from finite_strain.press import Balanced, ConvergenceError
from finite_strain.recover import Deformed, deformed
from finite_strain.rounded_punch import EDGE, PunchPress, punch_disc, touch
from press_tables import POISSON_RATIO, QUANTUM, graded_fractions

CELL = 1.0 / 160.0
STUDY_CELLS = (1.0 / 80.0, 1.0 / 112.0)
THICKNESSES = {f"punch-h{name}-mu0": h for name, h in (("2", 2.0), ("25", 2.5), ("33", 10.0 / 3.0))}
YOUNG = (0.005, 0.01, 0.02, 0.03)
GREATEST = 1.0  # beyond, the cells about the edge are crushed
SOLVED = (*YOUNG, *(0.02 * k for k in range(2, round(GREATEST / 0.02) + 1)))
KEPT = (*YOUNG, *(0.02 * k for k in range(2, 6)), *(0.04 * k for k in range(3, 26)))
BETWEEN = (0.14, 0.18, 0.22, 0.3, 0.42, 0.58, 0.74, 0.9)
EVERY = 3  # knots each way that are written between depths
STUDY_DEPTHS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
FIRST = 0.008  # R under the top: the first knot down
DOWN = 42

HERE = Path(__file__).parent

Found = tuple[float, float, float, ndarray]  # depth, force, energy and state


def radii(disc_radius: float) -> Float[ndarray, " n"]:
    """Spatial radii of a table [R]: dense about the edge, none at 1, where skin lies on the upright side."""
    under = np.concatenate([np.linspace(0.0, 0.7, 11), np.arange(0.725, 0.89, 0.025)])
    edge = np.concatenate([np.arange(0.89, 0.981, 0.01), [0.985, 0.99, 0.995, 1.005, 1.01, 1.015, 1.02]])
    side = np.array([1.03, 1.04, 1.055, 1.07, 1.09, 1.11, 1.14, 1.17, 1.21, 1.25, 1.3])
    far = 1.3 + (disc_radius - 1.8) * np.expm1(np.linspace(0.0, 2.4, 23)[1:]) / np.expm1(2.4)
    rim = disc_radius - np.array([0.4, 0.28, 0.18, 0.1, 0.04, 0.0])
    return np.concatenate([under, edge, side, far, rim])


def solve(thickness: float, cell: float, path: Path) -> None:
    """Press through the depths and keep every balance; stops early, and says so, where the solver does."""
    press = PunchPress(punch_disc(thickness, cell), NeoHookean(POISSON_RATIO))
    found: list[Found] = []
    started = time.process_time()
    try:
        for b in press.through(SOLVED):
            found.append((b.depth, press.force(b), press.energy(b), b.state))
            keep(found, thickness, cell, path)
            print(
                f"h {thickness:g} depth {b.depth:.3f} R: force {found[-1][1]:.5f} E R^2, energy "
                f"{found[-1][2]:.6f} E R^3, {press.iterations} iterations, "
                f"{time.process_time() - started:.0f} s in all",
                flush=True,
            )
    except ConvergenceError as stop:
        print(f"stopped: {stop}", flush=True)


def keep(found: list[Found], thickness: float, cell: float, path: Path) -> None:
    """Write what has been solved so far."""
    depth, force, energy, state = (np.array(column) for column in zip(*found, strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, thickness=thickness, cell=cell, depth=depth, force=force, energy=energy, state=state)


class Solved:
    """Every depth of one file that is deep enough in balance, with what a table needs of it."""

    def __init__(self, path: Path) -> None:
        with np.load(path) as file:
            self.thickness, self.cell = float(file["thickness"]), float(file["cell"])
            self.depth, self.force, self.energy = file["depth"], file["force"], file["energy"]
            self.state = file["state"]
        self.press = PunchPress(punch_disc(self.thickness, self.cell), NeoHookean(POISSON_RATIO))

    def body(self, i: int) -> Deformed:
        """The disc in space."""
        return deformed(self.press, self._balanced(i))

    def contact_radius(self, i: int) -> float:
        """Between the last point that touches and the first that does not [R]; 1 on the upright side."""
        balanced = self._balanced(i)
        r, touching = self.press.top(balanced.state)[..., 0].ravel(), balanced.touch.touching.ravel()
        last = int(np.flatnonzero(touching)[-1])
        return min(float(r[last] + r[last + 1]) / 2.0, 1.0)

    def field(self, i: int, r: ndarray, zeta: ndarray) -> tuple[ndarray, ndarray, float]:
        """Surface, stress and greatest pressure at the top."""
        body, a = self.body(i), self.contact_radius(i)
        stress = body.stress_at(r, zeta)
        dense = np.linspace(0.0, min(a, 0.998), 1001)
        return body.surface(r), stress, float(pressure(dense, body.stress_at(dense, np.zeros(1))[:, 0]).max())

    def _balanced(self, i: int) -> Balanced:
        depth, top = float(self.depth[i]), self.press.top(self.state[i])
        none = np.full(self.press.disc.top_radius.shape, np.nan)
        return Balanced(depth, self.state[i], touch(top, depth, 0.0, none, 0.0))


def pressure(r: ndarray, stress: Float[ndarray, "4 n"]) -> ndarray:
    """-n.s.n under the punch [E], n its own normal."""
    sine = np.clip((r - (1.0 - EDGE)) / EDGE, 0.0, 1.0)
    rr, _, zz, rz = stress
    return -(sine**2 * rr + 2.0 * sine * np.sqrt(1.0 - sine**2) * rz + (1.0 - sine**2) * zz)


def write(path: Path, solved: Solved, depths: tuple[float, ...], r: ndarray, zeta: ndarray) -> None:
    """Write the chosen depths, and depth 0 before them in a full table."""
    chosen = [i for i, d in enumerate(solved.depth) if np.isclose(d, depths).any()]
    fields = [solved.field(i, r, zeta) for i in chosen]
    surface, stress = np.stack([f[0] for f in fields]), np.stack([f[1] for f in fields])
    scalars = {
        "depth": solved.depth[chosen],
        "force": solved.force[chosen],
        "contact_radius": np.maximum.accumulate([solved.contact_radius(i) for i in chosen]),
        "peak_pressure": np.array([f[2] for f in fields]),
    }
    if depths is KEPT:
        scalars = {name: np.append(0.0, values) for name, values in scalars.items()}
        surface = np.concatenate([np.zeros_like(surface[:1]), surface])
        stress = np.concatenate([np.zeros_like(stress[:1]), stress])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        thickness=solved.thickness,
        disc_radius=solved.press.disc.radius,
        poisson_ratio=POISSON_RATIO,
        friction=0.0,
        **scalars,
        r=r,
        zeta=zeta,
        surface=(np.round(surface / QUANTUM) * QUANTUM).astype(np.float32),
        stress=(np.round(stress / QUANTUM) * QUANTUM).astype(np.float32),
    )
    deepest = scalars["depth"][-1]
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, {len(chosen)} depths to {deepest:g} R", flush=True)


def study(paths: list[Path]) -> list[dict[str, float]]:
    """Force, energy, contact radius and greatest pressure on every mesh."""
    rows = []
    for path in paths:
        solved = Solved(path)
        for i, depth in enumerate(solved.depth):
            if np.isclose(depth, STUDY_DEPTHS).any():
                rows.append(
                    {
                        "thickness": round(solved.thickness, 6),
                        "cells_per_radius": round(1.0 / solved.cell),
                        "unknowns": solved.press.disc.unknowns,
                        "depth": round(float(depth), 6),
                        "deepest": round(float(solved.depth[-1]), 6),
                        "force": round(float(solved.force[i]), 6),
                        "energy": round(float(solved.energy[i]), 7),
                        "contact_radius": round(solved.contact_radius(i), 5),
                        "peak_pressure": round(
                            solved.field(i, radii(solved.press.disc.radius), np.zeros(1))[2], 4
                        ),
                    }
                )
    return rows


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("solved", type=Path, help="folder of what was solved")
    parser.add_argument("--variant", choices=sorted(THICKNESSES), action="append")
    parser.add_argument("--out", type=Path, help="folder for the tables; without it presses are solved")
    parser.add_argument("--between", type=Path, help="folder for what was solved between the table's depths")
    parser.add_argument("--check", action="store_true", help="study the meshes")
    args = parser.parse_args()
    names = args.variant or sorted(THICKNESSES)
    wanted = {args.solved / f"{name}.npz": (THICKNESSES[name], CELL) for name in names}
    if args.check:
        h = THICKNESSES["punch-h25-mu0"]
        wanted |= {args.solved / f"punch-h25-{round(1 / cell)}.npz": (h, cell) for cell in STUDY_CELLS}
    for path, (thickness, cell) in wanted.items():
        if not path.exists():
            solve(thickness, cell, path)
    if args.check:
        held = {"lengths": "R", "stresses": "E", "forces": "E R^2", "meshes": study(list(wanted))}
        (HERE / "punch_study.json").write_text(json.dumps(held, indent=1) + "\n")
    elif args.out is not None:
        for path in wanted:
            solved = Solved(path)
            r, zeta = radii(solved.press.disc.radius), graded_fractions(solved.thickness, FIRST, DOWN)
            write(args.out / path.name, solved, KEPT, r, zeta)
            if args.between is not None:
                between = args.between / f"between-{path.name}"
                write(between, solved, BETWEEN, r[::EVERY], zeta[::EVERY])


if __name__ == "__main__":
    main()
