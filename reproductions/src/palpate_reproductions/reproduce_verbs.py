"""Commands of `palpate reproduce`: one study each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from palpate.cli.command_kinds import Kinds, by_word
from palpate.cli.verb_support import print_found, progress_bar

HERE = "palpate_reproductions.reproduce_verbs"
app = Kinds(
    "Reproduce published studies on virtual sensors.",
    {study: f"{HERE}:{study}" for study in ("palm", "tactip", "nusense", "softness")},
    by_word,
    "KIND",
)


def palm(
    out: Annotated[Path, Option(help="Folder to make; must not exist.")],
    scale: Annotated[
        str, Option(help="small: for two cores. small-five-folds: a night on them. full: for a GPU.")
    ] = "small",
    part: Annotated[str, Option(help="all, headline, or one stage: leakage, mirror, noise, …")] = "all",
    seed: Annotated[int, Option(min=0, help="Seed of everything random.")] = 0,
) -> None:
    """Compare the palm's four networks with ours and with what needs none.

    Records the virtual palm, trains the networks and writes it up: report.html and summary.json.
    Interrupted, the same command goes on from where it was; a stage made alone is kept for it.

    Example: palpate reproduce palm --scale small --out palm-study
    """
    from palpate_reproductions.palm import reproduce_palm, scale_of

    with progress_bar() as progress:
        entries = reproduce_palm(out, scale_of(scale), seed=seed, part=part, progress=progress)
    warning = "Virtual sensor: models compared on one simulator, not how good a sensor is."
    print_found(entries, _beside_the_source(warning, entries, out))


def tactip(
    out: Annotated[Path, Option(help="Folder to make; must not exist.")],
    seed: Annotated[int, Option(min=0, help="Seed of everything random.")] = 0,
    trials: Annotated[int, Option(help="Trials of each specimen at each tilt; the report has 5.")] = 5,
) -> None:
    """Set the report on compliance by touch beside our numbers.

    Its figures 5 to 9, p-values and new specimen. Makes report.html and summary.json; some two minutes.

    Example: palpate reproduce tactip --out tactip-study
    """
    from palpate_reproductions.tactip import reproduce_tactip

    with progress_bar() as progress:
        entries = reproduce_tactip(out, seed=seed, trials=trials, progress=progress)
    warning = "Virtual sensor: what the estimators recover of a model, not how good a sensor is."
    print_found(entries, _beside_the_source(warning, entries, out))


def nusense(
    out: Annotated[Path, Option(help="Folder to make; must not exist. Recordings stay in it.")],
    scale: Annotated[
        str, Option(help="small: for minutes on two cores. full: the plans as they are.")
    ] = "small",
    part: Annotated[
        str, Option(help="all, or force, places, hysteresis, cycles, edges, damage, controls alone.")
    ] = "all",
    seed: Annotated[int, Option(min=0, help="Seed of everything random.")] = 0,
) -> None:
    """Set the thesis on NUSense, a patterned pad, beside our numbers.

    Records its chapter 4 on the virtual pad: force, places, hysteresis, 70 cycles, edges, damage. Makes
    report.html and summary.json. Interrupted, the same command goes on from where it was.

    Example: palpate reproduce nusense --out nusense-study
    """
    from palpate_reproductions.nusense import reproduce_nusense, scale_named

    with progress_bar() as progress:
        entries = reproduce_nusense(out, scale_named(scale), seed=seed, part=part, progress=progress)
    warning = "Virtual sensor: what the estimators recover of a model, not how good a sensor is."
    print_found(entries, _beside_the_source(warning, entries, out))


def softness(
    out: Annotated[Path, Option(help="Folder to make; must not exist.")],
    seed: Annotated[int, Option(min=0, help="Seed of the sensors' noise.")] = 0,
) -> None:
    """Set the report on softness rendered by two cues beside our numbers.

    Its figures 1 to 3 and 5 on the virtual bench, its tables of people's rankings recomputed, and observers
    tested on them. Makes report.html and summary.json; half a minute.

    Example: palpate reproduce softness --out softness-study
    """
    from palpate_reproductions.softness import reproduce_softness

    with progress_bar() as progress:
        entries = reproduce_softness(out, seed=seed, progress=progress)
    warning = "Virtual bench: what a loop does with assumed parts, not what a hand feels."
    print_found(entries, _beside_the_source(warning, entries, out))


def _beside_the_source(warning: str, entries: Sequence[Mapping[str, Any]], out: Path) -> str:
    """Text of the numbers that the source prints too, and where all of them are."""
    beside = [one for one in entries if one["published"] is not None and one["value"] is not None]
    width = max((len(one["name"]) for one in beside), default=0)
    lines = [
        f"{one['name']:{width}}  {one['value']:.3g} {one['unit'] if one['unit'] != '1' else '':4}  "
        f"(printed: {one['published']:g})"
        for one in beside
    ]
    files = [f"all {len(entries)} numbers: {out / 'summary.json'}", f"report: {out / 'report.html'}"]
    if not out.exists():  # one part alone
        files = [f"{len(entries)} numbers, kept for when all is asked for with the same --out"]
    return "\n".join([warning, *lines, *files])
