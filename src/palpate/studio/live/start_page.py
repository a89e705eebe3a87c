"""Start: from a camera, or a virtual sensor, to live newtons, each step a card that says how it stands.

The steps are done by a process of their own, and kept in a folder of the workspace, which stands in the
page's address: whoever opens it goes on where it was left.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from html import escape
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from palpate.core import InputError, PalpateError
from palpate.rig.real.scale import NEWTONS
from palpate.studio.library.workspace import Workspace
from palpate.studio.live.live_desk import (
    VIRTUAL,
    Cameras,
    LiveDesk,
    check_devices,
    plugged_in,
    source_options,
)
from palpate.studio.live.live_page import TYPED, live_address, live_name
from palpate.studio.live.start_desk import StartDesk, StartRun, kept_session
from palpate.studio.page_shell import (
    PageBeat,
    commands_html,
    keep_in_address,
    page_shell,
    page_title,
    progress_html,
    simulated_badge,
    state_word,
    trouble_html,
)
from palpate.studio.status_text import duration, number

REFRESH_S = 0.25
MAX_ADDRESS, MAX_DIGITS = 200, 5  # of what the page's address states
FIRST = "my-sensor"
STEPS = {
    "camera": "Camera and scale",
    "settings": "Picture",
    "untouched": "Untouched sensor",
    "collect": "Presses",
    "train": "Calibration",
    "live": "Live newtons",
}
SCALES = {
    "virtual": "virtual scale",
    "typed": "weights that are typed",
}
UNITS = {"": "as it prints, with its unit", "g": "g", "kg": "kg", "N": "N", "oz": "oz", "lb": "lb"}
"""Of numbers that a scale prints without one; they weigh nothing until it is known."""
SELECT = 'dense outlined options-dense stack-label id="{}" aria-label="{}"'
OUTLINED = 'dense outlined stack-label id="{}" aria-label="{}"'


class StartPage:
    """First page, in one tab.

    Args:
        name: of the session's folder, as in the address; "" for a new one.
        asked: camera, scale, unit and presses, where the address states them as `palpate start` does.
    """

    def __init__(
        self, workspace: Workspace, starts: StartDesk, lives: LiveDesk, name: str,
        asked: Mapping[str, str] | None = None, cameras: Cameras = plugged_in,
    ) -> None:  # fmt: skip
        self._workspace, self._starts, self._lives = workspace, starts, lives
        self._cameras, self._asked = cameras, dict(asked or {})
        self._kept: dict[str, Any] = {}
        self._picture_number, self._chosen = -1, False
        self._gone: str | None = None  # folder whose presses were deleted
        self._pressing: StartRun | None = None  # what presses anew there
        page_shell("start")
        PageBeat()
        page_title("Start", "from a plugged-in sensor to readings that say how sure they are")
        with ui.element("main").classes("sheet start"):
            self._trouble = ui.html("", sanitize=False).props('id="start-trouble" role="alert"')
            self._choice_card(name or FIRST)
            with ui.element("div").classes("pair"):
                self._steps = ui.html("", sanitize=False).classes("steps").props('id="steps" role="status"')
                self._press_card()
            self._result = ui.html("", sanitize=False).props('id="result"')
            self._live_button = ui.button("Read it live", on_click=self._go_live)
            self._live_button.props('unelevated no-caps id="go-live"').set_visibility(False)
            self._commands = ui.html("", sanitize=False).props('id="commands"')
        ui.timer(0.01, self._fill, once=True)
        ui.timer(REFRESH_S, self._refresh)

    def _choice_card(self, name: str) -> None:
        with ui.element("section").classes("card").props('aria-label="Camera and scale"'):
            ui.html(f"<h2>{STEPS['camera']}</h2>", sanitize=False)
            ui.label(
                "Choose what is plugged in, or type a camera's number or serial number, and a scale's port. "
                "A virtual sensor is pressed by a virtual hand: what it reads is simulated, not measured."
            ).classes("soft")
            with ui.element("div").classes("fields choice q-mt-sm"):
                self._camera = ui.select(dict(VIRTUAL), value="virtual:palm", label="camera", **TYPED)
                self._camera.props(SELECT.format("camera", "camera")).on_value_change(self._suit_scale)
                self._scale = ui.select(dict(SCALES), value="virtual", label="scale", **TYPED)
                self._scale.props(SELECT.format("scale", "scale that labels presses"))
                self._scale.on_value_change(self._suit_unit)
                self._unit = ui.select(UNITS, value="", label="unit of the scale's numbers")
                self._unit.props(SELECT.format("unit", "unit of the scale's numbers that carry none"))
                self._suit_unit()
                self._presses = ui.number("presses", value=40, min=10, max=400, format="%d")
                self._presses.props(OUTLINED.format("presses", "presses to collect"))
                self._folder = ui.input("folder in the workspace", value=name)
                self._folder.props(OUTLINED.format("folder", "folder of the session"))
            with ui.row().classes("items-center q-mt-sm"):
                self._button = ui.button("Begin", on_click=self._begin).props(
                    'unelevated no-caps id="start-begin"'
                )
                self._anew = ui.button("Press anew", on_click=lambda: self._begin(anew=True)).props(
                    'outline no-caps id="press-anew"'
                )
                self._anew.set_visibility(False)
                self._stop = ui.button("Stop", on_click=self._stopped).props(
                    'outline no-caps id="start-stop"'
                )
                self._clock = ui.label("").classes("soft")

    def _press_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Presses"'):
            ui.html("<h2>What the camera sees, and what was pressed</h2>", sanitize=False)
            self._picture = ui.interactive_image("", sanitize=False).classes("w-full camera")
            self._picture.props('alt="no picture yet"')
            self._caption = ui.html("", sanitize=False).props('id="picture-caption" role="status"')
            self._collect = ui.html(NO_PRESSES, sanitize=False).props('id="collect"')
            with ui.row().classes("items-center") as self._typed:
                self._weight = ui.number("weight lying there now", value=100.0, min=0.1, suffix="g")
                self._weight.props(OUTLINED.format("weight", "weight that lies on the sensor now, in grams"))
                ui.button("It lies there", on_click=self._weigh).props('outline no-caps id="weigh"')
            self._typed.set_visibility(False)

    async def _fill(self) -> None:
        cameras = await asyncio.to_thread(self._cameras)
        self._camera.set_options({**VIRTUAL, **cameras}, value=self._camera.value)
        await self._look()
        self._take_asked()

    def _take_asked(self) -> None:
        """Take what the address states, which says more than what was chosen before."""
        for element, key in ((self._camera, "camera"), (self._scale, "scale"), (self._unit, "unit")):
            if value := self._asked.get(key, "")[:MAX_ADDRESS]:
                _offer(element, value)
        presses = self._asked.get("presses", "")
        if presses.isascii() and presses.isdigit() and len(presses) < MAX_DIGITS:
            self._presses.set_value(int(presses))

    async def _look(self) -> None:
        """Take in the session that the folder holds."""
        try:
            self._kept = await asyncio.to_thread(kept_session, self._path())
        except PalpateError as e:
            self._kept = {}
            self._trouble.set_content(trouble_html(str(e)))
        if self._kept and not self._chosen:
            self._chosen = True
            for element, key in ((self._camera, "camera"), (self._scale, "scale")):
                value = str(self._kept[key])
                if value in element.options or not self._kept.get("unopened"):
                    _offer(element, value)  # a camera that never gave a frame is chosen anew
            if "gone" in self._kept:
                self._gone = str(self._folder.value)
                self._trouble.set_content(trouble_html(str(self._kept["gone"])))
            self._unit.set_value(self._kept["unit"])
            self._presses.set_value(self._kept["asked"])

    def _path(self) -> Any:
        return self._workspace.resolve(str(self._folder.value or ""))

    def _suit_scale(self) -> None:
        """A virtual scale lies beneath virtual sensors alone."""
        virtual = str(self._camera.value).startswith("virtual:")
        if virtual != (self._scale.value == "virtual"):
            self._scale.set_value("virtual" if virtual else "typed")

    def _suit_unit(self) -> None:
        """Only a scale on a port has one to state."""
        self._unit.set_visibility(str(self._scale.value) not in SCALES)

    async def _begin(self, *, anew: bool = False) -> None:
        """Begin, or go on; or press as many as were asked for `anew`, where those that were are gone."""
        self._trouble.set_content("")
        try:
            presses = self._presses.value
            if presses is None or presses != int(presses):
                from palpate.workflows.start_session import MIN_TO_LEARN

                given = "no number of presses" if presses is None else f"{presses:g} presses"
                raise InputError(f"{given}; give a whole number of {MIN_TO_LEARN} or more, 40 is a good one")
            scale = str(self._scale.value)
            check_devices(str(self._camera.value), scale, self._cameras)
            work = (self._path(), str(self._camera.value), scale, int(presses))
            unit = "" if scale in SCALES else str(self._unit.value or "")
            more = int(presses) if anew else 0
            await asyncio.to_thread(self._starts.begin, *work, unit=unit, more=more)
            self._pressing = self._run()
        except PalpateError as e:
            self._trouble.set_content(trouble_html(str(e)))
            return
        self._trouble.set_content("")  # of the process before, if it was shown again meanwhile
        self._chosen = True
        keep_in_address(folder=self._folder.value)

    async def _stopped(self) -> None:
        run = self._run()
        if run is not None:
            await asyncio.to_thread(run.close)

    def _weigh(self) -> None:
        run = self._run()
        if run is not None and self._weight.value:
            run.weigh(float(self._weight.value) * NEWTONS["g"])

    async def _go_live(self) -> None:
        session = self._session()
        camera, calibration = str(session["camera"]), str(session["calibration"])
        self._live_button.disable()
        try:
            options = await asyncio.to_thread(source_options, self._workspace, camera, self._cameras)
            options |= {"calibration": calibration, "runs": str(self._workspace.folder / "runs")}
            sensor = await asyncio.to_thread(self._lives.begin, live_name(camera), options)
            if sensor.connection.status is not None:
                await asyncio.to_thread(sensor.connection.ask, "calibration", path=calibration)
        except PalpateError as e:
            self._trouble.set_content(trouble_html(str(e)))
            return
        finally:
            self._live_button.enable()
        ui.navigate.to(live_address([sensor.name]))

    def _run(self) -> StartRun | None:
        try:
            return self._starts.run(self._path())
        except PalpateError:
            return None

    def _session(self) -> dict[str, Any]:
        run = self._run()
        return (run.session if run is not None else {}) or self._kept

    async def _refresh(self) -> None:
        run, session = self._run(), self._session()
        running = run is not None and run.running
        self._button.set_enabled(not running)
        goes_on = session and session.get("step") != "live" and not session.get("unopened")
        self._button.set_text("Go on" if goes_on else "Begin")
        collects = running or (run is not None and run is self._pressing and bool(run.collect))
        self._anew.set_visibility(self._folder.value == self._gone and not collects)
        self._stop.set_visibility(running)
        self._clock.set_text(f"for {duration(time.monotonic() - run.begun_s)}" if running and run else "")
        if run is not None and run.why and not running:
            self._set(self._trouble, trouble_html(run.why))
        self._set(self._steps, steps_html(session, run))
        collected = _collected(session, run)
        said = trouble_html(run.said) if run is not None and run.said else ""
        empty = NOT_YET if running else NO_PRESSES
        self._set(self._collect, (collected_html(collected, reads_now(run)) if collected else empty) + said)
        self._typed.set_visibility(running and session.get("scale") == "typed")
        if run is not None and run.picture is not None and run.picture[0] != self._picture_number:
            self._picture_number = run.picture[0]
            asked = urlencode({"folder": str(self._folder.value), "n": self._picture_number})
            self._picture.set_source(f"/start/picture?{asked}")
        if self._picture_number > 0:
            words = caption_of(run)
            if words not in self._caption.content:
                self._picture.props(f'alt="{words}"')
                self._caption.set_content(f'<p class="soft">{words}</p>')
        done = session.get("step") == "live" and not running
        self._live_button.set_visibility(done)
        self._set(self._result, result_html(session) if done else "")
        commands = list(session.get("commands") or ())
        heading = '<section class="card"><h2>The same by commands</h2>'
        self._set(self._commands, f"{heading}{commands_html(commands)}</section>" if commands else "")

    @staticmethod
    def _set(element: ui.html, text: str) -> None:
        if element.content != text:
            element.set_content(text)


def _offer(element: ui.select, value: str) -> None:
    """Choose a value of a list, which is offered beside those that are there."""
    element.set_options({value: value} | dict(element.options), value=value)


NOT_YET = '<p class="empty">Collecting has not begun yet: leave the sensor untouched.</p>'
NO_PRESSES = '<p class="empty">No press yet. Press anywhere, hold still for a second, let go.</p>'


def steps_html(session: Mapping[str, Any], run: StartRun | None) -> str:
    """The steps as cards: done, under way, or still to come, each in a word and with what it found."""
    running = run is not None and run.running
    parts = []
    for place, (step, title) in enumerate(STEPS.items(), 1):
        state, look = _state_of(step, session, run if running else None)
        told = {**session, "collected": _collected(session, run)}
        if state == "to come":  # what there is of it is of before
            told |= {"trained": {}}
        found = _found(step, told)
        if run is not None and running and step == _at(run):
            found += progress_html(run.step, run.done, run.total, title)
        words = "being collected" if (step, state) == ("collect", "under way") else state
        heading = f"<h3>{place}. {title} {state_word(words, look)}</h3>"
        parts.append(f'<section class="card step" data-state="{state}">{heading}{found}</section>')
    return "".join(parts)


def _collected(session: Mapping[str, Any], run: StartRun | None) -> dict[str, Any]:
    """The presses so far; of a process that has yet to collect none, whatever was collected before."""
    if run is not None and run.collect:
        return run.collect
    before = run is not None and run.running and _at(run) != "train"
    return {} if before else dict(session.get("collected") or {})


def _at(run: StartRun) -> str:
    """The step that a process is at; before it has told, it looks for camera and scale."""
    return run.at if run.at in STEPS else "camera"


def _state_of(step: str, session: Mapping[str, Any], running: StartRun | None) -> tuple[str, str]:
    """State of a step in words, and its look."""
    order = list(STEPS)
    if running is not None:
        after = order.index(step) - order.index(_at(running))
        return ("done", "") if after < 0 else ("to come" if after else "under way", "warn")
    done, now = list(session.get("done") or ()), str(session.get("step") or "camera")
    if session.get("unopened"):  # chosen, and never opened
        done, now = [], "camera"
    if step in done or (step == "live" and now == "live"):
        return ("ready" if step == "live" else "done"), ""
    return ("waits" if step == now else "to come"), "warn"


def reads_now(run: StartRun | None) -> bool:
    """Whether camera and scale are being read."""
    return run is not None and run.running and run.at in ("settings", "untouched", "collect")


def caption_of(run: StartRun | None) -> str:
    """What the picture shows: the camera as it is read now, or the last of the presses."""
    if reads_now(run):
        return "What the camera sees now."
    return "The last picture that was taken; the camera is not being read now."


def _found(step: str, session: Mapping[str, Any]) -> str:
    """What a step has found, in words."""
    if step == "camera" and session.get("camera"):
        bare = "; no frame has come from it yet: choose again above" if session.get("unopened") else ""
        words = f"{session['camera']}, scale: {session['scale']}{bare}"
        return f'<p class="soft">{escape(words)}</p>'
    settings = session.get("settings") or {}
    if step == "settings" and settings:
        width, height = settings["size_px"]
        advice = (settings.get("health") or {}).get("advice") or ()
        told = f'<p class="soft">{width} × {height} px, {settings["rate_hz"]:.1f} frames a second</p>'
        return told + "".join(f'<p class="advice">{escape(str(one))}</p>' for one in advice)
    if step == "collect" and session.get("collected"):
        return f'<p class="soft">{escape(str(session["collected"].get("text", "")))}</p>'
    if step == "train" and session.get("trained"):
        return f'<p class="soft">calibration {escape(str(session["trained"].get("id", "")))}</p>'
    return ""


def collected_html(collect: Mapping[str, Any], now_too: bool = True) -> str:
    """Presses so far: how many, what is missing, where and how hard was pressed, and how it stands now."""
    force = collect.get("force_N")
    now = "hold still …" if collect.get("touched") else "untouched"
    now = "held still" if collect.get("holding") else now
    shown = f", {number(force, 2)} N" if isinstance(force, int | float) else ""
    told = f"<p><b>{escape(str(collect.get('text', '')))}</b></p>"
    told += f'<p class="soft">now: {now}{shown}</p>' if now_too and "touched" in collect else ""
    refused = collect.get("last_refused")
    if refused:
        why = escape(str(refused["why"]))
        told += f'<p class="soft">{collect.get("refused")} did not count; the last: {why}</p>'
    if collect.get("advice"):
        told += f'<p class="advice">{escape(str(collect["advice"]))}</p>'
    return told + coverage_html(collect.get("map") or {})


def coverage_html(coverage: Mapping[str, Any]) -> str:
    """A table of the image's nine fields: how many presses in each, and up to which force."""
    counts, edges = coverage.get("counts"), coverage.get("edges_N")
    if not counts or not edges:
        return ""
    rows = []
    for name, fields in zip(coverage["rows"], counts, strict=True):
        cells = ""
        for bins in fields:
            count = sum(bins)
            top = max((edges[k + 1] for k, one in enumerate(bins) if one), default=0)
            words = f"<b>{count}</b><br>to {top:g} N" if count else "none"
            cells += f'<td class="{"pressed" if count else "bare"}">{words}</td>'
        rows.append(f"<tr><th>{escape(name)}</th>{cells}</tr>")
    heads = "".join(f"<th>{escape(name)}</th>" for name in coverage["columns"])
    return (
        '<table class="map"><caption>Presses by place in the image</caption>'
        f"<thead><tr><th></th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )


def result_html(session: Mapping[str, Any]) -> str:
    """What the certificate says in one sentence, and what ten more presses would bring."""
    trained = session.get("trained") or {}
    curve = (trained.get("curve") or {}).get("text", "")
    badge = simulated_badge(str(session.get("camera", "")).startswith("virtual:"))
    warning = f"<p>{badge}</p>" if badge else ""
    more = f'<p class="soft">{escape(str(curve))}</p>' if curve else ""
    sentence = f"<p>{escape(str(trained.get('sentence', '')))}</p>"
    newest = f'<p class="soft">{escape(str(session.get("newest", "")))}</p>'
    begin = '<section class="card" aria-label="Certificate"><h2>Certificate</h2>'
    return f"{begin}{warning}{sentence}{more}{newest}</section>"
