"""Make the tip tables that palpate ships: a hemispherical tip pressed head-on on cylinders, at finite strain.

    python tools/tip_tables.py solved --out src/palpate/mechanics/tip_tables
    python tools/tip_tables.py solved --check          # the mesh study, to tools/tip_mesh_study.json

Needs scikit-fem. A press takes half a minute of one core. All tips are pressed on a rigid plate as well, to
equal depths, for tips between the tables. Options are those of `table_runner`.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.tip import Balanced, Specimen, Tip, TipPress
from table_runner import Arrays, kept, run, write, write_study

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
STUDY_MPA = (0.035, 0.2419)


def inside_of(press: TipPress) -> ndarray:
    """Nodes of the skin's inside, from the axis outwards."""
    return press.shell(press.tip.radius - press.tip.skin)


def measured(press: TipPress, approaches: Float[ndarray, " k"], max_n: float = MAX_N) -> Arrays:
    """Every balance at approaches [mm] until the greatest force, column by column [mm, N, MPa, rad]."""
    inside, apex = inside_of(press), press.shell(press.tip.radius)[0]
    rows = []
    for balanced in press.through(approaches):
        u = balanced.u + np.array([0.0, balanced.approach])
        rows.append(
            {
                "approach_mm": balanced.approach,
                "force_n": press.force(balanced),
                "flattening_mm": u[apex, 1],
                "inside_mm": (press.places + u)[inside][::EVERY],  # in the tip's own frame
                "energy_mpa": _energy(press, balanced, inside)[::EVERY],
                "edges": _edges(press, balanced),
            }
        )
        if rows[-1]["force_n"] > max_n:
            break
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _edges(press: TipPress, balanced: Balanced) -> tuple[float, float, float, float]:
    """Radii, then polar angles, of the last point of the skin that touches and the next."""
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


def with_edges(columns: Arrays, at: ndarray) -> Arrays:
    """Columns with one smooth curve for the edge, at forces: single states know it to a point's spacing."""
    edges = columns.pop("edges")
    r, angle = (smooth_edge(columns["force_n"], *edges.T[i : i + 2], at) for i in (0, 2))
    return columns | {"radius_mm": r, "angle_rad": angle}


def smooth_edge(force: ndarray, low: ndarray, high: ndarray, at: ndarray) -> Float[ndarray, " n"]:
    """A curve between the places, by force, that touch and those that do not."""

    def powers(f: ndarray) -> ndarray:
        return np.cbrt(f)[:, None] ** np.arange(1, EDGE_TERMS + 1)

    touched = high > 0
    weight = np.cbrt(force[touched]) / (high - low)[touched]
    middle = ((low + high) / 2)[touched]
    c, *_ = np.linalg.lstsq(powers(force[touched]) * weight[:, None], middle * weight, rcond=None)
    return np.asarray(powers(at) @ c)


def tabulated(press: TipPress, approaches: Float[ndarray, " k"] = EVEN) -> Arrays:
    """What one press through approaches [mm] gives at the table's forces."""
    columns = with_edges(measured(press, approaches), FORCES_N)
    # all start as powers of force, nearly straight in its cube root
    root = np.cbrt(np.append(0.0, columns.pop("force_n")))
    for name in ("approach_mm", "flattening_mm", "inside_mm", "energy_mpa"):
        first = press.places[inside_of(press)[::EVERY]] if name == "inside_mm" else 0.0 * columns[name][0]
        columns[name] = PchipInterpolator(root, np.concatenate([[first], columns[name]]))(np.cbrt(FORCES_N))
    return columns


def solve(path: Path, tip: str, mpa: float, cells: int = CELLS) -> None:
    """One press to the table's forces."""
    np.savez(path, **tabulated(TipPress(TIPS[tip], Specimen(mpa), cells=cells)))


def solve_plate(path: Path, tip: str) -> None:
    """One tip on a rigid plate, to a depth."""
    press = TipPress(TIPS[tip], Specimen(np.inf), cells=CELLS)
    found = measured(press, EVEN[EVEN <= PLATE_MM], np.inf)
    np.savez(path, **with_edges(found, found["force_n"]))


def polar_rad(tip: str, cells: int) -> ndarray:
    """Polar angles of the places on the skin's inside that a table of such cells keeps."""
    press = TipPress(TIPS[tip], Specimen(np.inf), cells=cells)
    r, z = press.places[inside_of(press)[::EVERY]].T
    return np.arctan2(r, TIPS[tip].radius - z)


def stacked(folder: Path, names: list[str]) -> Arrays:
    """Presses one over the other."""
    presses = [kept(folder / f"{name}.npz") for name in names]
    return {name: np.stack([press[name] for press in presses]).astype(np.float32) for name in presses[0]}


def tables(folder: Path, out: Path) -> None:
    """One of each tip, and one of all on a rigid plate."""
    for tip, made in TIPS.items():
        columns = stacked(folder, [f"{tip}-{mpa:g}" for mpa in SPECIMENS_MPA])
        fixed = {"force_n": FORCES_N, "specimen_mpa": SPECIMENS_MPA, "polar_rad": polar_rad(tip, CELLS)}
        fixed["tip"] = (made.radius, made.skin, made.skin_mpa, made.gel_mpa, TipPress.poisson_ratio)
        write(out / f"tip-{tip}.npz", columns | fixed | {"specimen": (Specimen.radius, Specimen.height)})
    plates = stacked(folder, [f"{tip}-plate" for tip in TIPS])
    moduli = {name: [getattr(made, name) for made in TIPS.values()] for name in ("skin_mpa", "gel_mpa")}
    write(out / "plate.npz", plates | {"approach_mm": EVEN[EVEN <= PLATE_MM]} | moduli)


def study(folder: Path) -> None:
    """What the mesh costs: area, approach and flattening at 1, 3 and 5 N on finer and finer cells."""
    found = {}
    for mpa in STUDY_MPA:
        for cells in STUDY_CELLS:
            press = kept(folder / (f"base-{mpa:g}.npz" if cells == CELLS else f"base-{mpa:g}-{cells}.npz"))
            press["area_mm2"] = np.pi * press["radius_mm"] ** 2
            found[f"{mpa:g} MPa, {cells} cells"] = {
                name: np.interp([1, 3, 5], FORCES_N, press[name]).round(5).tolist()
                for name in ("area_mm2", "approach_mm", "flattening_mm")
            }
    write_study("tip_mesh", found)


if __name__ == "__main__":
    presses = {f"{tip}-{mpa:g}": partial(solve, tip=tip, mpa=mpa) for tip in TIPS for mpa in SPECIMENS_MPA}
    presses |= {f"{tip}-plate": partial(solve_plate, tip=tip) for tip in TIPS}
    studied = {
        f"base-{mpa:g}-{cells}": partial(solve, tip="base", mpa=mpa, cells=cells)
        for mpa in STUDY_MPA for cells in STUDY_CELLS if cells != CELLS
    }  # fmt: skip
    run(__doc__ or "", presses, tables, study, studied)
