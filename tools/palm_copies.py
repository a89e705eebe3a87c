"""Draw copies of a palm, fit each to presses of known force, and count how often intervals hold the truth.

    python tools/palm_copies.py                  # eight copies, twenty minutes of one core
    python tools/palm_copies.py --copies 3 --presses 8
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
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from palpate.core import ImageError, Pose
from palpate.estimators.unit_fit import GRAVITY_M_S2
from palpate.sensors.palm.copies.palm_copy import AS_SAID, LOCAL, PalmCopy, PicturedPress, designed_copy
from palpate.sensors.palm.copies.palm_copy_fit import check_weight, fit_copy, read_press
from palpate.sensors.palm.palm_press import press, press_to_force
from palpate.sensors.palm.palm_render import render
from palpate.sensors.palm.palm_spec import PalmSpec, palm, scaled_down
from palpate.sensors.palm.palm_variation import IMPERFECT, CopySpread, drawn_palm

FORCE_N = (1.0, 8.0)
WITHIN = 0.6  # of the membrane's radius
FORCE_SHARE = 0.005  # to which forces are known
CONSTANT_SHARE = 0.005  # to which C is, where it is said to be known
NEW = 3  # presses that are read
NORMAL = 1.645

ONE_BY_ONE: dict[str, tuple[str, ...]] = {
    "none": (),
    "thickness": ("thickness_share",),
    "dirt and texture": ("specks", "texture"),
    "turned regions": ("turn_rad",),
    "glare": ("spots", "glare"),
    "residual map": ("residual",),
    "own exposure": ("stops",),
    "uneven thickness": ("gel_thickness",),
    "uneven modulus": ("gel_modulus",),
    "residual, uniform": ("frozen",),
    "temperature": ("kelvin",),
}
"""Faults and the fields of `CopySpread` that make them."""

Errors = dict[str, list[tuple[float, bool]]]


def pressed(
    spec: PalmSpec, rng: np.random.Generator, force_n: tuple[float, float] = FORCE_N
) -> tuple[PicturedPress, Pose, float]:
    """A picture, the place and depth it is of, and the true force."""
    away, turn = WITHIN * spec.radius_m * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    x_m, y_m = float(away * np.cos(turn)), float(away * np.sin(turn))
    contact = press_to_force(spec, float(rng.uniform(*force_n)), x_m, y_m)
    untouched = press(spec, Pose(x_m, y_m, -1e-3))
    image, reference = (render(one, spec, rng, exact=True).image for one in (contact, untouched))
    told = contact.force_n * float(np.exp(FORCE_SHARE * rng.standard_normal()))
    return PicturedPress(image, reference, told, FORCE_SHARE, (x_m, y_m)), contact.pose, contact.force_n


def knowing(design: PalmSpec, copy: PalmSpec) -> PalmCopy:
    """What is known of a copy whose C was measured."""
    law = copy.stress_optic
    return designed_copy(replace(design, stress_optic=law), coefficient_share=CONSTANT_SHARE)


def knowing_both(design: PalmSpec, copy: PalmSpec) -> PalmCopy:
    """What is known of a copy whose E and C were measured."""
    known = replace(design, stress_optic=copy.stress_optic, youngs_modulus_pa=copy.youngs_modulus_pa)
    return designed_copy(known, coefficient_share=CONSTANT_SHARE, modulus_share=CONSTANT_SHARE)


def each_fault(design: PalmSpec, copies: int, new_presses: int, seed: int) -> Iterator[dict[str, Errors]]:
    """Errors of readings that know E and C, of the same copies with one fault at a time."""
    for k in range(copies):
        for name, fields in ONE_BY_ONE.items():
            rng = np.random.default_rng([seed, k])
            spread = replace(CopySpread(), **{field: getattr(IMPERFECT, field) for field in fields})
            copy = replace(drawn_palm(design, rng, spread), rim=design.rim)
            new = [pressed(copy, np.random.default_rng([seed, k, i])) for i in range(new_presses)]
            errors: dict[str, Errors] = defaultdict(lambda: defaultdict(list))
            read_by(knowing_both(design, copy), new, errors[name])
            yield errors


def read_by(known: PalmCopy, new: list[tuple[PicturedPress, Pose, float]], into: Errors) -> None:
    """Read new presses: errors of force [share and N], place and depth [mm], and whether intervals hold."""
    for one, pose, force_n in new:
        try:
            found = read_press(known, one.image, one.reference)
        except ImageError:
            into["refused"].append((1.0, True))
            continue
        off = float(np.log(found.force_n / force_n))
        into["force, per cent"].append((100 * off, abs(off) <= NORMAL * found.force_share))
        into["force, N"].append((found.force_n - force_n, abs(off) <= NORMAL * found.force_share))
        for name in ("x_m", "y_m", "depth_m"):
            miss = getattr(found, name) - getattr(pose, name)
            held = abs(miss) <= NORMAL * getattr(found, name.replace("_m", "_sd_m"))
            into["depth, mm" if name == "depth_m" else "place, mm"].append((1e3 * miss, held))


def believing(design: PalmSpec, control: bool) -> PalmCopy:
    """What is known of a copy beforehand; for the control, that its terms are all that presses differ by."""
    return (
        designed_copy(design, local_spreads=dict.fromkeys(LOCAL[3:], 1e-6))
        if control
        else designed_copy(design)
    )


def study(design: PalmSpec, asked: argparse.Namespace, spread: CopySpread) -> Iterator[dict[str, Errors]]:
    """Errors of every copy: of its constants, and of new presses by what is known of it."""
    presses = asked.presses
    for k in range(asked.copies):
        rng = np.random.default_rng([asked.seed, k])
        # As the design, which the readers know: what the rim does is no difference between copies.
        copy = replace(drawn_palm(design, rng, spread), rim=design.rim)
        told, new = ([pressed(copy, rng) for _ in range(n)] for n in (presses, asked.new))
        errors: dict[str, Errors] = defaultdict(lambda: defaultdict(list))
        designed, one = believing(design, asked.control), [told[0][0]]
        if not asked.fitted:
            read_by(knowing_both(design, copy), new, errors["new presses, E and C known"])
            read_by(knowing(design, copy), new, errors["new presses, C known, E not"])
            read_by(designed, new, errors["new presses, neither known"])
        try:
            fitted = fit_copy(designed, [press for press, _, _ in told]).copy
        except ImageError:
            errors[f"constants by {presses} presses"]["refused"].append((1.0, True))
            yield errors
            continue
        if asked.control:
            fitted = replace(fitted, widening=AS_SAID)
        for name, value, truth, share in (
            ("E, per cent", fitted.modulus_pa, copy.youngs_modulus_pa, fitted.modulus_share),
            (
                "C, per cent",
                fitted.coefficient_per_pa,
                copy.stress_optic.coefficient_per_pa,
                fitted.coefficient_share,
            ),
        ):
            off = float(np.log(value / truth))
            errors[f"constants by {presses} presses"][name].append((100 * off, abs(off) <= NORMAL * share))
        read_by(fitted, new, errors[f"new presses, by {presses} presses"])
        if asked.fitted:
            yield errors
            continue
        try:
            read_by(fit_copy(designed, one).copy, new, errors["new presses, by one known force"])
        except ImageError:
            errors["new presses, by one known force"]["refused"].append((1.0, True))
        yield errors


CHANGED = math.log(1.15)
CHANGES = {"E + 15 %": (1, 0), "E - 15 %": (-1, 0), "C + 15 %": (0, 1), "C - 15 %": (0, -1)}
WEIGHT_N = (1.5, 5.0)


def changed(copy: PalmSpec, modulus: int, coefficient: int) -> PalmSpec:
    """The same copy, its E and C so many times 15 % more."""
    law, E = copy.stress_optic, copy.youngs_modulus_pa * math.exp(CHANGED * modulus)
    C = law.coefficient_per_pa * math.exp(CHANGED * coefficient)
    return replace(copy, youngs_modulus_pa=E, stress_optic=replace(law, coefficient_per_pa=C))


def weighed(design: PalmSpec, asked: argparse.Namespace) -> Iterator[dict[str, Errors]]:
    """What known weights say of copies with every fault: by how much E and C are off, and what is named."""
    for k in range(asked.copies):
        rng = np.random.default_rng([asked.seed, k])
        copy = replace(drawn_palm(design, rng, IMPERFECT), rim=design.rim)
        fitted = fit_copy(designed_copy(design), [pressed(copy, rng)[0] for _ in range(asked.presses)]).copy
        errors: dict[str, Errors] = defaultdict(lambda: defaultdict(list))
        for name, by in [("nothing changed", (0, 0))] * asked.new + list(CHANGES.items()):
            one, _, force_n = pressed(changed(copy, *by), rng, WEIGHT_N)
            check, _ = check_weight(fitted, one.image, one.reference, force_n / GRAVITY_M_S2)
            for of, found, true in zip(
                ("modulus", "coefficient"), (check.modulus_change, check.coefficient_change), by, strict=True
            ):
                off = 100 * (math.log1p(found) - CHANGED * true)
                errors[name][f"{of}, per cent"].append((off, (of in check.drifted) == bool(true)))
        yield errors


def told(every: dict[str, Errors], holding: str) -> Iterator[str]:
    """A line for each quantity."""
    for case, quantities in every.items():
        for name, results in quantities.items():
            off = np.abs([error for error, _ in results])
            held = np.mean([inside for _, inside in results])
            yield (
                f"{case}; {name}: mean {off.mean():.3g}, greatest {off.max():.3g}, {holding} "
                f"{100 * held:.0f} % of {len(results)}"
            )


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--new", type=int, default=NEW, help="presses that are read")
    parser.add_argument("--fitted", action="store_true", help="read by the copy that was fitted alone")
    parser.add_argument("--control", action="store_true", help="by a model that is taken for exact")
    parser.add_argument("--smaller", type=int, default=14, help="times smaller than the full frame")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--law", choices=("plain", "imperfect", "each", "weigh"), default="plain")
    asked = parser.parse_args()
    design = scaled_down(palm(), asked.smaller, f"a {asked.smaller}th")
    every: dict[str, Errors] = defaultdict(lambda: defaultdict(list))
    start = time.monotonic()
    spread = IMPERFECT if asked.law == "imperfect" else CopySpread()
    if asked.law == "each":
        found = each_fault(design, asked.copies, asked.new, asked.seed)
    else:
        found = weighed(design, asked) if asked.law == "weigh" else study(design, asked, spread)
    holding = "rightly named or not" if asked.law == "weigh" else "90 % intervals hold"
    for k, errors in enumerate(found):
        for case, quantities in errors.items():
            for name, results in quantities.items():
                every[case][name] += results
        print(
            f"\n{k + 1} {'faults' if asked.law == 'each' else 'copies'}, {time.monotonic() - start:.0f} s",
            *told(every, holding),
            sep="\n",
            flush=True,
        )


if __name__ == "__main__":
    main()
