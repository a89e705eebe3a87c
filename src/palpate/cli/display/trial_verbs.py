"""Verbs of experiments on people: a design's folder, a participant's sitting, tables for other programs."""

from __future__ import annotations

import secrets
import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from palpate.cli.verb_support import print_found, say

if TYPE_CHECKING:
    from palpate.psychophysics.experiments import (
        Answerer,
        ExperimentDesign,
        Sitting,
        SittingDesk,
        SittingOutcome,
        StimulusPresenter,
    )

Folder = Annotated[Path, Argument(help="Folder of the experiment.")]


def new(
    folder: Annotated[Path, Argument(help="Folder to make; must not exist.")],
    preset: Annotated[str, Option(help="jelly, bianchi-2010 or threshold.")] = "jelly",
    seed: Annotated[int | None, Option(help="Of everything that is drawn; else drawn itself.")] = None,
    moduli_kpa: Annotated[
        str | None, Option(help="Of bianchi-2010's five silicones, 0 to 45 % softener [kPa].")
    ] = None,
) -> None:
    """Make an experiment's folder from a ready design.

    It may be edited before the first participant.

    jelly: five cups, pairs and a ranking, ten minutes. bianchi-2010: three conditions, direct and rendered,
    fifteen participants. threshold: staircases and Bayesian placement on a display.

    Example: palpate experiment new jelly --preset jelly
    """
    from palpate.psychophysics.experiments import make_experiment, make_schedule

    chosen = secrets.randbelow(1 << 31) if seed is None else seed
    design = make_experiment(folder, preset, chosen, _moduli(moduli_kpa))
    answer = {
        "folder": str(folder),
        "preset": preset,
        "seed": chosen,
        "participants": sum(one.participants for one in design.file.group),
        "stimuli": len(design.stimuli),
        "judgements_of_the_first": make_schedule(design, 1).max_trials,
    }
    text = (
        f"{folder}: {design.file.name}, seed {chosen}, {answer['participants']} participants, "
        f"{answer['judgements_of_the_first']} judgements at most of the first\n"
        f"  {_levels_said(folder, preset, moduli_kpa is not None)}then: "
        f"palpate experiment run {folder} --participant P01{' --bench FILE' if preset == 'threshold' else ''}"
    )
    print_found(answer, text)


def run(
    folder: Folder,
    participant: Annotated[str, Option(help="Code, such as P01; no name of a person.")],
    bench: Annotated[Path | None, Option(help="TOML file of display and arm, for rendered stimuli.")] = None,
    rehearse: Annotated[
        bool, Option("--rehearse", help="Nobody is there: kept in rehearsal/, as simulated.")
    ] = False,
    answers: Annotated[
        Path | None, Option(help="File of answers still to come, a line each: a rehearsal.")
    ] = None,
    noise: Annotated[
        float | None, Option(help="Spread of a simulated observer, in the levels' unit: a rehearsal.")
    ] = None,
) -> None:
    """Run a participant's sitting, or go on with it.

    Each answer is on disk before the next trial.

    The experimenter reads letters and types 1 or 2, or an order; q pauses. After a pause, a crash or a kill
    the same command goes on where it was. Rendered stimuli need --bench; with --rehearse the display may be
    virtual, which nobody can feel, and with --answers or --noise alone nothing is rendered at all.

    Example: palpate experiment run jelly --participant P01

    Example: palpate experiment run jelly --participant R01 --noise 0.3
    """
    from palpate.psychophysics.experiments import read_design

    design = read_design(folder)
    simulated = rehearse or answers is not None or noise is not None
    desk, answerer = _desk(answers, noise is not None), _observer(design, participant, noise)
    with ExitStack() as stack:
        sitting = _sitting(stack, design, participant, desk, simulated)
        presenter = _presenter(stack, sitting, bench, rehearse)
        outcome = _went(sitting, desk, presenter, answerer)
    answer = {
        "participant": participant,
        "group": sitting.record.group,
        "complete": outcome.complete,
        "judgements": outcome.kept,
        "paused": outcome.why or None,
        "simulated": sitting.record.simulated,
    }
    print_found(answer, _text(answer, folder))
    if outcome.fault is not None:
        raise outcome.fault


def export(
    folder: Folder,
    out: Annotated[Path, Argument(help="Folder to make; must not exist.")],
    rehearsal: Annotated[bool, Option("--rehearsal", help="Simulated participants instead.")] = False,
) -> None:
    """Write all participants' judgements in the layout of BIDS.

    Tables have their columns described.

    Example: palpate experiment export jelly jelly-bids
    """
    from dataclasses import asdict

    from palpate.psychophysics.experiments import export_trials, read_design

    found = export_trials(read_design(folder), out, rehearsal)
    print_found(asdict(found) | {"folder": str(out)})


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


class _Terminal:
    """The experimenter's terminal: what is told goes to stderr, so that stdout has the answer alone."""

    def tell(self, text: str) -> None:
        say(text, err=True)

    def ask(self, prompt: str) -> str:
        say(f"{prompt} > ", err=True, nl=False)
        line = sys.stdin.readline() if sys.stdin is not None and not sys.stdin.closed else ""
        if not line:
            raise EOFError
        return line.rstrip("\n")

    wait = mend = ask


class _Script:
    """Lines of a file in place of keys; nothing has to be done by hand, and nobody mends a fault."""

    def __init__(self, lines: list[str]) -> None:
        self._lines = iter(lines)

    def tell(self, text: str) -> None:
        say(text, err=True)

    def ask(self, prompt: str) -> str:
        for line in self._lines:
            return line
        raise EOFError

    def wait(self, prompt: str) -> str:
        return ""

    def mend(self, prompt: str) -> str:
        raise EOFError


def _desk(answers: Path | None, observed: bool) -> SittingDesk:
    from palpate.core import InputError, storage_errors

    if answers is None:
        return _Script([]) if observed else _Terminal()
    with storage_errors(answers):
        data = answers.read_bytes()
    try:
        return _Script(data.decode("utf-8-sig").splitlines())
    except UnicodeDecodeError as e:
        raise InputError(f"{answers} is no text: {e}") from e


def _observer(design: ExperimentDesign, participant: str, noise: float | None) -> Answerer | None:
    from palpate.psychophysics.experiments import noisy_answers

    return None if noise is None else noisy_answers(design, participant, noise)


def _presenter(
    stack: ExitStack, sitting: Sitting, bench: Path | None, shown: bool
) -> StimulusPresenter | None:
    """What shows rendered stimuli; a person is never asked about what nobody can feel."""
    from palpate.core import InputError
    from palpate.psychophysics import Presentation
    from palpate.psychophysics.experiments import UnrenderedStimuli

    if not any(one.presentation is Presentation.RENDERED for one in sitting.schedule.blocks):
        return None
    if bench is None and not sitting.record.simulated:
        raise InputError(
            f"{sitting.record.participant} is in group {sitting.record.group}, who feel rendered stimuli: "
            "name the display's file by --bench. Nobody can feel the virtual display; it is for --rehearse"
        )
    if bench is None and not shown:
        return UnrenderedStimuli()
    from palpate.softness.process import read_bench
    from palpate.workflows.rendered_stimuli import RenderedStimuli

    return stack.enter_context(RenderedStimuli(sitting.design, read_bench(bench)))


def _sitting(
    stack: ExitStack, design: ExperimentDesign, participant: str, desk: SittingDesk, simulated: bool
) -> Sitting:
    from palpate.core import InputError
    from palpate.psychophysics.experiments import Enrolment, Sitting, ask_enrolment, enrol, participant_folder

    if not participant_folder(design, participant, simulated).exists():
        try:
            told = Enrolment(True, simulated=True) if simulated else ask_enrolment(design, desk)
        except KeyboardInterrupt as e:
            say("\npalpate: stopped before the first trial; nothing was made", err=True)
            raise typer.Exit(130) from e
        except EOFError as e:
            raise InputError("the input is closed, so that nobody can consent; nothing was made") from e
        enrol(design, participant, told)
    return stack.enter_context(Sitting(design, participant, _now, simulated))


def _went(
    sitting: Sitting, desk: SittingDesk, presenter: StimulusPresenter | None, answerer: Answerer | None
) -> SittingOutcome:
    from palpate.core import MonotonicClock
    from palpate.psychophysics.experiments import SittingDialogue

    try:
        return SittingDialogue(sitting, desk, presenter, MonotonicClock(), answerer).run()
    except KeyboardInterrupt as e:
        kept = len(sitting.judgements)
        say(f"\npalpate: paused; {kept} judgements are kept, and the same command goes on", err=True)
        raise typer.Exit(130) from e


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _moduli(text: str | None) -> tuple[float, ...] | None:
    from palpate.core import InputError

    if text is None:
        return None
    try:
        return tuple(float(one) for one in text.split(","))
    except ValueError as e:
        raise InputError(f"--moduli-kpa {text!r}; five numbers are needed, as in 800,500,300,150,100") from e


def _levels_said(folder: Path, preset: str, given: bool) -> str:
    """What to edit before the first participant; a display's objects do not follow the table."""
    if preset == "jelly":
        return f"put in your own levels in {folder / 'stimuli.csv'}, "
    if preset == "threshold":
        both = f"{folder / 'stimuli.csv'} and in {folder / 'objects'}"
        return f"a flat's modulus is in {both}: change both or none, "
    return "" if given else "make it anew with your silicones' moduli by --moduli-kpa, "


def _text(answer: dict[str, Any], folder: Path) -> str:
    code, kept = answer["participant"], answer["judgements"]
    said = f"{code}: {kept} judgements are kept; "
    said += "all is answered" if answer["complete"] else f"paused: {answer['paused']}"
    if answer["complete"]:
        analysed = folder / "rehearsal" if answer["simulated"] else folder
        said += f"\n  palpate experiment analyze {analysed} --out PAGE.html says what was found so far"
    else:
        said += f"\n  palpate experiment run {folder} --participant {code} goes on, with the same options"
    return said + ("\nsimulated: no measurement" if answer["simulated"] else "")
