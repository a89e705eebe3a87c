"""The verb that analyses an experiment's judgements."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from palpate.cli.verb_support import print_found


def analyze(
    folder: Annotated[Path, Argument(help="Folder of stimuli.csv and responses.csv, or of participants'.")],
    out: Annotated[Path | None, Option(help="HTML page to make; must not exist.")] = None,
    shape: Annotated[
        str, Option(help="Of psychometric functions: gaussian, logistic, weibull.")
    ] = "gaussian",
    logarithmic: Annotated[bool, Option("--logarithmic", help="Count levels by their logarithm.")] = False,
    lapse: Annotated[
        float | None, Option(min=0.0, max=0.4, help="Share of slips; found from the answers unless given.")
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed of draws.")] = 0,
) -> None:
    """Say which conditions differ, how often answers were right.

    Thresholds too, all with their intervals.

    Example: palpate experiment analyze STUDY --out study.html
    """
    from dataclasses import replace

    from palpate.core import InputError, refuse_existing
    from palpate.psychophysics.analysis import SigmoidShape, analyse_experiment
    from palpate.psychophysics.experiments import read_kept_answers
    from palpate.reports.trial_page import LEGEND, analysis_answers, write_trial_page

    if shape not in list(SigmoidShape):
        raise InputError(f"--shape {shape!r}; {', '.join(SigmoidShape)} are known")
    if out is not None:
        refuse_existing(out)
    kept = read_kept_answers(folder)
    found = analyse_experiment(
        kept.judgements, kept.stimuli, unanswered=kept.unanswered, simulated=kept.simulated,
        shape=SigmoidShape(shape), logarithmic=logarithmic, lapse=lapse, seed=seed,
    )  # fmt: skip
    if kept.withdrawn:
        left_out = f"{len(kept.withdrawn)} with answers whose consent does not stand are left out"
        found = replace(found, caveats=(*found.caveats, left_out))
    if out is not None:
        write_trial_page(found, out, str(folder.name))
    said = ["Simulated: nothing here is a measurement of people."] if kept.simulated else []
    told = [*said, *analysis_answers(found), f"({LEGEND}.)", *(f"Note: {one}." for one in found.caveats)]
    if out is not None:
        told.append(f"page: {out}")
    print_found(found.to_dict() | {"answers": list(analysis_answers(found))}, "\n".join(told))
