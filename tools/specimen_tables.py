"""Solve the virtual tip on specimens that are no flat cylinder: domes, rigid and soft, and bonded layers.

    python tools/specimen_tables.py solved         # a file a press; those that are there are kept
    python tools/specimen_tables.py solved --out src/palpate/mechanics/tip_tables
    python tools/specimen_tables.py solved --check     # to tools/specimen_study.json

Needs scikit-fem. Each press takes some twenty seconds of one core.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain import meeting
from finite_strain.tip import Specimen, Tip, TipPress
from scipy.interpolate import CubicSpline
from tip_tables import CELLS as TABLE_CELLS, EVERY, FORCES_N, TIPS, tabulated

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


def file_of(folder: Path, tip: str, specimen: Specimen) -> Path:
    """Where a press is kept."""
    s = specimen
    return folder / f"{tip}_E{s.mpa:g}_h{s.height:g}_r{s.radius:g}_R{s.dome:g}.npz"


def solve(folder: Path, tip: str) -> None:
    """Every press that is not there yet."""
    folder.mkdir(exist_ok=True, parents=True)
    for specimen in [*domes(), *layers()]:
        path = file_of(folder, tip, specimen)
        if path.exists():
            continue
        started = time.perf_counter()
        found = tabulated(TipPress(TIPS[tip], specimen, cells=CELLS), APPROACHES)
        np.savez(path, **found)
        print(f"{path.name}: {time.perf_counter() - started:.0f} s", flush=True)


def differences(folder: Path, tip: str) -> dict[str, dict[str, ndarray]]:
    """What shapes change, by family and column ``[shapes moduli forces ...]``; millimetres and MPa."""

    def at(mpa: float, dome: float = np.inf) -> dict[str, ndarray]:
        return dict(np.load(file_of(folder, tip, Specimen(mpa, dome=dome))))

    def layer(mpa: float, height: float) -> dict[str, ndarray]:
        return dict(np.load(file_of(folder, tip, Specimen(mpa, height, LAYER_RADIUS_MM))))

    flat = {mpa: at(mpa) for mpa in DOME_MPA}
    rows = {
        "dome": [[(at(E, R), flat[E]) for E in DOME_MPA] for R in DOMES_MM],
        "layer": [
            [*((layer(E, h), flat[np.inf]) for E in LAYER_MPA), (flat[np.inf], flat[np.inf])]
            for h in LAYERS_MM
        ],
    }
    coarse, fine = polar(tip, CELLS), polar(tip, TABLE_CELLS)

    def on_table(values: ndarray) -> ndarray:
        return CubicSpline(coarse, values, axis=3)(fine) if values.ndim > SCALAR_AXES else values

    return {
        family: {
            name: on_table(np.array([[one[name] - base[name] for one, base in row] for row in grid]))
            for name in flat[np.inf]
        }
        for family, grid in rows.items()
    }


def polar(tip: str, cells: int) -> ndarray:
    """Polar angles of the places on the skin's inside that a table of such cells keeps."""
    body = TipPress(TIPS[tip], Specimen(np.inf), cells=cells)
    r, z = body.places[body.shell(TIPS[tip].radius - TIPS[tip].skin)[::EVERY]].T
    return np.arctan2(r, TIPS[tip].radius - z)


def along_modes(values: list[ndarray], count: int) -> tuple[list[ndarray], ndarray, float]:
    """Places along the directions in which fields differ most, these, and the greatest error of it."""
    size = values[0].ndim - 3
    shape = values[0].shape[3:]
    flat = np.concatenate([one.reshape(-1, int(np.prod(shape))) for one in values])
    modes = np.linalg.svd(flat, full_matrices=False)[2][:count].astype(np.float32)
    places = [np.tensordot(one, modes.reshape(count, *shape), axes=(range(3, 3 + size), range(1, 1 + size)))
              for one in values]  # fmt: skip
    return places, modes.reshape(count, *shape), float(np.abs(flat - flat @ modes.T @ modes).max())


def reduce(folder: Path, tip: str, out: Path) -> None:
    """Write the table of a tip, and print what keeping few directions costs."""
    found = differences(folder, tip)
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
        print(f"{tip}: {name} along {count} directions, off by up to {error:.2g}")
        arrays[f"{to}_modes"] = modes
        for family, one in zip(found, places, strict=True):
            arrays[f"{family}_{to}"] = one.astype(np.float32)
    np.savez_compressed(out / f"shapes-{tip}.npz", **arrays)


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


def study(folder: Path, tip: str) -> dict[str, dict[str, list[float] | float]]:
    """What reading between solved specimens costs, and what the cells do, in per cent at 1, 3 and 5 N."""
    from palpate.mechanics.axisymmetric.shape_table import shape_table

    found: dict[str, dict[str, list[float] | float]] = {}
    table = shape_table(tip)
    for s in FINER:
        fine, coarse = (
            tabulated(TipPress(TIPS[tip], s, cells=cells), APPROACHES) if cells != CELLS
            else np.load(file_of(folder, tip, s)) for cells in (FINER_CELLS, CELLS)
        )  # fmt: skip
        found[f"{s.mpa:g} MPa, h {s.height:g} mm, R {s.dome:g} mm, {CELLS} cells over {FINER_CELLS}"] = {
            f"{name}_percent": _percent(coarse[of] ** p, fine[of] ** p)
            for name, of, p in (("area", "radius_mm", 2), ("approach", "approach_mm", 1))
        }
    for s in BETWEEN:
        path = file_of(folder, tip, s)
        if not path.exists():
            np.savez(path, **tabulated(TipPress(TIPS[tip], s, cells=CELLS), APPROACHES))
        solved = np.load(path)
        press = (
            table.layer(1e-3 * s.height, 1e6 * s.mpa) if s.height < LAYERS_MM[-1]
            else table.dome(1e-3 * s.dome, 1e6 * s.mpa)
        )  # fmt: skip
        area, approach = (
            np.interp(AT_N, FORCES_N, y) for y in (np.pi * solved["radius_mm"] ** 2, solved["approach_mm"])
        )
        inside = CubicSpline(polar(tip, CELLS), solved["inside_mm"], axis=1)(polar(tip, TABLE_CELLS))
        off = np.abs(1e3 * press.at("inside_m", FORCES_N) - inside).max(axis=(1, 2))
        found[f"{s.mpa:g} MPa, h {s.height:g} mm, R {s.dome:g} mm, read between"] = {
            "area_percent": (100 * (1e6 * press.at("area_m2", AT_N) / area - 1)).round(3).tolist(),
            "approach_percent": (100 * (1e3 * press.at("approach_m", AT_N) / approach - 1)).round(3).tolist(),
            "skin_um": (1e3 * np.interp(AT_N, FORCES_N, off)).round(2).tolist(),
        }
    return found


def _percent(one: ndarray, other: ndarray) -> list[float]:
    """By how much a column lies above another, at 1, 3 and 5 N."""
    of_one, of_other = (np.interp(AT_N, FORCES_N, column) for column in (one, other))
    return (100 * (of_one / of_other - 1)).round(3).tolist()


def main() -> None:
    """Solve, or reduce what was solved, or study it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("solved", type=Path, help="folder of the presses")
    parser.add_argument("--tip", choices=sorted(TIPS), default="base")
    parser.add_argument("--out", type=Path, help="folder for the table; without it presses are solved")
    parser.add_argument("--check", action="store_true", help="study the table that is shipped")
    asked = parser.parse_args()
    if asked.check:
        found = study(asked.solved, asked.tip) | small_loads()
        (Path(__file__).parent / "specimen_study.json").write_text(json.dumps(found, indent=2) + "\n")
    elif asked.out is None:
        solve(asked.solved, asked.tip)
    else:
        reduce(asked.solved, asked.tip, asked.out)


if __name__ == "__main__":
    main()
