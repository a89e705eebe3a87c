"""Verbs on recordings: import, check, repair, export."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

import palpate
from palpate.cli.verb_support import (
    ForceColumn,
    ForceRate,
    ForceTable,
    NewRun,
    PositionColumn,
    ProvenanceName,
    given_provenance,
    names_of,
    pairs_of,
    print_found,
    progress_bar,
    typed_again,
)

if TYPE_CHECKING:
    from palpate.recordings import ImportReport


Sensor = Annotated[str, Option(help="What was recorded.")]
License = Annotated[str, Option(help="License of the data.")]
Origin = Annotated[str, Option(help="Where the data come from.")]
Unlabelled = Annotated[bool, Option("--allow-unlabelled", help="Skip images without a row.")]


def palm(
    folder: Annotated[Path, Argument(help="Folder of the dataset.")],
    run: NewRun,
    sensor: Sensor = "palm",
    licence: License = "",
    origin: Origin = "",
    provenance: ProvenanceName = None,
    allow_unlabelled: Unlabelled = False,
) -> None:
    """Import the photoelastic palm's own tables and photographs.

    Tables are Cycle_Indent5mm_r{row}c{col}_{cycle}.csv.

    Example: palpate import palm dataset run --licence CC-BY-4.0
    """
    from palpate.sensors.palm.palm_import import import_palm

    with progress_bar() as progress:
        report = import_palm(
            folder,
            run,
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=given_provenance(provenance),
            allow_unlabelled=allow_unlabelled,
            progress=partial(progress, "importing"),
        )
    _print_import(run, report)


def press(
    frames: Annotated[Path, Argument(help="TIFF, video, or folder of the frames of one press.")],
    run: NewRun,
    force: ForceTable,
    force_column: ForceColumn = None,
    position_column: PositionColumn = None,
    rate_hz: ForceRate = None,
    sensor: Sensor = "",
    licence: License = "",
    origin: Origin = "",
    provenance: ProvenanceName = None,
) -> None:
    """Import the frames of one press, of a TIFF or a video, with its table of force.

    Example: palpate import press PRESS.tif RUN --force force.csv

    Example: palpate import press press.avi RUN --force force.csv --rate-hz 30
    """
    from palpate.recordings.exchange.image_import import import_press

    with progress_bar() as progress:
        report = import_press(
            frames,
            run,
            force=force,
            force_column=force_column,
            position_column=position_column,
            rate_hz=rate_hz,
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=given_provenance(provenance),
            progress=partial(progress, "importing"),
        )
    result = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    print_found(result, f"{run}: {report.frames} frames with {', '.join(report.columns)}")


def images(
    folder: Annotated[Path, Argument(help="Folder of labelled images.")],
    run: NewRun,
    labels: Annotated[
        Path | None,
        Option(
            help="CSV, TSV, JSON, NumPy or Parquet, one row an image; here or in the folder. In "
            "quotes, '*/labels.csv' takes a table a session, '*.json' a file an image."
        ),
    ] = None,
    image_column: Annotated[
        str | None, Option(help="Label column that names the image, if not a usual name.")
    ] = None,
    rename: Annotated[list[str] | None, Option(help="OLD=NEW name of a column, as in Fz=force_N.")] = None,
    unit: Annotated[
        list[str] | None, Option(help="COLUMN=UNIT of a column that has none, as in depth=mm.")
    ] = None,
    columns: Annotated[
        str, Option(help="Names of the columns of a file without a header, x_mm,force_N.")
    ] = "",
    decimal: Annotated[
        str, Option(help="What stands before decimals: auto (default), point or comma.")
    ] = "auto",
    name_pattern: Annotated[
        str | None, Option(help="Labels in the images' names, as in 'x{x_mm}_f{force_N}.png'.")
    ] = None,
    in_order: Annotated[
        bool, Option("--in-order", help="Row i belongs to image i, counted by the numbers in their names.")
    ] = False,
    sensor: Sensor = "",
    licence: License = "",
    origin: Origin = "",
    provenance: ProvenanceName = None,
    rate_hz: Annotated[float | None, Option(help="Frame rate, if the images are a sequence [Hz].")] = None,
    order_by: Annotated[
        str | None, Option(help="Column of numbers that says in which order the images were taken.")
    ] = None,
    allow_unlabelled: Unlabelled = False,
    strict: Annotated[bool, Option("--strict", help="Refuse columns of numbers that carry no unit.")] = False,
) -> None:
    """Import a folder of labelled images.

    Example: palpate import images taps run --labels labels.csv --rename Fz=force_N --unit depth=mm
    """
    from palpate.core import InputError
    from palpate.recordings.exchange.label_files import mending_options

    if decimal not in ("auto", "point", "comma"):
        raise InputError(f"--decimal {decimal!r} is none of auto, point and comma")
    with progress_bar() as progress:
        report = palpate.import_images(
            folder,
            run,
            labels=labels,
            image_column=image_column,
            name_pattern=name_pattern,
            columns=names_of(columns),
            decimal=decimal,  # type: ignore[arg-type]
            in_order=in_order,
            rename=pairs_of(rename or [], "--rename"),
            units=pairs_of(unit or [], "--unit"),
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=given_provenance(provenance),
            rate_hz=rate_hz,
            order_by=order_by,
            allow_unlabelled=allow_unlabelled,
            strict=strict,
            progress=partial(progress, "importing"),
        )
    if report.no_targets:
        given = {
            "--labels": labels,
            "--image-column": image_column,
            "--rename": rename,
            "--unit": [*(unit or []), *mending_options(report.no_targets)],
            "--columns": columns,
            "--decimal": decimal if decimal != "auto" else None,
            "--name-pattern": name_pattern,
            "--in-order": in_order,
            "--sensor": sensor,
            "--licence": licence,
            "--origin": origin,
            "--provenance": provenance,
            "--rate-hz": rate_hz,
            "--order-by": order_by,
            "--allow-unlabelled": allow_unlabelled,
        }
        typer.echo(
            f"palpate: no unit in {', '.join(report.no_targets)}: these cannot be targets; if one shall be, "
            "import "
            "again, with the unit that it is in: "
            f"{typed_again('import images', [folder, f'{run}-with-units'], given)}",
            err=True,
        )
    for doubt in report.doubts:
        typer.echo(f"palpate: {doubt}", err=True)
    _print_import(run, report)


def _print_import(run: Path, report: ImportReport) -> None:
    units = ", ".join(f"{column} [{symbol}]" for column, symbol in report.units.items())
    text = f"{run}: {report.frames} frames; columns with a unit: {units or 'none'}"
    if report.unitless:
        text += f"; without: {', '.join(report.unitless)}"
    result = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    more = {"unitless": list(report.unitless), "doubts": list(report.doubts)}
    print_found(result | more, text)


def check(
    run: Annotated[Path, Argument(help="Run to look through; it is only read.")],
    repair: Annotated[
        Path | None, Option(help="Run to make of all that can be read; must not exist.")
    ] = None,
) -> None:
    """Look through a run: counts, rates, gaps, drops, damage. Ends with status 1 if it is damaged.

    Also counts frames without the record of their labels, and records without a frame, as a kill leaves them.
    With --repair, all that can be read of a damaged run is copied into a new one instead.

    Example: palpate check run

    Example: palpate check run --repair run-repaired
    """
    from palpate.recordings import check as look_through
    from palpate.reports.terminal_text import check_text

    if repair is not None:
        _repair(run, repair)
        return
    report = look_through(run)
    print_found(report.to_dict(), check_text(report))
    if not report.sound:
        raise typer.Exit(1)


def _repair(run: Path, new: Path) -> None:
    from palpate.recordings import repair as copy_readable

    report = copy_readable(run, new)
    lost = [f"{d.file} at byte {d.at_byte}: {d.what}" for d in report.lost]
    text = f"{new}: {report.frames} frames, {report.messages} messages kept; " + (
        "; ".join(lost) or "nothing lost"
    )
    print_found({"run": str(new), "frames": report.frames, "messages": report.messages, "lost": lost}, text)


def export(
    run: Annotated[Path, Argument(help="Run to export.")],
    folder: Annotated[Path, Argument(help="Folder to make; must not exist.")],
) -> None:
    """Export a run as PNG images and CSV tables.

    Example: palpate export run folder
    """
    from palpate.recordings.exchange.press_export import export_folder

    with progress_bar() as progress:
        count = export_folder(palpate.Run.open(run), folder, partial(progress, "exporting"))
    print_found({"folder": str(folder), "frames": count}, f"{folder}: {count} frames")
