"""Make the tables of inclined presses that palpate ships: a tip on inclined tops, at finite strain, in 3-D.

    python tools/inclined_tables.py --solve solved --tilt-deg 30 --mpa inf --mpa 0.035
    python tools/inclined_tables.py --solved solved --out src/palpate/mechanics/tip_tables
    python tools/inclined_tables.py --solve solved --tilt-deg 0 --mpa inf --mpa 0.2419 --mpa 0.035
    python tools/inclined_tables.py --solve coarse --tilt-deg 30 --mpa 0.0987 --cells 8 10 4
    python tools/inclined_tables.py --solved solved --check --coarse coarse   # to tools/inclined_study.json

One press takes one to three minutes of one core; its states are kept in a file of its own. A table is made of
all presses of the tip whose files are there, and needs those at 0 degrees of the softest and the stiffest,
where the head-on table shows how far outside of where these cells see it a contact's edge is.
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
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline, interp1d

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.cylinder import Cylinder
from finite_strain.inclined import Fineness, Inclined, InclinedPress
from tip_tables import TIPS

from palpate.mechanics.axisymmetric.tip_table import tip_table

MAX_N = 5.5  # along the tip's axis
FORCES_N = 5.5 * (np.arange(1, 17) / 16) ** 2  # of a table
ACROSS, ASIDE = np.linspace(0.0, np.pi, 41), np.linspace(0.0, np.pi / 2, 21)
AREA_TERMS = 4
EDGE_FROM_N = 0.3  # below, a contact is of a few points only
UNIT_MM = 5e-4  # of a motion in the table
CELLS = Fineness.degrees, Cylinder.across, Cylinder.down
SHOWN_N = np.array([1.0, 3.0, 5.0])


def solved(
    tip: str, tilt_deg: float, mpa: float, folder: Path, cells: tuple[float, int, int] = CELLS
) -> None:
    """Solve one press and write its states after every one."""
    degrees, across, down = cells
    top = Cylinder(mpa, across=across, down=down) if np.isfinite(mpa) else None
    press = InclinedPress(TIPS[tip], top, np.deg2rad(tilt_deg), fineness=Fineness(degrees))
    started, states = time.process_time(), []
    for state in press.states():
        states.append(
            (state.approach, press.force(state), press.area(state), press.span(state), inside(press, state))
        )
        approach, force, area, span, _ = states[-1]
        print(
            f"{tip} {tilt_deg:g} degrees {mpa:g} MPa: {approach:.2f} mm {force[2]:.4f} N, {area:.1f} mm2 "
            f"from {span[0]:.1f} to {span[1]:.1f} mm up the slope; "
            f"{press.iterations} moves, {time.process_time() - started:.0f} s", flush=True,
        )  # fmt: skip
        approaches, forces, areas, spans, moved = (np.array(c) for c in zip(*states, strict=True))
        np.savez_compressed(
            folder / f"{tip}_{tilt_deg:g}_{mpa:g}.npz", tip=tip, tilt_deg=tilt_deg, mpa=mpa, cells=cells,
            approach_mm=approaches, force_n=forces, area_mm2=areas, span_mm=spans, moved_mm=moved,
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


def at_forces(press: dict[str, ndarray], unseen_mm: float = 0.0) -> dict[str, ndarray]:
    """One press at the table's forces, the contact's edge so far outside of where the cells see it."""
    lift = press["force_n"][:, 2]
    root, to = np.concatenate([[0.0], np.cbrt(lift)]), np.cbrt(FORCES_N)
    found = {}
    for name in (
        "approach_mm",
        "moved_mm",
    ):  # over the root they are nearly straight lines, from first touch on
        shape = (-1,) + (1,) * (press[name].ndim - 1)
        slope = press[name] / root[1:].reshape(shape)
        read = PchipInterpolator(root, np.concatenate([np.zeros_like(slope[:1]), slope]))
        found[name] = read(to) * to.reshape(shape)
    # the contact's size, known to a point's spacing only, by a smooth curve
    powers = root[1:, None] ** np.arange(1, AREA_TERMS + 1)
    size = np.sqrt(press["area_mm2"]) + np.sqrt(np.pi) * unseen_mm
    c, *_ = np.linalg.lstsq(powers * root[1:, None], size * root[1:], rcond=None)
    found["area_mm2"] = (to[:, None] ** np.arange(1, AREA_TERMS + 1) @ c) ** 2
    return found


def unseen_mm(tip: str, presses: dict[tuple[float, float], dict[str, ndarray]]) -> interp1d:
    """How far outside of where the cells see it a contact's edge is, over a specimen's place.

    By presses at 0 degrees against the head-on table; between their moduli by a straight line.
    """
    edges = {}
    for (tilt, mpa), press in presses.items():
        if tilt == 0:
            force = press["force_n"][:, 2]
            known = (force > EDGE_FROM_N) & (force < FORCES_N[-1])
            true = 1e3 * tip_table(tip).press(1e6 * mpa).at("radius_m", force[known])
            edges[place_mm(tip, mpa)] = np.mean(true - np.sqrt(press["area_mm2"][known] / np.pi))
    places = sorted(edges)
    return interp1d(places, [edges[one] for one in places])


def place_mm(tip: str, mpa: float) -> float:
    """A specimen's place among others: the head-on approach at 3 N."""
    return 1e3 * float(tip_table(tip).press(1e6 * mpa).at("approach_m", np.array([3.0]))[0])


def table(tip: str, folder: Path) -> dict[str, ndarray]:
    """All presses of a tip."""
    states = {}
    for path in folder.glob(f"{tip}_*.npz"):
        with np.load(path) as arrays:
            one = {name: arrays[name] for name in arrays.files}
        states[float(one["tilt_deg"]), float(one["mpa"])] = one
    unseen = unseen_mm(tip, states)
    presses = {
        (tilt, mpa): at_forces(one, float(unseen(place_mm(tip, mpa))))
        for (tilt, mpa), one in states.items()
        if tilt > 0
    }
    tilts, moduli = (np.unique([key[i] for key in presses]) for i in (0, 1))
    missing = {name: np.full_like(values, np.nan) for name, values in presses[tilts[0], np.inf].items()}
    columns = {
        name: np.array([[presses.get((t, E), missing)[name] for E in moduli] for t in tilts])
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
    whole = np.moveaxis(np.rint(np.nan_to_num(moved) / UNIT_MM).astype(np.int64), -1, 0)
    for axis in (3, 4, 5):
        whole = np.diff(whole, axis=axis, prepend=0)
    if np.abs(whole).max() > np.iinfo(np.int16).max:
        raise OverflowError("a motion's step is too long for the table")
    return whole.astype(np.int16)


def head_on_study(tip: str, folder: Path) -> dict[str, dict[str, list[float]]]:
    """What three dimensions and their mesh cost: presses at 0 degrees over the head-on table, less 1."""
    found = {}
    for path in sorted(folder.glob(f"{tip}_0_*.npz")):
        with np.load(path) as arrays:
            press = {name: arrays[name] for name in arrays.files}
        found[f"{named(tip, press)} over the head-on table"] = compared(
            read_at(press), head_on(tip, 1e6 * float(press["mpa"]))
        )
    return found


def mesh_study(tip: str, folder: Path, coarse: Path) -> dict[str, dict[str, list[float]]]:
    """What the mesh costs: presses on coarser cells over the same ones, less 1."""
    found = {}
    for path in sorted(coarse.glob(f"{tip}_*.npz")):
        with np.load(path) as arrays, np.load(folder / path.name) as finer:
            press, other = ({name: a[name] for name in a.files} for a in (arrays, finer))
        cells = "{:g} degrees, {:g} cells across and {:g} down".format(*press["cells"])
        found[f"{named(tip, press)}, cells of {cells}"] = compared(read_at(press), read_at(other))
    return found


def named(tip: str, press: dict[str, ndarray]) -> str:
    """What a press is called in the study."""
    mpa = float(press["mpa"])
    on = f"{mpa:g} MPa" if np.isfinite(mpa) else "rigid"
    return f"{tip}, {on}, {float(press['tilt_deg']):g} degrees, {', '.join(f'{n:g}' for n in SHOWN_N)} N"


def read_at(press: dict[str, ndarray]) -> dict[str, ndarray]:
    """A press at `SHOWN_N`."""
    root = np.cbrt(FORCES_N)
    return {n: PchipInterpolator(root, v)(np.cbrt(SHOWN_N)) for n, v in at_forces(press).items()}


def head_on(tip: str, specimen_pa: float) -> dict[str, ndarray]:
    """The head-on table's press, as a tilted one of no tilt."""
    upright = tip_table(tip).press(specimen_pa)
    phi, inner = upright.polar_rad, TIPS[tip].radius - TIPS[tip].skin
    rest = np.stack([inner * np.sin(phi), TIPS[tip].radius - inner * np.cos(phi)], axis=-1)
    a, b = np.meshgrid(ACROSS, ASIDE, indexing="ij")
    x, y, polar = np.cos(b) * np.cos(a), np.sin(b), np.arccos(np.clip(np.cos(b) * np.sin(a), 0.0, 1.0))
    out, up = np.moveaxis(
        CubicSpline(phi, 1e3 * upright.at("inside_m", SHOWN_N) - rest, axis=1)(polar), -1, 0
    )
    r = np.maximum(np.hypot(x, y), 1e-9)
    return {
        "approach_mm": 1e3 * upright.at("approach_m", SHOWN_N),
        "area_mm2": 1e6 * upright.at("area_m2", SHOWN_N),
        "moved_mm": np.stack([out * x / r, out * y / r, up], axis=-1),
    }


def compared(one: dict[str, ndarray], other: dict[str, ndarray]) -> dict[str, list[float]]:
    """One press over another, less 1; motion by the difference's root mean square over the other's."""
    off = one["moved_mm"] - other["moved_mm"]
    over = {
        "approach": one["approach_mm"] / other["approach_mm"] - 1,
        "area": one["area_mm2"] / other["area_mm2"] - 1,
        "motion": np.sqrt((off**2).sum(axis=(1, 2, 3)) / (other["moved_mm"] ** 2).sum(axis=(1, 2, 3))),
    }
    return {name: np.round(values, 4).tolist() for name, values in over.items()}


def main() -> None:
    """Solve presses, or make the table of those that are solved."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tip", choices=sorted(TIPS), default="base")
    parser.add_argument("--solve", type=Path, help="folder for the states of presses, to be solved now")
    parser.add_argument("--tilt-deg", type=float, action="append", default=[])
    parser.add_argument("--mpa", type=float, action="append", default=[], help="inf for a rigid plate")
    parser.add_argument("--solved", type=Path, help="folder of presses to make a table of")
    parser.add_argument("--out", type=Path, help="folder for the table")
    parser.add_argument(
        "--cells", type=float, nargs=3, default=CELLS, metavar=("DEGREES", "ACROSS", "DOWN"),
        help="of the skin, and numbers of the cylinder's",
    )  # fmt: skip
    parser.add_argument("--check", action="store_true", help="compare the solved presses at 0 degrees")
    parser.add_argument(
        "--coarse", type=Path, help="folder of the same presses on coarser cells, to compare too"
    )
    asked = parser.parse_args()
    if asked.solve:
        asked.solve.mkdir(parents=True, exist_ok=True)
        for tilt in asked.tilt_deg:
            for mpa in asked.mpa:
                degrees, across, down = asked.cells
                solved(asked.tip, tilt, mpa, asked.solve, (degrees, int(across), int(down)))
    if asked.check:
        study = head_on_study(asked.tip, asked.solved)
        study |= mesh_study(asked.tip, asked.solved, asked.coarse) if asked.coarse else {}
        (Path(__file__).parent / "inclined_study.json").write_text(json.dumps(study, indent=2) + "\n")
    if asked.out:
        np.savez_compressed(asked.out / f"inclined-{asked.tip}.npz", **table(asked.tip, asked.solved))


if __name__ == "__main__":
    main()
