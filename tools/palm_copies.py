"""Draw copies of a palm, fit each to presses of known force, and count how often intervals hold the truth.

    python tools/palm_copies.py                  # eight copies, twenty minutes of one core
    python tools/palm_copies.py --law imperfect  # membranes, mirrors and cameras with every fault
    python tools/palm_copies.py --law imperfect --copies 6 --new 8 --fitted  # by six known forces alone
    python tools/palm_copies.py --law imperfect --copies 6 --new 8 --fitted --control  # holds less
    python tools/palm_copies.py --law each --copies 3  # one fault at a time, E and C known
    python tools/palm_copies.py --law weigh --copies 4 --presses 4 --smaller 20  # checks by known weights

Copies are those of `palm_variation.drawn_palm`; presses are drawn by the exact way with the camera's noise.
No reader knows which faults a copy has: what they cost, and whether intervals hold, is what is asked. The
control reads by a model in which presses differ by nothing but the copy's terms, and takes its own word.
Numbers stand in docs/how-to/find-a-palms-constants.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from tally import Tally

from palpate.core import Pose
from palpate.estimators.unit_fit import GRAVITY_M_S2
from palpate.sensors.palm.copies.palm_copy import AS_SAID, LOCAL, PalmCopy, PicturedPress, designed_copy
from palpate.sensors.palm.copies.palm_copy_fit import check_weight, fit_copy, read_press
from palpate.sensors.palm.palm_press import press, press_to_force
from palpate.sensors.palm.palm_render import render
from palpate.sensors.palm.palm_spec import PalmSpec, palm, scaled_down
from palpate.sensors.palm.palm_variation import IMPERFECT, CopySpread, drawn_palm

FORCE_N, WEIGHT_N = (1.0, 8.0), (1.5, 5.0)
WITHIN = 0.6  # of the membrane's radius
FORCE_SHARE = 0.005  # to which forces are known
CONSTANT_SHARE = 0.005  # to which E and C are, where they are said to be known
CHANGED = math.log(1.15)
CHANGES = {"E + 15 %": (1, 0), "E - 15 %": (-1, 0), "C + 15 %": (0, 1), "C - 15 %": (0, -1)}
ONE_BY_ONE: dict[str, tuple[str, ...]] = {
    "none": (), "thickness": ("thickness_share",), "dirt and texture": ("specks", "texture"),
    "turned regions": ("turn_rad",), "glare": ("spots", "glare"), "residual map": ("residual",),
    "own exposure": ("stops",), "uneven thickness": ("gel_thickness",), "uneven modulus": ("gel_modulus",),
    "residual, uniform": ("frozen",), "temperature": ("kelvin",),
}  # fmt: skip
"""Faults and the fields of `CopySpread` that make them."""

Pressed = tuple[PicturedPress, Pose, float]


def drawn(design: PalmSpec, rng: np.random.Generator, spread: CopySpread) -> PalmSpec:
    """A copy; what its rim does, which the readers know, is no difference between copies."""
    return replace(drawn_palm(design, rng, spread), rim=design.rim)


def pressed(spec: PalmSpec, rng: np.random.Generator, force_n: tuple[float, float] = FORCE_N) -> Pressed:
    """A picture, the place and depth it is of, and the true force."""
    away, turn = WITHIN * spec.radius_m * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    x_m, y_m = float(away * np.cos(turn)), float(away * np.sin(turn))
    contact = press_to_force(spec, float(rng.uniform(*force_n)), x_m, y_m)
    untouched = press(spec, Pose(x_m, y_m, -1e-3))
    image, reference = (render(one, spec, rng, exact=True).image for one in (contact, untouched))
    told = contact.force_n * float(np.exp(FORCE_SHARE * rng.standard_normal()))
    return PicturedPress(image, reference, told, FORCE_SHARE, (x_m, y_m)), contact.pose, contact.force_n


def knowing(design: PalmSpec, copy: PalmSpec, modulus: bool) -> PalmCopy:
    """What is known of a copy whose C was measured, and E as well if asked."""
    known, shares = replace(design, stress_optic=copy.stress_optic), {"coefficient_share": CONSTANT_SHARE}
    if modulus:
        known = replace(known, youngs_modulus_pa=copy.youngs_modulus_pa)
        shares["modulus_share"] = CONSTANT_SHARE
    return designed_copy(known, **shares)


def read_by(known: PalmCopy, new: Sequence[Pressed], into: Tally, case: str) -> None:
    """Read new presses: errors of force [share and N], place and depth [mm]."""
    for one, pose, force_n in new:
        found = into.attempted(case, read_press, known, one.image, one.reference)
        if found is None:
            continue
        off = float(np.log(found.force_n / force_n))
        into.interval(f"{case}; force, per cent", 100 * off, 100 * found.force_share)
        into.add(f"{case}; force, N", found.force_n - force_n, True)
        for name in ("x_m", "y_m", "depth_m"):
            miss = 1e3 * (getattr(found, name) - getattr(pose, name))
            what = "depth" if name == "depth_m" else "place"
            into.interval(f"{case}; {what}, mm", miss, 1e3 * getattr(found, name.replace("_m", "_sd_m")))


def each_fault(design: PalmSpec, asked: argparse.Namespace, into: Tally) -> Iterator[str]:
    """Readings that know E and C, of the same copies with one fault at a time."""
    for k in range(asked.copies):
        for name, fields in ONE_BY_ONE.items():
            spread = replace(CopySpread(), **{field: getattr(IMPERFECT, field) for field in fields})
            copy = drawn(design, np.random.default_rng([asked.seed, k]), spread)
            new = [pressed(copy, np.random.default_rng([asked.seed, k, i])) for i in range(asked.new)]
            read_by(knowing(design, copy, modulus=True), new, into, name)
            yield name


def study(design: PalmSpec, asked: argparse.Namespace, into: Tally) -> Iterator[int]:
    """Constants of every copy, and new presses by what is known of it."""
    believed = designed_copy(design)
    if asked.control:  # its terms are all that presses differ by
        believed = designed_copy(design, local_spreads=dict.fromkeys(LOCAL[3:], 1e-6))
    spread = IMPERFECT if asked.law == "imperfect" else CopySpread()
    for k in range(asked.copies):
        rng = np.random.default_rng([asked.seed, k])
        copy = drawn(design, rng, spread)
        told, new = ([pressed(copy, rng) for _ in range(n)] for n in (asked.presses, asked.new))
        pictures = [one for one, _, _ in told]
        if not asked.fitted:
            read_by(knowing(design, copy, modulus=True), new, into, "E and C known")
            read_by(knowing(design, copy, modulus=False), new, into, "C known, E not")
            read_by(believed, new, into, "neither known")
            if (fit := into.attempted("one known force", fit_copy, believed, pictures[:1])) is not None:
                read_by(fit.copy, new, into, "one known force")
        by = f"{asked.presses} known forces"
        if (fit := into.attempted(by, fit_copy, believed, pictures)) is not None:
            fitted = replace(fit.copy, widening=AS_SAID) if asked.control else fit.copy
            C = copy.stress_optic.coefficient_per_pa
            E_off = 100 * math.log(fitted.modulus_pa / copy.youngs_modulus_pa)
            C_off = 100 * math.log(fitted.coefficient_per_pa / C)
            into.interval(f"{by}; E, per cent", E_off, 100 * fitted.modulus_share)
            into.interval(f"{by}; C, per cent", C_off, 100 * fitted.coefficient_share)
            read_by(fitted, new, into, by)
        yield k


def changed(copy: PalmSpec, modulus: int, coefficient: int) -> PalmSpec:
    """The same copy, its E and C so many times 15 % more."""
    law, E = copy.stress_optic, copy.youngs_modulus_pa * math.exp(CHANGED * modulus)
    C = law.coefficient_per_pa * math.exp(CHANGED * coefficient)
    return replace(copy, youngs_modulus_pa=E, stress_optic=replace(law, coefficient_per_pa=C))


def weighed(design: PalmSpec, asked: argparse.Namespace, into: Tally) -> Iterator[int]:
    """What known weights say of copies with every fault: how far E and C are off, what is rightly named."""
    for k in range(asked.copies):
        rng = np.random.default_rng([asked.seed, k])
        copy = drawn(design, rng, IMPERFECT)
        fitted = fit_copy(designed_copy(design), [pressed(copy, rng)[0] for _ in range(asked.presses)]).copy
        for name, by in [("nothing changed", (0, 0))] * asked.new + list(CHANGES.items()):
            one, _, force_n = pressed(changed(copy, *by), rng, WEIGHT_N)
            check, _ = check_weight(fitted, one.image, one.reference, force_n / GRAVITY_M_S2)
            for of, true in zip(("modulus", "coefficient"), by, strict=True):
                off = 100 * (math.log1p(getattr(check, f"{of}_change")) - CHANGED * true)
                into.add(f"{name}; {of}, per cent", off, (of in check.drifted) == bool(true))
        yield k


LAWS = {"plain": study, "imperfect": study, "each": each_fault, "weigh": weighed}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--new", type=int, default=3, help="presses that are read")
    parser.add_argument("--fitted", action="store_true", help="read by the copy that was fitted alone")
    parser.add_argument("--control", action="store_true", help="by a model that is taken for exact")
    parser.add_argument("--smaller", type=int, default=14, help="times smaller than the full frame")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--law", choices=list(LAWS), default="plain")
    asked = parser.parse_args()
    design, tally = scaled_down(palm(), asked.smaller, f"a {asked.smaller}th"), Tally()
    tally.follow(LAWS[asked.law](design, asked, tally))


if __name__ == "__main__":
    main()
