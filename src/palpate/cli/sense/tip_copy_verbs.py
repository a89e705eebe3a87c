"""Verbs of one TacTip's stiffness, from presses of known force on a rigid plate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import print_found, progress_bar

if TYPE_CHECKING:
    from palpate.sensors.tactip.tip_copies import PlatePress, TipCopy, TipCopyFit

UnitFile = Annotated[Path, Option("--with", help="File of the unit, as `palpate calibrate` made it.")]
Loaded = Annotated[Path, Argument(help="Frame of the tip on a flat rigid plate.")]
RestFrame = Annotated[Path, Option("--reference", help="Frame of the untouched tip, before it.")]
COVERED = 1.645  # standard deviations of a 90 % interval


def calibrate(
    runs: Annotated[list[Path], Argument(help="Presses on a rigid plate: folders of presses, or runs.")],
    out: Annotated[Path, Option(help="File of the copy to make; must not exist.")],
    preset: Annotated[str, Option(help="Design of the TacTip: 127, 331 or 331-fitted.")] = "127",
    presses: Annotated[int, Option(help="How many frames are taken, spread over force; 5 to 10.")] = 10,
    force_share: Annotated[float, Option(help="Standard deviation of a force, as a share.")] = 0.005,
    force_sd_n: Annotated[float, Option(help="The same in newtons, added [N].")] = 0.03,
) -> None:
    """Find a tip's own constants from presses of known force.

    Stiffness, ratio of skin and gel, pins, camera and seat.

    Takes frames of a folder that has specimens.csv (those on a rigid plate), of a run of one press, or of a
    run on a rig.

    Example: palpate calibrate --method tip-unit presses --out mine.json
    """
    from palpate.core import refuse_existing
    from palpate.sensors.tactip.tactip_sensor import tactip
    from palpate.sensors.tactip.tip_copies import designed_tip, fit_tip_copy, known_presses
    from palpate.sensors.tactip.tip_copies.tip_copy_store import write_tip_copy

    refuse_existing(out)
    design = designed_tip(tactip(preset).spec)
    with progress_bar() as tell:
        known = known_presses(
            runs, presses, design.spec.pins.count, force_share=force_share, force_sd_n=force_sd_n
        )
        found = fit_tip_copy(design, known, tell)
    write_tip_copy(found.copy, preset, out)
    answer = _copy_answer(found) | {"copy": str(out)}
    print_found(answer, _copy_text(answer))


def force(image: Loaded, reference: RestFrame, copy: UnitFile) -> None:
    """Read force and depth on a flat rigid plate by a copy's constants.

    Example: palpate read frame.png --with mine.json --reference rest.png
    """
    from palpate.sensors.tactip.tip_copies import read_plate_press
    from palpate.sensors.tactip.tip_copies.tip_copy_store import load_tip_copy

    known = load_tip_copy(copy)
    with progress_bar() as tell:
        found = read_plate_press(known, _press(known, image, reference), tell)
    low, high = (found.force_n * (1 + side * COVERED * found.force_share) for side in (-1, 1))
    half = COVERED * found.depth_sd_mm
    answer: dict[str, Any] = {
        "force_N": found.force_n, "force_low_N": low, "force_high_N": high, "depth_mm": found.depth_mm,
        "depth_half_mm": half, "coverage": 0.9, "off_px": found.off_px, "motion_px": found.motion_px,
    }  # fmt: skip
    text = (
        f"{found.force_n:.3f} N ({low:.3f} to {high:.3f}), {found.depth_mm:.3f} ± {half:.3f} mm deep; 90 % "
        "intervals, for a flat rigid plate and as far as this model of the tip is right"
    )
    print_found(answer, text)


def weigh(
    images: Annotated[list[Path], Argument(help="Frame of the weight at rest; several have to agree.")],
    reference: RestFrame,
    copy: UnitFile,
    mass_g: Annotated[float, Option(help="Mass of all that rests on the tip [g].")],
) -> None:
    """Check a copy by a flat rigid object of known mass.

    It sees a change of stiffness, which an untouched frame cannot show.

    Example: palpate check-weight w.png --with mine.json --reference rest.png --mass-g 200
    """
    from palpate.sensors.tactip.tip_copies.tip_copy_store import load_tip_copy
    from palpate.sensors.tactip.tip_copies.tip_weight import check_tip_weight

    known = load_tip_copy(copy)
    with progress_bar() as tell:
        pressed = [_press(known, image, reference) for image in images]
        check = check_tip_weight(known, pressed, 1e-3 * mass_g, tell)
    answer: dict[str, Any] = {
        "weight_N": check.force_n, "read_N": check.read_n, "depth_mm": check.depth_mm,
        "stiffness_change": check.stiffness_change, "stiffness_deviations": check.stiffness_deviations,
        "ratio_change": check.ratio_change, "ratio_deviations": check.ratio_deviations,
        "least_change": check.least_change, "drifted": list(check.drifted),
    }  # fmt: skip
    said = f"changed: {', '.join(check.drifted)}; calibrate anew" if check.drifted else "as calibrated"
    text = (
        f"weight {check.force_n:.3f} N, read {check.read_n:.3f} N at {check.depth_mm:.2f} mm\n"
        f"  stiffness {check.stiffness_change:+.1%} ({check.stiffness_deviations:+.1f} standard deviations; "
        f"from {check.least_change:.1%} it is said), ratio of skin and gel {check.ratio_change:+.0%} "
        f"({check.ratio_deviations:+.1f})\n"
        f"{said}"
    )
    print_found(answer, text)


def _press(known: TipCopy, image: Path, reference: Path) -> PlatePress:
    from palpate.sensors.tactip.taps.tap_pins import read_image
    from palpate.sensors.tactip.tip_copies import PlatePress, pins_between

    return PlatePress(*pins_between(read_image(reference), read_image(image), known.spec.pins.count))


def _copy_answer(found: TipCopyFit) -> dict[str, Any]:
    copy = found.copy
    skin_pa, gel_pa = copy.moduli_pa
    terms = {name: one | {"half": COVERED * one["standard_deviation"]} for name, one in copy.told.items()}
    return {
        "force_at_3_mm_N": copy.stated_force_n, "stiffness_share": COVERED * copy.stiffness_share,
        "skin_Pa": skin_pa, "gel_Pa": gel_pa, "coverage": 0.9, "terms": terms, "untold": list(found.untold),
        "tied": [list(pair) for pair in copy.tied],
        "zeros": [
            {"approach": z.approach, "zero_mm": z.zero_mm, "half_mm": COVERED * z.sd_mm} for z in found.zeros
        ],
        "helpful": [
            {"press": one.press, "force_N": one.force_n, "term": one.term, "spread_ratio": one.ratio}
            for one in found.helpful
        ],
        "presses": len(found.presses), "off_px": max(one.off_px for one in found.presses),
        "forces_off_deviations": found.forces_off,
    }  # fmt: skip


def _copy_text(answer: dict[str, Any]) -> str:
    head = (
        f"{answer['force_at_3_mm_N']:.3f} N at 3 mm ± {answer['stiffness_share']:.1%} (90 %), from "
        f"{answer['presses']} presses; skin {answer['skin_Pa'] / 1e3:.0f} kPa and gel "
        f"{answer['gel_Pa'] / 1e3:.1f} kPa, if dome and skin are as thick as the tables'"
    )
    off = (
        f"  pins differ from the copy's by {answer['off_px']:.2f} px at most, forces by "
        f"{answer['forces_off_deviations']:.1f} standard deviations (rms)"
    )
    lines = [
        head,
        off,
        *(f"  {name:11}{one['value']:+10.4f} ± {one['half']:.2g}" for name, one in answer["terms"].items()),
        *(
            f"  approach {one['approach']}: apex at {one['zero_mm']:.3f} ± {one['half_mm']:.2g} mm"
            for one in answer["zeros"]
        ),
    ]
    if answer["untold"]:
        lines.append(f"  not told by these presses: {', '.join(answer['untold'])}")
    lines += [f"  not told apart: {first}, {second}" for first, second in answer["tied"]]
    lines += [
        f"  would help: {one['press']} ({one['term']} to {one['spread_ratio']:.0%} of its spread)"
        + ("" if one["force_N"] is None else f" at {one['force_N']:.2g} N")
        for one in answer["helpful"]
    ]
    return "\n".join([*lines, f"copy: {answer['copy']}"])
