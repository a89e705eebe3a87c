"""Make the press tables that palpate ships: a rigid sphere in a bonded elastomer disc, at finite strain.

    python tools/press_tables.py --out src/palpate/mechanics/tables
    python tools/press_tables.py --out tables --variant sphere-h2-mu0
    python tools/press_tables.py --check mesh          # the mesh study, to tools/mesh_study.json

Needs scikit-fem. A table takes one to three minutes of one core, the study some ten. With `--between` the
generator also writes what it solved between the table's depths, so that a test can measure interpolation.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.disc import DISC_RADIUS, Disc
from finite_strain.neo_hookean import NeoHookean
from finite_strain.press import Balanced, ConvergenceError, Press
from finite_strain.recover import contact_radii, deformed, edge

POISSON_RATIO = 0.49
CELL = 1.0 / 48.0
STUDY_CELLS = (1.0 / 32.0, 1.0 / 48.0, 1.0 / 72.0)
STUDY_DEPTHS = (0.2, 0.6, 1.0)
ASIDE_CELL = 1.0 / 28.0
BELOW = 0.05  # R under the top: where the greatest shear is read, clear of the contact's edge
VARIANTS = {f"sphere-h{h:g}-mu{mu:g}".replace(".", ""): (h, mu) for h in (2.0, 4.0) for mu in (0.0, 0.5)}
YOUNG = (0.005, 0.01, 0.02, 0.03)  # depths before the even steps, where the force bends most
SOLVED = (*YOUNG, *(0.02 * k for k in range(2, 61)))
STUDIED = tuple(d for d in SOLVED if d <= 1.001)
KEPT = (*YOUNG, 0.04, 0.06, 0.08, *(0.04 * k for k in range(3, 31)))
BETWEEN = (0.1, 0.14, 0.22, 0.3, 0.5, 0.7, 0.9, 1.1)
QUANTUM = 2.0**-16  # E; stress is rounded to it so that it packs, far below the mesh's own error

HERE = Path(__file__).parent


def radii() -> Float[ndarray, " n"]:
    """Spatial radii of a table [R]: dense under and around the contact, and again at the bonded rim."""
    near = np.concatenate([np.linspace(0.0, 0.2, 17), np.linspace(0.2, 1.2, 51)[1:]])
    far = 1.2 + 3.9 * np.expm1(np.linspace(0.0, 2.4, 27)[1:]) / np.expm1(2.4)
    rim = DISC_RADIUS - np.array([0.45, 0.32, 0.22, 0.14, 0.07, 0.03, 0.0])
    return np.concatenate([near, far, rim])


def fractions(thickness: float) -> Float[ndarray, " m"]:
    """Fractions zeta of the way from the top to the base: 0.016 R at the top, growing evenly."""
    return graded_fractions(thickness, 0.016, 46)


def graded_fractions(thickness: float, first: float, count: int) -> Float[ndarray, " m"]:
    """Such fractions, `count` and two before the base, the first of a height under the top [R]."""
    u = np.linspace(0.0, 1.0, count)
    first /= thickness

    def knots(stretch: float) -> Float[ndarray, " m"]:
        return np.expm1(stretch * u) / np.expm1(stretch)

    low, high = 1e-3, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if knots(middle)[1] > first else (low, middle)
    even = knots(low)
    return np.sort(np.concatenate([even, [0.5 * (even[-2] + 1.0), 0.25 * even[-2] + 0.75]]))


@dataclass(frozen=True)
class Solved:
    """Every depth that balanced, with what a table needs of it."""

    press: Press
    balances: list[Balanced]
    radius: Float[ndarray, " n"]

    def field(self, i: int, r: ndarray, zeta: ndarray) -> tuple[ndarray, ndarray, float]:
        """Surface, stress and greatest pressure at the top."""
        body = deformed(self.press, self.balances[i])
        surface, stress = body.surface(r), body.stress_at(r, zeta)
        at, _ = body.top()
        if (np.diff(at) <= 0.0).any():
            raise RuntimeError(f"the surface folds over itself at depth {self.balances[i].depth:g} R")
        pressure = top_pressure(r, surface, stress[:, 0])
        return surface, stress, float(pressure[r < self.radius[i]].max())


def top_pressure(r: ndarray, surface: ndarray, stress: ndarray) -> ndarray:
    """-n.s.n at the deformed top [E], n its normal."""
    slope = np.gradient(surface, r)
    rr, _, zz, rz = stress
    return -(slope**2 * rr - 2.0 * slope * rz + zz) / (1.0 + slope**2)


def solve(press: Press, depths: Sequence[float]) -> Solved:
    """Press through the depths; stops early, and says so, where the solver does."""
    balances: list[Balanced] = []
    start, steps = time.process_time(), 0
    try:
        for balanced in press.through(depths):
            balances.append(balanced)
            print(
                f"h {press.disc.thickness:g} mu {press.friction:g} depth {balanced.depth:.3f} R: force "
                f"{press.force(balanced):.5f} E R^2, {press.iterations - steps} iterations, "
                f"{time.process_time() - start:.0f} s in all",
                flush=True,
            )
            steps = press.iterations
    except ConvergenceError as stop:
        print(f"stopped: {stop}", flush=True)
    reached = np.array([b.depth for b in balances])
    return Solved(press, balances, contact_radii(reached, np.array([edge(press, b) for b in balances])))


def table(name: str, out: Path, between: Path | None) -> None:
    """Solve one variant and write it."""
    thickness, friction = VARIANTS[name]
    solved = solve(Press(Disc(thickness, CELL), NeoHookean(POISSON_RATIO), friction), SOLVED)
    r, zeta = radii(), fractions(thickness)
    write(out / f"{name}.npz", solved, KEPT, r, zeta, thickness, friction)
    if between is not None:
        write(between / f"between-{name}.npz", solved, BETWEEN, r[::4], zeta[::4], thickness, friction)


def write(
    path: Path,
    solved: Solved,
    depths: tuple[float, ...],
    r: ndarray,
    zeta: ndarray,
    thickness: float,
    friction: float,
) -> None:
    """Write the chosen depths, and depth 0 before them in a full table."""
    chosen = [i for i, b in enumerate(solved.balances) if np.isclose(b.depth, depths).any()]
    # the greatest pressure is read on the table's own radii whatever the radii written
    peaks = [solved.field(i, radii(), np.array([0.0]))[2] for i in chosen]
    fields = [solved.field(i, r, zeta) for i in chosen]
    force = [solved.press.force(solved.balances[i]) for i in chosen]
    depth = [solved.balances[i].depth for i in chosen]
    surface = np.stack([f[0] for f in fields])
    stress = np.stack([f[1] for f in fields])
    radius = list(solved.radius[chosen])
    if depths is KEPT:
        depth, force, radius, peaks = [0.0, *depth], [0.0, *force], [0.0, *radius], [0.0, *peaks]
        surface = np.concatenate([np.zeros_like(surface[:1]), surface])
        stress = np.concatenate([np.zeros_like(stress[:1]), stress])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        thickness=thickness,
        disc_radius=DISC_RADIUS,
        poisson_ratio=POISSON_RATIO,
        friction=friction,
        depth=np.array(depth),
        force=np.array(force),
        contact_radius=np.array(radius),
        peak_pressure=np.array(peaks),
        r=r,
        zeta=zeta,
        surface=(np.round(surface / QUANTUM) * QUANTUM).astype(np.float32),
        stress=(np.round(stress / QUANTUM) * QUANTUM).astype(np.float32),
    )
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, {len(depth)} depths to {depth[-1]:g} R", flush=True)


def mesh_study(path: Path) -> None:
    """Force, contact radius and greatest shear on three meshes, and what else a force depends on."""
    meshes: list[dict[str, object]] = []
    for friction in (0.0, 0.5):
        for cell in STUDY_CELLS:
            press = Press(Disc(2.0, cell), NeoHookean(POISSON_RATIO), friction)
            meshes += [_row(press, *found) for found in _studied(press, STUDIED)]
    halved = sorted({*STUDIED, *(round(d + 0.01, 6) for d in STUDIED if 0.04 <= d < 0.99)})
    asides: list[dict[str, object]] = []
    for what, nu, radius, friction, depths in (
        ("as the tables, coarse", POISSON_RATIO, DISC_RADIUS, 0.0, STUDIED),
        ("Poisson's ratio 0.495", 0.495, DISC_RADIUS, 0.0, STUDIED),
        ("Poisson's ratio 0.499", 0.499, DISC_RADIUS, 0.0, STUDIED),
        ("disc twice as wide", POISSON_RATIO, 2.0 * DISC_RADIUS, 0.0, STUDIED),
        ("friction 0.2", POISSON_RATIO, DISC_RADIUS, 0.2, STUDIED),
        ("friction 0.5", POISSON_RATIO, DISC_RADIUS, 0.5, STUDIED),
        ("friction 0.5, half the steps' length", POISSON_RATIO, DISC_RADIUS, 0.5, halved),
    ):
        press = Press(Disc(2.0, ASIDE_CELL, radius), NeoHookean(nu), friction)
        asides += [{"what": what, **_row(press, *found)} for found in _studied(press, depths)]
    held = {"lengths": "R", "stresses": "E", "forces": "E R^2", "meshes": meshes, "asides": asides}
    path.write_text(json.dumps(held, indent=1) + "\n")


def _studied(press: Press, depths: Sequence[float]) -> list[tuple[Solved, int]]:
    solved = solve(press, depths)
    return [(solved, i) for i, b in enumerate(solved.balances) if np.isclose(b.depth, STUDY_DEPTHS).any()]


def _row(press: Press, solved: Solved, i: int) -> dict[str, object]:
    r, zeta = radii(), fractions(press.disc.thickness)
    surface, stress, peak = solved.field(i, r, zeta)
    deep = zeta[:, None] * (press.disc.thickness - surface) > BELOW
    return {
        "thickness": press.disc.thickness,
        "friction": press.friction,
        "cells_per_radius": round(1.0 / press.disc.cell),
        "unknowns": press.disc.unknowns,
        "depth": round(solved.balances[i].depth, 6),
        "force": round(press.force(solved.balances[i]), 6),
        "contact_radius": round(float(solved.radius[i]), 5),
        "peak_pressure": round(peak, 5),
        "greatest_shear_below": round(float((shear(stress) * deep).max()), 5),
    }


def shear(stress: Float[ndarray, "4 m n"]) -> Float[ndarray, "m n"]:
    """Greatest shear stress, half the difference of the outer principal stresses [E]."""
    rr, tt, zz, rz = stress
    centre, half = (rr + zz) / 2, np.hypot((rr - zz) / 2, rz)
    return (np.maximum(centre + half, tt) - np.minimum(centre - half, tt)) / 2


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=HERE.parent / "src/palpate/mechanics/tables")
    parser.add_argument("--variant", choices=sorted(VARIANTS), action="append")
    parser.add_argument("--between", type=Path, help="folder for what was solved between the table's depths")
    parser.add_argument("--check", choices=["mesh"])
    args = parser.parse_args()
    if args.check == "mesh":
        mesh_study(HERE / "mesh_study.json")
        return
    for name in args.variant or sorted(VARIANTS):
        table(name, args.out, args.between)


if __name__ == "__main__":
    main()
