"""The finite-strain press tables: balance, small strain, another solver's figures, its own mesh study."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy import ndarray
from scipy.interpolate import CubicSpline, RegularGridInterpolator

from oracles import Oracle
from palpate.mechanics.axisymmetric.disc_table import TabulatedPress
from palpate.mechanics.axisymmetric.shape_table import OFF_CENTRE, SphereTable
from palpate.mechanics.layers.bonded_layer import sphere_force

REPOSITORY = Path(__file__).resolve().parents[2]
STUDY = REPOSITORY / "tools" / "mesh_study.json"
DEPTHS = (0.2, 0.33, 0.6, 1.0, 1.2)


def presses(depths: tuple[float, ...] = DEPTHS) -> Iterator[TabulatedPress]:
    """Every shipped table at these depths [R]."""
    for name in SphereTable.shipped():
        for depth in depths:
            yield SphereTable.load(name).at(depth)


def base() -> float:
    """What the bonded base carries, over the force."""
    return max(abs(-_over_a_circle(p.stress[2, -1], p.r) / p.force - 1) for p in presses())


def halfway() -> float:
    """What a plane halfway down the untouched membrane carries; it runs through the deformed body."""
    errors = []
    for p in presses((0.2, 0.4, 0.6)):
        z = p.thickness / 2
        zeta = (z - p.surface) / (p.thickness - p.surface)
        read = RegularGridInterpolator((p.zeta, p.r), p.stress[2])
        errors.append(abs(-_over_a_circle(read(np.stack([zeta, p.r], axis=-1)), p.r) / p.force - 1))
    return max(errors)


def top() -> float:
    """What the deformed top carries."""
    return max(abs(2 * math.pi * float(np.trapezoid(p.top_load * p.r, p.r)) / p.force - 1) for p in presses())


def _over_a_circle(values: ndarray, r: ndarray) -> float:
    return 2 * math.pi * float(CubicSpline(r, values * r).integrate(r[0], r[-1]))


def free_top() -> float:
    """Traction on the top beside the contact, over the greatest pressure."""
    errors = []
    for p in presses():
        slope = np.gradient(p.surface, p.r)
        normal = np.stack([slope, -np.ones_like(slope)]) / np.hypot(1, slope)
        rr, _, zz, rz = p.stress[:, 0]
        traction = np.hypot(rr * normal[0] + rz * normal[1], rz * normal[0] + zz * normal[1])
        beside = (p.r > p.contact_radius + 0.06) & (p.r < p.disc_radius - 0.2)
        errors.append(float(traction[beside].max()) / p.peak_pressure)
    return max(errors)


def shape() -> float:
    """How far the skin under the ball is from the ball's shape, in radii."""
    errors = []
    for p in presses():
        under = p.r < p.contact_radius - 0.02
        ball = p.depth - 1 + np.sqrt(1 - p.r[under] ** 2)
        errors.append(float(np.abs(p.surface[under] - ball).max()))
    return max(errors)


def shallow(depth: float) -> float:
    """Force without friction against the exact small-strain layer, at one depth [R]."""
    return max(
        abs(SphereTable.load(f"sphere-h{h}-mu0").at(depth).force / sphere_force(depth, 1.0, h, 1.0, 0.49) - 1)
        for h in (2, 4)
    )


def other_force() -> float:
    """Force at 1 R against other elements, mesh and contact springs: F / E of 61.97 and 45.33 mm^2."""
    other = {2: 61.97 / 25, 4: 45.33 / 25}
    return max(abs(SphereTable.load(f"sphere-h{h}-mu0").at(1.0).force / f - 1) for h, f in other.items())


def other_exponent() -> float:
    """The local exponent of force against depth from 0.2 to 1 R, against the same solver's 1.57 and 1.47."""
    return max(abs(exponent(h) - wanted) for h, wanted in {2: 1.57, 4: 1.47}.items())


def exponent(thickness: int) -> float:
    """Slope of log force over log depth from 0.2 to 1 R, without friction."""
    depths = np.linspace(0.2, 1.0, 9)
    force = [SphereTable.load(f"sphere-h{thickness}-mu0").at(d).force for d in depths]
    return float(np.polyfit(np.log(depths), np.log(force), 1)[0])


def between(part: str) -> float:
    """What the table reads between its depths against what was solved there."""
    errors = []
    for name in SphereTable.shipped():
        with np.load(REPOSITORY / "tests" / "mechanics" / f"between-{name}.npz") as solved:
            for depth, wanted in zip(solved["depth"], solved[part], strict=True):
                p = SphereTable.load(name).at(float(depth))
                if part == "stress":
                    off = (p.stress[:, ::4, ::4] - wanted) / np.abs(wanted).max()
                    errors.append(float(np.sqrt(np.mean(off**2))))
                else:
                    errors.append(abs(getattr(p, part) / float(wanted) - 1))
    return max(errors)


def bricks() -> float:
    """Force without friction from 0.2 to 1 R against another mesh, in three dimensions, of other elements."""
    return max(
        abs(row["force"] / SphereTable.load(f"sphere-h{row['thickness']:g}-mu0").at(row["depth"]).force - 1)
        for row in _off_centre("presses")
        if row["offset"] == 0 and row["depth"] >= 0.2
    )


def finer_bricks() -> float:
    """Those bricks' forces, in the middle, at 4.2 and at 4.7 R, against a mesh of 1.8 times the unknowns."""
    at = ("thickness", "offset", "depth")
    coarse = {tuple(row[part] for part in at): row["force"] for row in _off_centre("presses")}
    fine = {tuple(row[part] for part in at): row["force"] for row in _off_centre("finer")}
    return max(abs(coarse[place] / force - 1) for place, force in fine.items() if place[2] >= 0.2)


def _off_centre(part: str) -> list[dict[str, float]]:
    found: list[dict[str, float]] = json.loads(OFF_CENTRE.read_text(encoding="utf-8"))[part]
    return found


def finer(part: str) -> Callable[[], float]:
    """The table's mesh against the finest of the study."""

    def error() -> float:
        rows = json.loads(STUDY.read_text())["meshes"]
        finest = {(r["depth"], r["friction"]): r[part] for r in rows if r["cells_per_radius"] == 72}
        shipped_mesh = [r for r in rows if r["cells_per_radius"] == 48]
        return max(abs(r[part] / finest[r["depth"], r["friction"]] - 1) for r in shipped_mesh)

    return error


ORACLES = (
    Oracle("Load on the bonded base", "the force", 1e-2, base),
    Oracle("Load on a plane halfway down", "the force", 1e-2, halfway),
    Oracle("Load on the top", "the force", 1e-2, top),
    Oracle("Traction beside the contact, over the greatest pressure", "zero", 1e-2, free_top),
    Oracle("Skin under the ball, in ball radii", "the ball", 1.5e-3, shape),
    Oracle("Force at 0.05 mm", "the exact small-strain layer", 1.5e-2, lambda: shallow(0.01)),
    Oracle(
        "Force at 0.5 mm; finite strain is in it", "the exact small-strain layer", 3e-2, lambda: shallow(0.1)
    ),
    Oracle("Force at 5 mm", "a coarse solution with other elements", 2e-2, other_force),
    Oracle("Exponent of force over depth", "the same coarse solution", 3e-2, other_exponent),
    Oracle("Force, 1 to 5 mm", "bricks in three dimensions", 1e-2, bricks),
    Oracle(
        "Force of those bricks, in the middle and 21 mm out", "1.8 times the unknowns", 1e-2, finer_bricks
    ),
    Oracle("Force between the table's depths", "solving there", 3e-4, lambda: between("force")),
    Oracle("Stress between them, rms over the greatest", "solving there", 2.5e-3, lambda: between("stress")),
)

MESH = (
    Oracle("Force, 48 cells a radius", "72 cells a radius", 1e-2, finer("force")),
    Oracle("Contact radius, 48 cells a radius", "72 cells a radius", 1e-2, finer("contact_radius")),
    Oracle("Greatest shear, 48 cells a radius", "72 cells a radius", 2e-2, finer("greatest_shear_below")),
)
if STUDY.exists():
    ORACLES = (*ORACLES, *MESH)
