"""Verbs of the demo and of the studio."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

import palpate
from palpate.cli.verb_support import phases, print_found, progress_bar, stopped_by_signals


def demo(out: Annotated[Path, Option(help="Folder to make; must not exist.")]) -> None:
    """Show the whole loop on a virtual photoelastic skin.

    Records it, calibrates it, certifies it and senses with it; needs no hardware.

    Example: palpate demo --out demo-out
    """
    with progress_bar() as bar:
        progress = bar if sys.stderr.isatty() else phases()
        result = palpate.run_demo(out, progress=progress)
    print_found(result.to_dict(), result.text())


if TYPE_CHECKING:
    from palpate.rig.service import RigClient


DEFAULT_RIG = "virtual:palm"


def studio(
    port: Annotated[int, Option(min=1, max=65535, help="Of the pages.")] = 8080,
    workspace: Annotated[Path, Option(help="Folder whose runs and calibrations are shown.")] = Path(),
    rig: Annotated[
        str | None, Option(help="Start this rig: a TOML file, or virtual:palm. By default the page Rig does.")
    ] = None,
    runs: Annotated[
        Path | None,
        Option(help="Folder that the rig's recordings go into; by default runs, in the workspace."),
    ] = None,
    accelerated: Annotated[
        bool, Option("--accelerated", help="Let virtual:palm run as fast as the machine can.")
    ] = False,
    objects: Annotated[
        Path | None, Option(help="Folder of objects' files, for the page Softness; by default the workspace.")
    ] = None,
    bench: Annotated[Path | None, Option(help="TOML file of a display and an arm; else virtual.")] = None,
    host: Annotated[str, Option(help="Address to listen at, where others may reach it.")] = "127.0.0.1",
) -> None:
    """Open the studio's pages in the browser.

    Start, live, rig, recordings, calibrations, softness, trials.

    The printed address contains a token, which the browser keeps; without it nothing is answered. The pages
    are open to this machine only, unless --host says otherwise. The rig is held by a process of its own that
    belongs to the workspace: closing the page or losing this command moves nothing and loses nothing.
    Ctrl-C, or SIGTERM, pauses a recording with the probe lifted; run the same command again to go on. A
    rendering of softness ends with this command.

    Example: palpate studio --port 8080 --workspace .
    """
    _refuse_missing("--workspace", workspace)
    if objects is not None:
        _refuse_missing("--objects", objects)
    serve_studio(
        port=port, workspace=workspace, rig=rig, runs=runs, accelerated=accelerated, objects=objects,
        bench=bench, host=host,
    )  # fmt: skip


def _refuse_missing(option: str, folder: Path) -> None:
    """Refuse a folder that is not there: a misspelt one would be served empty."""
    from palpate.core import InputError

    if not folder.is_dir():
        raise InputError(
            f"{option} {folder}: there is no such folder in {folder.absolute().parent}; name one that is "
            "there, or make it first"
        )


def serve_studio(
    *,
    port: int,
    workspace: Path,
    rig: str | None = None,
    runs: Path | None = None,
    accelerated: bool = False,
    objects: Path | None = None,
    bench: Path | None = None,
    host: str = "127.0.0.1",
    page: Mapping[str, object] | None = None,
) -> None:
    """Serve the studio's pages, see `studio`; `page` holds fields of the address that is printed."""
    import secrets

    from palpate.core import storage_errors
    from palpate.devices.rpc import workspace_folder
    from palpate.rig.service import RigClient, launch, rig_name
    from palpate.softness.process import read_bench
    from palpate.studio.page_server import StudioParts, check_port, serve_pages

    name = rig_name(rig or DEFAULT_RIG)
    from palpate.studio.library.workspace import Workspace
    from palpate.studio.softness_page import RenderingDesk

    shown = Workspace(workspace)
    with storage_errors(workspace):
        workspace.mkdir(parents=True, exist_ok=True)
    desk = RenderingDesk((objects or workspace).absolute(), read_bench(bench))
    recorded = (runs or workspace / "runs").absolute()
    check_port(port, host)
    folder = workspace_folder(workspace)
    # Of a terminal that is closed nothing is heard: a recording goes on then, as the rig's process does.
    with stopped_by_signals((signal.SIGINT, signal.SIGTERM)), RigClient(name, folder) as client:

        def launch_rig() -> None:
            launch(name, recorded, accelerated=accelerated, folder=folder)
            client.reached(within_s=10.0)

        if rig is not None and not client.reached(within_s=1.0):
            typer.echo(f"starting the rig {name} …")
            launch_rig()
        secret = secrets.token_urlsafe(32)
        address = _page_address(host, port, {**(page or {}), "token": secret})
        typer.echo(f"{address}  (Ctrl-C ends the page, and pauses a recording)")
        parts = StudioParts(client, recorded, desk, shown, launch_rig, folder)
        try:
            with contextlib.suppress(KeyboardInterrupt):
                serve_pages(parts, port, secret, host)
        finally:
            if client.told_s is not None:  # else none was ever started
                typer.echo(_leave(client, name))


def _page_address(host: str, port: int, fields: Mapping[str, object]) -> str:
    """The address to open; one that stands for every address is told by this machine's name."""
    import socket
    from urllib.parse import urlencode

    from palpate.studio.page_security import EVERY_ADDRESS

    shown = f"[{host}]" if ":" in host else host
    shown = socket.gethostname() if host in EVERY_ADDRESS else shown
    return f"http://{shown}:{port}/?{urlencode(fields)}"


def _others(client: RigClient) -> int:
    """Pages and programs that stay at the rig; 0 beside a process of an older palpate, which counts none."""
    from palpate.core import InputError

    try:
        return client.leave()
    except InputError:
        return 0


def _leave(client: RigClient, rig: str) -> str:
    """Leave the rig safe; what was done."""
    try:
        if _others(client):
            return f"the rig {rig} goes on as it is: another page or program is at it"
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
    except palpate.PalpateError as e:
        return (
            f"the rig {rig} does not answer ({e}); look at it, and use its own emergency switch if it moves"
        )
