"""Make the tip tables that palpate ships: a hemispherical tip pressed head-on on cylinders, at finite strain.

    python tools/tip_tables.py --out src/palpate/mechanics/tip_tables
    python tools/tip_tables.py --out tables --tip base
    python tools/tip_tables.py --out src/palpate/mechanics/tip_tables --plate     # all tips, equally deep
    python tools/tip_tables.py --check mesh          # the mesh study, to tools/tip_mesh_study.json

Needs scikit-fem. A press takes half a minute of one core.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from joblib import Parallel, delayed
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.tip import Balanced, Specimen, Tip, TipPress

CELLS, STUDY_CELLS = 60, (40, 60, 90)
EVEN = np.arange(0.25, 20.0, 0.25)  # mm of approach
MAX_N = 5.6
FORCES_N = 5.5 * (np.arange(1, 41) / 40) ** 2  # of a table: dense where contact is young
EVERY = 2  # of the skin's nodes is kept
EDGE_TERMS = 5
PLATE_MM = 6.75  # to which every tip is pressed on a rigid plate, for tips between the tables

TIPS = {
    "base": Tip(skin_mpa=0.5, gel_mpa=0.015),
    "soft-skin": Tip(skin_mpa=0.3, gel_mpa=0.03),
    "stiff-skin": Tip(skin_mpa=0.6, gel_mpa=0.01),
    "even": Tip(skin_mpa=0.05, gel_mpa=0.05),
}
# The report's four specimens stand among them: kappa = E pi r^2 / h is 7.6, 5.3, 3.1 and 1.1 N/mm.
SPECIMENS_MPA = (0.03, 0.035, 0.06, 0.0987, 0.1687, 0.2419, 0.4, 1.0, np.inf)


@dataclass(frozen=True)
class State:
    """What a table keeps of one balance [mm, N, MPa]."""

    approach: float
    force: float
    edges: tuple[
        float, float, float, float
    ]  # radii, then polar angles, of the last that touches and the next
    flattening: float
    inside: Float[ndarray, "n 2"]  # (r, z) of the skin's inside in the tip's own frame
    energy: Float[ndarray, " n"]  # strain energy density on the skin's inside


def pressed(press: TipPress, approaches: Float[ndarray, " k"], max_n: float = MAX_N) -> Iterator[State]:
    """States at approaches [mm], until the greatest force."""
    inside = press.shell(press.tip.radius - press.tip.skin)
    for balanced in press.through(approaches):
        u = balanced.u + np.array([0.0, balanced.approach])
        apex = press.shell(press.tip.radius)[0]
        force = press.force(balanced)
        yield State(
            balanced.approach, force, _edges(press, balanced), float(u[apex, 1]),
            (press.places + u)[inside], _energy(press, balanced, inside),
        )  # fmt: skip
        if force > max_n:
            return


def _edges(press: TipPress, balanced: Balanced) -> tuple[float, float, float, float]:
    """Between these two points of the skin the contact ends."""
    touching = np.flatnonzero(balanced.touch.gap < 0)
    if not len(touching):
        return (0.0, 0.0, 0.0, 0.0)
    last, m = int(touching[-1]), press.meeting
    unloaded = np.einsum("pa,pai->pi", m.shapes, press.places[m.nodes])
    angle = np.arctan2(unloaded[:, 0], press.tip.radius - unloaded[:, 1])
    r = balanced.touch.radius
    return float(r[last]), float(r[last + 1]), float(angle[last]), float(angle[last + 1])


def _energy(press: TipPress, balanced: Balanced, nodes: ndarray) -> Float[ndarray, " n"]:
    """Strain energy density at nodes of the skin's inside: the mean over the skin's cells around."""
    body = press.tip_body
    u = balanced.u[: len(body.places)]
    energy = (body.strain_energy(u) * body.weight).sum(axis=1) / body.weight.sum(axis=1)
    near = np.isin(body.nodes_of, nodes).any(axis=1)
    skin = np.flatnonzero(near & np.isclose(body.youngs_modulus, press.tip.skin_mpa))
    total, count = np.zeros((2, len(body.places)))
    for cell in skin:
        total[body.nodes_of[cell]] += energy[cell]
        count[body.nodes_of[cell]] += 1
    return total[nodes] / np.maximum(count[nodes], 1)


def tabulated(press: TipPress, approaches: Float[ndarray, " k"] = EVEN) -> dict[str, ndarray]:
    """What one press through approaches [mm] gives at the table's forces."""
    states = list(pressed(press, approaches))
    inside = press.shell(press.tip.radius - press.tip.skin)
    force = np.array([0.0, *(s.force for s in states)])
    edges = np.array([s.edges for s in states])
    columns = {
        "approach_mm": np.array([0.0, *(s.approach for s in states)]),
        "flattening_mm": np.array([0.0, *(s.flattening for s in states)]),
        "inside_mm": np.stack([press.places[inside], *(s.inside for s in states)])[:, ::EVERY],
        "energy_mpa": np.stack([np.zeros(len(inside)), *(s.energy for s in states)])[:, ::EVERY],
    }
    # all start as powers of force, nearly straight in its cube root
    root, to = np.cbrt(force), np.cbrt(FORCES_N)
    found = {name: PchipInterpolator(root, values)(to) for name, values in columns.items()}
    for name, (low, high) in {"radius_mm": (0, 1), "angle_rad": (2, 3)}.items():
        found[name] = smooth_edge(force[1:], edges[:, low], edges[:, high], FORCES_N)
    return found


def smooth_edge(force: ndarray, low: ndarray, high: ndarray, at: ndarray) -> Float[ndarray, " n"]:
    """The edge at forces: a smooth curve, where single states know it to a point's spacing only."""

    def powers(f: ndarray) -> ndarray:
        return np.cbrt(f)[:, None] ** np.arange(1, EDGE_TERMS + 1)

    touched = high > 0
    weight = np.cbrt(force[touched]) / (high - low)[touched]
    middle = ((low + high) / 2)[touched]
    c, *_ = np.linalg.lstsq(powers(force[touched]) * weight[:, None], middle * weight, rcond=None)
    return np.asarray(powers(at) @ c)


def one(tip: str, mpa: float, cells: int = CELLS) -> dict[str, ndarray]:
    """One press, and a line about it."""
    started = time.perf_counter()
    found = tabulated(TipPress(TIPS[tip], Specimen(mpa), cells=cells))
    area, approach = (
        np.interp(5, FORCES_N, y) for y in (np.pi * found["radius_mm"] ** 2, found["approach_mm"])
    )
    took = time.perf_counter() - started
    print(
        f"{tip:11s} {mpa:7.4g} MPa, {cells} cells, at 5 N: {area:6.1f} mm2, {approach:6.3f} mm; {took:.0f} s",
        flush=True,
    )
    return found


def table(tip: str, processes: int) -> dict[str, ndarray]:
    """One tip on every specimen."""
    presses = Parallel(processes)(delayed(one)(tip, mpa) for mpa in SPECIMENS_MPA)
    stacked = {name: np.stack([press[name] for press in presses]).astype(np.float32) for name in presses[0]}
    body = TipPress(TIPS[tip], Specimen(np.inf), cells=CELLS)
    inside = body.shell(TIPS[tip].radius - TIPS[tip].skin)[::EVERY]
    r, z = body.places[inside].T
    made = TIPS[tip]
    return stacked | {
        "force_n": FORCES_N,
        "specimen_mpa": np.array(SPECIMENS_MPA),
        "polar_rad": np.arctan2(r, made.radius - z),
        "tip": np.array([made.radius, made.skin, made.skin_mpa, made.gel_mpa, body.poisson_ratio]),
        "specimen": np.array([Specimen(1.0).radius, Specimen(1.0).height]),
    }


def plate_table() -> dict[str, ndarray]:
    """All tips on a rigid plate, at the same depths."""
    found: dict[str, list[ndarray]] = {}
    for made in TIPS.values():
        press = TipPress(made, Specimen(np.inf), cells=CELLS)
        states = list(pressed(press, EVEN[EVEN <= PLATE_MM], np.inf))
        force, edges = np.array([s.force for s in states]), np.array([s.edges for s in states])
        columns = {
            "force_n": force,
            "flattening_mm": np.array([s.flattening for s in states]),
            "inside_mm": np.stack([s.inside for s in states])[:, ::EVERY],
            "energy_mpa": np.stack([s.energy for s in states])[:, ::EVERY],
            "radius_mm": smooth_edge(force, edges[:, 0], edges[:, 1], force),
            "angle_rad": smooth_edge(force, edges[:, 2], edges[:, 3], force),
        }
        for name, values in columns.items():
            found.setdefault(name, []).append(values)
        print(f"skin {made.skin_mpa:g}, gel {made.gel_mpa:g} MPa: {force[-1]:.3g} N", flush=True)
    stacked = {name: np.stack(values).astype(np.float32) for name, values in found.items()}
    return stacked | {
        "approach_mm": np.array([s.approach for s in states]),
        "skin_mpa": np.array([made.skin_mpa for made in TIPS.values()]),
        "gel_mpa": np.array([made.gel_mpa for made in TIPS.values()]),
    }


def mesh_study(path: Path) -> None:
    """What the mesh costs: area, approach and flattening at 1, 3 and 5 N on finer and finer cells."""
    found = {}
    for mpa in (0.035, 0.2419):
        for cells in STUDY_CELLS:
            press = one("base", mpa, cells)
            found[f"{mpa:g} MPa, {cells} cells"] = {
                "area_mm2": np.interp([1, 3, 5], FORCES_N, np.pi * press["radius_mm"] ** 2).round(3).tolist(),
                "approach_mm": np.interp([1, 3, 5], FORCES_N, press["approach_mm"]).round(5).tolist(),
                "flattening_mm": np.interp([1, 3, 5], FORCES_N, press["flattening_mm"]).round(5).tolist(),
            }
    path.write_text(json.dumps(found, indent=2) + "\n")


def main() -> None:
    """Write the tables, or the study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for the tables")
    parser.add_argument("--tip", choices=sorted(TIPS), action="append", help="only this one")
    parser.add_argument("--plate", action="store_true", help="all tips on a rigid plate, equally deep")
    parser.add_argument("--check", choices=["mesh"], help="study the mesh instead")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    if asked.check:
        mesh_study(Path(__file__).parent / "tip_mesh_study.json")
        return
    if asked.plate:
        np.savez_compressed(asked.out / "plate.npz", **plate_table())
        return
    for tip in asked.tip or TIPS:
        np.savez_compressed(asked.out / f"tip-{tip}.npz", **table(tip, asked.processes))


if __name__ == "__main__":
    main()
