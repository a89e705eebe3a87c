"""Verbs of one TacTip's own constants, from taps of known pose; those of known force are `tip_copy_verbs`.

Verbs of one TacTip's stiffness, from presses of known force on a rigid plate.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import print_found, print_record, progress_bar

if TYPE_CHECKING:
    from palpate.sensors.tactip.tip_copies import PlatePress, TipCopy, TipCopyFit


def fit(
    taps: Annotated[Path, Argument(help="Folder of taps to fit to: labels.csv and images.")],
    judge: Annotated[Path, Option(help="Folder of other taps of the same sensor, to judge by.")],
    out: Annotated[Path, Option(help="Folder to make: tip.json, reader.json, tip.png.")],
    preset: Annotated[str, Option(help="Number of the tip's pins: 127 or 331.")] = "331",
    presses: Annotated[int, Option(help="How many taps are fitted to.")] = 400,
) -> None:
    """Find a tip's lever, camera and grip from taps of known pose.

    Images are binarised, pins bright; labels.csv has image_file, depth_mm, tilt_x_deg, tilt_y_deg,
    shear_x_mm, shear_y_mm and twist_deg. A tip then reads poses: `palpate read`. Some eight minutes for
    2,000 taps of which 400 are fitted to.

    Example: palpate calibrate --method tip-pose taps/train --judge taps/val --out tip
    """
    from palpate.core import refuse_existing
    from palpate.reports.compliance_figures import TipPicture, write_tip_files
    from palpate.sensors.tactip.tactip_sensor import tactip
    from palpate.sensors.tactip.taps import fit_folder, reader_record
    from palpate.sensors.tactip.taps.tap_folder import tip_record, upright_places

    refuse_existing(out)
    with progress_bar() as progress:
        found = fit_folder(taps, judge, pins=tactip(preset).spec.pins.count, taps=presses, progress=progress)
    record, judged = tip_record(found), found.judged
    left = {"motion": judged.motion_px, "twin": judged.residual_px, "smooth": judged.floor_px}
    left["learnt"] = found.learnt_px
    shown = upright_places(found.fit, found.known)
    picture = TipPicture(found.fit.tip.rest_px, *shown, judged.by_pin_px, left)
    write_tip_files(out, record, reader_record(found.reader, found.known.layout), picture)
    record["out"] = str(out)
    print_record(record)


def read(
    taps: Annotated[list[Path], Argument(help="Images of taps, binarised; or one folder of labelled taps.")],
    tip: Annotated[Path, Option("--with", help="Folder of a fitted tip, as `palpate calibrate` made it.")],
) -> None:
    """Read the poses of taps with 90 % intervals, by a fitted tip.

    Of a folder with labels.csv, as the calibration takes it, it says how far readings are from the labels and
    how many intervals hold them.

    Example: palpate read tap_1.png tap_2.png --with tip
    """
    from palpate.sensors.tactip.taps import load_reader, read_images, register_taps
    from palpate.sensors.tactip.taps.tap_folder import reading_record

    reader, layout = load_reader(tip)
    if len(taps) == 1 and taps[0].is_dir():
        with progress_bar() as progress:
            labelled = register_taps(taps, len(layout.cells), progress, layout)[0]
            read = reader.read(labelled.places_px)
        record = reading_record(read, labelled.poses, len(reader.error.known))
        record["taps_left_out"] = labelled.lost
        print_record(record)
        return
    with progress_bar() as progress:
        rows = read_images(reader, layout, taps, progress)
    print_found({"coverage": 0.9, "readings": rows}, "\n".join(map(_reading_text, rows)))


def _reading_text(row: dict[str, Any]) -> str:
    if row["pose"] is None:
        return f"{row['image']}: not valid: {row['why']}"
    said = ", ".join(
        f"{name} {value:.3g} ± {row['half_width'][name]:.2g}" for name, value in row["pose"].items()
    )
    return f"{row['image']}: {said}" + ("" if row["valid"] else f"; not valid: {row['why']}")


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
    from palpate.sensors.tactip.tip_copies.tip_copy import write_tip_copy

    refuse_existing(out)
    design = designed_tip(tactip(preset).spec)
    with progress_bar() as tell:
        known = known_presses(
            runs, presses, design.spec.pins.count, force_share=force_share, force_sd_n=force_sd_n
        )
        found = fit_tip_copy(design, known, tell)
    write_tip_copy(found.copy, preset, out)
    answer = _copy_answer(found) | {"copy": str(out)}
    print_record(answer)


def force(image: Loaded, reference: RestFrame, copy: UnitFile) -> None:
    """Read force and depth on a flat rigid plate by a copy's constants.

    Example: palpate read frame.png --with mine.json --reference rest.png
    """
    from palpate.sensors.tactip.tip_copies import read_plate_press
    from palpate.sensors.tactip.tip_copies.tip_copy import load_tip_copy

    known = load_tip_copy(copy)
    with progress_bar() as tell:
        found = read_plate_press(known, _press(known, image, reference), tell)
    low, high = (found.force_n * (1 + side * COVERED * found.force_share) for side in (-1, 1))
    half = COVERED * found.depth_sd_mm
    answer: dict[str, Any] = {
        "force_N": found.force_n, "force_low_N": low, "force_high_N": high, "depth_mm": found.depth_mm,
        "depth_half_mm": half, "coverage": 0.9, "off_px": found.off_px, "motion_px": found.motion_px,
    }  # fmt: skip
    print_record(answer)


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
    from palpate.sensors.tactip.tip_copies.tip_copy import load_tip_copy
    from palpate.sensors.tactip.tip_copies.tip_copy_fit import check_tip_weight

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
    print_record(answer)


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
