"""Verbs of one TacTip's own constants, from taps of known pose; those of known force are `tip_copy_verbs`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import print_found, progress_bar


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
    from palpate.reports.tip_fit_figure import TipPicture, write_tip_files
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
    print_found(record, _text(record))


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
        print_found(record, _judged_text(record))
        return
    with progress_bar() as progress:
        rows = read_images(reader, layout, taps, progress)
    print_found({"coverage": 0.9, "readings": rows}, "\n".join(map(_reading_text, rows)))


def _judged_text(record: dict[str, Any]) -> str:
    lines = [f"{record['all']['taps']} taps read, {record['taps_left_out']} whose pins could not be named"]
    for name in ("all", "valid"):
        if not (part := record[name])["taps"]:
            continue
        lines.append(f"{name}: {part['taps']} taps")
        errors, held = part["mean_absolute_error"], part["held_by_90_percent"]
        lines += [
            f"  {what:14}{error:8.3g} off in the mean; 90 % intervals hold {held[what]:.0%} of the labels"
            for what, error in errors.items()
        ]
    return "\n".join(lines)


def _reading_text(row: dict[str, Any]) -> str:
    if row["pose"] is None:
        return f"{row['image']}: not valid: {row['why']}"
    said = ", ".join(
        f"{name} {value:.3g} ± {row['half_width'][name]:.2g}" for name, value in row["pose"].items()
    )
    return f"{row['image']}: {said}" + ("" if row["valid"] else f"; not valid: {row['why']}")


def _text(record: dict[str, Any]) -> str:
    registered, lost = record["taps_registered"], record["taps_left_out"]
    lines = [f"{registered[0]} and {registered[1]} taps registered, {lost[0]} and {lost[1]} left out"]
    lines.append(f"fitted to {record['taps_fitted']}")
    lines += [
        f"  {name:20}{one['value']:9.3f}   ({one['low']:.3f} to {one['high']:.3f}, 90 %)"
        for name, one in record["terms"].items()
    ]
    if record["untold"]:
        lines.append(f"not told by these taps: {', '.join(record['untold'])}")
    lines += [f"not told apart: {first}, {second}" for first, second in record["tied"]]
    lines.append(
        f"on the other taps pins are {record['residual_px']:.2f} px off, of {record['motion_px']:.1f} px of "
        f"motion; the floor is {record['floor_px']:.2f} px ({record['floor']}); "
        f"with its learnt error the tip is {record['residual_with_learnt_error_px']:.2f} px off"
    )
    lines.append(f"poses of the other taps, read after {record['taps_fitted']} taps:")
    lines.append(_judged_text(record["reading"] | {"taps_left_out": lost[1]}))
    lines.append(f"picture and numbers: {record['out']}")
    return "\n".join(lines)
