"""Verbs on recordings: import, check, repair, export."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

import palpate
from palpate.cli.verb_support import (
    ForceColumn,
    Json,
    NewRun,
    PositionColumn,
    ProvenanceName,
    Quiet,
    arguments_for,
    given_provenance,
    names_of,
    pairs_of,
    print_found,
    progress_bar,
    typed_again,
)

if TYPE_CHECKING:
    from palpate.recordings import ImportReport


def palm(
    folder: Path,
    run: Path,
    json_: bool,
    quiet: bool,
    sensor: str = "palm",
    licence: str = "",
    origin: str = "",
    provenance: str | None = None,
    allow_unlabelled: bool = False,
) -> None:
    """Import the photoelastic palm's own tables and photographs."""
    from palpate.sensors.palm.palm_import import import_palm

    with progress_bar(quiet) as progress:
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
    _print_import(run, report, json_)


def press(
    frames: Path,
    run: Path,
    json_: bool,
    quiet: bool,
    force: Path,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    provenance: str | None = None,
) -> None:
    """Import the frames of one press, of a TIFF or a video, with its table of force."""
    from palpate.recordings.exchange.press_import import import_press

    with progress_bar(quiet) as progress:
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
    print_found(result, f"{run}: {report.frames} frames with {', '.join(report.columns)}", json_)


def images(
    folder: Path,
    run: Path,
    json_: bool,
    quiet: bool,
    labels: Path | None = None,
    image_column: str | None = None,
    rename: list[str] | None = None,
    unit: list[str] | None = None,
    columns: str = "",
    decimal: str = "auto",
    name_pattern: str | None = None,
    in_order: bool = False,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    provenance: str | None = None,
    rate_hz: float | None = None,
    order_by: str | None = None,
    allow_unlabelled: bool = False,
    strict: bool = False,
) -> None:
    """Import a folder of labelled images."""
    from palpate.core import InputError
    from palpate.recordings.exchange.label_units import mending_options

    if decimal not in ("auto", "point", "comma"):
        raise InputError(f"--decimal {decimal!r} is none of auto, point and comma")
    with progress_bar(quiet) as progress:
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
    _print_import(run, report, json_)


def _print_import(run: Path, report: ImportReport, json_: bool) -> None:
    units = ", ".join(f"{column} [{symbol}]" for column, symbol in report.units.items())
    text = f"{run}: {report.frames} frames; columns with a unit: {units or 'none'}"
    if report.unitless:
        text += f"; without: {', '.join(report.unitless)}"
    result = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    more = {"unitless": list(report.unitless), "doubts": list(report.doubts)}
    print_found(result | more, text, json_)


FORMATS: dict[str, Callable[..., None]] = {"images": images, "palm": palm, "tiff": press, "video": press}


def import_run(
    kind: Annotated[str, Argument(help="images, palm, tiff, or video.", metavar="FORMAT")],
    source: Annotated[
        Path, Argument(help="Folder of images, dataset of the palm, or the TIFF or video of one press.")
    ],
    run: NewRun,
    labels: Annotated[
        Path | None,
        Option(
            help="images: CSV, TSV, JSON, NumPy or Parquet, one row an image; here or in the folder. In "
            "quotes, '*/labels.csv' takes a table a session, '*.json' a file an image."
        ),
    ] = None,
    image_column: Annotated[
        str | None, Option(help="images: label column that names the image, if not a usual name.")
    ] = None,
    rename: Annotated[
        list[str] | None, Option(help="images: OLD=NEW name of a column, as in Fz=force_N.")
    ] = None,
    unit: Annotated[
        list[str] | None, Option(help="images: COLUMN=UNIT of a column that has none, as in depth=mm.")
    ] = None,
    columns: Annotated[
        str | None, Option(help="images: names of the columns of a file without a header, x_mm,force_N.")
    ] = None,
    decimal: Annotated[
        str | None, Option(help="images: what stands before decimals: auto (default), point or comma.")
    ] = None,
    name_pattern: Annotated[
        str | None, Option(help="images: labels in the images' names, as in 'x{x_mm}_f{force_N}.png'.")
    ] = None,
    in_order: Annotated[
        bool,
        Option("--in-order", help="images: row i belongs to image i, counted by the numbers in their names."),
    ] = False,
    force: Annotated[
        Path | None,
        Option(help="tiff, video: CSV or Parquet of samples of force and the frame each is of."),
    ] = None,
    force_column: ForceColumn = None,
    position_column: PositionColumn = None,
    rate_hz: Annotated[
        float | None,
        Option(help="Frame rate, if images are a sequence; else rate of the force's rows without time_s."),
    ] = None,
    order_by: Annotated[
        str | None,
        Option(help="images: column of numbers that says in which order the images were taken."),
    ] = None,
    sensor: Annotated[str | None, Option(help="What was recorded.")] = None,
    licence: Annotated[str | None, Option(help="Licence of the data.")] = None,
    origin: Annotated[str | None, Option(help="Where the data come from.")] = None,
    provenance: ProvenanceName = None,
    allow_unlabelled: Annotated[bool, Option(help="images, palm: skip images without a row.")] = False,
    strict: Annotated[
        bool, Option("--strict", help="images: refuse columns of numbers that carry no unit.")
    ] = False,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Bring a recording from elsewhere into a run.

    images: a folder of labelled images. palm: the photoelastic palm's own tables and photographs
    (Cycle_Indent5mm_r{row}c{col}_{cycle}.csv). tiff, video: the frames of one press and its table of force.

    Example: palpate import images taps run --labels labels.csv --rename Fz=force_N --unit depth=mm

    Example: palpate import palm dataset run --licence CC-BY-4.0

    Example: palpate import tiff PRESS.tif RUN --force force.csv

    Example: palpate import video press.avi RUN --force force.csv --rate-hz 30
    """
    options = dict(locals())
    for argument in ("kind", "source", "run", "json_", "quiet"):
        del options[argument]
    from palpate.core import InputError

    if kind not in FORMATS:
        raise InputError(f"format {kind!r} is not known; the formats are {', '.join(FORMATS)}")
    importer = partial(FORMATS[kind], source, run, json_, quiet)
    importer(**arguments_for(importer, f"import {kind}", options))


def check(run: Annotated[Path, Argument(help="Run to look through.")], json_: Json = False) -> None:
    """Look through a run: counts, rates, gaps, drops, damage. Ends with status 1 if it is damaged.

    Also counts frames without the record of their labels, and records without a frame, as a kill leaves them.

    Example: palpate check run
    """
    from palpate.recordings import check as look_through
    from palpate.reports.terminal_text import check_text

    report = look_through(run)
    print_found(report.to_dict(), check_text(report), json_)
    if not report.sound:
        raise typer.Exit(1)


def repair(
    run: Annotated[Path, Argument(help="Damaged run; it is only read.")],
    new: Annotated[Path, Argument(help="Run to make of what can be read; must not exist.")],
    json_: Json = False,
) -> None:
    """Copy all that can be read of a damaged run into a new one.

    Example: palpate repair run run-repaired
    """
    from palpate.recordings import repair as copy_readable

    report = copy_readable(run, new)
    lost = [f"{d.file} at byte {d.at_byte}: {d.what}" for d in report.lost]
    text = f"{new}: {report.frames} frames, {report.messages} messages kept; " + (
        "; ".join(lost) or "nothing lost"
    )
    print_found(
        {"run": str(new), "frames": report.frames, "messages": report.messages, "lost": lost}, text, json_
    )


def export(
    run: Annotated[Path, Argument(help="Run to export.")],
    folder: Annotated[Path, Argument(help="Folder to make; must not exist.")],
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Export a run as PNG images and CSV tables.

    Example: palpate export run folder
    """
    from palpate.recordings.exchange.folder_export import export_folder

    with progress_bar(quiet) as progress:
        count = export_folder(palpate.Run.open(run), folder, partial(progress, "exporting"))
    print_found({"folder": str(folder), "frames": count}, f"{folder}: {count} frames", json_)
