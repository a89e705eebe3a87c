"""The rig: devices and their health, the plan, the camera, the force, the log, and what the operator may ask.

Nothing is kept here but drafts: every tab shows what the rig's process tells, and a reload loses nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from datetime import datetime
from html import escape
from typing import Any

from nicegui import run, ui

from palpate.core import PalpateError
from palpate.rig.service.rig_client import RigClient
from palpate.studio import status_text, svg_drawing
from palpate.studio.operator_lease import Operator, RigLease
from palpate.studio.page_shell import AXES, page_shell, paint, simulated_badge
from palpate.studio.plan_panel import PlanPanel
from palpate.studio.status_text import age_note

REFRESH_S = 0.2
INK, SOFT, BAD = map(paint, ("ink", "soft", "bad"))
AXIS_NAMES = {"x": "x", "y": "y", "z": "z, normal"}
AGE_OF_DEVICE = {"stage": "position", "force sensor": "force", "camera": "camera"}
LOST = "The rig's process cannot be reached. If it runs, this page connects to it; else start it."


class RigPage:
    """Page of the rig in one tab.

    Args:
        client: of the rig's process; shared by all tabs.
        runs: the folder that recordings go into, to be named.
        launch: starts the rig's process and waits until it answers.
    """

    def __init__(
        self,
        client: RigClient,
        runs: str,
        lease: RigLease,
        operator: Operator,
        launch: Callable[[], object],
    ) -> None:
        self._client, self._lease, self._operator, self._launch = client, lease, operator, launch
        self._runs = runs
        self._busy = False
        self._log_count = -1
        self._picture_number = -1
        self._serial = -1
        self._last_run = ""
        self._last_status: Mapping[str, Any] | None = None
        self._beats = 0
        page_shell("rig")
        self._beat = ui.element("div").props('id="beat" hidden')
        self._failure = ui.label("").classes("unseen").props('id="failure" role="alert"')
        self._top()
        self._lost_banner()
        self._hold_banner()
        with ui.element("main").classes("board"):
            with ui.element("div"):
                self._plan = PlanPanel(self._act)
            with ui.element("div"):
                self._camera_card()
                self._force_card()
            with ui.element("div"):
                self._recording_card()
                self._devices = self._list_card("Devices", "devices")
                self._log = self._list_card("Events", "log")
                # It scrolls, so keys must reach it; each event is not read out: the state's changes are.
                self._log.props('role="log" aria-live="off" aria-label="Events, newest first" tabindex="0"')
        ui.timer(REFRESH_S, self._refresh)

    def _top(self) -> None:
        with ui.element("header").classes("top"):
            self._title = ui.html("<h1>Indentation rig</h1>", sanitize=False)
            self._state = ui.label("…").classes("state").props('id="state" role="status"')
            self._state.props('data-age-of="engine"')
            self._progress = ui.html("", sanitize=False).classes("progress")
            self._progress.props('id="progress" data-age-of="engine"')
            age_note("engine", "state and progress")

    def _lost_banner(self) -> None:
        with ui.element("div").classes("heldbar").props('id="lost" role="status"') as self._lost:
            self._lost_note = ui.label(LOST)
            self._launch_button = ui.button(f"Start {self._client.name}", on_click=self._start_process)
            self._launch_button.props('outline no-caps id="start-process"')
        self._lost.set_visibility(False)

    async def _start_process(self) -> None:
        """Start the rig's process, as nothing does by itself: opening a real rig may move it."""
        self._launch_button.disable()
        self._lost_note.set_text(f"The process of {self._client.name} starts …")
        try:
            self._lease.take(self._operator)
            await run.io_bound(self._launch)
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)
        finally:
            self._lost_note.set_text(LOST)
            self._launch_button.enable()

    def _hold_banner(self) -> None:
        with ui.dialog() as self._dialog, ui.card().style("max-width: 460px"):
            self._dialog.props('aria-label="Release the emergency stop?"')
            ui.html("<h2>Release the emergency stop?</h2>", sanitize=False).classes("asked")
            ui.label(
                "Look at the rig first: is the probe free, is nobody's hand near it? Nothing moves until you "
                "start; a recording that is started lifts the probe before anything else."
            )
            with ui.row().classes("w-full justify-end"):
                ui.button("Keep it held", on_click=self._dialog.close).props("flat no-caps")
                ui.button("Release", on_click=self._release).props('unelevated no-caps id="release-yes"')
        with ui.element("div").classes("heldbar").props('id="held" role="status"') as self._banner:
            ui.label("Emergency stop: the stage is held, also from moving away. What was recorded is kept.")
            self._release_button = ui.button("Release…", on_click=self._dialog.open)
            self._release_button.props('outline no-caps color=negative id="release"')
        self._banner.set_visibility(False)

    def _camera_card(self) -> None:
        with ui.element("section").classes("card camera").props('aria-label="Camera"'):
            ui.html("<h2>Camera</h2>", sanitize=False)
            age_note("camera", "picture")
            self._picture = ui.interactive_image("", sanitize=False)
            self._picture.props('id="camera" data-age-of="camera" data-alt="no picture of the camera yet"')
            self._picture_note = ui.label("no frame yet").classes("soft")

    def _force_card(self) -> None:
        with ui.element("section").classes("card force").props('aria-label="Force on the skin"'):
            ui.html("<h2>Force on the skin</h2>", sanitize=False)
            age_note("force", "force")
            self._force_now = ui.html("", sanitize=False).classes("now")
            self._force_now.props('id="force-now" data-age-of="force"')
            self._force = ui.html("", sanitize=False).props('id="force" data-age-of="force"')
            self._force_note = ui.label("").classes("soft")

    def _recording_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Recording"'):
            ui.html("<h2>Recording</h2>", sanitize=False)
            with ui.row().classes("w-full items-center justify-between no-wrap"):
                self._holder = ui.label("").classes("soft").props('id="holder" role="status"')
                self._let_go = ui.button("Let go", on_click=self._let_go_of_rig)
                self._let_go.props('flat dense no-caps id="let-go" aria-label="Let go of the rig"')
            self._name = ui.input("run", value=f"run-{datetime.now().astimezone():%Y-%m-%d-%H%M}")
            self._name.props('dense outlined aria-label="name of the run"').classes("w-full run-name")
            with ui.element("div").classes("buttons"):
                self._start = self._button("Start", "start", "unelevated", self._begin).classes("wide")
                self._pause = self._button("Pause", "pause")
                self._resume = self._button("Resume", "resume")
                self._stop = self._button("Stop after press", "stop")
                self._abort = self._button("Abort", "abort", "outline color=negative")
            self._doing = ui.html("", sanitize=False).classes("doing")
            self._doing.props('id="doing" data-age-of="engine"')
            self._where = ui.label(f"into {self._runs}").classes("soft").style("overflow-wrap: anywhere")

    def _list_card(self, title: str, name: str) -> ui.html:
        with ui.element("section").classes("card").props(f'aria-label="{title}"'):
            ui.html(f"<h2>{title}</h2>", sanitize=False)
            return ui.html("", sanitize=False).classes(name).props(f'id="{name}"')

    def _button(self, text: str, name: str, props: str = "outline", ask: Any = None) -> ui.button:
        """A button that asks the rig for what its name says, or calls `ask`."""
        button = ui.button(text, on_click=ask or (lambda: self._act(name)))
        return button.props(f'{props} no-caps id="{name}"')

    async def _act(self, name: str, *words: Any) -> bool:
        """Ask the rig's process, off the page's own loop; what it refuses is said."""
        try:
            self._lease.take(self._operator)
            await run.io_bound(getattr(self._client, name), *words)
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)
            return False
        return True

    def _let_go_of_rig(self) -> None:
        self._lease.release(self._operator)

    async def _begin(self) -> None:
        self._start.disable()
        await self._act("start", str(self._name.value or ""))

    async def _release(self) -> None:
        self._dialog.close()
        await self._act("release")

    async def _refresh(self) -> None:
        self._tell_ages()  # whatever holds up the rest
        if self._busy:
            return
        self._busy = True
        try:
            await self._show()
        finally:
            self._busy = False

    def _tell_ages(self) -> None:
        status = self._last_status = self._client.status or self._last_status
        ages = status_text.ages_at(time.monotonic(), status, self._client.told_s)
        self._beats += 1
        self._beat.props["data-ages"] = status_text.ages_attribute(ages, self._beats)
        self._beat.update()

    async def _show(self) -> None:
        status = self._client.status
        text, kind = status_text.state_of(status)
        self._state.set_text(text)
        self._state.classes(replace=f"state {kind}")
        self._failure.set_text(status_text.failure(status, LOST))
        self._lost.set_visibility(status is None)
        if status is None:
            self._banner.set_visibility(False)
            self._doing.set_content("")
            for button in (self._start, self._pause, self._resume, self._stop, self._abort):
                button.disable()
            self._serial = -1
            return
        self._lease.see(self._operator, recording=bool(status["recording"]))
        if status["serial"] == self._serial:
            return
        self._serial = status["serial"]
        self._show_recording(status)
        self._show_devices(status)
        self._show_force(status)
        self._show_picture(status)
        await self._plan.refresh(status, may_use=self._lease.may_act(self._operator))

    def _show_recording(self, status: Mapping[str, Any]) -> None:
        recording, paused = bool(status["recording"]), status["state"] == "paused"
        command = status["asked"]
        self._title.set_content(title_html(status))
        shots, planned = int(status["shots"]), int(status["planned"])
        share = 100 * shots / planned if planned else 0
        self._progress.set_content(
            f'<div class="said"><span><b>{shots:,}</b> of {planned:,} shots</span>'
            f"<span>{escape(status_text.time_left(status))}</span></div>"
            f'<div class="bar" role="progressbar" aria-label="shots recorded" aria-valuenow="{share:.0f}" '
            f'aria-valuemin="0" aria-valuemax="100"><i style="width:{share:.2f}%"></i></div>'
        )
        self._banner.set_visibility(bool(status["held"]))
        mine = self._show_holder()
        self._start.set_enabled(mine and not recording and not status["held"])
        self._pause.set_enabled(mine and recording and not paused and command is None)
        self._resume.set_enabled(mine and recording and command == "pause")
        self._stop.set_enabled(mine and recording and command in (None, "pause"))
        self._abort.set_enabled(mine and recording and command in (None, "pause", "stop"))
        self._release_button.set_enabled(mine)
        self._name.set_enabled(mine and not recording)
        run_name = str(status["run"])
        if run_name and run_name != self._last_run:  # so that "start" goes on with it
            self._last_run = run_name
            self._name.set_value(run_name)
        self._start.set_text("Go on" if self._left_over(status) else "Start")
        message = escape(status_text.doing(status))
        colour = BAD if status["state"] == "failed" and not recording else INK if recording else SOFT
        self._doing.set_content(f'<span style="color:{colour}">{message}</span>')
        if status["log_count"] != self._log_count:
            self._log_count = status["log_count"]
            self._log.set_content("".join(_log_line(line) for line in reversed(status["log"])))

    def _show_holder(self) -> bool:
        """Say who holds the rig; whether this tab may act."""
        holder = self._lease.holder
        self._holder.set_text(self._lease.words(self._operator))
        self._let_go.set_visibility(holder is not None and holder.key == self._operator.key)
        return self._lease.may_act(self._operator)

    def _left_over(self, status: Mapping[str, Any]) -> bool:
        begun = status["state"] in ("stopped", "aborted", "failed", "e-stopped") and status["run"]
        return (
            bool(begun)
            and not status["recording"]
            and self._name.value == status["run"]
            and status["shots"] > 0
        )

    def _show_devices(self, status: Mapping[str, Any]) -> None:
        self._devices.set_content("".join(_device_line(one) for one in status["devices"]))

    def _show_force(self, status: Mapping[str, Any]) -> None:
        force = status["force_n"]
        words = [
            f'<span><i style="background:{colour}"></i>{AXIS_NAMES[axis]} '
            f"<b>{'–' if force is None else status_text.number(force[i], 2)}</b> N</span>"
            for i, (axis, colour) in enumerate(AXES.items())
        ]
        self._force_now.set_content("".join(words))
        self._force.set_content(svg_drawing.force_svg(status["series"]))
        zero = "less its zero in the air" if status["tared"] else "as measured: its zero is not taken off yet"
        self._force_note.set_text(
            f"{zero}; positive into the skin; the rig stops at {status['limits']['force_n']:g} N"
        )

    def _show_picture(self, status: Mapping[str, Any]) -> None:
        picture = self._client.picture
        if picture is None or picture[0] == self._picture_number:
            return
        number, _, size_px = picture
        first, self._picture_number = self._picture_number < 0, number
        if first:
            self._picture.set_content(svg_drawing.regions_svg(status["regions"], size_px))
            names = ", ".join(region["name"] for region in status["regions"])
            self._picture_note.set_text(f"{size_px[0]} × {size_px[1]} px; boxes: {names or 'none'}")
            size = f"{size_px[0]} by {size_px[1]} pixels"
            self._picture.props["data-alt"] = f"the camera's newest picture, {size}; boxes: {names or 'none'}"
            self._picture.update()
        self._picture.set_source(f"/picture?{number}")


def title_html(status: Mapping[str, Any]) -> str:
    """Heading of the page, and below it the rig's name with what is not as on a real one."""
    faster = "" if status["real_time"] else ", faster than real time"
    badge = simulated_badge(bool(status.get("simulated")))
    return f'<h1>Indentation rig</h1><div class="under">{escape(status["rig"])}{faster}{badge}</div>'


def _device_line(device: Mapping[str, str]) -> str:
    name, state, detail = (escape(device[key]) for key in ("name", "state", "detail"))
    said = f'<span class="unseen">{state}: </span>' if state == "ok" else f"{state}: "
    part = AGE_OF_DEVICE.get(device["name"], "process")
    return (
        f'<b class="{state}" data-age-of="{part}">{name}</b><span class="{state}">'
        f'<span data-age-of="{part}">{said}{detail}</span> '
        f'<em class="age" data-says-age-of="{part}"></em></span>'
    )


def _log_line(line: Mapping[str, str]) -> str:
    at = datetime.fromisoformat(line["utc"]).astimezone()
    return (
        f'<div class="{escape(line["kind"])}"><time datetime="{escape(line["utc"])}">{at:%H:%M:%S}</time>'
        f"<span>{escape(line['text'])}</span></div>"
    )
