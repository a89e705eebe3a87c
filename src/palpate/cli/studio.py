"""The studio."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.shared import reports_errors

if TYPE_CHECKING:
    from palpate.rig.service import RigClient


@reports_errors
def studio(
    port: Annotated[int, typer.Option(min=1, max=65535, help="On 127.0.0.1.")] = 8080,
    rig: Annotated[str, typer.Option(help="A TOML file, or virtual:palm.")] = "virtual:palm",
    runs: Annotated[Path, typer.Option(help="Folder that recordings go into.")] = Path("runs"),
    accelerated: Annotated[
        bool, typer.Option("--accelerated", help="Let virtual:palm run as fast as the machine can.")
    ] = False,
) -> None:
    """Open the operator's page of the rig in the browser.

    The page is open to this machine only. The rig itself is held by a process of its own, which is started
    where none runs: closing the page or losing this command moves nothing and loses nothing. Ctrl-C pauses a
    recording with the probe lifted; run the same command again to go on.

    Example: palpate studio --port 8080
    """
    from palpate.rig.service import RigClient, launch, rig_name
    from palpate.studio.app import check_needed, check_port, serve

    rig = rig_name(rig)
    check_needed()
    check_port(port)
    with RigClient(rig) as client:
        if not client.reached(within_s=1.0):
            typer.echo(f"starting the rig {rig} …")
            launch(rig, runs, accelerated=accelerated)
            client.reached(within_s=10.0)
        typer.echo(f"http://127.0.0.1:{port}  (Ctrl-C ends the page, and pauses a recording)")
        try:
            with contextlib.suppress(KeyboardInterrupt):
                serve(client, port, runs.absolute())
        finally:
            typer.echo(_leave(client, rig))


def _leave(client: RigClient, rig: str) -> str:
    """Leave the rig safe; what was done."""
    from palpate.core.errors import PalpateError

    try:
        status = client.ask_status()
        if not status["recording"]:
            client.shutdown()
            return f"the rig {rig} stands and nothing is recorded; its process ends"
        if status["asked"] is None:
            client.pause()
        return (
            f"the recording {status['run']} is paused with the probe lifted, and its process waits; run "
            "palpate studio again to go on or to end it"
        )
    except PalpateError as e:
        return (
            f"the rig {rig} does not answer ({e}); look at it, and use its own emergency switch if it moves"
        )
