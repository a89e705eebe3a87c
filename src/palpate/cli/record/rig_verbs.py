"""Verbs on the rig: record a plan, look at a plan before it is run.

Verbs that work a rig by hand: home, jog, stop, status, zero, and the guided setup of its file.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer import Argument, Option

import palpate
from palpate.cli.verb_support import (
    ENDING,
    group,
    print_found,
    print_record,
    progress_bar,
    stopped_by_signals,
)

if TYPE_CHECKING:
    from palpate.devices.check.interface_check import CheckResult
    from palpate.devices.operator_control import OperatorControl
    from palpate.recordings.clock_offset import Offset
    from palpate.rig import Outcome, Status
    from palpate.rig.commissioning.bench import Bench
    from palpate.rig.rig_file import PositionFrom

plan_app = group("Plans of recordings.")
FRAME_KB = 90.0  # of a frame on disk
rig_app = group("Rigs: stage, force sensor, camera.")

PositionSource = Annotated[
    str | None,
    Option(
        help="Source of the stage's position: stored (only with complete evidence), reference (your word "
        "that it stands at the file's reference), or touch-off (a guarded search for the skin, from at most "
        "5 mm above its center, after a push by hand)."
    ),
]
Opened = TypeVar("Opened")
SHOWN_IN = {"s": (1e3, "ms"), "m": (1e3, "mm"), "m/s": (1e3, "mm/s")}


def opened_at(position: str | None, opens: Callable[[PositionFrom], Opened]) -> Opened:
    """Open a rig by the source of its stage's position; without one, ask a person where that is unknown."""
    from palpate.core import InputError, PositionUnknownError
    from palpate.rig.mean_force import PUSH

    sources: dict[str, PositionFrom] = {
        "stored": "stored",
        "reference": "reference",
        "touch-off": "touch-off",
    }
    if position is not None and position not in sources:
        raise InputError(f"--position {position!r} is unknown; give one of {', '.join(sources)}")

    def opened(source: PositionFrom) -> Opened:
        if source == "touch-off":
            typer.echo(f"palpate: {PUSH}", err=True)
        return opens(source)

    try:
        return opened(sources[position or "stored"])
    except PositionUnknownError as e:
        if position is not None or not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise
        typer.echo(f"palpate: {e}", err=True)
        answer = typer.prompt(
            "reference: the stage stands there; touch-off: the probe hangs above the skin's center; no",
            default="no",
            err=True,
        )
        if answer not in ("reference", "touch-off"):
            raise
    return opened(sources[answer])


def record(
    out: Annotated[Path, Option(help="Run to make, or to go on with.")],
    plan: Annotated[
        str | None,
        Option(
            help="Plan: a TOML file, or a name such as palm, palm-reduced or tactip; else the sensor's own."
        ),
    ] = None,
    rig: Annotated[
        str, Option(help="Rig: a TOML file, virtual:palm, virtual:tactip or another sensor's.")
    ] = "virtual:palm",
    seed: Annotated[int, Option(min=0, help="Of all that varies on a virtual rig.")] = 0,
    position: PositionSource = None,
) -> None:
    """Record a plan on a rig, or go on with an interrupted run.

    Ctrl-C stops the motion, lifts the probe and ends; a second one is the emergency stop: nothing moves.
    Ends with status 1 where shots are still missing. Presses on specimens are also written as the folder
    `presses` within the run, for `palpate read`.

    Example: palpate record --rig virtual:palm --plan palm-reduced --out run
    """
    from palpate.devices.operator_control import OperatorControl
    from palpate.rig import State, plan_of, plan_of_sensor, record as record_plan
    from palpate.rig.rig_file import open_rig

    control = OperatorControl()
    opened = opened_at(position, lambda source: open_rig(rig, seed=seed, position=source))
    try:
        chosen = plan_of_sensor(opened.design) if plan is None else plan_of(plan, opened.design)
        with progress_bar() as progress, _signals_ask(control):

            def watch(status: Status) -> None:
                progress("recording", status.shots, status.planned)

            outcome = record_plan(opened, chosen, out, control=control, watch=watch)
        _tell(out, outcome, chosen.indenters)  # before the devices are closed, which may fail
    finally:
        opened.close()
    if outcome.state is not State.DONE:
        raise typer.Exit(1)


def _tell(out: Path, outcome: Outcome, indenters: tuple[str, ...]) -> None:
    """Print how a recording ended, and write its presses on specimens."""
    from palpate.rig import State

    done = outcome.state is State.DONE
    result: dict[str, Any] = {"run": str(out), **asdict(outcome)}
    text = f"{out}: {outcome.state.value}, {outcome.shots} of {outcome.planned} shots"
    if not done:
        reason = f" ({outcome.reason.value})" if outcome.reason else ""
        text += f"{reason}: {outcome.message}"
    if outcome.clocks is not None:
        text += f"\n{_late(outcome.clocks)}"
    if outcome.zero_moved_n is not None:
        text += f"\nthe force sensor's zero moved by at most {outcome.zero_moved_n:.4f} N over a press"
    if outcome.void_shots:
        text += f"\n{outcome.void_shots} shots were rejected and do not count"
    if outcome.retries:
        text += f"\n{outcome.retries} presses were repeated after a transient fault (events 'rejected')"
    goes_on = "\nthe same command goes on at the first missing shot"
    text += _write_presses(out, indenters, result) if done else goes_on
    print_found(result, text)


def _write_presses(out: Path, indenters: tuple[str, ...], result: dict[str, Any]) -> str:
    """Write presses on specimens into the run's folder, as `palpate read` reads them."""
    if not any(_is_specimen(words) for words in indenters):
        return ""
    from palpate.recordings.exchange.press_export import export_presses
    from palpate.recordings.exchange.press_folder import PRESSES

    if (out / PRESSES).exists():
        return ""
    written = export_presses(palpate.Run.open(out))
    if written is None:
        return ""
    result[PRESSES] = str(written.path)
    return f"\n{written.path}: presses on {len(written.specimens)} specimens, as compliance reads them"


def _is_specimen(words: str) -> bool:
    from palpate.core import InputError, Specimen

    try:
        Specimen.parse(words.partition("@")[0])
    except InputError:
        return False
    return True


@rig_app.command()
def check(
    rig: Annotated[str, Argument(help="A TOML file, or virtual:palm.")], position: PositionSource = None
) -> None:
    """Check a rig with its probe in free air; the stage moves by 2 mm.

    Measures rates, noise, stamps and limits. Prints what was measured, and in brackets what was stated or
    is allowed; then what is wrong.
    It never goes nearer to the expected surface than 2 mm, and does not move where the force sensor fails.
    Ends with status 1 where something is wrong.

    Example: palpate rig check bench.toml
    """
    from palpate.rig.rig_check import check_rig
    from palpate.rig.rig_file import open_rig

    with stopped_by_signals():
        opened = opened_at(position, lambda source: open_rig(rig, supervised=False, position=source))
        findings = check_rig(opened)
    wrong = [one for one in findings if not one.ok]
    lines = [_measured(one) for one in findings if one.ok and one.unit]
    lines += [f"note: {one.code}: {one.message}" for one in findings if one.ok and one.message]
    lines += wrong_lines(wrong)
    text = "\n".join([*lines, f"{rig}: {len(findings) - len(wrong)} of {len(findings)} checks passed"])
    print_found([asdict(one) for one in findings], text)
    if wrong:
        raise typer.Exit(1)


@rig_app.command()
def fit(run: Annotated[Path, Argument(help="Run whose force was right, or of the plan layer.")]) -> None:
    """Print what a run says about the rig, to write into the rig's file.

    Of a run of the plan layer: where the layer lies. Of any other: the range of the skin's stiffness, against
    which the guard checks the first press of every run. Weigh the force sensor before such a run.

    Example: palpate rig fit run >> bench.toml
    """
    from palpate.rig.locate_skin import goes_around

    opened = palpate.Run.open(run)
    if goes_around(opened):
        _print_layer(opened)
    else:
        _print_stiffness(opened)


def _print_stiffness(run: palpate.Run) -> None:
    from palpate.rig.force_checks import MAX_RATIO, stiffness_lines, stiffness_of

    found = stiffness_of(run)
    indenter = next(iter(run.labels["indenter"].dropna()), "")
    text = stiffness_lines(indenter, found, run.manifest.created_utc[:10])
    if found.ratio > MAX_RATIO:
        typer.echo(f"note: the range is {found.ratio:.2g} wide; a gain of two may lie inside it", err=True)
    print_found({"indenter": indenter, **asdict(found)}, text)


def _print_layer(run: palpate.Run) -> None:
    from palpate.rig.locate_skin import locate_skin

    place = locate_skin(run)
    at, moved = (", ".join(f"{d:.3f}" for d in three) for three in (place.origin_mm, place.moved_mm))
    text = (
        f"origin_mm = [{at}]\n"
        f"that is ({moved}) mm from where it was taken to be, and each is known to about the search's step, "
        f"{place.step_mm:g} mm\n"
        f"tilt {place.tilt_mrad[0]:.2f} and {place.tilt_mrad[1]:.2f} mrad along x and y; "
        f"diameter {place.diameter_mm[0]:.2f} and {place.diameter_mm[1]:.2f} mm; "
        f"{place.off_plane_mm:.3f} mm off a plane at most"
    )
    print_found(asdict(place), text)


@plan_app.command()
def preview(
    plan: Annotated[str, Argument(help="A TOML file, or a name such as palm.")],
    png: Annotated[Path | None, Option(help="Draw the places into this PNG; must not exist.")] = None,
    rate_hz: Annotated[float, Option(min=0.1, help="Frame rate of the camera.")] = 30.0,
) -> None:
    """Count a plan's points, shots, frames and minutes, and draw it.

    Example: palpate plan preview palm --png places.png
    """
    from palpate.rig import plan_of, size_of

    chosen = plan_of(plan)
    size = size_of(chosen, rate_hz)
    result: dict[str, Any] = size._asdict()
    result["bytes"] = round((size.frames + size.reference_frames) * FRAME_KB * 1e3)
    result["plan"] = chosen.name
    result["hash"] = chosen.hash
    if png is not None:
        from palpate.reports.field_figures import draw_places

        draw_places(chosen, png)
        result["png"] = str(png)
    print_record(result)


def wrong_lines(wrong: list[CheckResult]) -> list[str]:
    """A line for each finding that failed, with what was measured and what is stated or allowed."""
    return [f"wrong: {_measured(one) if one.unit else one.code}: {one.message}" for one in wrong]


def _measured(finding: CheckResult) -> str:
    scale, unit = SHOWN_IN.get(finding.unit, (1.0, finding.unit))
    values = (finding.measured or 0.0, finding.allowed or 0.0)
    measured, allowed = (f"{round(scale * value, 6):.4g}" for value in values)
    return f"{finding.code}: {measured} {unit} ({allowed})"


def _late(clocks: Offset) -> str:
    late, low, high, jitter = (
        f"{1e3 * s:.1f}" for s in (clocks.seconds, clocks.low_s, clocks.high_s, clocks.jitter_s)
    )
    return (
        f"frames are stamped {late} ms after the force they show (95 %: {low} to {high} ms), and jitter by "
        f"{jitter} ms at most"
    )


# Ctrl-C, a request to end, and a terminal that is closed.


@contextmanager
def _signals_ask(control: OperatorControl) -> Iterator[None]:
    """Ctrl-C and a request to end abort the recording; the second time they are the emergency stop."""
    from palpate.devices.operator_control import OperatorCommand

    def ask(number: int, frame: object) -> None:
        control.ask(
            OperatorCommand.ESTOP if control.command is OperatorCommand.ABORT else OperatorCommand.ABORT
        )

    before = {number: signal.signal(number, ask) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


RigName = Annotated[str, Argument(help="A rig's TOML file, or virtual:palm.")]


@rig_app.command()
def home(
    rig: RigName,
    lifted: Annotated[
        bool, Option("--lifted", help="Your word that the probe hangs free: home without a lift by force.")
    ] = False,
) -> None:
    """Home the stage, after the probe was lifted by force.

    The probe is lifted in steps until the force no longer changes, by 8 mm at least and some 20 mm at most;
    only then does the stage run to its switches. A numb sensor reads as air does, so look first. Without a
    force sensor, and where the lift is refused, it is not homed.

    Example: palpate rig home bench.toml
    """
    from palpate.rig.commissioning.bench import open_bench
    from palpate.rig.commissioning.homing import home_clear

    typer.echo("lifting by force, then homing; Ctrl-C stops", err=True)
    with stopped_by_signals(), open_bench(rig, ("force", "stage"), position="nowhere") as bench:
        stage = bench.need_stage()
        bench.check_may_home()
        force = None if lifted and bench.force is None else bench.need_force()
        found = home_clear(stage, force, bench.mounting, bench.clock, lifted=lifted)
        at_mm = [round(1e3 * d, 4) for d in stage.position_m()]
    lift_mm = None if found is None else found.lifted_mm
    text = f"{rig}: homed, at ({', '.join(f'{d:g}' for d in at_mm)}) mm"
    if lift_mm is not None:
        text += f", after a lift of {lift_mm:.1f} mm to a flat force, as a numb sensor gives too"
    print_found({"rig": rig, "position_mm": at_mm, "lifted_mm": lift_mm}, text)


def _placed_bench(rig: str, source: PositionFrom) -> Bench:
    """Open stage and force sensor, the stage's position known."""
    from palpate.rig.commissioning.bench import open_bench

    bench = open_bench(rig, ("force", "stage"), position=source)
    try:
        bench.need_stage().position_m()
    except BaseException:
        bench.close()
        raise
    return bench


@rig_app.command()
def jog(
    rig: RigName,
    axis: Annotated[str, Option(help="x, y or z; z leads into the skin.")],
    mm: Annotated[float, Option(help="How far, with its sign [mm]; 50 mm at most.")],
    speed_mm_s: Annotated[float, Option(help="Speed [mm/s]; 10 mm/s at most.")] = 1.0,
    stop_n: Annotated[float, Option(help="Change of force that stops it [N].")] = 1.0,
    unguarded: Annotated[
        bool,
        Option(
            "--unguarded", help="Move without a force sensor, 2 mm/s at most: your word that nothing is near."
        ),
    ] = False,
    position: PositionSource = None,
) -> None:
    """Move one axis by some millimetres, guarded by force.

    Any change of force from what it is at the start stops it, and so does a sensor that repeats itself; one
    that only hums, or reads a tenth, is not told from air. Towards the skin and aside it is no faster than
    the rig can stop within its `overshoot_mm`. Where there is no force sensor, or it fails,
    nothing moves unless --unguarded is given: then at 2 mm/s at most, and nothing stops it but its limits.

    Example: palpate rig jog bench.toml --axis z --mm -2
    """
    from palpate.core import InputError
    from palpate.rig.commissioning.hand_motion import jog as jog_stage

    with stopped_by_signals(), opened_at(position, lambda source: _placed_bench(rig, source)) as bench:
        stage = bench.need_stage()
        if bench.force is None and not unguarded:
            why = bench.failed.get("force", f"the rig {bench.name!r} has no [force]")
            raise InputError(f"{why}. Not moved: nothing guards it; --unguarded moves it at 2 mm/s at most")
        if bench.limits is None:
            raise InputError(f"{rig}: a jog keeps to [limits], and the file has none; state them")
        jog_stage(
            stage,
            None if unguarded else bench.force,
            bench.mounting,
            bench.limits,
            bench.clock,
            axis=axis,
            distance_m=mm * 1e-3,
            speed_m_s=speed_mm_s * 1e-3,
            stop_n=stop_n,
        )
        at_mm = [round(1e3 * d, 4) for d in stage.position_m()]
    text = f"{rig}: at ({', '.join(f'{d:g}' for d in at_mm)}) mm"
    print_found({"rig": rig, "position_mm": at_mm, "guarded": not unguarded}, text)


@rig_app.command()
def stop(rig: RigName) -> None:
    """Stop the stage at once.

    Through the process that holds the rig, where one does, as the page's emergency stop; through the
    supervisor of a recording, also while that homes; else on the stage's own port, and a process that has
    that is told to end first. It is no substitute for a switch.

    Example: palpate rig stop bench.toml
    """
    from palpate.rig.commissioning.bench import stop_rig

    done = stop_rig(rig)
    found = {"rig": rig, "stopped": True, "how": done.how, "code": done.code}
    print_found(found | {"processes": [one.to_dict() for one in done.holders]}, f"{rig}: {done.how}")


@rig_app.command()
def status(rig: RigName) -> None:
    """Say what each device reads now, and how old that is.

    Moves nothing. Ends with status 1 where a device does not answer.

    Example: palpate rig status bench.toml --json
    """
    from palpate.rig.commissioning.bench import bench_status, open_bench, process_status

    found = process_status(rig)
    if found is None:
        with open_bench(rig) as bench:
            found = bench_status(bench)
    lines = [f"{name}: {'not known' if value is None else value}" for name, value in found.items()]
    lines = [line for line in lines if not line.startswith("problems")]
    problems: dict[str, str] = found.get("problems", {})
    lines += [f"wrong: {role}: {why}" for role, why in problems.items()]
    print_found(found, "\n".join(lines))
    if problems:
        raise typer.Exit(1)


@rig_app.command()
def zero(rig: RigName, position: PositionSource = None) -> None:
    """Measure what the force sensor reads in the air.

    The probe is lifted by 0.6 mm first: where the force changes on the way, it was in contact, and the zero
    is refused. Nothing is set in the sensor; each run measures its own.

    Example: palpate rig zero bench.toml
    """
    from palpate.rig.commissioning.hand_motion import zero as zero_force
    from palpate.rig.mean_force import Hand

    with stopped_by_signals(), opened_at(position, lambda source: _placed_bench(rig, source)) as bench:
        found = zero_force(
            Hand(bench.need_stage(), bench.need_force(), bench.mounting, bench.clock), bench.limits
        )
    print_record({"rig": rig, **asdict(found)})


@contextmanager
def _answers_kept(out: Path, asked: Any) -> Iterator[None]:
    """Where a setup ends early, keep what was answered beside the file that was to be."""
    from palpate.core.files import new_file
    from palpate.rig.commissioning.setup_answers import kept_answers, toml_text

    try:
        yield
    except BaseException:
        kept = kept_answers(asked.given)
        if kept and not out.exists():
            names = (out.with_suffix(f".answers{i or ''}.toml") for i in range(100))
            free = next(name for name in names if not name.exists())
            with new_file(free) as path:
                path.write_text(toml_text(kept), encoding="utf-8")
            typer.echo(f"your answers are kept: palpate rig setup --out {out} --answers {free}", err=True)
        raise


@rig_app.command()
def setup(
    out: Annotated[Path, Option(help="Rig file to make; must not exist.")],
    answers: Annotated[
        Path | None, Option(help="TOML file of answers, name = value; the rest is asked at a terminal.")
    ] = None,
    yes: Annotated[bool, Option("--yes", help="Take what is proposed wherever something is.")] = False,
) -> None:
    """Write a rig's file by asking, and by trying each device.

    Nothing moves before you say that it may. It ends in the check of `palpate rig check`, and says what it
    could not check. Ends with status 1 where the check found something wrong; the file stays.

    Example: palpate rig setup --out bench.toml
    """
    from palpate.rig.commissioning.rig_setup import set_up
    from palpate.rig.commissioning.setup_answers import Answers

    prompt = input if answers is None or sys.stdin.isatty() else None
    asked = Answers.read(answers, yes=yes, read=prompt) if answers else Answers(yes=yes, read=prompt)
    with stopped_by_signals(), _answers_kept(out, asked):
        found = set_up(out, asked, lambda line: typer.echo(line, err=True))
    wrong = [one for one in found.checks if not one.ok]
    lines = wrong_lines(wrong)
    lines += [f"not checked: {one}" for one in found.unchecked]
    lines.append(f"{out}: {len(found.checks) - len(wrong)} of {len(found.checks)} checks passed")
    result: dict[str, Any] = {
        "file": str(out),
        "checks": [asdict(one) for one in found.checks],
        "unchecked": list(found.unchecked),
    }
    print_found(result, "\n".join(lines))
    if wrong:
        raise typer.Exit(1)
