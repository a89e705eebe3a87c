"""Solve the virtual tip on specimens that are no flat cylinder: domes, rigid and soft, and bonded layers.

    python tools/specimen_tables.py solved --out src/palpate/mechanics/tip_tables
    python tools/specimen_tables.py solved --check     # of the shipped table, to tools/specimen_study.json

Needs scikit-fem. Each press takes some twenty seconds of one core. Options are those of `table_runner`.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain import meeting
from finite_strain.tip import Specimen, Tip, TipPress
from scipy.interpolate import CubicSpline
from table_runner import Arrays, kept, run, write, write_study
from tip_tables import CELLS as TABLE_CELLS, FORCES_N, TIPS, polar_rad, tabulated

TIP = "base"
CELLS = 40
APPROACHES = np.concatenate([np.arange(0.25, 1.0, 0.25), np.arange(1.0, 24.0, 0.5)])  # mm
DOMES_MM = (np.inf, 80.0, 40.0, 27.0, 20.0)
DOME_MPA = (0.03, 0.06, 0.0987, 0.1687, 0.4, np.inf)
LAYERS_MM = (1.0, 2.0, 4.0, 8.0)
LAYER_MPA = (0.03, 0.06, 0.12, 0.3)
LAYER_RADIUS_MM = 30.0
SCALAR_AXES = 3  # shapes, moduli, forces
MODES = 24  # directions in which fields are kept


def domes() -> list[Specimen]:
    """Cylinders of the flat tables' size with a cap of a sphere on top."""
    return [Specimen(E, dome=R) for R in DOMES_MM[::-1] for E in DOME_MPA[::-1]]


def layers() -> list[Specimen]:
    """Layers bonded to a rigid base, wider than any contact."""
    return [Specimen(E, h, LAYER_RADIUS_MM) for h in LAYERS_MM for E in LAYER_MPA]


def name_of(s: Specimen) -> str:
    """Of a press."""
    return f"{TIP}_E{s.mpa:g}_h{s.height:g}_r{s.radius:g}_R{s.dome:g}"


def solve(path: Path, specimen: Specimen) -> None:
    """One press."""
    np.savez(path, **tabulated(TipPress(TIPS[TIP], specimen, cells=CELLS), APPROACHES))


def differences(folder: Path) -> dict[str, Arrays]:
    """What shapes change, by family and column ``[shapes moduli forces ...]``; millimetres and MPa."""

    def at(mpa: float, dome: float = np.inf) -> Arrays:
        return kept(folder / f"{name_of(Specimen(mpa, dome=dome))}.npz")

    def layer(mpa: float, height: float) -> Arrays:
        return kept(folder / f"{name_of(Specimen(mpa, height, LAYER_RADIUS_MM))}.npz")

    flat = {mpa: at(mpa) for mpa in DOME_MPA}
    rows = {
        "dome": [[(at(E, R), flat[E]) for E in DOME_MPA] for R in DOMES_MM],
        "layer": [
            [*((layer(E, h), flat[np.inf]) for E in LAYER_MPA), (flat[np.inf], flat[np.inf])]
            for h in LAYERS_MM
        ],
    }
    coarse, fine = polar_rad(TIP, CELLS), polar_rad(TIP, TABLE_CELLS)

    def on_table(values: ndarray) -> ndarray:
        return CubicSpline(coarse, values, axis=3)(fine) if values.ndim > SCALAR_AXES else values

    return {
        family: {
            name: on_table(np.array([[one[name] - base[name] for one, base in row] for row in grid]))
            for name in flat[np.inf]
        }
        for family, grid in rows.items()
    }


def along_modes(values: list[ndarray], count: int) -> tuple[list[ndarray], ndarray, float]:
    """Places along the directions in which fields differ most, these, and the greatest error of it."""
    size = values[0].ndim - 3
    shape = values[0].shape[3:]
    flat = np.concatenate([one.reshape(-1, int(np.prod(shape))) for one in values])
    modes = np.linalg.svd(flat, full_matrices=False)[2][:count].astype(np.float32)
    places = [np.tensordot(one, modes.reshape(count, *shape), axes=(range(3, 3 + size), range(1, 1 + size)))
              for one in values]  # fmt: skip
    return places, modes.reshape(count, *shape), float(np.abs(flat - flat @ modes.T @ modes).max())


def tables(folder: Path, out: Path) -> None:
    """Write the table of a tip, and print what keeping few directions costs."""
    found = differences(folder)
    arrays: dict[str, ndarray] = {
        "dome_curvature_per_mm": 1 / np.array(DOMES_MM),
        "dome_mpa": np.array(DOME_MPA),
        "layer_mm": np.array(LAYERS_MM),
        "layer_mpa": np.array([*LAYER_MPA, np.inf]),
    }
    names = {"approach_mm": "approach_m", "flattening_mm": "flattening_m", "radius_mm": "radius_m",
             "angle_rad": "angle_rad"}  # fmt: skip
    for family, columns in found.items():
        arrays |= {f"{family}_{to}": columns[name].astype(np.float32) for name, to in names.items()}
    for name, to, count in (("inside_mm", "inside_m", MODES), ("energy_mpa", "energy_pa", MODES)):
        places, modes, error = along_modes([found[family][name] for family in found], count)
        print(f"{TIP}: {name} along {count} directions, off by up to {error:.2g}")
        arrays[f"{to}_modes"] = modes
        for family, one in zip(found, places, strict=True):
            arrays[f"{family}_{to}"] = one.astype(np.float32)
    write(out / f"shapes-{TIP}.npz", arrays)


BETWEEN = (
    Specimen(0.13, dome=32.0),
    Specimen(0.05, dome=23.0),
    Specimen(0.3, dome=55.0),
    Specimen(np.inf, dome=32.0),
    Specimen(0.08, 3.0, LAYER_RADIUS_MM),
    Specimen(0.2, 1.5, LAYER_RADIUS_MM),
    Specimen(0.05, 6.0, LAYER_RADIUS_MM),
)
FINER = (Specimen(0.06, dome=20.0), Specimen(0.06, 2.0, LAYER_RADIUS_MM))
FINER_CELLS = 60
AT_N = np.array([1.0, 3.0, 5.0])


def small_loads() -> dict[str, dict[str, float]]:
    """Homogeneous tips at small loads over closed forms: Hertz's for spheres, Hayes's for a layer.

    With a contact twenty-five times as stiff as elsewhere: it sinks by what is much to such small depths.
    """
    from palpate.mechanics.half_space.hertz import Body
    from palpate.mechanics.layers.bonded_layer import sphere_from_radius

    meeting.STIFFNESS = 25 * 2.0
    plane, found = 1 - 0.48**2, {}
    even = Tip(skin_mpa=0.05, gel_mpa=0.05)
    for mpa, dome in ((np.inf, 20.0), (np.inf, 60.0), (0.1, 20.0), (0.1, np.inf)):
        press = TipPress(even, Specimen(mpa, dome=dome), cells=FINER_CELLS)
        (state,) = press.through([0.1])
        pair = Body(5e4 / plane, 20e-3).against(Body(1e6 * mpa / plane, 1e-3 * dome))
        found[f"tip of 0.05 MPa on {mpa:g} MPa, R {dome:g} mm, at 0.1 mm"] = {
            "force_over_hertz": round(press.force(state) / float(pair.force_n(1e-4)), 4)
        }
    stiff = Tip(skin_mpa=100.0, gel_mpa=100.0)
    press = TipPress(stiff, Specimen(0.1, 2.0, LAYER_RADIUS_MM), cells=FINER_CELLS)
    (state,) = press.through([0.1])
    by_radius = [sphere_from_radius(a, 20e-3, 2e-3, 1e5, 0.48) for a in np.linspace(1e-3, 4e-3, 200)]
    depth, force = np.array(by_radius).T
    found["rigid sphere of 20 mm on a layer of 2 mm, 0.1 MPa, at 0.1 mm"] = {
        "force_over_hayes": round(press.force(state) / float(np.interp(1e-4, depth, force)), 4)
    }
    return found


def study(folder: Path) -> None:
    """What reading between solved specimens costs, and what the cells do, in per cent at 1, 3 and 5 N."""
    from palpate.mechanics.axisymmetric.shape_table import shape_table

    found: dict[str, dict[str, list[float] | float]] = {}
    table = shape_table(TIP)
    for s in FINER:
        fine = tabulated(TipPress(TIPS[TIP], s, cells=FINER_CELLS), APPROACHES)
        coarse = kept(folder / f"{name_of(s)}.npz")
        found[f"{s.mpa:g} MPa, h {s.height:g} mm, R {s.dome:g} mm, {CELLS} cells over {FINER_CELLS}"] = {
            "area_percent": _percent(coarse["radius_mm"] ** 2, fine["radius_mm"] ** 2),
            "approach_percent": _percent(coarse["approach_mm"], fine["approach_mm"]),
        }
    for s in BETWEEN:
        solved, is_layer = kept(folder / f"{name_of(s)}.npz"), s.height < LAYERS_MM[-1]
        size = 1e-3 * (s.height if is_layer else s.dome)
        press = (table.layer if is_layer else table.dome)(size, 1e6 * s.mpa)
        inside = CubicSpline(polar_rad(TIP, CELLS), solved["inside_mm"], axis=1)(polar_rad(TIP, TABLE_CELLS))
        off = np.abs(1e3 * press.at("inside_m", FORCES_N) - inside).max(axis=(1, 2))
        area, approach = 1e6 * press.at("area_m2", FORCES_N), 1e3 * press.at("approach_m", FORCES_N)
        found[f"{s.mpa:g} MPa, h {s.height:g} mm, R {s.dome:g} mm, read between"] = {
            "area_percent": _percent(area, np.pi * solved["radius_mm"] ** 2),
            "approach_percent": _percent(approach, solved["approach_mm"]),
            "skin_um": (1e3 * np.interp(AT_N, FORCES_N, off)).round(2).tolist(),
        }
    write_study("specimen", found | small_loads())


def _percent(one: ndarray, other: ndarray) -> list[float]:
    """By how much a column lies above another, at 1, 3 and 5 N."""
    of_one, of_other = (np.interp(AT_N, FORCES_N, column) for column in (one, other))
    return (100 * (of_one / of_other - 1)).round(3).tolist()


if __name__ == "__main__":
    presses, between = [
        {name_of(specimen): partial(solve, specimen=specimen) for specimen in some}
        for some in ([*domes(), *layers()], BETWEEN)
    ]
    run(__doc__ or "", presses, tables, study, between)
