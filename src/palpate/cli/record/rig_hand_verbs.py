"""Verbs that work a rig by hand: home, jog, stop, status, zero, and the guided setup of its file."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from palpate.cli.record.rig_verbs import PositionSource, opened_at, rig_app, wrong_lines
from palpate.cli.verb_support import print_found, stopped_by_signals

if TYPE_CHECKING:
    from palpate.rig.commissioning.bench import Bench
    from palpate.rig.rig_file import PositionFrom

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
    from palpate.rig.commissioning.hand_motion import Hand, zero as zero_force

    with stopped_by_signals(), opened_at(position, lambda source: _placed_bench(rig, source)) as bench:
        found = zero_force(
            Hand(bench.need_stage(), bench.need_force(), bench.mounting, bench.clock), bench.limits
        )
    x, y, z = found.force_n
    text = (
        f"{rig}: {x:.4f}, {y:.4f}, {z:.4f} N, the same over a lift of {found.lifted_mm:.1f} mm; noise "
        f"{found.noise_n:.4f} N along the press, {found.rate_hz:.0f} samples/s"
    )
    print_found({"rig": rig, **asdict(found)}, text)


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
