"""The demo."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.shared import Json, Quiet, phases, print_found, progress_bar, reports_errors


@reports_errors
def demo(
    out: Annotated[Path, typer.Option(help="Folder to make; must not exist.")],
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show the whole loop on a virtual photoelastic skin.

    Records it, calibrates it, certifies it and senses with it; needs no hardware.

    Example: palpate demo --out demo-out
    """
    from palpate.studies.demo import run_demo

    with progress_bar(quiet) as bar:
        progress = bar if sys.stderr.isatty() else phases(quiet)
        result = run_demo(out, seed=seed, progress=progress)
    print_found(result.to_dict(), result.text(), json_)
