"""Verbs that render softness now, on a bench of devices or on the virtual one, and stop it."""

from __future__ import annotations

import csv
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Exit, Option

from palpate.cli.stop_command import DEFAULT_BENCH, stop_display
from palpate.cli.verb_support import ENDING, as_json, is_quiet, print_found

if TYPE_CHECKING:
    from palpate.softness import Mode, RenderingLaw, SoftObject
    from palpate.softness.control import LoopSample
    from palpate.softness.process import RenderingSession, RenderingStatus

LOOK_S = 0.1
COLUMNS: dict[str, Callable[[LoopSample], float]] = {
    "time_s": lambda one: one.time_s,
    "pushed_mm": lambda one: 1e3 * one.pushed_m,
    "arm_mm": lambda one: 1e3 * one.arm_m,
    "displacement_mm": lambda one: 1e3 * one.displacement_m,
    "area_mm2": lambda one: 1e6 * one.area_m2,
    "pressure_kPa": lambda one: 1e-3 * one.pressure_pa,
    "told_kPa": lambda one: 1e-3 * one.told_pa,
    "force_N": lambda one: one.force_n,
    "arm_force_N": lambda one: one.arm_force_n,
    "touched": lambda one: int(one.touched),
}

BenchPath = Annotated[Path | None, Option("--bench", help="TOML file of display and arm; else virtual.")]


def run(
    object_: Annotated[Path, Option("--object", help="TOML file of the object's curves, with units.")],
    bench: BenchPath = None,
    mode: Annotated[str, Option(help="CM1: both cues. CM2: the arm's. CM3: the skin's.")] = "CM1",
    seconds: Annotated[float, Option(help="How long; until Ctrl-C if left out [s].")] = float("inf"),
    peak_n: Annotated[float, Option(help="Force of the virtual bench's finger [N].")] = 1.0,
    frequency_hz: Annotated[float, Option(help="Its presses a second, 0.1 to 5 [Hz].")] = 1.0,
    samples: Annotated[Path | None, Option(help="CSV of samples, 100 a second; must not exist.")] = None,
) -> None:
    """Render an object on a display and an arm, now.

    Without --bench the devices are virtual, and a virtual finger presses. The rendering ends by Ctrl-C, by
    `palpate display stop` and on any fault; then the chamber vents and the arm brakes.

    Example: palpate display run --object foam.toml --seconds 10
    """
    from palpate.core import RangeError, SafetyError
    from palpate.softness import read_object
    from palpate.softness.process import RenderingSession, read_bench

    kind = checked_press(mode, frequency_hz, 5, samples)
    if not seconds > 0:
        raise RangeError(f"a rendering of {seconds:g} s; give more than 0 s")
    soft, file = read_object(object_), read_bench(bench)
    check_peak(soft, peak_n)
    seen: list[LoopSample] = []
    with ExitStack() as stack:
        ending = stack.enter_context(_ended_by_signals())
        keep = stack.enter_context(_kept(samples))
        session = stack.enter_context(RenderingSession(file, soft, kind, peak_n, frequency_hz))
        say = stack.enter_context(_told())

        def take(more: Sequence[LoopSample]) -> None:
            seen.extend(more)
            keep(more)
            say(session, more)

        status = _watch(session, seconds, ending, take)
    answer = _answer(status, session.law, seen, samples)
    print_found(answer)
    if answer["ended_by_fault"]:
        raise SafetyError(f"the rendering ended by itself: {status.why}")


def checked_press(mode: str, frequency_hz: float, max_hz: float, new: Path | None) -> Mode:
    """Return the mode by its name; reject a press or a file that cannot be before anything is opened."""
    from palpate.core import InputError, RangeError, refuse_existing
    from palpate.softness import Mode

    if mode not in tuple(Mode):
        raise InputError(f"mode {mode!r}; there are {', '.join(Mode)}")
    if not 0.1 <= frequency_hz <= max_hz:
        raise RangeError(f"presses at {frequency_hz:g} Hz; 0.1 to {max_hz:g} Hz are allowed")
    refuse_existing(new)
    return Mode(mode)


def check_peak(soft: SoftObject, peak_n: float) -> None:
    """Reject a press beyond the forces at which an object is known."""
    from palpate.core import RangeError

    if not 0 < peak_n <= soft.greatest_n:
        raise RangeError(f"a press of {peak_n:g} N; {soft.name} is known from 0 to {soft.greatest_n:g} N")


def _watch(
    session: RenderingSession,
    seconds: float,
    ending: threading.Event,
    take: Callable[[list[LoopSample]], Any],
) -> RenderingStatus:
    """Hand on what comes until it ends, by time, by wish or by itself; then end it, and say how it stood."""
    end_s, over = time.monotonic() + seconds, False
    while session.status().state != "ended" and not ending.wait(
        max(0.0, min(LOOK_S, end_s - time.monotonic()))
    ):
        take(session.taken())
        over = time.monotonic() >= end_s and not ending.is_set()
        if over:
            break
    status = session.stop()
    take(session.taken())
    return replace(status, why=f"its {seconds:g} s were over") if over and status.wished else status


@contextmanager
def _ended_by_signals() -> Iterator[threading.Event]:
    """What Ctrl-C, a request to end and a closed terminal set; the devices are made safe in any case."""
    asked = threading.Event()
    before = {number: signal.signal(number, lambda *_: asked.set()) for number in ENDING}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _kept(path: Path | None) -> Iterator[Callable[[Sequence[LoopSample]], None]]:
    """Writes samples as they come; a new file, or none."""
    from palpate.core import storage_errors

    if path is None:
        yield lambda more: None
        return
    with storage_errors(path), path.open("x", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)

        def keep(more: Sequence[LoopSample]) -> None:
            table.writerows([f"{of(one):.6g}" for of in COLUMNS.values()] for one in more)
            file.flush()

        yield keep


@contextmanager
def _told() -> Iterator[Callable[[RenderingSession, Sequence[LoopSample]], None]]:
    """A line on stderr that shows how it goes, where somebody is looking."""
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    if is_quiet() or as_json() or not console.is_terminal:
        yield lambda session, more: None
        return
    with Live("opens", console=console, transient=True, refresh_per_second=10) as live:

        def say(session: RenderingSession, more: Sequence[LoopSample]) -> None:
            now = session.status()
            last = f"{_measured(more[-1])}; " if more else ""
            live.update(f"{now.object}, {now.mode.value}: {last}{_timing(now)}. Ctrl-C ends it")

        yield say


def _measured(one: LoopSample) -> str:
    return (
        f"{one.force_n:5.2f} N, {1e6 * one.area_m2:6.1f} mm², {1e3 * one.displacement_m:6.2f} mm, "
        f"{1e-3 * one.pressure_pa:5.1f} kPa"
    )


def _timing(status: RenderingStatus) -> str:
    return (
        f"{status.periods} periods, {status.late_share:.3%} longer than 1.5 ms, longest "
        f"{1e3 * status.longest_s:.1f} ms"
    )


def _answer(
    status: RenderingStatus, law: RenderingLaw, seen: Sequence[LoopSample], samples: Path | None
) -> dict[str, Any]:
    """What is said of a rendering that has ended."""
    import numpy as np

    from palpate.softness import Mode

    felt = [one for one in seen if one.touched]
    force, area, way = (
        np.array([getattr(one, name) for one in felt]) for name in ("force_n", "area_m2", "displacement_m")
    )
    cues = {"area": (law.object.area, area), "displacement": (law.object.displacement, way)}
    unkept = {Mode.KINESTHETIC: "area", Mode.CUTANEOUS: "displacement"}.get(status.mode)
    peak = float(force.max()) if len(felt) else 0.0
    off = {
        cue: None if cue == unkept or not peak else float(
            np.sqrt(np.mean((force - np.interp(x, curve.x, curve.force_n)) ** 2)) / peak
        )
        for cue, (curve, x) in cues.items()
    }  # fmt: skip
    return {
        "object": status.object,
        "mode": status.mode.value,
        "simulated": status.simulated,
        "ended": status.why,
        "ended_by_fault": not status.wished,
        "periods": status.periods,
        "late_share": status.late_share,
        "longest_period_ms": 1e3 * status.longest_s,
        "samples": len(seen),
        "peak_N": peak,
        **{f"force_{cue}_rms_of_peak": value for cue, value in off.items()},
        "file": None if samples is None else str(samples),
    }


def stop(name: Annotated[str, Option(help="Name of the bench, as its file has it.")] = DEFAULT_BENCH) -> None:
    """Stop a rendering, from any terminal: vent and brake.

    Example: palpate display stop --name "desk bench"
    """
    raise Exit(stop_display(name, as_json()))
