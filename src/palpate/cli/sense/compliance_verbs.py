"""The verbs of compliance by touch: read a press, calibrate on references, compare, and the plate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from palpate.cli.verb_support import (
    ForceColumn,
    ForceRate,
    ForceTable,
    PositionColumn,
    print_found,
    print_record,
    progress_bar,
    record_text,
)
from palpate.core import refuse_existing

SHOWN = ("series_stiffness", "untouched_area_mm2", "contact_shape", "flags", "nuisances", "out")
"""What is shown of a press beside its readings."""
Calibration = Annotated[
    Path | None, Option("--with", help="Calibration (.npz) of this sensor; without, only relative numbers.")
]


LatencyFile = Annotated[
    Path | None, Option("--latency", help="Camera's latency, by `compliance latency --out`: taken off.")
]


def read(
    press: Annotated[Path, Argument(help="Frames of one press: multi-page TIFF, video, folder or run.")],
    force: ForceTable,
    calibration: Calibration = None,
    out: Annotated[Path | None, Option(help="Folder to make: press.png, readings.json.")] = None,
    force_column: ForceColumn = None,
    position_column: PositionColumn = None,
    rate_hz: ForceRate = None,
    lens: Annotated[Path | None, Option(help="Lens file of the camera: adds A_c0 in mm².")] = None,
    latency_file: LatencyFile = None,
) -> None:
    """Read one press: stiffness, contact area, spread rate and E*.

    Each comes with its interval and its flags.

    Example: palpate read PRESS.tif --with tip.npz --force force.csv --out press
    """
    from palpate.calibration.compliance import CameraLatency, press_record, read_press
    from palpate.calibration.compliance.press_cues import UNITS

    refuse_existing(out)
    cues, touch = read_press(
        press, force, calibration=calibration,
        force_column=force_column, position_column=position_column, rate_hz=rate_hz,
        latency=None if latency_file is None else CameraLatency.load(latency_file),
    )  # fmt: skip
    record = press_record(cues, touch)
    if lens is not None:
        record["untouched_area_mm2"] = _untouched_area_mm2(lens, cues)
    if out is not None:
        from palpate.reports.compliance_figures import write_press_readings

        write_press_readings(out, record, cues, touch)
        record["out"] = str(out)
    readings = [
        f"{'' if one.valid else 'NOT VALID: '}{one.in_unit(UNITS[one.quantity])}"
        for one in (touch.readings if touch else ())
    ]
    shown = {name: record[name] for name in SHOWN if name in record}
    if record["readings"]:
        shown |= {name: record["readings"][0][name] for name in ("calibration", "drift")}
    print_found(record, "\n".join([*readings, record_text(shown)]))


def _untouched_area_mm2(lens: Path, cues: Any) -> float:
    """A_c0 of a press's pins through a lens, on the dome of the preset with as many rings of pins."""
    from palpate.core import Lens
    from palpate.estimators.lattice.ring_layout import ring_of
    from palpate.sensors.tactip import tactip, untouched_area_m2

    press = cues.trial.press
    rings = int(ring_of(press.cells).max()) if press.cells is not None else 0
    spec = tactip(3 * rings * (rings + 1) + 1)
    return 1e6 * untouched_area_m2(spec, press.untouched_px, press.cells, Lens.read(lens))


def calibrate(
    folder: Annotated[Path, Argument(help="Folder of references: specimens.csv, SPECIMEN/01.tif, 01.csv.")],
    out: Annotated[Path, Option(help="Calibration to make, an .npz; must not exist.")],
    tilt_deg: Annotated[float, Option(help="Tilt of the specimens' tops [deg].")] = 0.0,
    note: Annotated[str, Option(help="Free words to keep with it.")] = "",
    nuisance: Annotated[
        list[str] | None, Option(help="NAME=SIZE of what later presses may differ by, e.g. lever=0; repeat.")
    ] = None,
    latency_file: LatencyFile = None,
) -> None:
    """Calibrate a tip on a rigid plate and known specimens.

    Example: palpate calibrate --method compliance references --out tip.npz
    """
    from palpate.calibration.compliance import CameraLatency, calibrate_folder

    camera = None if latency_file is None else CameraLatency.load(latency_file)
    with progress_bar() as progress:
        record = calibrate_folder(
            folder, out, tilt_deg=tilt_deg, note=note, nuisances=nuisance or [],
            latency=None if camera is None else (camera.seconds, camera.sd_s), progress=progress,
        )  # fmt: skip
    print_record(record)


def latency(
    press: Annotated[
        list[Path], Argument(help="Frames of presses there and back, each table beside; or folders of them.")
    ],
    force: Annotated[
        Path | None, Option(help="Table of the one press, where its name is not that of the frames.")
    ] = None,
    out: Annotated[Path | None, Option(help="JSON to make, for --latency of the other verbs.")] = None,
    force_column: ForceColumn = None,
) -> None:
    """Measure by how much the camera's frames are late, from presses.

    A press must come back within its record: late frames show more motion on the way up than on the way down
    at the same force. Above 0, a frame shows an earlier moment than its row says.

    Example: palpate compliance latency presses/S1/01.tif presses/S1/02.tif --out latency.json
    """
    from palpate.calibration.compliance import measure_latency

    with progress_bar() as progress:
        record = measure_latency(press, out, force=force, force_column=force_column, progress=progress)
    print_record(record)


def plate(
    tables: Annotated[list[Path], Argument(help="Tables of force and position, one a trial.")],
    force_column: Annotated[str | None, Option(help="Column of force, if not a usual name.")] = None,
    position_column: Annotated[str | None, Option(help="Column of position, if not a usual name.")] = None,
    rate_hz: Annotated[float | None, Option(help="Rate of the rows [Hz], if without time_s.")] = None,
    nuisance: Annotated[
        list[str] | None,
        Option(help="NAME=SIZE: force_gain=0.02, frame_yield_mm_per_N=0.02; repeat. What trials share."),
    ] = None,
) -> None:
    """Measure a specimen's own stiffness by a rigid plate.

    It is what specimens.csv asks for.

    Example: palpate compliance plate S1-plate-1.csv S1-plate-2.csv S1-plate-3.csv
    """
    from palpate.calibration.compliance import plate_stiffness
    from palpate.calibration.compliance.press_nuisances import Nuisances

    record = plate_stiffness(
        tables,
        force_column=force_column,
        position_column=position_column,
        rate_hz=rate_hz,
        nuisances=Nuisances.named(nuisance or []),
    )
    print_record(record)


def compare(
    folder: Annotated[Path, Argument(help="Folder of an experiment: SPECIMEN/01.tif with 01.csv.")],
    out: Annotated[Path, Option(help="Folder to make: trials.csv, comparison.json, comparison.png.")],
    calibration: Calibration = None,
    pooled: Annotated[bool, Option(help="Also test pooled samples as the report did; warns of it.")] = False,
    group: Annotated[
        list[str] | None,
        Option(help="Column of trials.csv that trials share, e.g. session; a second one is nested in it."),
    ] = None,
    latency_file: LatencyFile = None,
) -> None:
    """Compare several specimens, a value a trial.

    Gives means, rank tests and box plots; with --group also a linear mixed model of every cue.

    Example: palpate compliance compare experiment --with tip.npz --out compared
    """
    from palpate.calibration.compliance import CameraLatency, compare_specimens
    from palpate.reports.compliance_figures import write_comparison

    refuse_existing(out)
    camera = None if latency_file is None else CameraLatency.load(latency_file)
    with progress_bar() as progress:
        comparison = compare_specimens(
            folder,
            calibration=calibration,
            pooled=pooled,
            groups=group or [],
            latency=camera,
            progress=progress,
        )
        write_comparison(out, comparison)
    record = comparison.record | {"out": str(out)}
    print_found(record, record_text(_without_pairs(record)))


def _without_pairs(record: dict[str, Any]) -> dict[str, Any]:
    """All but comparisons of two specimens, which the files list: ten of each cue."""
    return {
        name: _without_pairs(one) if isinstance(one, dict) else one
        for name, one in record.items()
        if name != "pairs"
    }
