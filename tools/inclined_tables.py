"""Make the tables of inclined presses that palpate ships: a tip on inclined tops, at finite strain, in 3-D.

    python tools/inclined_tables.py solved --out src/palpate/mechanics/tip_tables
    python tools/inclined_tables.py solved --check       # to tools/inclined_study.json

One press takes one to three minutes of one core. Those at 0 degrees show, against the head-on table, how far
outside of where these cells see it a contact's edge is. Options are those of `table_runner`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline, interp1d

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.cylinder import Cylinder
from finite_strain.inclined import Fineness, Inclined, InclinedPress
from table_runner import Arrays, keep_states, kept, run, write, write_study
from tip_tables import TIPS

from palpate.mechanics.axisymmetric.tip_table import tip_table

MAX_N = 5.5  # along the tip's axis
FORCES_N = 5.5 * (np.arange(1, 17) / 16) ** 2  # of a table
ACROSS, ASIDE = np.linspace(0.0, np.pi, 41), np.linspace(0.0, np.pi / 2, 21)
AREA_TERMS = 4
EDGE_FROM_N = 0.3  # below, a contact is of a few points only
UNIT_MM = 5e-4  # of a motion in the table
TIP = "base"
CELLS, COARSE = (Fineness.degrees, Cylinder.across, Cylinder.down), (8.0, 10, 4)
SHOWN_N = np.array([1.0, 3.0, 5.0])
PRESSES = (  # degrees, MPa
    (0, np.inf), (0, 0.035), (30, np.inf), (30, 0.2419), (30, 0.035), (45, np.inf), (45, 0.2419),
)  # fmt: skip
COARSE_PRESS = 30, 0.2419  # which is pressed on coarser cells as well
NAMES = ("approach_mm", "force_n", "area_mm2", "moved_mm")


def name_of(tilt_deg: float, mpa: float) -> str:
    """Of a press."""
    return f"{TIP}_{tilt_deg:g}_{mpa:g}"


def solve(path: Path, tilt_deg: float, mpa: float, cells: tuple[float, int, int] = CELLS) -> None:
    """One press."""
    degrees, across, down = cells
    top = Cylinder(mpa, across=across, down=down) if np.isfinite(mpa) else None
    press = InclinedPress(TIPS[TIP], top, np.deg2rad(tilt_deg), fineness=Fineness(degrees))

    def states() -> Iterator[tuple[float, ndarray, float, ndarray]]:
        for one in press.states():
            force = press.force(one)
            yield one.approach, force, press.area(one), inside(press, one)
            if force[2] > MAX_N:
                return

    keep_states(path, states(), NAMES)


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


def unseen_mm(tip: str, presses: dict[tuple[float, float], Arrays]) -> interp1d:
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


def tables(folder: Path, out: Path) -> None:
    """Of all presses; what was not pressed at a tilt is NaN."""
    solved = {pair: kept(folder / f"{name_of(*pair)}.npz") for pair in PRESSES}
    unseen = unseen_mm(TIP, solved)
    presses = {
        (tilt, mpa): at_forces(one, float(unseen(place_mm(TIP, mpa))))
        for (tilt, mpa), one in solved.items() if tilt > 0
    }  # fmt: skip
    tilts, moduli = (np.unique([pair[i] for pair in presses]) for i in (0, 1))
    missing = {name: np.full_like(values, np.nan) for name, values in presses[tilts[0], np.inf].items()}
    columns = {
        name: np.array([[presses.get((t, E), missing)[name] for E in moduli] for t in tilts])
        for name in missing
    }
    made, nu = TIPS[TIP], InclinedPress.poisson_ratio
    axes = {"tilt_deg": tilts, "specimen_mpa": moduli, "force_n": FORCES_N, "across_rad": ACROSS}
    fixed = {"tip": (made.radius, made.skin, made.skin_mpa, made.gel_mpa, nu), "unit_mm": UNIT_MM}
    fixed |= {name: columns[name].astype(np.float32) for name in ("approach_mm", "area_mm2")}
    fixed |= {"moved_steps": steps(columns["moved_mm"]), "specimen": (Cylinder.radius, Cylinder.height)}
    write(out / f"inclined-{TIP}.npz", {**axes, "aside_rad": ASIDE, **fixed})


def steps(moved: Float[ndarray, "t s f a b 3"]) -> Int[ndarray, "3 t s f a b"]:
    """Motions by their steps from force to force and from place to place, which pack four times as well."""
    whole = np.moveaxis(np.rint(np.nan_to_num(moved) / UNIT_MM).astype(np.int64), -1, 0)
    for axis in (3, 4, 5):
        whole = np.diff(whole, axis=axis, prepend=0)
    if np.abs(whole).max() > np.iinfo(np.int16).max:
        raise OverflowError("a motion's step is too long for the table")
    return whole.astype(np.int16)


def study(folder: Path) -> None:
    """What three dimensions cost at 0 degrees, over the head-on table, and what the mesh does; less 1."""
    found = {}
    for mpa in (mpa for tilt, mpa in PRESSES if tilt == 0):
        press = read_at(kept(folder / f"{name_of(0, mpa)}.npz"))
        found[f"{named(0, mpa)} over the head-on table"] = compared(press, head_on(TIP, 1e6 * mpa))
    coarse, fine = (read_at(kept(folder / f"{name_of(*COARSE_PRESS)}{s}.npz")) for s in ("-coarse", ""))
    cells = "{:g} degrees, {:g} cells across and {:g} down".format(*COARSE)
    found[f"{named(*COARSE_PRESS)}, cells of {cells}"] = compared(coarse, fine)
    write_study("inclined", found)


def named(tilt_deg: float, mpa: float) -> str:
    """What a press is called in the study."""
    on = f"{mpa:g} MPa" if np.isfinite(mpa) else "rigid"
    return f"{TIP}, {on}, {tilt_deg:g} degrees, {', '.join(f'{n:g}' for n in SHOWN_N)} N"


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


if __name__ == "__main__":
    presses = {name_of(*pair): partial(solve, tilt_deg=pair[0], mpa=pair[1]) for pair in PRESSES}
    tilt, modulus = COARSE_PRESS
    coarser = {f"{name_of(tilt, modulus)}-coarse": partial(solve, tilt_deg=tilt, mpa=modulus, cells=COARSE)}
    run(__doc__ or "", presses, tables, study, coarser)
