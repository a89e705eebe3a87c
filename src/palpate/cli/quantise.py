"""The verb that makes a calibration's network faster, and says what that costs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from palpate.cli.shared import Json, Quiet, print_found, progress_bar, reports_errors


@reports_errors
def quantise(
    calibration: Annotated[Path, typer.Argument(help="Calibration folder; left as it is.")],
    run: Annotated[Path, typer.Argument(help="The run that it was calibrated on.")],
    out: Annotated[Path, typer.Option(help="Calibration folder to make; must not exist.")],
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a calibration's network int8, and say what that costs.

    Also spelt quantize. The calibration is written anew; both networks are scored on the rows that it
    held out.

    Example: palpate quantise cal run --out cal-int8
    """
    from palpate.calibration.int8 import quantise as written
    from palpate.calibration.int8_cost import cost
    from palpate.recordings.run_reader import Run
    from palpate.reports.certificate import write_report
    from palpate.studies.certify import REPORT_FILE

    with progress_bar(quiet) as progress:
        card = written(calibration, Run.open(run), out, progress)
    write_report(out, out / REPORT_FILE)
    found = cost(calibration, out)
    table = {
        target.column: {
            "unit": target.unit,
            "fp32_mae": found.mae[target.column][0],
            "int8_mae": found.mae[target.column][1],
            "int8_half_width": target.score.half_width,
        }
        for target in card.targets
    }
    ms = {name: 1e3 * seconds for name, seconds in zip(("fp32", "int8"), found.seconds, strict=True)}
    said = {"calibration": card.id, "quantised_from": card.options["quantised_from"]}
    print_found(said | {"targets": table, "network_ms": ms}, _text(card.id, out, table, ms), json_)


def _text(name: str, out: Path, table: dict[str, dict[str, Any]], ms: dict[str, float]) -> str:
    lines = [
        f"calibration {name}: {out}",
        f"{'target':20}{'unit':6}{'MAE fp32':>10}{'int8':>10}{'change':>9}",
    ]
    for column, row in table.items():
        before, now = row["fp32_mae"], row["int8_mae"]
        change = f"{100 * (now / before - 1):+.1f} %" if before > 0 else ""
        lines.append(f"{column:20}{row['unit']:6}{before:10.3g}{now:10.3g}{change:>9}")
    lines.append(
        f"network alone, this machine: fp32 {ms['fp32']:.2f} ms, int8 {ms['int8']:.2f} ms an image, "
        f"{ms['fp32'] / ms['int8']:.2f} times as fast"
    )
    if ms["int8"] > 0.9 * ms["fp32"]:
        lines.append("int8 gains nothing on this machine: keep the calibration as it is")
    return "\n".join(lines)
