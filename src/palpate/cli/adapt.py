"""The verb that takes a calibration over to another copy of its sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.cli.shared import Json, Quiet, print_found, progress_bar, reports_errors

HEAD = ("target", "unit", "MAE before", "MAE after", "correction", "90 % interval", "covered")


@reports_errors
def adapt(
    calibration: Annotated[Path, typer.Argument(help="Calibration folder; it is left as it is.")],
    run: Annotated[Path, typer.Argument(help="Labelled run of your own copy, ten presses or more.")],
    out: Annotated[Path, typer.Option(help="Calibration folder to make; must not exist.")],
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Adapt a calibration to your own copy of its sensor.

    Ten to 50 presses are enough.

    Example: palpate adapt cal run-of-my-copy --out cal-my-copy
    """
    from palpate.calibration.adapt import adapt as take_over
    from palpate.recordings.run_reader import Run
    from palpate.reports.certificate import write_report
    from palpate.studies.certify import REPORT_FILE

    with progress_bar(quiet) as progress:
        card = take_over(calibration, Run.open(run), out, progress)
        progress("writing the report", 0, 1)
        write_report(out, out / REPORT_FILE)
    print_found(card.model_dump(mode="json"), _text(card, out, REPORT_FILE), json_)


def _text(card: Any, out: Path, report: str) -> str:
    lines = [HEAD, *(_cells(target, card.split.details["correction"]) for target in card.targets)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEAD))]
    table = [
        "  ".join(
            cell.ljust(w) if i in (0, 1, 4) else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    scored = (
        f"scored on {card.split.groups} groups, each read by a correction fitted without it "
        f"(split {card.split.kind}); before: the network alone, with the copy's own zero"
    )
    return "\n".join(
        [
            f"calibration {card.id}: {out}, adapted from {card.adapted_from}",
            *table,
            scored,
            f"audit: {card.split.audit}",
            f"report: {out / report}",
        ]
    )


def _cells(target: Any, corrections: dict[str, Any]) -> tuple[str, ...]:
    said, score = corrections[target.column], target.score
    return (
        target.column,
        target.unit,
        f"{said['mae_before']:.3g}",
        f"{said['mae_after']:.3g}",
        said["terms"],
        f"±{score.half_width:.3g}",
        f"{100 * score.coverage_90:.1f} %",
    )
