"""Verbs that reproduce a published study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.shared import Group, Json, Quiet, print_found, progress_bar, reports_errors

app = typer.Typer(
    cls=Group,
    add_completion=False,
    help="Reproduce published studies on virtual sensors.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.callback()
def start() -> None:
    """Reproduce published studies on virtual sensors."""


@app.command()
@reports_errors
def palm(
    out: Annotated[Path, typer.Option(help="Folder to make; must not exist.")],
    scale: Annotated[str, typer.Option(help="small: for two cores. full: for a GPU.")] = "small",
    part: Annotated[
        str, typer.Option(help="all, or headline for the comparison of the models alone.")
    ] = "all",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare the palm's four published networks with ours.

    Records the virtual palm, trains the networks and writes it up: report.html and summary.json.
    Interrupted, the same command goes on from where it was.

    Example: palpate reproduce palm --scale small --out palm-study
    """
    from palpate.studies.palm import reproduce_palm, scale_of

    with progress_bar(quiet) as progress:
        entries = reproduce_palm(out, scale_of(scale), seed=seed, part=part, progress=progress)
    beside = [one for one in entries if one["published"] is not None]
    width = max((len(one["name"]) for one in beside), default=0)
    lines = [
        "Virtual sensor, and models trained with unequal budgets: neither a sensor's accuracy nor a ranking."
    ]
    lines += [
        f"{one['name']:{width}}  {one['value']:.3g} {one['unit']}  (printed: {one['published']:g})"
        for one in beside
    ]
    lines += [f"all {len(entries)} numbers: {out / 'summary.json'}", f"report: {out / 'report.html'}"]
    print_found(entries, "\n".join(lines), json_)


@app.command()
@reports_errors
def tactip(
    out: Annotated[Path, typer.Option(help="Folder to make; must not exist.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    trials: Annotated[int, typer.Option(help="Trials of each specimen at each tilt; the report has 5.")] = 5,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Set the report on compliance by touch beside our numbers.

    Its figures 5 to 9, p-values and new specimen. Makes report.html and summary.json; some two minutes.

    Example: palpate reproduce tactip --out tactip-study
    """
    from palpate.studies.tactip.reproduce import reproduce_tactip

    with progress_bar(quiet) as progress:
        entries = reproduce_tactip(out, seed=seed, trials=trials, progress=progress)
    beside = [one for one in entries if one["published"] is not None]
    width = max(len(one["name"]) for one in beside)
    lines = ["Virtual sensor: what the estimators recover of a model, not how good a sensor is."]
    lines += [
        f"{one['name']:{width}}  {one['value']:.3g} {one['unit'] if one['unit'] != '1' else '':4}  "
        f"(printed: {one['published']:g})"
        for one in beside
        if one["value"] is not None
    ]
    lines += [f"all {len(entries)} numbers: {out / 'summary.json'}", f"report: {out / 'report.html'}"]
    print_found(entries, "\n".join(lines), json_)
