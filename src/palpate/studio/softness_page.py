"""Softness rendered: an object's two curves, what the display can do of it, what is felt, and the stop.

Nothing is kept here: every tab shows what the server's `RenderingDesk` has, and a reload loses nothing.

What the studio's server keeps of softness: a folder's objects, the bench, and the rendering that runs.

The rendering belongs to the server and not to a tab: a reload loses nothing, every tab shows the same, and
where the server ends, the rendering's process sees it and makes the devices safe.
"""

from __future__ import annotations

import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
from nicegui import run, ui

from palpate.core import InputError, PalpateError
from palpate.softness import Characteristic, Mode, RenderingLaw, SoftObject, is_object_file, read_object
from palpate.softness.control import LoopSample
from palpate.softness.process import BenchFile, RenderingSession, RenderingStatus
from palpate.softness.rendering_law import LIMIT_WORDS
from palpate.studio import status_text
from palpate.studio.page_shell import commands_html, page_shell, paint
from palpate.studio.status_text import age_note, number
from palpate.studio.svg_drawing import Plot

KEPT_S = 10.0  # of samples that are shown
KEPT = 1000
MAX_OBJECTS = 200

Begin = Callable[[BenchFile, SoftObject, Mode, float, float], RenderingSession]


class RenderingDesk:
    """Objects, bench and rendering, shared by all tabs."""

    def __init__(self, folder: Path, bench: BenchFile, begin: Begin = RenderingSession) -> None:
        self.folder, self.bench, self._begin = folder, bench, begin
        self._turn = threading.Lock()
        self._session: RenderingSession | None = None
        self._samples: deque[LoopSample] = deque(maxlen=KEPT)

    def objects(self) -> tuple[dict[str, SoftObject], dict[str, str]]:
        """Objects of the folder by their file's name; and why other objects' files cannot be used.

        A TOML file without a table of an object, such as a rig's, is left out.
        """
        found: dict[str, SoftObject] = {}
        refused: dict[str, str] = {}
        for path in sorted(filter(is_object_file, self.folder.glob("*.toml")))[:MAX_OBJECTS]:
            try:
                found[path.stem] = read_object(path)
            except PalpateError as e:
                refused[path.name] = str(e).removeprefix(f"{path}: ")
        return found, refused

    @property
    def law(self) -> RenderingLaw | None:
        """What is rendered, or was last; None before the first."""
        session = self._session
        return None if session is None else session.law

    @property
    def status(self) -> RenderingStatus | None:
        """How the rendering stands; None before the first."""
        session = self._session
        return None if session is None else session.status()

    @property
    def told_s(self) -> float | None:
        """When the rendering's process told anything last; None where none runs [s, monotonic time]."""
        session = self._session
        return None if session is None or session.status().state == "ended" else session.told_s

    def samples(self) -> list[LoopSample]:
        """Samples of the last `KEPT_S`, oldest first."""
        with self._turn:
            if self._session is not None:
                self._samples.extend(self._session.taken())
            newest_s = self._samples[-1].time_s if self._samples else 0.0
            return [one for one in self._samples if one.time_s > newest_s - KEPT_S]

    def begin(self, name: str, mode: Mode, peak_n: float, frequency_hz: float) -> None:
        """Begin to render an object, or turn into it where one is rendered in the same mode."""
        path = self.folder / f"{name}.toml"
        soft = read_object(path)
        with self._turn:
            now = self._session
            if now is not None and now.status().state == "renders":
                if now.status().mode is not mode:
                    raise InputError(
                        f"{now.status().mode.value} is rendered; stop it before {mode.value} begins, and "
                        "take the finger away",
                        code="rendering-running",
                    )
                now.show(soft)
                return
            self._close()
            self._samples.clear()
            self._session = self._begin(self.bench, soft, mode, peak_n, frequency_hz)

    def end(self) -> None:
        """End the rendering: the chamber vents and the arm brakes."""
        session = self._session
        if session is not None:
            session.stop()

    def estop(self) -> None:
        """Emergency stop; at once, whatever else is asked."""
        session = self._session
        if session is not None:
            session.estop()

    def close(self) -> None:
        """End the rendering, and let go of its devices."""
        with self._turn:
            self._close()

    def _close(self) -> None:
        if self._session is not None:
            self._session.close()


def age_s(desk: RenderingDesk, now_s: float | None = None) -> float:
    """Age of what the page shows of a rendering; 0 where none runs [s]."""
    told = desk.told_s
    return 0.0 if told is None else max((time.monotonic() if now_s is None else now_s) - told, 0.0)


REFRESH_S = 0.2
MODES = {
    Mode.BOTH: "CM1: both cues",
    Mode.KINESTHETIC: "CM2: the arm's alone",
    Mode.CUTANEOUS: "CM3: the skin's alone",
}
LOOKS = {"opens": "warn", "renders": "busy", "ended": "calm"}
EXAMPLE = (
    'name = "soft ball"', "[hertz]", "modulus_kPa = 50", "radius_mm = 20", "poisson = 0.49",
    "finger_modulus_kPa = 100", "finger_radius_mm = 8", "finger_poisson = 0.49", "until_N = 2",
)  # fmt: skip
"""Lines of an object's file: a ball of 50 kPa, as a finger of 100 kPa feels it."""
LABEL = 'dense outlined options-dense stack-label aria-label="{}"'


class SoftnessPage:
    """Page of softness in one tab.

    Args:
        desk: what the server keeps; shared by all tabs.
    """

    def __init__(self, desk: RenderingDesk) -> None:
        self._desk, self._beats = desk, 0
        self._drawn: RenderingLaw | None = None
        page_shell("softness")
        self._beat = ui.element("div").props('id="beat" hidden')
        self._failure = ui.label("").classes("unseen").props('id="failure" role="alert"')
        self._top()
        with ui.element("main").classes("board"):
            with ui.element("div"):
                self._object_card()
                self._timing_card()
            with ui.element("div"):
                self._felt_card()
            with ui.element("div"):
                self._force_card()
                self._envelope_card()
        self._list_objects()
        ui.timer(REFRESH_S, self._refresh)

    def _top(self) -> None:
        with ui.element("header").classes("top"):
            kind = (
                "virtual: display, arm and finger are simulated" if self._desk.bench.simulated else "devices"
            )
            ui.html(
                f'<h1>Softness</h1><div class="under">{escape(self._desk.bench.name)} ({kind})</div>',
                sanitize=False,
            )
            self._state = ui.label("nothing is rendered").classes("state calm")
            self._state.props('id="state" role="status" data-age-of="process"')
            age_note("process", "state and force")

    def _object_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Object and mode"'):
            ui.html("<h2>Object and mode</h2>", sanitize=False)
            self._object = ui.select([], label="object").classes("w-full")
            self._object.props(LABEL.format("object") + ' id="object"')
            self._mode = ui.select(
                {mode.value: words for mode, words in MODES.items()}, value="CM1", label="mode"
            )
            self._mode.classes("w-full").props(LABEL.format("mode"))
            with ui.element("div").classes("fields") as finger:
                self._peak = ui.number("finger's force [N]", value=1.0, min=0.01, step=0.1)
                self._peak.props('dense outlined aria-label="force of the virtual finger [N]"')
                self._frequency = ui.number("presses [Hz]", value=1.0, min=0.1, max=5, step=0.1)
                self._frequency.props('dense outlined aria-label="presses of the virtual finger [Hz]"')
            finger.set_visibility(self._desk.bench.simulated)
            with ui.element("div").classes("buttons"):
                self._begin = ui.button("Begin", on_click=self._begun)
                self._begin.props('unelevated no-caps id="begin"').classes("wide")
                self._end = ui.button("Stop", on_click=self._ended).props('outline no-caps id="end"')
                again = ui.button("Read folder again", on_click=self._list_objects)
                again.props('outline no-caps id="again"')
            self._where = ui.label(f"objects of {self._desk.folder}").classes("soft")
            self._where.style("overflow-wrap: anywhere")
            self._refused = ui.html("", sanitize=False).props('id="refused"')

    def _timing_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Loop"'):
            ui.html("<h2>Loop</h2>", sanitize=False)
            self._timing = ui.html("", sanitize=False).classes("facts")
            self._timing.props('id="timing" data-age-of="process"')
            self._why = ui.html("", sanitize=False).props('id="why"')

    def _felt_card(self) -> None:
        with ui.element("section").classes("card force").props('aria-label="What is felt"'):
            ui.html("<h2>The object, and what is felt of it</h2>", sanitize=False)
            self._skin = ui.html("", sanitize=False).props('id="skin" data-age-of="process"')
            self._arm = ui.html("", sanitize=False).props('id="arm" data-age-of="process"')
            ui.label(
                "line: the object; points: the last 10 s, force from pressure and area; shaded: not rendered "
                "as it is"
            ).classes("soft")

    def _force_card(self) -> None:
        with ui.element("section").classes("card force").props('aria-label="Now"'):
            ui.html("<h2>Now</h2>", sanitize=False)
            self._now = ui.html("", sanitize=False).classes("now")
            self._now.props('id="force-now" data-age-of="process"')
            self._time = ui.html("", sanitize=False).props('id="force" data-age-of="process"')

    def _envelope_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="What the display can render"'):
            ui.html("<h2>What the display can render of it</h2>", sanitize=False)
            self._envelope = ui.html("", sanitize=False).props('id="envelope"')

    def _list_objects(self) -> None:
        found, refused = self._desk.objects()
        kept = self._object.value if self._object.value in found else next(iter(found), None)
        self._object.set_options({name: soft.name for name, soft in found.items()}, value=kept)
        lines = [f"{name} is no object: {why}" for name, why in refused.items()]
        told = "".join(f'<p class="trouble">{escape(line)}</p>' for line in lines)
        self._refused.set_content(("" if found else no_object_html(self._desk.folder)) + told)
        self._begin.set_enabled(bool(found))
        if self._drawn is None:
            self._say_empty(bool(found))

    def _say_empty(self, found: bool) -> None:
        """Say in each card that shows a rendering what has to be done before it can."""
        need = "choose an object and begin" if found else "there is no object yet; see Object and mode"
        for part, what in (
            (self._skin, "The object's curves, and what is felt of it, are drawn here"),
            (self._now, "Force, area, displacement and pressure stand here"),
            (self._envelope, "What the display can and cannot render of the object stands here"),
        ):
            part.set_content(f'<p class="empty">{what} once it is rendered: {need}.</p>')

    async def _begun(self) -> None:
        if not self._object.value:
            return
        wish = Mode(str(self._mode.value)), float(self._peak.value or 0), float(self._frequency.value or 0)
        self._begin.disable()
        self._state.set_text("opening the devices …")
        await self._act(lambda: self._desk.begin(str(self._object.value), *wish))

    async def _ended(self) -> None:
        await self._act(self._desk.end)

    async def _act(self, work: object) -> None:
        """Ask off the page's own loop; what is refused is said."""
        try:
            await run.io_bound(work)  # type: ignore[arg-type]
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)
        finally:
            self._begin.enable()

    def _refresh(self) -> None:
        self._beats += 1
        ages: status_text.Ages = {"process": age_s(self._desk, time.monotonic())}
        self._beat.props["data-ages"] = status_text.ages_attribute(ages, self._beats)
        self._beat.update()
        self._show()

    def _show(self) -> None:
        status, law, samples = self._desk.status, self._desk.law, self._desk.samples()
        renders = status is not None and status.state != "ended"
        self._end.set_enabled(renders)
        self._begin.set_text("Show this object" if renders else "Begin")
        if status is None or law is None:
            self._timing.set_content("no period yet")
            return
        words = f"{status.state}: {status.object}, {status.mode.value}"
        fault = status.state == "ended" and not status.wished
        self._state.set_text(words)
        self._state.classes(replace=f"state {'bad' if fault else LOOKS[status.state]}")
        self._failure.set_text(f"The rendering ended: {status.why}" if fault else "")
        ended = f'<p class="{"trouble" if fault else "soft"}">Ended: {escape(status.why)}</p>'
        self._why.set_content(ended if status.state == "ended" else "")
        self._timing.set_content(
            f"<b>{status.periods:,}</b> periods, <b>{status.late_share:.3%}</b> longer than 1.5 ms, longest "
            f"<b>{1e3 * status.longest_s:.1f}</b> ms"
        )
        self._skin.set_content(area_svg(law, samples))
        self._arm.set_content(displacement_svg(law, samples))
        self._time.set_content(time_svg(samples))
        if law is not self._drawn:
            self._drawn = law
            lines = [f"<li>{escape(line)}</li>" for line in envelope_words(law)]
            self._envelope.set_content(
                f'<p class="soft">{escape(law.object.source)}</p><ul>{"".join(lines)}</ul>'
            )
        if samples:
            last = samples[-1]
            shown = {
                "N": (last.force_n, 2), "mm²": (1e6 * last.area_m2, 1), "mm": (1e3 * last.displacement_m, 2),
                "kPa": (1e-3 * last.pressure_pa, 1),
            }  # fmt: skip
            self._now.set_content(
                "".join(
                    f"<span><b>{number(value, digits)}</b> {unit}</span>"
                    for unit, (value, digits) in shown.items()
                )
            )


def no_object_html(folder: Path) -> str:
    """What is missing in a folder without an object's file, and a command that makes one there."""
    written = " ".join(map(shlex.quote, EXAMPLE))
    command = f"printf '%s\\n' {written} > {shlex.quote(str(folder / 'soft-ball.toml'))}"
    made = "" if folder.is_dir() else f"mkdir -p {shlex.quote(str(folder))} && "
    return (
        '<p class="empty">No object is here, and a rendering needs the file of one: two curves or a body, '
        "as docs/how-to/render-softness.md shows. This command writes one, a ball of 50 kPa; then read the "
        f"folder again.</p>{commands_html([made + command])}"
    )


INK, ACCENT, BAND, BAD = map(paint, ("ink", "accent", "band", "bad"))
SIZE = 460, 280
SPAN_S = 10.0
MIN_SPAN_N = 0.5
POINTS = 120  # of a curve that is drawn
FELT = 400  # samples that are drawn


def area_svg(law: RenderingLaw, felt: Sequence[LoopSample]) -> str:
    """Force over contact area: the object's curve, what cannot be rendered shaded, what is felt as points."""
    curve, end_n = law.object.area, shown_n(law)
    end = 1e6 * float(curve.at_force(end_n))
    plot = Plot(SIZE, (0.0, end), (0.0, end_n), x_name="contact area [mm²]", y_name="force [N]")
    for low, high, limit in stretches(law):
        if limit:
            plot.span(1e6 * low, 1e6 * high, BAND if limit == "onset" else BAD)
    plot.line(_points(curve, end_n, 1e6), INK, 2)
    shown = _touched(felt) if law.mode is not Mode.KINESTHETIC else []
    plot.dots([(1e6 * one.area_m2, one.force_n) for one in shown], ACCENT)
    kept = "not rendered in CM2, a plate is in the display's place" if law.mode is Mode.KINESTHETIC else ""
    return plot.svg("Force over contact area", _words(end_n, shown, kept))


def shown_n(law: RenderingLaw) -> float:
    """Force to which both curves are drawn: what the bounds and the display's base allow [N]."""
    end_n = min(law.object.greatest_n, law.bounds.force_n)
    base_m2 = law.display.greatest_m2
    if law.mode is Mode.KINESTHETIC or base_m2 >= law.object.area.x[-1]:
        return end_n
    return min(end_n, float(law.object.area.force_at(base_m2)))


def displacement_svg(law: RenderingLaw, felt: Sequence[LoopSample]) -> str:
    """Force over displacement: the object's curve, and what is felt as points."""
    curve, end_n = law.object.displacement, shown_n(law)
    end = 1e3 * float(curve.at_force(end_n))
    plot = Plot(SIZE, (0.0, end), (0.0, end_n), x_name="displacement [mm]", y_name="force [N]")
    plot.line(_points(curve, end_n, 1e3), INK, 2)
    shown = _touched(felt) if law.mode is not Mode.CUTANEOUS else []
    plot.dots([(1e3 * one.displacement_m, one.force_n) for one in shown], ACCENT)
    kept = "not rendered in CM3, the surface is held still" if law.mode is Mode.CUTANEOUS else ""
    return plot.svg("Force over displacement", _words(end_n, shown, kept))


def _points(curve: Characteristic, end_n: float, scale: float) -> list[tuple[float, float]]:
    x = np.linspace(float(curve.x[0]), float(curve.at_force(end_n)), POINTS)
    return list(zip((scale * x).tolist(), np.asarray(curve.force_at(x)).tolist(), strict=True))


def time_svg(felt: Sequence[LoopSample]) -> str:
    """Force on the finger over the last seconds."""
    end_s = max(felt[-1].time_s if felt else 0.0, SPAN_S)
    most_n = max(1.1 * max((one.force_n for one in felt), default=0.0), MIN_SPAN_N)
    since = "time since it began [s]"
    plot = Plot(SIZE, (end_s - SPAN_S, end_s), (0.0, most_n), x_name=since, y_name="force [N]")
    if felt:
        plot.line([(one.time_s, one.force_n) for one in felt[:: max(1, len(felt) // FELT)]], ACCENT)
    words = f"{number(felt[-1].force_n, 2)} N now" if felt else "no force yet"
    return plot.svg("Force on the finger over time", words)


def stretches(law: RenderingLaw) -> list[tuple[float, float, str]]:
    """Stretches of area with one verdict: from, to [m^2], and why not rendered; empty in CM2."""
    if law.mode is Mode.KINESTHETIC:
        return []
    state = law.envelope(500)
    ends = [0, *(np.flatnonzero(state.limit[1:] != state.limit[:-1]) + 1).tolist(), len(state.limit)]
    return [
        (float(state.area_m2[low]) if low else 0.0, float(state.area_m2[high - 1]), str(state.limit[low]))
        for low, high in pairwise(ends)
    ]


def envelope_words(law: RenderingLaw) -> list[str]:
    """What a display can render of an object, a line for each stretch of area."""
    if law.mode is Mode.KINESTHETIC:
        return ["CM2: a rigid plate is in the display's place; the arm alone is felt"]
    return [
        f"{1e6 * low:.1f} to {1e6 * high:.1f} mm²: {LIMIT_WORDS[limit] if limit else 'rendered as it is'}"
        for low, high, limit in stretches(law)
    ]


def _touched(felt: Sequence[LoopSample]) -> list[LoopSample]:
    shown = [one for one in felt if one.touched]
    return shown[:: max(1, len(shown) // FELT)]


def _words(greatest_n: float, shown: Sequence[LoopSample], kept: str) -> str:
    felt = f"{len(shown)} points felt, to {number(max(one.force_n for one in shown), 2)} N" if shown else ""
    return "; ".join(one for one in (f"the object's curve to {greatest_n:g} N", felt, kept) if one)
