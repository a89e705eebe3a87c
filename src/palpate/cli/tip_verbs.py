"""Verbs of one TacTip's own constants, from taps of known pose."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import Json, Quiet, group, print_found, progress_bar

app = group("Fit a virtual TacTip to taps of a real one.")


@app.command()
def fit(
    taps: Annotated[Path, Argument(help="Folder of taps to fit to: labels.csv and images.")],
    judge: Annotated[Path, Option(help="Folder of other taps of the same sensor, to judge by.")],
    out: Annotated[Path, Option(help="Folder to make: tip.json, tip.png.")],
    pins: Annotated[int, Option(help="How many pins the tip has.")] = 331,
    count: Annotated[int, Option(help="How many taps are fitted to.")] = 400,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find lever, camera, lens and grip of a tip from taps of known pose.

    Images are binarised, pins bright; labels.csv has image_file, depth_mm, tilt_x_deg, tilt_y_deg,
    shear_x_mm, shear_y_mm and twist_deg. Some three minutes for 400 taps.

    Example: palpate tip fit taps/train --judge taps/val --out tip
    """
    from palpate.core import refuse_existing
    from palpate.reports.tip_fit_figure import TipPicture, write_tip_files
    from palpate.sensors.tactip.taps import fit_folder
    from palpate.sensors.tactip.taps.tap_folder import tip_record, upright_places

    refuse_existing(out)
    with progress_bar(quiet) as progress:
        found, judged, registered = fit_folder(taps, judge, pins=pins, taps=count, progress=progress)
    record = tip_record(found, judged, registered)
    left = {"motion": judged.motion_px, "twin": judged.residual_px, "smooth": judged.floor_px}
    shown = upright_places(found, registered[0])
    write_tip_files(out, record, TipPicture(found.tip.rest_px, *shown, judged.by_pin_px, left))
    record["out"] = str(out)
    print_found(record, _text(record), json_)


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
        f"motion; the floor is {record['floor_px']:.2f} px ({record['floor']})"
    )
    lines.append(f"picture and numbers: {record['out']}")
    return "\n".join(lines)
