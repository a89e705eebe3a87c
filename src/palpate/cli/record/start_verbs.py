"""Verbs of a sensor's first ten minutes: start, collect."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from palpate.cli.verb_support import as_json, is_quiet, print_found, progress_bar, say, stopped_by_signals

if TYPE_CHECKING:
    from palpate.sensing.collection import PressCollector
    from palpate.workflows.press_feeds import PressFeed
    from palpate.workflows.start_session import StartSession

CameraOption = Annotated[
    str, Option(help="Camera: its number, path or USB serial number; or virtual:palm, virtual:tactip.")
]
ScaleOption = Annotated[
    str, Option(help="Serial port of a scale; typed for known weights; virtual beneath a virtual sensor.")
]
PressesOption = Annotated[int, Option(help="Presses to collect, with those that the run holds.", min=1)]
SeedOption = Annotated[int, Option(help="Seed of a virtual hand, and of training.", min=0)]
HandSeedOption = Annotated[
    int | None, Option(help="Seed of a virtual hand; by default another hand presses each time.", min=0)
]
UnitOption = Annotated[
    str, Option(help="Unit of the scale's lines that carry none: g, kg, N, oz or lb; a unit in a line wins.")
]
LagOption = Annotated[
    float | None, Option(help="Time constant of the scale's filter [s]; by default as presses tell.", min=0)
]
_GROUPED = re.compile(r"[1-9]\d*,\d{3}(?!\d)|_")  # a thousand to some, 1 to others
ADVICE_S = 5.0  # after which advice that nobody has heeded is told again
RealTime = Annotated[bool, Option("--real-time", help="Let a virtual second take one.")]


def collect(
    camera: CameraOption,
    scale: ScaleOption,
    out: Annotated[Path, Option(help="Run to record into; one that is there goes on.")],
    presses: PressesOption = 40,
    sensor: Annotated[str, Option(help="What the sensor is called; by default by its camera.")] = "",
    session: Annotated[str, Option(help="What this sitting is called; by default the day.")] = "",
    seed: HandSeedOption = None,
    unit: UnitOption = "",
    scale_lag_s: LagOption = None,
    real_time: RealTime = False,
) -> None:
    """Collect presses by hand, labelled by a scale.

    Press the sensor on the scale, hold still for a second, let go; steady presses are found by themselves,
    and what is missing is said. With --scale typed, lay known weights on and type each while it lies there.

    Example: palpate collect --camera 0 --scale /dev/ttyUSB0 --out presses
    Example: palpate collect --camera virtual:palm --scale virtual --out presses
    """
    from palpate.workflows.press_feeds import collector_of, open_feed

    with stopped_by_signals(), progress_bar() as progress:
        feed = open_feed(camera, scale, seed=seed, real_time=real_time, unit=_unit(unit), lag_s=scale_lag_s)
        try:
            with collector_of(feed, out, presses, sensor, session) as collector:
                if (have := len(collector.presses)) >= presses:
                    say(
                        f"{out} holds {have} presses, and --presses {presses} is how many there shall be in "
                        f"all: none is collected; give {have + 1} or more",
                        err=True,
                    )
                _pressed(feed, collector, progress)
                status = collector.status
        finally:
            feed.close()
    print_found(status, f"{out}: {status['text']} ({status['refused']} did not count)")


def _pressed(feed: PressFeed, collector: PressCollector, progress: Any) -> None:
    """Take frames and forces in until all presses are there; tell of each."""
    beside = _beside(feed)
    feed.press(go_on=True)
    told = -1
    while len(collector.presses) < collector.asked:
        frame = feed.grab()
        if feed.force is not None:
            collector.on_force(feed.force.drain())
        collector.on_frame(frame)
        beside(collector)
        if len(collector.presses) != told:
            told = len(collector.presses)
            progress("presses", told, collector.asked)
    feed.press(go_on=False)


def _beside(feed: PressFeed) -> Callable[[PressCollector], None]:
    """What is done after each frame: typed weights are stated, and it is told how the presses stand."""
    typed = (
        None
        if feed.force is not None
        else _typed_weights(getattr(feed, "lay", None), getattr(feed, "lifted", None))
    )
    tell = _teller()

    def do(collector: PressCollector) -> None:
        if typed is not None:
            typed(collector)
        if not is_quiet() and not as_json():
            tell(collector)

    return do


def _teller() -> Callable[[PressCollector], None]:
    """Tell of each press that counts or does not, and again and again of what keeps any from counting."""
    told, told_s = -1, 0.0

    def tell(collector: PressCollector) -> None:
        nonlocal told, told_s
        count = len(collector.presses) + collector.refusals
        if count == told and (time.monotonic() - told_s < ADVICE_S or not collector.advice):
            return
        told, told_s = count, time.monotonic()
        status = collector.status
        words = status["text"] if len(collector.presses) else "press anywhere, and hold still for a second"
        if status["last_refused"] and collector.refusals:
            words += f"; the last that did not count: {status['last_refused']['why']}"
        if status["advice"]:
            words += f"; {status['advice']}"
        say(words, err=True)

    return tell


def _typed_weights(
    lay: Callable[[float], None] | None, lifted: Callable[[], None] | None
) -> Callable[[PressCollector], None]:
    """Read weights from the keyboard in a thread; what is returned states those that have come."""
    import queue
    import sys
    import threading

    from palpate.core import InputError, PalpateError

    lines: queue.Queue[str | None] = queue.Queue()
    say("lay a weight on, type its mass in g (or its force as 2.5N), take it off", err=True)

    def read() -> None:
        with suppress(OSError, ValueError):
            for line in sys.stdin or ():
                lines.put(line.strip())
        lines.put(None)

    threading.Thread(target=read, name="typed weights", daemon=True).start()
    ended = False
    laid: list[float] = []
    judged = -1  # presses that were judged as the last weight was laid on

    def laid_on(collector: PressCollector) -> bool:
        """Whether a virtual hand is busy with a weight, which is stated as it lies still."""
        nonlocal judged
        if not laid:
            return False
        if collector.status["holding"] and not collector.weight_stated:
            collector.label(laid[0])
            if lifted is not None:
                lifted()
        if len(collector.presses) + collector.refusals > judged:
            laid.clear()
        return bool(laid)

    def state(collector: PressCollector) -> None:
        nonlocal ended, judged
        while not laid_on(collector) and not lines.empty():
            words = lines.get()
            ended = ended or words is None
            try:
                if words and lay is None:
                    collector.label(force_of(words))
                elif words and lay is not None:
                    lay(force_of(words))
                    laid.append(force_of(words))
                    judged = len(collector.presses) + collector.refusals
            except PalpateError as e:
                say(str(e), err=True)
        short = len(collector.presses) < collector.asked
        if ended and short and not collector.weight_stated and not laid and lines.empty():
            raise InputError(
                f"nothing more can be typed: the standard input has ended; {collector.coverage.text}. "
                "The same command goes on"
            )

    return state


def force_of(words: str) -> float:
    """Force of a weight as typed: a mass in g, or with its unit as 200g, 0.2kg, 7oz, 2.5N [N].

    Example:
        >>> round(force_of("100"), 4), force_of("2.5 N")
        (0.9807, 2.5)
    """
    from palpate.core import InputError
    from palpate.rig.real.scale import NEWTONS

    text = "" if _GROUPED.search(words) else words.replace(",", ".").strip()
    number = text.rstrip("abcdefghijklmnopqrstuvwxyzN ").strip()
    unit = text[len(number) :].strip() or "g"
    try:
        value = float(number)
        return value * NEWTONS[unit]
    except (ValueError, KeyError) as e:
        raise InputError(
            f"{words!r} is no weight; type a mass in g, or with a unit: {', '.join(NEWTONS)}; a "
            "thousand without a comma: 1000 or 1kg"
        ) from e


def start(
    folder: Annotated[Path, Option(help="Folder of the session; one that is there goes on.")] = Path(
        "my-sensor"
    ),
    terminal: Annotated[
        bool, Option("--terminal", help="Do it all here, without pages; by default on a virtual sensor.")
    ] = False,
    camera: Annotated[
        str | None,
        Option(
            help="Camera: its number, path or USB serial number; or virtual:palm, virtual:tactip. By default "
            "the session's own; of a new one virtual:palm."
        ),
    ] = None,
    scale: Annotated[
        str | None,
        Option(
            help="Serial port of a scale; typed for known weights; virtual beneath a virtual sensor. By "
            "default the session's own; of a new one virtual."
        ),
    ] = None,
    presses: Annotated[
        int | None,
        Option(
            help="Presses in all, with those that are there; 40, or as many as a session was begun for.",
            min=1,
        ),
    ] = None,
    more: Annotated[
        int, Option(help="Presses to collect beside those that are there, and learn from all anew.", min=0)
    ] = 0,
    seed: SeedOption = 0,
    unit: UnitOption = "",
    scale_lag_s: LagOption = None,
    real_time: RealTime = False,
    port: Annotated[int, Option(min=1, max=65535, help="Of the pages, on 127.0.0.1.")] = 8080,
) -> None:
    """Go from a plugged-in camera to live newtons, step by step.

    Opens the page that leads through it. With --terminal all steps are done here: settings, untouched sensor,
    presses, training, and the commands that do the same are printed. Left half-way, the same command goes on.

    Example: palpate start

    Example: palpate start --terminal --camera 0 --scale /dev/ttyUSB0

    Example: palpate start --terminal --more 20
    """
    if not terminal:
        own = {"--more": more, "--seed": seed, "--real-time": real_time, "--json": as_json()}
        _refuse_terminals_own(own, scale_lag_s)
        chosen = {"camera": camera, "scale": scale, "presses": presses, "unit": _unit(unit)}
        _open_page(folder, port, chosen)
        return
    from palpate.workflows.start_session import StartSession

    _refuse_both(presses, more)
    session = StartSession(folder)
    if camera is None:
        camera = session.state.camera or "virtual:palm"
    if scale is None:
        scale = (session.state.scale if camera == session.state.camera else "") or "virtual"
    with stopped_by_signals(), session.held(keep_choice=False), progress_bar() as progress:
        if not more and session.has_nothing_left_by(camera, scale, presses):
            say(session.nothing_left_text, err=True)
        else:
            _choose(session, camera, scale, presses, seed, _unit(unit) or None, scale_lag_s)
        if more:
            session.ask_more(more)
        if "collect" not in session.state.done and session.remaining:
            say(session.remaining, err=True)
        if session.step in ("settings", "untouched", "collect"):
            feed = session.feed(real_time=real_time)
            try:
                for line in session.check_settings(feed)["health"]["advice"]:
                    say(line, err=True)
                session.take_untouched(feed)
                session.collect(feed, progress, beside=_beside(feed))
            finally:
                feed.close()
        if session.step == "train":
            session.train(progress)
    found = session.to_dict()
    curve = (session.state.trained.get("curve") or {}).get("text", "")
    simulated = "Simulated, not measured:" if session.state.camera.startswith("virtual:") else ""
    lines = [
        session.state.collected.get("text", ""),
        simulated,
        session.sentence,
        session.state.trained.get("left_out", ""),
        curve,
        session.newest_text,
        "The same by commands, where these folders are not there yet:",
    ]
    print_found(found, "\n".join([one for one in lines if one] + session.commands()))


def _refuse_both(presses: int | None, more: int) -> None:
    """Refuse to be told in two ways how many presses shall be collected."""
    from palpate.core import InputError

    if presses is not None and more:
        raise InputError(
            f"--presses {presses} and --more {more}: --presses is how many there shall be in all, --more how "
            "many beside those that are there; give one of them"
        )


def _choose(
    session: StartSession,
    camera: str,
    scale: str,
    presses: int | None,
    seed: int,
    unit: str | None,
    scale_lag_s: float | None,
) -> None:
    """Choose camera and scale, where that was not done yet or they are others, and how many presses."""
    session.choose_if_other(camera, scale, asked=presses, seed=seed, unit=unit, scale_lag_s=scale_lag_s)
    if presses is not None and (said := session.ask_for(presses)):
        say(f"{said}; --more N does", err=True)


def _unit(name: str) -> str:
    """A unit as it is known, or none."""
    if not name:
        return ""
    from palpate.core import InputError
    from palpate.rig.real.scale import NEWTONS

    if name not in NEWTONS:
        raise InputError(f"--unit {name}: it is not known; give one of {', '.join(NEWTONS)}")
    return name


def _refuse_terminals_own(given: dict[str, Any], scale_lag_s: float | None) -> None:
    """Refuse what the page has no field for, in place of losing it."""
    from palpate.core import InputError

    lost = [name for name, value in given.items() if value]
    lost += [] if scale_lag_s is None else ["--scale-lag-s"]
    if lost:
        raise InputError(
            f"the page that leads through it has no field for {', '.join(lost)}: give --terminal, too"
        )


def _open_page(folder: Path, port: int, chosen: dict[str, Any]) -> None:
    """Serve the studio, whose first page leads through the steps; what was chosen stands in its fields."""
    from palpate.cli.study.study_verbs import serve_studio

    told = {name: value for name, value in chosen.items() if value not in (None, "")}
    serve_studio(port=port, workspace=folder.absolute().parent, page={"folder": folder.name} | told)
