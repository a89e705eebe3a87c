"""The verb that imports the photoelastic palm's own recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.shared import Json, Quiet, print_found, progress_bar, reports_errors


@reports_errors
def palm(
    folder: Annotated[
        Path, typer.Argument(help="Folder of Cycle_Indent5mm_r{row}c{col}_{cycle}.csv tables.")
    ],
    run: Annotated[Path, typer.Argument(help="Run to make; must not exist.")],
    sensor: Annotated[str, typer.Option(help="What was recorded.")] = "palm",
    licence: Annotated[str, typer.Option(help="Licence of the data.")] = "",
    origin: Annotated[str, typer.Option(help="Where the data come from.")] = "",
    allow_unlabelled: Annotated[bool, typer.Option(help="Skip photographs that no table names.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Import the photoelastic palm's own tables and photographs as a run.

    Example: palpate import palm dataset run --licence CC-BY-4.0
    """
    from palpate.sensors.palm.palm_import import import_palm

    with progress_bar(quiet) as progress:
        report = import_palm(
            folder,
            run,
            sensor=sensor,
            licence=licence,
            origin=origin,
            allow_unlabelled=allow_unlabelled,
            progress=lambda done, total: progress("importing", done, total),
        )
    units = ", ".join(f"{column} [{symbol}]" for column, symbol in report.units.items())
    text = f"{run}: {report.frames} frames; columns with a unit: {units}"
    found = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    print_found(found | {"unitless": list(report.unitless)}, text, json_)
