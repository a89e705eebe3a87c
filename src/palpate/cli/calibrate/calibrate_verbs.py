"""Verbs on calibrations: calibrate, evaluate, sense, report, compare, adapt."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

import palpate
from palpate.cli.verb_support import (
    NewCalibration,
    as_json,
    classes_of,
    names_of,
    numbers_of,
    options_of,
    periods_of,
    print_found,
    progress_bar,
    say,
    vectors_of,
)
from palpate.estimators.session_folder import calibration_in

if TYPE_CHECKING:
    from palpate.estimators.model_card import Card
    from palpate.recordings import Manifest

GivenCalibration = Annotated[
    Path, Argument(help="Calibration folder, or a session's, whose newest is taken.")
]
Box = tuple[int, int, int, int]
Instruments = Annotated[
    Path | None, Option(help="TOML file of what the labels were measured with, a section a column.")
]
CameraLens = Annotated[
    Path | None,
    Option(help="Lens file of the camera; refused where the calibration was made through another."),
]


def calibrate(
    runs: Annotated[
        list[Path], Argument(metavar="RUN...", help="Run to learn from; several are joined, each a session.")
    ],
    out: NewCalibration,
    targets: Annotated[
        str,
        Option(
            help="Label columns to estimate, e.g. depth_mm,force_N; by default those the run names, or none."
        ),
    ] = "",
    model: Annotated[
        str,
        Option(help="kernel-ridge, pca-ridge, pixel-mlp, compact-cnn, mean, a palm's, or module:Class."),
    ] = "kernel-ridge",
    split: Annotated[
        str,
        Option(
            help="auto, random, session, blocks, blocks:ROWS, group:COLUMN, leave-one-out:COLUMN, or "
            "module:function."
        ),
    ] = "auto",
    folds: Annotated[
        int | None, Option(help="Parts the rows are split in; default 5, for a network 8.")
    ] = None,
    scored_folds: Annotated[
        int | None, Option(help="How many folds to hold out; by default all, or one for a network.")
    ] = None,
    seed: Annotated[int, Option(help="Seed of everything random.")] = 0,
    size: Annotated[str | None, Option(help="HEIGHTxWIDTH of the model's input [px].")] = None,
    crop: Annotated[
        list[str] | None,
        Option(help="X,Y,WIDTH,HEIGHT cut from each frame [px]; given twice, two are laid side by side."),
    ] = None,
    skin: Annotated[
        str | None,
        Option(help="X,Y,WIDTH,HEIGHT of the skin [px], for the audit; by default it is found by itself."),
    ] = None,
    rgb: Annotated[
        bool | None,
        Option("--rgb/--grey", help="Learn from three colour channels or one; by default the model's own."),
    ] = None,
    delta: Annotated[
        bool | None,
        Option(
            "--delta/--raw",
            help="Learn from the difference to the untouched sensor, or from the frame itself.",
        ),
    ] = None,
    reference: Annotated[
        str | None, Option(help="COLUMN=VALUE of rows that show the untouched sensor.")
    ] = None,
    reference_by: Annotated[
        str, Option(help="Columns within whose groups a reference holds, e.g. press.")
    ] = "",
    learn_untouched: Annotated[
        bool, Option("--learn-untouched", help="Learn from the untouched sensor's frames too.")
    ] = False,
    option: Annotated[
        list[str] | None, Option(help="A model's own setting, NAME=VALUE, as in epochs=30.")
    ] = None,
    circular: Annotated[
        str, Option(help="Targets that come round again, e.g. angle_deg, or edge_deg=180 after half a turn.")
    ] = "",
    vector: Annotated[
        list[str] | None,
        Option(help="Targets read as one, e.g. force=force_x_N,force_y_N,force_z_N; may be given again."),
    ] = None,
    classes: Annotated[
        str,
        Option(
            help="Label columns of classes or counts, e.g. touched, or grade=soft/firm/hard to name 0, 1, 2."
        ),
    ] = "",
    instruments: Instruments = None,
    lens: Annotated[
        Path | None,
        Option(help="Lens file, by palpate lens calibrate; crops then count in the rectified image."),
    ] = None,
) -> None:
    """Calibrate an estimator and certify it.

    Makes a folder of model, card, held-out predictions and report. Interrupted, the same command goes on
    from where it was.

    Example: palpate calibrate run --targets depth_mm,force_N --model compact-cnn --out cal
    Example: palpate calibrate monday tuesday friday --split session --out cal
    Example: palpate calibrate run --targets none --classes object --split group:press --out cal
    """
    from palpate.calibration.calibration_job import model_regions
    from palpate.calibration.calibration_plan import ReferenceRule
    from palpate.core import Lens
    from palpate.estimators.networks import model_kind
    from palpate.recordings.joined_runs import joined
    from palpate.recordings.manifest import read_instruments

    if ":" in model + split:
        sys.path.append(str(Path.cwd()))  # a module of one's own lies where one works
    recorded, kind = joined([_labelled(run) for run in runs]), model_kind(model)
    crops = _crops(crop or [])
    if kind.regions and crops[0] is None:
        crops = model_regions(recorded.manifest, kind.regions)  # type: ignore[assignment]
    named, told_apart = names_of(targets) or kind.targets, classes_of(classes)
    plan = palpate.CalibrationPlan(
        targets=() if named == ("none",) else named or _others(recorded.manifest.targets, told_apart),
        model=model,
        split=split,
        folds=folds,
        scored_folds=scored_folds,
        seed=seed,
        size_px=numbers_of(size, 2, "--size"),  # type: ignore[arg-type]
        channels=3 if (kind.channels == 3 if rgb is None else rgb) else 1,
        crop_px=crops[0],
        beside_px=crops[1],
        delta=bool(kind.delta) if delta is None else delta,
        reference=ReferenceRule.parse(reference, names_of(reference_by)) if reference else None,
        learn_untouched=learn_untouched,
        skin_px=numbers_of(skin, 4, "--skin"),  # type: ignore[arg-type]
        options=options_of(option or []),
        circular=periods_of(circular),
        vectors=vectors_of(vector or []),
        instruments={} if instruments is None else read_instruments(instruments),
        classes=told_apart,
        lens=None if lens is None else Lens.read(lens),
    )
    with progress_bar() as progress:
        card = palpate.certify(recorded, plan, out, progress)
    print_found(card.model_dump(mode="json"), _card_text(card, out))


def _labelled(path: Path) -> palpate.Run:
    """A run without frames that have no label at all, as a kill leaves them; how many is said."""
    whole = palpate.Run.open(path)
    run = whole.labelled()
    if not len(run) or run is whole:
        return whole
    lost = len(whole) - len(run)
    has = "1 frame has" if lost == 1 else f"{lost} frames have"
    say(
        f"{path}: {has} no label at all, as a writer that was killed leaves them; left out, the other "
        f"{len(run)} are used. The command that recorded it goes on where it was killed",
        err=True,
    )
    return run


def _others(targets: tuple[str, ...], classes: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(name for name in targets if name not in classes)


def _crops(words: list[str]) -> tuple[Box | None, Box | None]:
    from palpate.core.errors import InputError

    if len(words) > 2:
        raise InputError(f"--crop is given {len(words)} times; one crop, or two side by side")
    boxes = [numbers_of(word, 4, "--crop") for word in words] + [None, None]
    return boxes[0], boxes[1]  # type: ignore[return-value]


def evaluate(
    calibration: GivenCalibration,
    run: Annotated[Path, Argument(help="Labelled run to score it on.")],
    out: Annotated[Path | None, Option(help="JSON file to write the scores to.")] = None,
    reference: Annotated[Path | None, Option(help="Image of the untouched sensor.")] = None,
    lens: CameraLens = None,
    keep: Annotated[
        bool, Option("--keep/--no-keep", help="Keep the scores in the calibration's folder, too.")
    ] = True,
) -> None:
    """Score a calibration on a labelled run.

    The scores are kept beside the card, in a file that names it; the card stays as it is.

    Example: palpate evaluate cal run-of-another-day --out scores.json
    """
    from palpate.calibration.sessions import keep_evaluation
    from palpate.core.files import new_file, refuse_existing

    refuse_existing(out)
    calibration = calibration_in(calibration)
    estimator = palpate.Estimator.open(calibration)
    _check_lens(estimator.card, lens)
    zero = None if reference is None else estimator.zero(palpate.read_image(reference))
    scored = _labelled(run)
    with progress_bar() as progress:
        scores = palpate.evaluate(estimator, scored, zero=zero, progress=progress)
    if out is not None:
        with new_file(out) as path:
            path.write_text(json.dumps(scores, indent=1, allow_nan=False) + "\n")
    print_found(scores, _scores_text(scores, estimator.card, scored.manifest))
    if keep:
        kept = keep_evaluation(calibration, scores, reference=reference is not None)
        say(f"kept in {kept}", err=as_json())


def read(
    source: Annotated[Path, Argument(help="An image, a folder of images, or a run.")],
    calibration: Annotated[
        Path, Option("--with", help="Calibration folder, or a session's, whose newest is taken.")
    ],
    reference: Annotated[Path | None, Option(help="Image of the untouched sensor.")] = None,
    lens: CameraLens = None,
    timing: Annotated[bool, Option("--timing", help="Print the latency at the end, to stderr.")] = False,
) -> None:
    """Read images: a value, an interval and a verdict for each target. With --json, one object a line.

    A run that its writer did not close is read, named, and ends with status 1. Of a virtual sensor the first
    line, or "simulated" in each object, says that it was not measured.

    Example: palpate read images --with cal --json
    """
    estimator = palpate.Estimator.open(calibration_in(calibration))
    _check_lens(estimator.card, lens)
    zero = None if reference is None else estimator.zero(palpate.read_image(reference))
    latencies, frames = [], palpate.open_source(source)
    about = None if frames.run is None else frames.run.manifest
    simulated = estimator.card.is_simulated or (about is not None and about.is_simulated)
    if simulated and not as_json():
        from palpate.reports.evaluation_text import simulated_text  # loads tables, which no image needs

        say(simulated_text(estimator.card, about))
    for sensed in palpate.sense(estimator, frames, zero):
        latencies.append(sensed.latency_s)
        if as_json():
            more = {"simulated": True} if simulated else {}
            say(json.dumps(sensed.to_dict() | more, allow_nan=False))
        else:
            say("\n".join(f"{sensed.frame}: {reading}" for reading in sensed.readings.values()))
    if timing:
        from palpate.reports import latency_line

        say(latency_line(latencies), err=True)
    if why := frames.unfinished:
        say(why, err=True)
        if as_json():
            say(json.dumps({"source": str(source), "state": "ended", "why": why}))
        raise typer.Exit(1)


def report(
    calibration: GivenCalibration,
    out: Annotated[
        Path | None,
        Option(help="HTML file to make; must not exist. By default beside the folder, of its name."),
    ] = None,
) -> None:
    """Write a calibration's report as one self-contained HTML page.

    Example: palpate report cal --out cal.html
    """
    from palpate.estimators.certified import read_card
    from palpate.reports.sections import ReportedCalibration

    calibration = calibration_in(calibration)
    page = out or calibration.parent / f"{calibration.resolve().name}.html"
    palpate.write_report(calibration, page)
    _tell_left_out(ReportedCalibration(calibration, read_card(calibration)).refused_evaluations)
    print_found({"report": str(page)}, str(page))


def compare(
    first: GivenCalibration,
    second: Annotated[Path, Argument(help="Another one, that reads some of the same targets.")],
    out: Annotated[Path | None, Option(help="HTML file to make; must not exist.")] = None,
) -> None:
    """Set two calibrations side by side.

    Says whether their scores can be compared: on the same rows they are, row by row, with an interval.

    Example: palpate compare cal-ridge cal-cnn --out compared.html
    """
    from palpate.core.files import refuse_existing
    from palpate.reports.comparison_page import compare_calibrations, comparison_text, write_comparison

    refuse_existing(out)
    comparison = compare_calibrations(calibration_in(first), calibration_in(second))
    if out is not None:
        write_comparison(comparison, out)
    _tell_left_out(comparison.left_out)
    page = {"page": None if out is None else str(out)}
    print_found(comparison.to_dict() | page, comparison_text(comparison))


def _tell_left_out(why: tuple[str, ...]) -> None:
    """A line on stderr for each evaluation that was refused, so that its absence is seen without the page."""
    for one in why:
        say(f"left out: {' '.join(one.split())}", err=True)


def _card_text(card: Any, out: Path) -> str:
    from palpate.calibration.coverage.range_scores import card_findings
    from palpate.reports.evaluation_text import class_lines
    from palpate.reports.terminal_text import confounds_text, instrument_lines

    lines = [f"calibration {card.id}: {out}", *confounds_text(card)]
    if card.sessions is not None:
        lines += [card.sessions.text, *(one.text for one in card.sessions.findings)]
    if card.targets:
        lines += [_card_scores(card), *instrument_lines(card.targets)]
    for one in card.classes or ():
        lines += [*class_lines(one, one.score, card.coverage), *one.findings]
    lines += [*card_findings(card), *(_vector_text(vector) for vector in card.vectors or ())]
    lines += _changes(card)
    if card.choice is not None:
        lines.append(f"chosen on inner folds: {card.choice.chosen}")
    if card.training is not None:
        lines.append(f"learnt in {card.training.sentence}")
    lines += [f"audit: {card.split.audit_text}", f"report: {out / 'report.html'}"]
    return "\n".join(lines)


def _changes(card: Any) -> list[str]:
    """What differs from the calibration that this one was made from; nothing, where it is of its own."""
    if card.interval_reset is not None:
        former = card.interval_reset.former_half_widths
        wider = [(t.column, t.score.half_width / former[t.column]) for t in card.targets if former[t.column]]
        return [f"{name}: intervals {times:.2f} times as wide as before, on average" for name, times in wider]
    if card.adapted_from is None:
        return []
    return [
        f"adapted from {card.adapted_from}; before: the network alone, with the copy's own zero",
        *(
            f"{name}: mean error {one['mae_before']:.3g} before, {one['mae_after']:.3g} after; correction: "
            f"{one['terms']}"
            for name, one in card.split.details["correction"].items()
        ),
    ]


def _card_scores(card: Any) -> str:
    from palpate.reports.terminal_text import scores_table

    periods = {t.column: t.period for t in card.targets}
    return scores_table({t.column: t.score for t in card.targets}, periods)


def _vector_text(vector: Any) -> str:
    return (
        f"{vector.column}: all of {', '.join(vector.columns)} in their joint region in "
        f"{100 * vector.covered:.1f} % "
        f"of rows (95 % interval {100 * vector.low:.1f} to {100 * vector.high:.1f} %)"
    )


def _scores_text(scores: dict[str, Any], card: Card, run: Manifest) -> str:
    from palpate.calibration.coverage.grouped_rates import counted_text
    from palpate.estimators.class_sets import ClassScoreCard
    from palpate.estimators.findings import ValidScoreCard
    from palpate.estimators.model_card import ScoreCard
    from palpate.reports.evaluation_text import (
        class_lines,
        day_text,
        frames_text,
        simulated_text,
        valid_readings_text,
    )
    from palpate.reports.terminal_text import scores_table

    lines = []
    if scores["targets"]:
        periods = {t.column: t.period for t in card.targets}
        targets = {name: ScoreCard(**score) for name, score in scores["targets"].items()}
        lines.append(scores_table(targets, periods, scores["labels_outside"]))
    for one in card.classes or ():
        found = ClassScoreCard(**scores["classes"][one.column])
        lines += class_lines(one, found, card.coverage)
    joint = [
        f"{name}: all components in their joint region in {100 * one['covered']:.1f} % of rows "
        f"(95 % interval {100 * one['low']:.1f} to {100 * one['high']:.1f} %)"
        for name, one in scores["vectors"].items()
    ]
    short = [
        f"{name}: {100 * one['coverage_90']:.1f} % of rows lay within their intervals, less than the "
        f"{100 * card.coverage:g} % promised"
        for name, one in scores["targets"].items()
        if one["coverage_90_high"] < card.coverage and name not in scores["labels_outside"]
    ]
    of_valid = {name: ValidScoreCard(**one) for name, one in scores["valid_readings"].items()}
    lines += valid_readings_text(card, of_valid)
    table = "\n".join([*lines, *short, *scores["instruments"].values(), *scores["findings"], *joint])
    counts = (scores[f"frames_{name}"] for name in ("scored", "valid", "untold", "all_valid"))
    valid = frames_text(card, *counts)
    day = day_text(scores)
    if scores["groups"] == 1 and scores["frames_read"] > 1:
        column = "/".join(scores["group_columns"])
        day += f"\nall of one {column}: the 95 % intervals are of its own rate, not of how others may differ"
    counted = f"95 % intervals count {counted_text(scores['counted_groups'], scores['counted_by'])}"
    return "\n".join(filter(None, [table, valid, counted, day, simulated_text(card, run)]))


def adapt(
    calibration: Annotated[Path, Argument(help="Calibration folder; it is left as it is.")],
    run: Annotated[Path, Argument(help="Labelled run of your own copy, ten presses or more.")],
    out: NewCalibration,
    intervals_only: Annotated[
        bool,
        Option(
            "--intervals-only", help="Leave the network as it is; set its intervals anew for this session."
        ),
    ] = False,
    instruments: Instruments = None,
    lens: CameraLens = None,
) -> None:
    """Adapt a calibration to your own copy of its sensor.

    Ten to 50 presses are enough. With --intervals-only, to another day of the same copy.

    Example: palpate adapt cal run-of-my-copy --out cal-my-copy
    Example: palpate adapt cal run-of-today --intervals-only --out cal-today
    """
    from palpate.calibration.adaptation import adapt as take_over
    from palpate.calibration.sessions import reset_intervals
    from palpate.estimators.certified import read_card
    from palpate.recordings.manifest import read_instruments
    from palpate.workflows.certification import REPORT_FILE

    stated = {} if instruments is None else read_instruments(instruments)
    _check_lens(read_card(calibration), lens)
    work = reset_intervals if intervals_only else take_over
    with progress_bar() as progress:
        card = work(calibration, _labelled(run), out, progress, instruments=stated)
        progress("writing the report", 0, 1)
        palpate.write_report(out, out / REPORT_FILE)
    print_found(card.model_dump(mode="json"), _card_text(card, out))


def _check_lens(card: Card, lens: Path | None) -> None:
    from palpate.core import Lens

    if lens is not None:
        card.input.check_lens(Lens.read(lens))
