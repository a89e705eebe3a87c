"""The verb that computes optical flow along a sequence of frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.shared import Json, Quiet, print_found, progress_bar, reports_errors


@reports_errors
def flow(
    frames: Annotated[Path, typer.Argument(help="Multi-page TIFF, video, folder of images or run.")],
    out: Annotated[Path, typer.Option(help="Folder to make; must not exist.")],
    method: Annotated[
        str, typer.Option(help="horn-schunck, coarse-to-fine, dis or farneback.")
    ] = "horn-schunck",
    from_first: Annotated[bool, typer.Option(help="From the first frame, not the one before.")] = False,
    fields: Annotated[bool, typer.Option(help="Also keep every flow: fields.npy, 4 bytes a number.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compute optical flow and its divergence along a sequence.

    Makes flow.csv and flow.png.

    Example: palpate flow press.tif --out flow
    """
    from palpate.reports.flow import write_flow

    with progress_bar(quiet) as progress:
        found = write_flow(
            frames,
            out,
            method=method,
            from_first=from_first,
            fields=fields,
            progress=lambda done, total: progress("flow", done, total),
        )
    text = (
        f"{out}: {found['steps']} steps by {method}, mean speed {found['mean_speed_px']:.3g} px, accumulated "
        f"mean divergence {found['accumulated_divergence']:.3g}"
    )
    print_found(found, text, json_)
