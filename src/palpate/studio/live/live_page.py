"""Live: sensors that are read now, each with its picture, its values, how sure they are, and what to mind.

Which sensors are shown stands in the page's address. Each belongs to a process of its own, which goes on when
this page is closed, and is begun, zeroed and ended here.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from html import escape
from typing import Any
from urllib.parse import quote, urlencode

from nicegui import ui

from palpate.core import PalpateError
from palpate.studio.library.workspace import Workspace
from palpate.studio.live import live_drawing
from palpate.studio.live.live_desk import (
    MAX_SENSORS,
    VIRTUAL,
    Cameras,
    LiveDesk,
    LiveSensor,
    NoConnection,
    check_name,
    edge_readings,
    plugged_in,
    source_options,
)
from palpate.studio.live.reading_rows import Told, named, softness_html, unread, values_html
from palpate.studio.page_shell import PageBeat, page_shell, page_title, simulated_badge, state_word
from palpate.studio.status_text import Ages, age_note, number

REFRESH_S = 0.2
FIND_S = 1.0  # between two searches for the processes of sensors that do not run
MAX_PLOTS = 3
NONE = {"": "none: the picture alone"}
MARKS = "marks:"
"""Before the name of a sensor whose patterned skin is read, in the list of calibrations."""
BY_MARKS = {f"{MARKS}nusense": "marks of a NUSense: touch and strain"}
NO_TIP = {"": "not read"}
TYPED: dict[str, Any] = {"with_input": True, "new_value_mode": "add-unique"}
"""Of a list in which an address may be typed that is not in it."""
ADDRESSES = (
    "Choose a source, or type a camera's number, path or serial number. Virtual sensors are pressed by a "
    "virtual hand: what they read is simulated."
)
LOOKS = {"opening": "warn", "live": "", "ended": "", "failed": "bad", "lost": "warn"}
SELECT = 'dense outlined options-dense stack-label id="{}" aria-label="{}"'
PLACES = ("x_mm", "y_mm")


class LivePage:
    """Page of live sensors in one tab.

    Args:
        names: of the sensors that are shown, as in the address.
    """

    def __init__(
        self, workspace: Workspace, desk: LiveDesk, names: list[str], cameras: Cameras = plugged_in
    ) -> None:
        self._workspace, self._desk, self._cameras = workspace, desk, cameras
        self._client = ui.context.client  # a card that ends is no place to ask it from any more
        page_shell("live")
        self._cards: list[SensorCard] = []
        PageBeat(self._ages)
        page_title(
            "Live", "each sensor is read by a process of its own, which goes on when this page is closed"
        )
        with ui.element("main").classes("sheet"):
            self._trouble = ui.html("", sanitize=False).props('role="alert"')
            with ui.element("div").classes("pair") as self._sensors:
                for name in (list(dict.fromkeys(names)) or desk.running())[:MAX_SENSORS]:
                    self._show(name)
            self._begin_card()
        ui.timer(0.01, self._list, once=True)
        ui.timer(REFRESH_S, self._refresh)
        ui.timer(FIND_S, self._find)

    def _show(self, name: str) -> None:
        """Show a sensor's card; `_find` connects it once the page is open, so that a GET changes nothing."""
        try:
            check_name(name)
        except PalpateError as e:
            self._say(e)
            return
        sensor = self._desk.listened(name) or LiveSensor(name, NoConnection())
        self._cards.append(SensorCard(sensor, len(self._cards), self._end))

    def _find(self) -> None:
        """Connect cards to processes that run by now."""
        for card in self._cards:
            if isinstance(card.sensor.connection, NoConnection):
                try:
                    card.sensor = self._desk.sensor(card.sensor.name) or card.sensor
                except PalpateError as e:
                    self._say(e)

    def _say(self, trouble: PalpateError) -> None:
        self._trouble.set_content(f'<p class="trouble">{escape(str(trouble))}</p>')

    def _begin_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Begin a sensor"'):
            ui.html("<h2>Begin a sensor</h2>", sanitize=False)
            ui.label(ADDRESSES).classes("soft")
            with ui.element("div").classes("fields begun q-mt-sm"):
                self._source = ui.select(dict(VIRTUAL), value="virtual:palm", label="source", **TYPED)
                self._source.classes("w-full")
                self._source.props(SELECT.format("live-source", "source"))
                self._calibration = ui.select(NONE | BY_MARKS, value="", label="calibration").classes(
                    "w-full"
                )
                self._calibration.props(SELECT.format("live-calibration", "calibration"))
                self._source.on_value_change(self._suit_marks)
                self._tip = ui.select(dict(NO_TIP), value="", label="softness of each press").classes(
                    "w-full"
                )
                self._tip.props(SELECT.format("live-tip", "calibration of softness"))
            with ui.row().classes("items-center q-mt-sm"):
                self._button = ui.button("Begin", on_click=self._begin).props(
                    'unelevated no-caps id="live-begin"'
                )
                self._doing = ui.label("").classes("soft").props('role="status"')

    async def _list(self) -> None:
        cameras, runs, calibrations, tips = await asyncio.to_thread(self._found)
        sources = {**VIRTUAL, **cameras, **{name: f"recording {name}, played" for name in runs}}
        self._source.set_options(sources, value=self._source.value)
        known = NONE | {name: name for name in calibrations} | BY_MARKS
        self._calibration.set_options(known, value=self._calibration.value)
        self._tip.set_options(NO_TIP | {name: name for name in tips}, value=self._tip.value)

    def _found(self) -> tuple[Mapping[str, str], list[str], list[str], list[str]]:
        runs, calibrations, tips = (self._workspace.found(one) for one in ("run", "calibration", "tip"))
        return self._cameras(), runs, calibrations, tips

    def _suit_marks(self) -> None:
        """A NUSense is read by its marks unless another calibration is chosen."""
        marked, value = "nusense" in str(self._source.value), str(self._calibration.value or "")
        if marked != value.startswith(MARKS) and (not value or value.startswith(MARKS)):
            self._calibration.set_value(next(iter(BY_MARKS)) if marked else "")

    async def _begin(self) -> None:
        source, calibration = str(self._source.value), str(self._calibration.value or "")
        self._button.disable()
        self._doing.set_text(f"opening {source} …")
        self._keep(live_name(source))  # from now on, whatever becomes of this page meanwhile
        try:
            sensor = await asyncio.to_thread(self._launched, source, calibration, str(self._tip.value or ""))
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=15000, multi_line=True)
            self._keep()
            return
        finally:
            self._button.enable()
            self._doing.set_text("")
        if all(card.sensor.name != sensor.name for card in self._cards):
            with self._sensors:
                self._show(sensor.name)
        self._find()
        self._keep()

    def _launched(self, source: str, calibration: str, tip: str) -> LiveSensor:
        options = source_options(self._workspace, source, self._cameras)
        options["runs"] = str(self._workspace.folder / "runs")
        if tip:
            options["compliance"] = str(self._workspace.resolve(tip))
        if calibration.startswith(MARKS):
            options["shear"] = calibration.removeprefix(MARKS)
        elif calibration:
            options["calibration"] = str(self._workspace.resolve(calibration))
        return self._desk.begin(live_name(source), options)

    async def _end(self, card: SensorCard) -> None:
        await asyncio.to_thread(self._desk.end, card.sensor.name)
        self._cards.remove(card)
        card.delete()
        self._keep()

    def _keep(self, *begun: str) -> None:
        names = [card.sensor.name for card in self._cards]
        address = live_address(list(dict.fromkeys([*names, *begun])))
        self._client.run_javascript(f"history.replaceState(null, '', '{address}')")

    def _ages(self) -> Ages:
        now_s = time.monotonic()
        return {card.part: card.sensor.age_s(now_s) for card in self._cards}

    def _refresh(self) -> None:
        for card in self._cards:
            card.refresh()


class SensorCard:
    """One sensor: its state, its picture, its values and what can be asked of it.

    Args:
        end: ends the sensor's process and takes the card away.

    Attributes:
        part: by which the page's script knows its age.
    """

    def __init__(self, sensor: LiveSensor, index: int, end: Callable[[SensorCard], Any]) -> None:
        self.sensor, self.part = sensor, f"live-{index}"
        self._picture_number, self._serial = -1, -1
        self._known: dict[str, Told] = {}  # the last readings that a frame had, and the calibration's name
        self._known_by: object = None
        self._strained: Told | None = None
        self._marked = False  # whether marks of the skin were ever followed
        old = f'data-age-of="{self.part}"'
        self._card = ui.element("section").classes("card live").props(f'aria-label="{escape(sensor.name)}"')
        with self._card:
            with ui.row().classes("items-center w-full gap-2"):  # above all whose height changes
                self._head = ui.html(f"<h2>{escape(sensor.name)}</h2>", sanitize=False).props(
                    f'role="status" {old}'
                )
                age_note(self.part, "")
                ui.space()
                self._buttons(end)
            self._advice = ui.html("", sanitize=False).classes("advice-room").props('role="status"')
            with ui.element("div").classes("parts"):
                with ui.element("div"):
                    self._picture = (
                        ui.interactive_image("", sanitize=False).classes("w-full camera").props(old)
                    )
                    self._legend = ui.html("", sanitize=False).classes("legend")
                    self._moved = ui.html("", sanitize=False).classes("soft moved").props(old)
                    self._strain = ui.html("", sanitize=False).classes("strain").props(old)
                    self._place = ui.html("", sanitize=False).classes("place").props(old)
                with ui.element("div"):
                    self._values = ui.html("", sanitize=False).classes("values").props(old)
                    self._softness = (
                        ui.html("", sanitize=False).classes("softness").props(f'{old} role="status"')
                    )
                    self._plots = ui.html("", sanitize=False).classes("plot").props(old)
            self._facts = ui.html("", sanitize=False).classes("facts").props(old)
            ui.label("Re-zero with nothing on the skin.").classes("soft")

    def _buttons(self, end: Callable[[SensorCard], Any]) -> None:
        self._zero = ui.button("Re-zero", on_click=self._zeroed).classes("re-zero")
        self._zero.props('outline no-caps aria-label="Take the untouched sensor anew"')
        self._ends = ui.button("End", on_click=lambda: end(self)).classes("end-live")
        self._ends.props('flat no-caps color=negative aria-label="End this sensor"')

    def delete(self) -> None:
        """Take the card away."""
        self._card.delete()

    def refresh(self) -> None:
        """Show what was told since."""
        status = self.sensor.connection.status
        if status is None:
            self._set(self._head, head_html(self.sensor.name, None))
            return
        self._show_picture(status)
        if status.get("serial") == self._serial:
            return
        self._serial = status.get("serial", -1)
        self._set(self._head, head_html(self.sensor.name, status))
        advice = ". ".join(str(one) for key in ("doubt", "advice") if (one := status.get(key)))
        self._set(self._advice, f'<p class="advice">{escape(advice)}</p>' if advice else "")
        readings = self._rows(edge_readings((status.get("reading") or {}).get("readings", {})), status)
        strain, size_px = self._strain_of(status), (self.sensor.connection.picture or (0, b"", (640, 480)))[2]
        self._set(self._values, values_html(readings, status))
        self._set(self._softness, softness_html(status.get("compliance")))
        self._set(self._strain, strain_html(strain, size_px))
        overlay = (status.get("image") or {}).get("overlay") or {}
        self._marked = self._marked or live_drawing.shows_marks(overlay)
        self._set(self._legend, live_drawing.overlay_legend(overlay, marked=self._marked))
        self._set(self._moved, motion_html(status.get("image")))
        self._set(self._place, "" if strain else live_drawing.place_svg(readings))
        self._set(self._plots, self._plots_html(readings, status))
        self._set(self._facts, facts_html(status))
        self._zero.set_enabled(status.get("state") == "live" and not status.get("zeroing"))

    def _rows(self, readings: dict[str, Told], status: Told) -> dict[str, Told]:
        """Readings of this frame; where it has none, the rows of those before, so that nothing moves."""
        if readings or status.get("calibration") != self._known_by:
            self._known, self._known_by = readings, status.get("calibration")
            return readings
        return unread(self._known)

    def _strain_of(self, status: Told) -> Told | None:
        """The strain of this frame; where it has none, the bare outline of that before."""
        strain = status.get("strain")
        if strain is None and self._strained is not None:
            strain = {**self._strained, "dots": [], "greatest": None, "contacts": [], "shift": None}
        self._strained = strain
        return strain

    def _plots_html(self, readings: Mapping[str, Mapping[str, Any]], status: Mapping[str, Any]) -> str:
        samples, now_s = list(self.sensor.samples), time.monotonic()
        columns = {name: str(one.get("unit", "")) for name, one in readings.items() if name not in PLACES}
        if not columns and status.get("force_N") is not None:
            columns = {"force_N": "N"}
        # By what a reading is, not by whether this frame has a value: plots must not come and go.
        words = [name for name, one in readings.items() if isinstance(one.get("value"), str)]
        numbers = [name for name, unit in columns.items() if unit and name not in words]
        chosen = sorted(numbers, key=lambda name: (columns[name] != "N", not name.startswith("gamma")))[
            :MAX_PLOTS
        ]
        return "".join(
            live_drawing.reading_svg(samples, name, columns[name], now_s, named(name, columns[name])[0])
            for name in chosen
        )

    def _show_picture(self, status: Mapping[str, Any]) -> None:
        picture = self.sensor.connection.picture
        if picture is None or picture[0] == self._picture_number:
            return
        self._picture_number = picture[0]
        self._picture.set_source(f"/live/picture?{urlencode({'name': self.sensor.name, 'n': picture[0]})}")
        overlay = live_drawing.overlay_svg(status.get("image"), picture[2])
        if overlay != self._picture.content:
            self._picture.set_content(overlay)

    async def _zeroed(self) -> None:
        try:
            await asyncio.to_thread(self.sensor.connection.ask, "zero")
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)

    @staticmethod
    def _set(element: ui.html, text: str) -> None:
        if element.content != text:
            element.set_content(text)


def live_name(source: str) -> str:
    """Name of the process that reads a source."""
    return f"live {source}"


def live_address(names: list[str]) -> str:
    """Address of the page with these sensors."""
    asked = "&".join(f"sensor={quote(name, safe='')}" for name in names)
    return f"/live?{asked}" if asked else "/live"


def head_html(name: str, status: Mapping[str, Any] | None) -> str:
    """A sensor's name and its state, in a word and with its reason."""
    title = f"<h2>{escape(name.removeprefix('live '))}"
    if status is None:
        gone = "Its process cannot be reached; begin it anew below."
        return f"{title} {state_word('no connection', 'bad')}</h2><p class='soft'>{gone}</p>"
    state = str(status.get("state"))
    why = f'<p class="trouble">{escape(str(status["why"]))}</p>' if status.get("why") else ""
    simulated = simulated_badge(bool(status.get("simulated")))
    zeroing = f" {state_word('taking the untouched sensor', 'warn')}" if status.get("zeroing") else ""
    return f"{title} {state_word(state, LOOKS.get(state, ''))}{simulated}{zeroing}</h2>{why}"


def strain_html(strain: Mapping[str, Any] | None, size_px: tuple[int, int]) -> str:
    """The strain of a patterned skin, drawn and in words; "" without one."""
    if not strain:
        return ""
    words = live_drawing.strain_words(strain)
    return f'<h3>Strain of the skin</h3>{live_drawing.strain_svg(strain, size_px)}<p class="soft">{words}</p>'


def motion_html(image: Mapping[str, Any] | None) -> str:
    """How far the skin's marks moved along it, in words; "" where none are followed."""
    motion = live_drawing.lateral_motion((image or {}).get("overlay"))
    if motion is None:
        return ""
    dx, dy = motion[1]
    told = f"marks moved on average {number(math.hypot(dx, dy), 1)} px along the skin"
    times = f"{live_drawing.MOTION_TIMES:g}"
    return f"{told}: {number(dx, 1)} to the right, {number(dy, 1)} down (thick arrow, {times} times as long)"


def facts_html(status: Mapping[str, Any]) -> str:
    """Rate, latency, what was lost, and how the picture is."""

    def told(key: str, digits: int) -> str:
        value = status.get(key)
        return "–" if value is None else number(float(value), digits)

    late = f"<b>{told('p50_ms', 1)}</b> ms (95 % within {told('p95_ms', 1)}, 99 % {told('p99_ms', 1)} ms)"
    lost = f"{told('dropped', 0)} dropped, {told('lost', 0)} lost by the source, {told('broken', 0)} broken"
    lines = [
        f"<b>{told('rate_hz', 1)}</b> frames a second; from arrival to reading {late}",
        f"{told('frames', 0)} frames; {lost}",
    ]
    drift = status.get("drift") or {}
    if drift.get("statistic") is not None:
        lines.append(
            f"drift {number(float(drift['statistic']), 1)}, of {number(float(drift['limit']), 1)} allowed"
        )
    calibration = status.get("calibration")
    lines.append(
        f"calibration {escape(str(calibration))}"
        if calibration
        else "no calibration: nothing is read in newtons"
    )
    image = status.get("image") or {}
    known = {
        "noise": ("noise", "grey levels", 2),
        "blur_px": ("blur", "px", 1),
        "level": ("level", "of 255", 0),
    }
    seen = [
        f"{name} {number(float(image[key]), digits)} {unit}"
        for key, (name, unit, digits) in known.items()
        if isinstance(image.get(key), int | float)
    ]
    if isinstance(image.get("clipped"), int | float):
        seen.append(f"{100 * float(image['clipped']):.1f} % clipped")
    return "<br>".join([*lines, *(["picture: " + ", ".join(seen)] if seen else [])])
