"""The verbs. Each says what it needs, calls one room, and prints what came back."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import typer

from palpate.core.errors import InputError, PalpateError
from palpate.version import __version__

P = ParamSpec("P")
T = TypeVar("T")

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

Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress bar.")]


def reports_errors(verb: Callable[P, T]) -> Callable[P, T]:
    """Print an expected error as one line and end with status 2; Ctrl-C ends with 130."""

    @functools.wraps(verb)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return verb(*args, **kwargs)
        except PalpateError as e:
            typer.echo(f"palpate: {e}", err=True)
            raise typer.Exit(2) from e
        except KeyboardInterrupt as e:
            said = "stopped; nothing half-written is left, and a calibration goes on where it was"
            typer.echo(f"palpate: {said}", err=True)
            raise typer.Exit(130) from e

    return wrapped


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar on stderr, where somebody is looking; what is being done, how far, how long it may take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as bar:
        tasks: dict[str, Any] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                for task in tasks.values():
                    bar.update(task, visible=False)
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total, visible=True)

        yield show


def columns_of(text: str) -> tuple[str, ...]:
    """Names from a comma-separated list."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def numbers_of(text: str | None, count: int, what: str) -> tuple[int, ...] | None:
    """Whole numbers from ``1,2,3`` or ``96x160``."""
    if text is None:
        return None
    try:
        numbers = tuple(int(part) for part in text.replace("x", ",").split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"{what} {text!r} is not {count} whole numbers separated by commas")
    return numbers


def options_of(pairs: list[str]) -> dict[str, Any]:
    """Model options from ``name=value``, the values read as JSON where they are."""
    options: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"option {pair!r} is not NAME=VALUE, as in epochs=30")
        try:
            held = json.loads(value)
        except json.JSONDecodeError:
            held = value
        options[name] = tuple(held) if isinstance(held, list) else held
    return options


@app.callback(invoke_without_command=True)
def start(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Camera-based touch you can trust: record, calibrate, certify, sense."""
    if version:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit


@import_app.command("images")
@reports_errors
def import_images(
    folder: Annotated[Path, typer.Argument(help="Folder of images.")],
    run: Annotated[Path, typer.Argument(help="Run to make; must not exist.")],
    labels: Annotated[Path, typer.Option(help="CSV or Parquet, one row an image; here or in the folder.")],
    image_column: Annotated[str, typer.Option(help="Label column that names the image file.")] = "image_file",
    sensor: Annotated[str, typer.Option(help="What the images are of.")] = "",
    licence: Annotated[str, typer.Option(help="Licence of the data.")] = "",
    origin: Annotated[str, typer.Option(help="Where the data come from.")] = "",
    rate_hz: Annotated[float | None, typer.Option(help="Frame rate, if the images are a sequence.")] = None,
    allow_unlabelled: Annotated[bool, typer.Option(help="Skip images without a row.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Import a folder of labelled images as a run.

    Example: palpate import images taps run --labels labels.csv --image-column image_file
    """
    from palpate.recordings.importers.images import import_images as importer

    with progress_bar(quiet) as progress:
        report = importer(
            folder,
            run,
            labels=labels,
            image_column=image_column,
            sensor=sensor,
            licence=licence,
            origin=origin,
            rate_hz=rate_hz,
            allow_unlabelled=allow_unlabelled,
            progress=lambda done, total: progress("importing", done, total),
        )
    units = ", ".join(f"{column} [{symbol}]" for column, symbol in report.units.items())
    text = f"{run}: {report.frames} frames; columns with a unit: {units or 'none'}"
    if report.unitless:
        text += f"; without: {', '.join(report.unitless)}"
    found = {"run": str(run), "frames": report.frames, "units": dict(report.units)}
    _print(found | {"unitless": list(report.unitless)}, text, json_)


@app.command()
@reports_errors
def check(run: Annotated[Path, typer.Argument(help="Run to look through.")], json_: Json = False) -> None:
    """Look through a run: counts, rates, gaps, drops, damage. Ends with status 1 if it is damaged.

    Example: palpate check run
    """
    from palpate.recordings.check import check as look_through
    from palpate.reports.text import check_text

    report = look_through(run)
    _print(report.to_dict(), check_text(report), json_)
    if not report.sound:
        raise typer.Exit(1)


@app.command()
@reports_errors
def repair(
    run: Annotated[Path, typer.Argument(help="Damaged run; it is only read.")],
    new: Annotated[Path, typer.Argument(help="Run to make of what can be read; must not exist.")],
    json_: Json = False,
) -> None:
    """Copy all that can be read of a damaged run into a new one.

    Example: palpate repair run run-repaired
    """
    from palpate.recordings.repair import repair as copy_readable

    report = copy_readable(run, new)
    lost = [f"{d.file} at byte {d.at_byte}: {d.what}" for d in report.lost]
    text = f"{new}: {report.frames} frames, {report.messages} messages kept; " + (
        "; ".join(lost) or "nothing lost"
    )
    _print({"run": str(new), "frames": report.frames, "messages": report.messages, "lost": lost}, text, json_)


@app.command()
@reports_errors
def export(
    run: Annotated[Path, typer.Argument(help="Run to export.")],
    folder: Annotated[Path, typer.Argument(help="Folder to make; must not exist.")],
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Export a run as PNG images and CSV tables.

    Example: palpate export run folder
    """
    from palpate.recordings.exporters.folder import export_folder
    from palpate.recordings.reader import Run

    with progress_bar(quiet) as progress:
        count = export_folder(Run.open(run), folder, lambda done, total: progress("exporting", done, total))
    _print({"folder": str(folder), "frames": count}, f"{folder}: {count} frames", json_)


@app.command()
@reports_errors
def calibrate(
    run: Annotated[Path, typer.Argument(help="Run to learn from.")],
    targets: Annotated[str, typer.Option(help="Label columns to estimate, e.g. depth_mm,force_N.")],
    out: Annotated[Path, typer.Option(help="Calibration folder to make; must not exist.")],
    model: Annotated[str, typer.Option(help="mean, pca-ridge, pixel-mlp or compact-cnn.")] = "pca-ridge",
    split: Annotated[
        str, typer.Option(help="auto, random, group:COLUMN[,COLUMN] or leave-one-out:COLUMN.")
    ] = "auto",
    folds: Annotated[
        int | None, typer.Option(help="Parts the rows are split in; default 5, for a network 8.")
    ] = None,
    scored_folds: Annotated[
        int | None,
        typer.Option(help="How many folds to hold out; by default all, or one for a network."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    size: Annotated[str | None, typer.Option(help="HEIGHTxWIDTH of the model's input [px].")] = None,
    crop: Annotated[str | None, typer.Option(help="X,Y,WIDTH,HEIGHT cut from each frame [px].")] = None,
    rgb: Annotated[bool, typer.Option("--rgb", help="Learn from three colour channels, not grey.")] = False,
    delta: Annotated[
        bool, typer.Option("--delta", help="Learn from the difference to the untouched sensor.")
    ] = False,
    reference: Annotated[
        str | None, typer.Option(help="COLUMN=VALUE of rows that show the untouched sensor.")
    ] = None,
    reference_by: Annotated[
        str, typer.Option(help="Columns within whose groups a reference holds, e.g. press.")
    ] = "",
    learn_untouched: Annotated[
        bool, typer.Option("--learn-untouched", help="Learn from the untouched sensor's frames too.")
    ] = False,
    option: Annotated[
        list[str] | None, typer.Option(help="A model's own setting, NAME=VALUE, as in epochs=30.")
    ] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate an estimator and certify it: model, card, held-out predictions, report.

    Interrupted, the same command goes on from where it was.

    Example: palpate calibrate run --targets depth_mm,shear_x_mm --model compact-cnn --out cal
    """
    from palpate.calibration.plan import Plan, Reference
    from palpate.recordings.reader import Run
    from palpate.studies.certify import certify

    plan = Plan(
        targets=columns_of(targets),
        model=model,
        split=split,
        folds=folds,
        scored_folds=scored_folds,
        seed=seed,
        size_px=numbers_of(size, 2, "--size"),  # type: ignore[arg-type]
        channels=3 if rgb else 1,
        crop_px=numbers_of(crop, 4, "--crop"),  # type: ignore[arg-type]
        delta=delta,
        reference=Reference.parse(reference, columns_of(reference_by)) if reference else None,
        learn_untouched=learn_untouched,
        options=options_of(option or []),
    )
    with progress_bar(quiet) as progress:
        card = certify(Run.open(run), plan, out, progress)
    _print(card.model_dump(mode="json"), _card_text(card, out), json_)


@app.command()
@reports_errors
def evaluate(
    calibration: Annotated[Path, typer.Argument(help="Calibration folder.")],
    run: Annotated[Path, typer.Argument(help="Labelled run to score it on.")],
    out: Annotated[Path | None, typer.Option(help="JSON file to write the scores to.")] = None,
    reference: Annotated[Path | None, typer.Option(help="Image of the untouched sensor.")] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Score a calibration on a labelled run.

    Example: palpate evaluate cal run-val --out scores.json
    """
    from palpate.calibration.evaluate import evaluate as score
    from palpate.core.files import new_file, refuse_existing
    from palpate.estimators.certified import Estimator
    from palpate.recordings.reader import Run

    if out is not None:
        refuse_existing(out)
    estimator = Estimator.open(calibration)
    zero = _zero(estimator, reference)
    with progress_bar(quiet) as progress:
        scores = score(estimator, Run.open(run), zero=zero, progress=progress)
    if out is not None:
        with new_file(out) as path:
            path.write_text(json.dumps(scores, indent=1, allow_nan=False) + "\n")
    _print(scores, _scores_text(scores), json_)


@app.command()
@reports_errors
def sense(
    calibration: Annotated[Path, typer.Argument(help="Calibration folder.")],
    source: Annotated[Path, typer.Argument(help="An image, a folder of images, or a run.")],
    reference: Annotated[Path | None, typer.Option(help="Image of the untouched sensor.")] = None,
    timing: Annotated[
        bool, typer.Option("--timing", help="Print the latency at the end, to stderr.")
    ] = False,
    threads: Annotated[int, typer.Option(help="Threads of the inference engine; 0 lets it choose.")] = 0,
    json_: Json = False,
) -> None:
    """Read images: a value, an interval and a verdict for each target. With --json, one object a line.

    Example: palpate sense cal images --json
    """
    from palpate.estimators.certified import Estimator
    from palpate.live.sense import sense as read
    from palpate.live.sources import open_source

    estimator = Estimator.open(calibration, threads=threads)
    zero = _zero(estimator, reference)
    latencies = []
    for sensed in read(estimator, open_source(source), zero):
        latencies.append(sensed.latency_s)
        if json_:
            typer.echo(json.dumps(sensed.to_dict(), allow_nan=False))
        else:
            typer.echo("\n".join(f"{sensed.frame}: {reading}" for reading in sensed.shown().values()))
    if timing:
        typer.echo(_latency_text(latencies), err=True)


@app.command()
@reports_errors
def report(
    calibration: Annotated[Path, typer.Argument(help="Calibration folder.")],
    out: Annotated[Path, typer.Option(help="HTML file to make; must not exist.")],
    json_: Json = False,
) -> None:
    """Write a calibration's report as one self-contained HTML page.

    Example: palpate report cal --out cal.html
    """
    from palpate.reports.certificate import write_report

    write_report(calibration, out)
    _print({"report": str(out)}, str(out), json_)


@app.command()
@reports_errors
def demo(
    out: Annotated[Path, typer.Option(help="Folder to make; must not exist.")],
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Record a virtual photoelastic skin, calibrate it, certify it, sense with it. Needs no hardware.

    Example: palpate demo --out demo-out
    """
    from palpate.studies.demo import run_demo

    with progress_bar(quiet) as progress:
        result = run_demo(out, seed=seed, progress=progress)
    _print(result.to_dict(), result.text(), json_)


def main() -> None:
    """Entry point of the `palpate` command."""
    app()


def _print(found: Any, text: str, as_json: bool) -> None:
    typer.echo(json.dumps(found, indent=1, allow_nan=False) if as_json else text)


def _zero(estimator: Any, reference: Path | None) -> Any:
    from palpate.recordings.images import read_image

    return None if reference is None else estimator.zero(read_image(reference))


def _card_text(card: Any, out: Path) -> str:
    from palpate.reports.text import scores_table

    lines = [f"calibration {card.id}: {out}", scores_table({t.column: t.score for t in card.targets})]
    lines += [f"audit: {card.split.audit}", f"report: {out / 'report.html'}"]
    return "\n".join(lines)


def _scores_text(scores: dict[str, Any]) -> str:
    from palpate.estimators.card import ScoreCard
    from palpate.reports.text import scores_table

    table = scores_table({name: ScoreCard(**score) for name, score in scores["targets"].items()})
    valid = f"{scores['frames_valid']} of {scores['frames_scored']} frames gave valid readings throughout"
    learnt = "\nthis is the run it learnt from: these scores say nothing about new presses"
    return f"{table}\n{valid}" + (learnt if scores["learnt_from_this_run"] else "")


def _latency_text(latencies: list[float]) -> str:
    from palpate.reports.text import latency_line

    return latency_line(latencies)


if __name__ == "__main__":
    main()
