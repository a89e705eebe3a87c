"""Make the tables of inclined presses that palpate ships: a tip on inclined tops, at finite strain, in 3-D.

    python tools/inclined_tables.py --solve solved --tilt-deg 30 --mpa inf --mpa 0.035
    python tools/inclined_tables.py --solved solved --out src/palpate/mechanics/tip_tables
    python tools/inclined_tables.py --solve solved --tilt-deg 0 --mpa inf
    python tools/inclined_tables.py --solved solved --check head-on     # to tools/inclined_study.json

One press takes a minute of one core; its states are kept in a file of its own. A table is made of all presses
of the tip whose files are there, and needs every modulus at every tilt.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.cylinder import Cylinder
from finite_strain.inclined import Inclined, InclinedPress
from tip_tables import TIPS

from palpate.mechanics.axisymmetric.tip_table import tip_table

MAX_N = 5.6  # along the tip's axis
FORCES_N = 5.5 * (np.arange(1, 17) / 16) ** 2  # of a table
ACROSS, ASIDE = np.linspace(0.0, np.pi, 41), np.linspace(0.0, np.pi / 2, 21)
AREA_TERMS = 4
UNIT_MM = 5e-4  # of a motion in the table


def solved(tip: str, tilt_deg: float, mpa: float, folder: Path) -> None:
    """Solve one press and write its states after every one."""
    top = Cylinder(mpa) if np.isfinite(mpa) else None
    press = InclinedPress(TIPS[tip], top, np.deg2rad(tilt_deg))
    started, states = time.process_time(), []
    for state in press.states():
        states.append((state.approach, press.force(state), press.area(state), inside(press, state)))
        approach, force, area, _ = states[-1]
        print(
            f"{tip} {tilt_deg:g} degrees {mpa:g} MPa: {approach:.2f} mm {force[2]:.4f} N, {area:.1f} mm2; "
            f"{press.iterations} moves, {time.process_time() - started:.0f} s", flush=True,
        )  # fmt: skip
        approaches, forces, areas, moved = (np.array(c) for c in zip(*states, strict=True))
        np.savez_compressed(
            folder / f"{tip}_{tilt_deg:g}_{mpa:g}.npz", tip=tip, tilt_deg=tilt_deg, mpa=mpa,
            approach_mm=approaches, force_n=forces, area_mm2=areas, moved_mm=moved,
        )  # fmt: skip
        if force[2] > MAX_N:
            return


def inside(press: InclinedPress, state: Inclined) -> Float[ndarray, "a b 3"]:
    """How far the skin's inside has moved, over the table's angles."""
    body, cells = press.body, press.body.youngs_modulus.shape
    at = body.number[:, :, 2 * (cells[2] - 2)]
    moved = np.where(at[..., None] < 0, np.nan, state.u[at])
    # the middle of a face from the nodes around it
    corners = moved[:-2:2, :-2:2] + moved[2::2, :-2:2] + moved[:-2:2, 2::2] + moved[2::2, 2::2]
    sides = moved[1::2, :-2:2] + moved[1::2, 2::2] + moved[:-2:2, 1::2] + moved[2::2, 1::2]
    moved[1::2, 1::2] = sides / 2 - corners / 4
    across, aside = (np.interp(np.arange(2 * len(k) - 1) / 2, np.arange(len(k)), k) for k in body.knots[:2])
    both = np.concatenate([-aside[:0:-1], aside])
    mirrored = np.concatenate([moved[:, :0:-1] * [1.0, -1.0, 1.0], moved], axis=1)
    return np.stack(
        [RectBivariateSpline(across, both, mirrored[..., i])(ACROSS, ASIDE) for i in range(3)], axis=-1
    )


def at_forces(press: dict[str, ndarray]) -> dict[str, ndarray]:
    """One press at the table's forces."""
    lift = press["force_n"][:, 2]
    root, to = np.concatenate([[0.0], np.cbrt(lift)]), np.cbrt(FORCES_N)
    found = {
        name: PchipInterpolator(root, np.concatenate([np.zeros_like(press[name][:1]), press[name]]))(to)
        for name in ("approach_mm", "moved_mm")
    }
    # the contact's size, known to a point's spacing only, by a smooth curve
    powers = root[1:, None] ** np.arange(1, AREA_TERMS + 1)
    size = np.sqrt(press["area_mm2"])
    c, *_ = np.linalg.lstsq(powers * root[1:, None], size * root[1:], rcond=None)
    found["area_mm2"] = (to[:, None] ** np.arange(1, AREA_TERMS + 1) @ c) ** 2
    return found


def table(tip: str, folder: Path) -> dict[str, ndarray]:
    """All presses of a tip."""
    presses = {}
    for path in folder.glob(f"{tip}_*.npz"):
        with np.load(path) as arrays:
            one = {name: arrays[name] for name in arrays.files}
        if one["tilt_deg"] > 0:
            presses[float(one["tilt_deg"]), float(one["mpa"])] = at_forces(one)
    tilts, moduli = (np.unique([key[i] for key in presses]) for i in (0, 1))
    columns = {
        name: np.array([[presses[t, E][name] for E in moduli] for t in tilts])
        for name in ("approach_mm", "area_mm2", "moved_mm")
    }
    made, nu = TIPS[tip], InclinedPress(TIPS[tip], None, 0.0).poisson_ratio
    return {
        "tilt_deg": tilts,
        "specimen_mpa": moduli,
        "force_n": FORCES_N,
        "across_rad": ACROSS,
        "aside_rad": ASIDE,
        "approach_mm": columns["approach_mm"].astype(np.float32),
        "area_mm2": columns["area_mm2"].astype(np.float32),
        "moved_steps": steps(columns["moved_mm"]),
        "unit_mm": np.array(UNIT_MM),
        "tip": np.array([made.radius, made.skin, made.skin_mpa, made.gel_mpa, nu]),
        "specimen": np.array([Cylinder.radius, Cylinder.height]),
    }


def steps(moved: Float[ndarray, "t s f a b 3"]) -> Int[ndarray, "3 t s f a b"]:
    """Motions by their steps from force to force and from place to place, which pack four times as well."""
    whole = np.moveaxis(np.rint(moved / UNIT_MM).astype(np.int16), -1, 0)
    for axis in (3, 4, 5):
        whole = np.diff(whole, axis=axis, prepend=np.int16(0))
    return whole


def head_on_study(tip: str, folder: Path, path: Path) -> None:
    """What three dimensions and their mesh cost: the rigid press at 0 degrees over the head-on table, less 1.

    Motion is of the skin's inside along the plane y = 0: the difference's root mean square over the table's.
    """
    with np.load(folder / f"{tip}_0_inf.npz") as arrays:
        solved = at_forces({name: arrays[name] for name in arrays.files})
    upright, forces = tip_table(tip).press(np.inf), np.array([1.0, 3.0, 5.0])
    root = np.cbrt(FORCES_N)
    found = {name: PchipInterpolator(root, values)(np.cbrt(forces)) for name, values in solved.items()}
    phi, inner = upright.polar_rad, TIPS[tip].radius - TIPS[tip].skin
    rest = np.stack([inner * np.sin(phi), TIPS[tip].radius - inner * np.cos(phi)], axis=-1)
    moved = CubicSpline(phi, 1e3 * upright.at("inside_m", forces) - rest, axis=1)(np.abs(ACROSS - np.pi / 2))
    moved[..., 0] *= np.sign(np.pi / 2 - ACROSS)
    off = found["moved_mm"][:, :, 0, ::2] - moved
    over = {
        "approach": found["approach_mm"] / (1e3 * upright.at("approach_m", forces)) - 1,
        "area": found["area_mm2"] / (1e6 * upright.at("area_m2", forces)) - 1,
        "motion": np.sqrt((off**2).sum(axis=(1, 2)) / (moved**2).sum(axis=(1, 2))),
    }
    shown = {name: np.round(values, 4).tolist() for name, values in over.items()}
    path.write_text(json.dumps({f"{tip}, rigid, 0 degrees, 1, 3 and 5 N": shown}, indent=2) + "\n")


def main() -> None:
    """Solve presses, or make the table of those that are solved."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tip", choices=sorted(TIPS), default="base")
    parser.add_argument("--solve", type=Path, help="folder for the states of presses, to be solved now")
    parser.add_argument("--tilt-deg", type=float, action="append", default=[])
    parser.add_argument("--mpa", type=float, action="append", default=[], help="inf for a rigid plate")
    parser.add_argument("--solved", type=Path, help="folder of presses to make a table of")
    parser.add_argument("--out", type=Path, help="folder for the table")
    parser.add_argument("--check", choices=["head-on"], help="compare the solved press at 0 degrees")
    asked = parser.parse_args()
    if asked.solve:
        asked.solve.mkdir(parents=True, exist_ok=True)
        for tilt in asked.tilt_deg:
            for mpa in asked.mpa:
                solved(asked.tip, tilt, mpa, asked.solve)
    if asked.check:
        head_on_study(asked.tip, asked.solved, Path(__file__).parent / "inclined_study.json")
    if asked.out:
        np.savez_compressed(asked.out / f"inclined-{asked.tip}.npz", **table(asked.tip, asked.solved))


if __name__ == "__main__":
    main()
