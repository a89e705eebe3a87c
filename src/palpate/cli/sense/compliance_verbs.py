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
    progress_bar,
)
from palpate.core import refuse_existing

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
    print_found(record, _text(record))


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
    names = ", ".join(
        f"{one['specimen']} ({_reference(one)}, {one['trials']} trials)" for one in record["references"]
    )
    between = record["error_between_references"]
    lines = [
        f"{out}: {record['calibration']}, {record['pins']} pins, on {names}",
        "each inner reference, read from the others: "
        + ("none is between two references" if between is None else f"off by up to {100 * between:.1f} %"),
        _area_error(record["area_known"], record["area_error"]),
        "intervals contain, as standard deviations: " + _sizes(record["nuisances"]),
    ]
    if record["shape_known"]:
        off = record["errors_between_shapes"]
        lines.insert(
            3,
            "E* and 1/R, each reference between others read from these: off by up to "
            f"{100 * off['modulus']:.0f} % and {1e-3 * off['curvature_per_m']:.2g} per mm",
        )
    if camera is not None:
        lines.append(f"frames late by {record['latency_ms']:.3g} ms: taken off")
    print_found(record, "\n".join(lines))


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
    print_found(record, _latency(record))


def _latency(record: dict[str, Any]) -> str:
    lines = [
        f"{name}: {one['latency_ms']:.3g} ms ({one['low_ms']:.3g} to {one['high_ms']:.3g}), force rises by "
        f"{one['force_rate_N_per_s']:.3g} N/s"
        for name, one in record["presses"].items()
    ]
    lines += [f"{name}: not used: {why}" for name, why in record["not_used"].items()]
    lines.append(
        f"frames late by {record['latency_ms']:.3g} ms ({record['low_ms']:.3g} to {record['high_ms']:.3g}, "
        f"95 %), by {len(record['presses'])} presses; of one press to "
        f"{record['standard_uncertainty_ms']:.2g} ms (standard uncertainty)"
    )
    if "speeds" in record:
        speeds = record["speeds"]
        lines.append(f"slow presses {speeds['slow_ms']:.3g} ms, fast ones {speeds['fast_ms']:.3g} ms")
    lines += [f"flag: {flag}" for flag in record["flags"]]
    if not record["valid"]:
        lines.append(f"NOT VALID: {record['why']}")
    return "\n".join(lines + ([f"latency: {record['out']}"] if "out" in record else []))


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
    low, high = record["low_N_per_mm"], record["high_N_per_mm"]
    ends = ", of one trial" if low is None else f" ({low:.3g} to {high:.3g}, 95 %)"
    lines = [
        f"{one['table']}: {one['stiffness_N_per_mm']:.3g} N/mm, adjusted R2 {one['adjusted_r2']:.3g}"
        for one in record["trials"]
    ]
    lines += [f"flag: {flag}" for flag in record["flags"]]
    lines.append(f"stiffness {record['stiffness_N_per_mm']:.3g} N/mm{ends}")
    if low is not None:
        lines.append("interval: Student's over trials, with " + _sizes(record["contained"]))
    print_found(record, "\n".join(lines))


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
    print_found(record, _compared(record))


def _area_error(known: bool, error: float | None) -> str:
    if not known:
        return "contact area: fewer than two references have a known one"
    if error is None:
        return "contact area: calibrated; two references cannot tell how well"
    return f"contact area: to {100 * error:.1f} %, of trials left out"


def _sizes(nuisances: dict[str, float]) -> str:
    return ", ".join(f"{name} {size:g}" for name, size in nuisances.items())


def _reference(one: dict[str, Any]) -> str:
    """What a reference is."""
    if one["radius_mm"] is None:
        return _stiff(one["stiffness_N_per_mm"])
    modulus = one["reduced_modulus_MPa"]
    body = "rigid" if modulus is None else f"E* {modulus:.3g} MPa"
    return f"sphere of {one['radius_mm']:.3g} mm, {body}"


def _stiff(stiffness_n_per_mm: float | None) -> str:
    return "rigid" if stiffness_n_per_mm is None else f"{stiffness_n_per_mm:.3g} N/mm"


NAMES = {
    "stiffness": "stiffness, by touch",
    "stiffness_both_cues": "stiffness, both cues",
    "area_at_4_N": "contact area at 4 N",
    "spread_rate": "spread rate dA/dF",
    "modulus": "modulus E*",
    "radius": "radius R",
}
SYMBOLS = {"N_per_mm": "N/mm", "mm2": "mm²", "mm2_per_N": "mm²/N"}


def _text(record: dict[str, Any]) -> str:
    readings = record["readings"]
    common = _common([one["why"].split("; ") for one in readings])
    lines = [_reading(one, common) for one in readings]
    series = record.get("series_stiffness")
    if series:
        lines.append(
            f"{'tip and specimen':22}{series['value_N_per_mm']:9.3g} N/mm    in series, by force and position"
        )
    if "untouched_area_mm2" in record:
        lines.append(
            f"{'untouched pins, A_c0':22}{record['untouched_area_mm2']:9.4g} mm²     through the lens"
        )
    lines += [f"flag: {flag}" for flag in dict.fromkeys([*common, *record["flags"]])]
    if readings:
        drift = readings[0]["drift"]
        lines.append(f"drift {drift['statistic']:.2g} (stale above {drift['limit']:g})")
    if "nuisances" in record:
        lines.append("intervals contain, as standard deviations: " + _sizes(record["nuisances"]))
    if readings:
        lines.append(f"calibration {readings[0]['calibration']}")
    if "out" in record:
        lines.append(f"picture and readings: {record['out']}")
    return "\n".join(lines)


def _common(reasons: list[list[str]]) -> list[str]:
    """Those that every reading has: said once."""
    return [why for why in reasons[0] if why and all(why in each for each in reasons)] if reasons else []


def _reading(one: dict[str, Any], common: list[str]) -> str:
    ends = _ends(one["low"], one["high"])
    value = "inf" if one["value"] is None else f"{one['value']:.3g}"
    own = "; ".join(why for why in one["why"].split("; ") if why not in common)
    verdict = "valid" if one["valid"] else f"NOT VALID: {own}" if own else "NOT VALID, see flag"
    unit = SYMBOLS.get(one["unit"], one["unit"])
    return f"{NAMES[one['quantity']]:22}{value:>9} {unit:7} ({ends}, 90 %)  {verdict}"


def _ends(low: float | None, high: float | None) -> str:
    return " to ".join("inf" if x is None else f"{x:.3g}" for x in (low, high))


def _compared(record: dict[str, Any]) -> str:
    lines = []
    for cue, one in record["cues"].items():
        means = ", ".join(
            f"{name} {mean:.3g} ({_ends(*one['interval_95'][name])})" for name, mean in one["mean"].items()
        )
        missing = [name for name in record["trials"] if name not in one["mean"]]
        worst = max(one["pairs"], key=lambda pair: pair["rank_sum_p"])
        test = f"Kruskal-Wallis p {one['kruskal_p']:.2g} ({one['kruskal_p_all_cues']:.2g} for all cues)"
        least = f"least apart {worst['first']}, {worst['second']}: rank-sum p {worst['rank_sum_p']:.2g}"
        lines += [
            f"{cue}: {means}" + (f"; no two valid readings: {', '.join(missing)}" if missing else ""),
            f"    {test}; {least}",
            *_mixed(one.get("mixed_model")),
        ]
    if record["references"]:
        lines.append(f"{', '.join(record['references'])}: references of this calibration, read by it")
    if "groups" in record:
        lines.append(f"mixed models: {record['groups']['model']}; all pairs: differences.csv")
    warnings = [*record.get("pooled_sums", {}).get("warnings", ()), record.get("groups", {}).get("warning")]
    lines += [f"warning: {warning}" for warning in warnings if warning]
    lines.append(f"means with Student's 95 % intervals over trials; all tests and picture: {record['out']}")
    return "\n".join(lines)


def _mixed(model: dict[str, Any] | None) -> list[str]:
    """What a mixed model says of one cue."""
    if model is None:
        return []
    if "why_not" in model:
        return [f"    no mixed model: {model['why_not']}"]
    if not model["converged"]:
        return [f"    no mixed model: {note}" for note in model["notes"]]
    means = ", ".join(f"{name} {_estimated(one)}" for name, one in model["means"].items())
    least = max(model["pairs"], key=lambda pair: pair["difference"]["p"])
    told = least["difference"]
    units = ", ".join(f"{count} of {level}" for level, count in model["units"].items())
    p = f"{told['p']:.2g} ({told['p_all_cues']:.2g} for all pairs of all cues)"
    return [
        f"    mixed model, {units}: {means}",
        f"    least apart {least['second']} - {least['first']}: {_estimated(told)}, p {p}",
        *(f"    note: {note}" for note in model["notes"]),
    ]


def _estimated(one: dict[str, Any]) -> str:
    return f"{one['value']:.3g} ({_ends(one['low'], one['high'])}, {one['freedom']:.3g} df)"
