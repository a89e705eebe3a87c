"""Verbs of one palm's own constants: modulus, stress-optic coefficient, lamp, polariser and mirror."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import print_record, progress_bar

if TYPE_CHECKING:
    from palpate.sensors.palm.copies.palm_copy import CopyFit, PalmCopy

UnitFile = Annotated[Path, Option("--with", help="File of the unit, as `palpate calibrate` made it.")]
Picture = Annotated[Path, Argument(help="Picture of the ball pressed in.")]
Untouched = Annotated[Path, Option(help="Picture of the untouched skin, before it.")]
COVERED = 1.645  # standard deviations of a 90 % interval


def fit(
    run: Annotated[Path, Argument(help="Run of presses with known forces, by the palm's ball.")],
    out: Annotated[Path, Option(help="File of the copy to make; must not exist.")],
    preset: Annotated[str, Option(help="Design of the palm: palm, small, demo, debug or crops.")] = "palm",
    presses: Annotated[int, Option(help="How many frames are taken, spread over force; 5 to 10.")] = 8,
    force_share: Annotated[float, Option(help="Standard deviation of a force, as a share.")] = 0.01,
    friction: Annotated[float, Option(help="Between ball and skin: 0 or 0.5.")] = 0.0,
) -> None:
    """Find a palm's modulus, stress-optic coefficient, lamp and mirror.

    Takes 5 to 40 seconds a press, by the frames' size, of presses within 0.7 radii of the middle.

    Example: palpate calibrate --method palm-unit runs/weights --preset demo --out mine.json
    """
    from palpate.core import refuse_existing
    from palpate.sensors.palm.copies.copy_estimate import unsure_constants
    from palpate.sensors.palm.copies.palm_copy_fit import (
        MAX_REACH,
        design_for,
        fit_copy,
        pictured_presses,
        preset_ball,
        preset_radius_m,
        write_copy,
    )

    refuse_existing(out)
    with progress_bar() as tell:
        within_m, ball = MAX_REACH * preset_radius_m(preset), preset_ball(preset)
        pictured = pictured_presses(run, presses, force_share, within_m, ball)
        known = design_for(preset, pictured[0].image.shape[:2], friction)
        found = fit_copy(known, pictured, tell)
        unsure = unsure_constants(found.copy, tell)
    write_copy(found.copy, preset, out)
    answer = _copy_answer(found) | {"unsure": [one._asdict() for one in unsure], "copy": str(out)}
    print_record(answer)


def known(
    reference: Annotated[Path, Argument(help="Picture of the untouched skin; its size is the frames'.")],
    out: Annotated[Path, Option(help="File of the copy to make; must not exist.")],
    coefficient_per_pa: Annotated[
        float, Option("--coefficient-per-Pa", help="Stress-optic coefficient C, as `fit-c` has it [1/Pa].")
    ],
    coefficient_share: Annotated[float, Option(help="Standard deviation of C, as a share.")] = 0.02,
    modulus_share: Annotated[float, Option(help="The same of the preset's E, which is not known.")] = 0.25,
    preset: Annotated[str, Option(help="Design of the palm: palm, small, demo, debug or crops.")] = "palm",
    friction: Annotated[float, Option(help="Between ball and skin: 0 or 0.5.")] = 0.0,
) -> None:
    """Make a copy of a design whose stress-optic coefficient was measured.

    Its pictures tell force whatever the modulus is: geometry has the depth, fringes have E C.

    Example: palpate calibrate --method palm-known rest.png --coefficient-per-Pa 3.5e-9 --out mine.json
    """
    from palpate.core import refuse_existing
    from palpate.sensors.palm.copies.palm_copy import measured_copy
    from palpate.sensors.palm.copies.palm_copy_fit import design_for, read_picture, write_copy

    refuse_existing(out)
    design = design_for(preset, read_picture(reference).shape[:2], friction).spec
    copy = measured_copy(design, coefficient_per_pa, coefficient_share, modulus_share)
    write_copy(copy, preset, out)
    answer: dict[str, Any] = {
        "modulus_Pa": copy.modulus_pa, "modulus_share": COVERED * copy.modulus_share,
        "coefficient_per_Pa": copy.coefficient_per_pa,
        "coefficient_share": COVERED * copy.coefficient_share, "coverage": 0.9, "copy": str(out),
    }  # fmt: skip
    print_record(answer)


def read(image: Picture, reference: Untouched, copy: UnitFile) -> None:
    """Read force, place and depth of a picture by a copy's constants.

    Example: palpate read press.png --with mine.json --reference rest.png --json
    """
    from palpate.sensors.palm.copies.palm_copy_fit import drift_of, read_copy, read_picture, read_press

    known = read_copy(copy)
    rest = read_picture(reference)
    with progress_bar():
        found = read_press(known, read_picture(image), rest)
    drift = drift_of(known, rest)
    force = [found.force_n * math.exp(side * COVERED * found.force_share) for side in (-1, 1)]
    answer: dict[str, Any] = {
        "force_N": found.force_n, "force_low_N": force[0], "force_high_N": force[1],
        "x_mm": 1e3 * found.x_m, "y_mm": 1e3 * found.y_m, "depth_mm": 1e3 * found.depth_m,
        "x_half_mm": 1e3 * COVERED * found.x_sd_m, "y_half_mm": 1e3 * COVERED * found.y_sd_m,
        "depth_half_mm": 1e3 * COVERED * found.depth_sd_m, "coverage": 0.9, "off_of_white": found.off,
        "misfit": found.misfit, "valid": True, "code": "", "drift": drift.to_dict(),
    }  # fmt: skip
    print_record(answer)


def weigh(
    image: Picture,
    reference: Untouched,
    copy: UnitFile,
    mass_g: Annotated[float, Option(help="Mass of all that rests on the skin, the ball as well [g].")],
    later: Annotated[
        Path | None, Option(help="Picture of the same weight some seconds later: one that rolled is refused.")
    ] = None,
) -> None:
    """Check a copy by a known weight, laid on the skin on the palm's ball.

    It sees a change of modulus or stress-optic coefficient, which an untouched frame cannot show.

    Example: palpate check-weight w.png --with mine.json --reference rest.png --mass-g 200 --later w2.png
    """
    from palpate.sensors.palm.copies.palm_copy_fit import (
        check_weight,
        read_copy,
        read_picture,
        refuse_rolling,
    )

    known, laid, rest = read_copy(copy), read_picture(image), read_picture(reference)
    with progress_bar() as tell:
        check, found = check_weight(known, laid, rest, 1e-3 * mass_g, tell)
        if later is not None:
            refuse_rolling(found, laid, read_picture(later), rest, tell)
    answer: dict[str, Any] = {
        "weight_N": check.force_n, "read_N": check.read_n,
        "modulus_change": check.modulus_change, "modulus_deviations": check.modulus_deviations,
        "coefficient_change": check.coefficient_change,
        "coefficient_deviations": check.coefficient_deviations, "drifted": list(check.drifted),
    }  # fmt: skip
    print_record(answer)


def _copy_answer(found: CopyFit) -> dict[str, Any]:
    copy: PalmCopy = found.copy
    return {
        "modulus_Pa": copy.modulus_pa, "modulus_share": COVERED * copy.modulus_share,
        "coefficient_per_Pa": copy.coefficient_per_pa,
        "coefficient_share": COVERED * copy.coefficient_share, "coverage": 0.9,
        "terms": copy.told, "widening": copy.widening._asdict(), "untold": list(found.untold),
        "presses": len(found.presses),
        "off_of_white": max(one.off for one in found.presses),
    }  # fmt: skip
