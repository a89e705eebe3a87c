"""The verbs. Each says what it needs, calls one room, and prints what came back."""

from __future__ import annotations

from typing import Annotated

import typer

from palpate.cli import (
    calibration,
    compliance,
    import_palm,
    import_press,
    mechanics,
    optics,
    recordings,
    render,
    reproduce,
    rig,
)
from palpate.cli.adapt import adapt
from palpate.cli.demo import demo
from palpate.cli.flow import flow
from palpate.cli.quantise import quantise
from palpate.cli.studio import studio
from palpate.version import __version__

__all__ = ["app", "main"]

app = typer.Typer(
    name="palpate",
    help="Camera-based touch you can trust: record, calibrate, certify, sense.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
import_app = typer.Typer(help="Bring recordings from elsewhere into a run.", no_args_is_help=True)
app.add_typer(import_app, name="import")
app.add_typer(render.app, name="render")
app.add_typer(mechanics.app, name="mechanics")
app.add_typer(optics.app, name="optics")
app.add_typer(rig.plan_app, name="plan")
app.add_typer(rig.rig_app, name="rig")
app.add_typer(reproduce.app, name="reproduce")
app.add_typer(compliance.app, name="compliance")
import_app.command("images")(recordings.import_images)
import_app.command("palm")(import_palm.palm)
import_app.command("tiff", help=import_press.TIFF)(import_press.press)
import_app.command("video", help=import_press.VIDEO)(import_press.press)
for verb in (
    rig.record,
    recordings.check,
    recordings.repair,
    recordings.export,
    calibration.calibrate,
    adapt,
    quantise,
    calibration.evaluate,
    calibration.sense,
    calibration.report,
    flow,
    demo,
    studio,
):
    app.command()(verb)


@app.callback(invoke_without_command=True)
def start(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Camera-based touch you can trust: record, calibrate, certify, sense."""
    if version:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point of the `palpate` command."""
    app()
