"""The verb that imports one press: frames in a TIFF or a video, force in a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.shared import Json, Quiet, print_found, progress_bar, reports_errors

Frames = Annotated[Path, typer.Argument(help="The frames of one press.")]
Made = Annotated[Path, typer.Argument(help="Run to make; must not exist.")]
Force = Annotated[Path, typer.Option(help="CSV or Parquet: samples of force and the frame each is of.")]
ForceColumn = Annotated[str | None, typer.Option(help="Its column of force, if not a usual name.")]
PositionColumn = Annotated[str | None, typer.Option(help="Its column of position, if not a usual name.")]
Rate = Annotated[float | None, typer.Option(help="Rate of its rows [Hz], if it has no time_s.")]
Sensor = Annotated[str, typer.Option(help="What was recorded.")]
Licence = Annotated[str, typer.Option(help="Licence of the data.")]
Origin = Annotated[str, typer.Option(help="Where the data come from.")]


TIFF = """Import a press from a multi-page TIFF and its table of force.

Example: palpate import tiff PRESS.tif RUN --force force.csv
"""
VIDEO = """Import a press from a video and its table of force.

Example: palpate import video press.avi RUN --force force.csv --rate-hz 30
"""


@reports_errors
def press(
    frames: Frames,
    run: Made,
    force: Force,
    force_column: ForceColumn = None,
    position_column: PositionColumn = None,
    rate_hz: Rate = None,
    sensor: Sensor = "",
    licence: Licence = "",
    origin: Origin = "",
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Import a press; the two kinds of frames differ only in what their help says."""
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
            progress=lambda done, total: progress("importing", done, total),
        )
    found = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    print_found(found, f"{run}: {report.frames} frames with {', '.join(report.columns)}", json_)
