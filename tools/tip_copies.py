"""Draw copies of a TacTip, calibrate each by presses of known force, and count how often intervals hold.

    python tools/tip_copies.py --tables tips             # twelve copies, ten minutes of one core
    python tools/tip_copies.py --tables tips --copies 3

Four copies have a full calibration as well, fits to five presses, and fits with positions.

Copies are those of `tip_variation.drawn_tip`, each with a tip of its own ratio of skin and gel, solved at
finite strain (half a minute each, kept in the folder of tables), so that its truth is not the interpolation
that reads it. Needs scikit-fem. Numbers stand in docs/how-to/find-a-tips-constants.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

import tip_tables
from finite_strain.tip import Specimen, Tip, TipPress
from sklearn.decomposition import PCA
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from tally import NORMAL, Tally

from palpate.estimators.unit_fit import GRAVITY_M_S2
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, TipBetween, tip_between
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.tip_copies import (
    PlatePress,
    TipCopy,
    designed_tip,
    fit_tip_copy,
    pins_between,
    read_plate_press,
)
from palpate.sensors.tactip.tip_copies.tip_copy_fit import check_tip_weight
from palpate.sensors.tactip.tip_copies.tip_variation import VirtualTip, drawn_tip

RATIOS = np.exp(np.random.default_rng(77).uniform(np.log(12), np.log(56), 16))
FORCE_N = (0.4, 4.8)
FORCE_SHARE, FORCE_SD_N = 0.005, 0.02  # to which forces are known
POSITION_M = 20e-6
NEW, FULL = 8, 120  # presses that are read, and of a full calibration
MASSES_G = (100.0, 300.0)
CHANGE = 0.15


def solved_tip(ratio: float, folder: Path) -> TipBetween:
    """A tip of a ratio of skin's and gel's moduli on a rigid plate, solved at finite strain."""
    gel = 0.085 / math.sqrt(ratio)
    path = folder / f"{ratio:.3f}.npz"
    if not path.exists():
        press = TipPress(Tip(skin_mpa=gel * ratio, gel_mpa=gel), Specimen(np.inf), cells=tip_tables.CELLS)
        np.savez(path, **tip_tables.tabulated(press))
    found, like = dict(np.load(path)), tip_between(math.log(ratio))

    def from_rest(name: str, scale: float = 1.0, first: ndarray | float = 0.0) -> ndarray:
        values = scale * found[name]
        return np.concatenate([np.broadcast_to(first, (1, *values.shape[1:])), values])

    press = HeadOnPress(
        np.append(0.0, tip_tables.FORCES_N), from_rest("approach_mm", 1e-3), from_rest("flattening_mm", 1e-3),
        from_rest("radius_mm", 1e-3), from_rest("angle_rad"), like.press.polar_rad,
        from_rest("inside_mm", 1e-3, like.press.inside_m[:1]), from_rest("energy_mpa", 1e6),
    )  # fmt: skip
    return TipBetween(like.radius_m, like.skin_m, 1e6 * gel * ratio, 1e6 * gel, press)


def pressed(
    tip: VirtualTip, force_n: float, rng: np.random.Generator, *, lean_rad: tuple[float, float] | None = None
) -> tuple[PlatePress, float, float]:
    """A press as it is known, its true force [N] and depth [m]."""
    force_n = min(force_n, 0.98 * tip.force_n(tip.deepest_m))
    depth = tip.depth_m(force_n)
    pins = pins_between(*tip.frames(depth, rng, lean_rad), tip.spec.pins.count)
    sd = math.hypot(FORCE_SHARE * force_n, FORCE_SD_N)
    told = force_n + sd * float(rng.standard_normal())
    at = depth + 7e-3 + POSITION_M * float(rng.standard_normal())
    return PlatePress(*pins, told, sd, at), force_n, depth


def truth(tip: VirtualTip, design: TipCopy) -> dict[str, float]:
    """Terms of a virtual copy, but for its edge, which its scattered pins do not define."""
    outer = tip.roots_rad[0, -6 * tip.spec.pins.rings :]
    seen, _ = replace(tip, distortion=0.0, scale_px=1.0).places_px(0.0)
    middle = (tip.spec.camera.size_px - 1) / 2
    ring = float(np.hypot(*(seen - middle).T)[-6 * tip.spec.pins.rings :].mean()) / tip.edge
    return {
        "stiffness": math.log(tip.force_n(3e-3) / design.stated_force_n),
        "ratio": math.log(tip.tip.skin_pa / tip.tip.gel_pa),
        "lever_mm": 1e3 * tip.spec.pins.length_m, "camera_mm": 1e3 * tip.spec.camera.height_m,
        "distortion": tip.distortion * ring**2, "edge_rad": float(outer.mean()),
        "axis_x_mm": 1e3 * tip.axis_m[0], "axis_y_mm": 1e3 * tip.axis_m[1],
        "seat_x_rad": float(tip.seat_rad[0]), "seat_y_rad": float(tip.seat_rad[1]),
    }  # fmt: skip


def line(known: Sequence[PlatePress]) -> Callable[[PlatePress], float]:
    """Force by a line in the mean radial motion of the pins."""
    slope, offset = np.polyfit([radial(one) for one in known], [one.force_n for one in known], 1)
    return lambda one: float(slope * radial(one) + offset)


def radial(one: PlatePress) -> float:
    """Mean outward motion of the pins [px]."""
    out = one.rest_px - np.median(one.rest_px, axis=0)
    out = out / np.maximum(np.hypot(*out.T), 1.0)[:, None]
    return float(np.nanmean(np.sum(out * (one.moved_px - one.rest_px), axis=1)))


def full_calibration(known: Sequence[PlatePress]) -> Callable[[PlatePress], float]:
    """Force by kernel ridge on principal components of the pins' motions, set by presses left out."""

    def motion(presses: Sequence[PlatePress]) -> ndarray:
        return np.stack([np.nan_to_num(one.moved_px - one.rest_px).ravel() for one in presses])

    force = np.array([one.force_n for one in known])
    unit = PCA(1).fit_transform(motion(known)).std()
    asked = {
        "pca__n_components": (3, 6, 10),
        "kernelridge__gamma": [1 / (2 * (reach * unit) ** 2) for reach in (1.0, 3.0, 10.0, 30.0)],
        "kernelridge__alpha": (1e-6, 1e-5, 1e-4, 1e-3),
    }
    law = GridSearchCV(make_pipeline(PCA(), KernelRidge(kernel="rbf")), asked, cv=3)
    law.fit(motion(known), force - force.mean())
    return lambda one: float(law.predict(motion([one]))[0] + force.mean())


def stiffened(tip: VirtualTip, skin: float, gel: float) -> VirtualTip:
    """The same copy, its skin and gel so many times as stiff; its shapes between the tables."""
    now = tip_between(math.log(tip.tip.skin_pa / tip.tip.gel_pa * skin / gel))
    before = tip_between(math.log(tip.tip.skin_pa / tip.tip.gel_pa))
    ratio = tip.force_ratio * tip.tip.gel_pa / before.gel_pa  # before: force over the tip between the tables
    return replace(tip, tip=now, force_ratio=ratio * before.gel_pa * gel / now.gel_pa)


def weighed(copy: TipCopy, tip: VirtualTip, rng: np.random.Generator, into: Tally, case: str) -> None:
    """Lay known masses on a copy as it is now."""
    for mass_g in MASSES_G:
        one, _, _ = pressed(tip, 1e-3 * mass_g * GRAVITY_M_S2, rng)
        check = into.attempted(f"weight, {case}", check_tip_weight, copy, [one], 1e-3 * mass_g)
        for term in ("stiffness", "ratio") if check is not None else ():
            change = 100 * getattr(check, f"{term}_change")
            into.add(f"weight, {case}: {term} said, change in %", change, term in check.drifted)


def read_new(name: str, copy: TipCopy, new: Sequence[tuple[PlatePress, float, float]], into: Tally) -> None:
    """Force and depth of presses that no fit has seen."""
    for one, force_n, depth_m in new:
        read = into.attempted(name, read_plate_press, copy, one)
        if read is not None:
            held = abs(math.log(read.force_n / force_n)) <= NORMAL * read.force_share
            into.add(f"{name}; new force, N", read.force_n - force_n, held)
            into.interval(f"{name}; new depth, mm", read.depth_mm - 1e3 * depth_m, read.depth_sd_mm)


def study(asked: argparse.Namespace, into: Tally) -> Iterator[int]:
    """Errors of every copy, and what was said; the first of all has no other copy's frames to refuse."""
    design = designed_tip(tactip(127))
    other: TipCopy | None = None
    for k in range(asked.copies):
        rng = np.random.default_rng([asked.seed, k])
        tip = drawn_tip(design.spec, solved_tip(float(RATIOS[k % len(RATIOS)]), asked.tables), rng)
        known = [pressed(tip, f, rng)[0] for f in np.linspace(*FORCE_N, 10)]
        new = [pressed(tip, f, rng) for f in rng.uniform(*FORCE_N, NEW)]
        blind = [replace(one, position_m=None) for one in known]
        fits = {"10 presses": blind}
        if k < asked.whole:
            fits |= {"10 presses and positions": known, "5 presses": blind[1::2]}
        true, copies = truth(tip, design), {}
        for name, presses in fits.items():
            copies[name] = fit_tip_copy(design, presses).copy
            for term, row in copies[name].told.items():
                into.interval(f"{name}; {term}", row["value"] - true[term], row["standard_deviation"])
            read_new(name, copies[name], new, into)
        mean = float(np.mean([one.force_n for one in known]))
        laws = {"mean": lambda _, m=mean: m, "line on mean radial motion, same 10": line(known)}
        if k < asked.whole:
            many = [pressed(tip, f, rng)[0] for f in rng.uniform(*FORCE_N, FULL)]
            laws[f"full calibration, {FULL} presses"] = full_calibration(many)
        for name, law in laws.items():
            for one, force_n, _ in new:
                into.add(f"new force, N, by {name}", law(one) - force_n, True)
        copy, sign = copies["10 presses"], CHANGE if rng.uniform() < 0.5 else -CHANGE
        for case, now in {
            "nothing changed": tip,
            "all by 15 %": replace(tip, force_ratio=tip.force_ratio * (1 + sign)),
            "gel by 15 %": stiffened(tip, 1.0, 1 + sign),
            "skin by 40 %": stiffened(tip, 1.4, 1.0),
        }.items():
            weighed(copy, now, rng, into, case)
        leaning = [pressed(tip, 2.0, rng, lean_rad=(math.radians(4.0), 0.0))[0]]
        into.attempted("weight that leans by 4 degrees", check_tip_weight, copy, leaning, 0.2)
        shuffled = rng.permutation([one.force_n for one in known])
        wrong = [replace(a, force_n=float(f)) for a, f in zip(blind, shuffled, strict=True)]
        into.attempted("shuffled forces", fit_tip_copy, design, wrong)
        if other is not None:
            for one, _, _ in new[:4]:
                into.attempted("another copy's frames", read_plate_press, other, one)
                unplaced = replace(other, rest_px=None, cells=None)
                into.attempted("another copy's frames, places not known", read_plate_press, unplaced, one)
        other = copy
        yield k


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tables", type=Path, required=True, help="folder of solved tips, filled as needed")
    parser.add_argument("--copies", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--whole", type=int, default=4, help="copies with a full calibration and other fits")
    asked = parser.parse_args()
    asked.tables.mkdir(exist_ok=True)
    tally = Tally()
    tally.follow(study(asked, tally))


if __name__ == "__main__":
    main()
