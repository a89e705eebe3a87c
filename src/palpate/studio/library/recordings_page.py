"""Recordings: the workspace's runs, one of them played with its curve, noted on, split, or beside another.

Which run, which frame, which split and which other run stand in the page's address.

Drawings of a recorded run, as SVG: a quantity over its length with notes, and frames held out.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pandas as pd
from nicegui import ui

from palpate.core import Float, InputError, PalpateError, has_unit, refuse_existing, split_column
from palpate.recordings import Run, Split, split
from palpate.recordings.manifest import MAX_NOTE, RunNote, add_note, read_notes
from palpate.studio.library.background_jobs import BackgroundJob, BackgroundJobs
from palpate.studio.library.calibrations_page import calibration_address, job_html
from palpate.studio.library.workspace import RunSummary, Workspace
from palpate.studio.page_shell import (
    PageBeat,
    keep_in_address,
    page_shell,
    page_title,
    paint,
    simulated_badge,
    state_word,
    table_html,
    text_of,
)
from palpate.studio.status_text import duration, number
from palpate.studio.svg_drawing import LEFT, RIGHT, TOP, Plot, round_numbers, with_room

WIDTH = 640
MAX_BINS = 500
"""Stretches of a curve that are drawn, each from its least to its greatest, so that no peak is lost."""
INK, LINE, ACCENT, WARN = map(paint, ("ink", "line", "accent", "warn"))
ROW, MAX_FOLDS = 13, 20
Samples = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class RecordedCurve:
    """Quantity over a run's length.

    Attributes:
        times_s: of its samples, from the run's first instant [s].
        values: in `unit`.
        whole_s: the run's length [s].
    """

    name: str
    unit: str
    times_s: Samples
    values: Samples
    whole_s: float


def curve_of(run: Run) -> RecordedCurve | None:
    """What a run's length is shown by: its force sensor, else numbers of its labels; None of neither."""
    whole_s = max(float(run.times_s[-1]), 1e-6) if len(run) else 1e-6
    force = run.force()
    if len(force):
        times_s, values = force["time_s"].to_numpy(), force["fz_N"].to_numpy()
        whole_s = max(whole_s, float(times_s[-1]))
        return RecordedCurve("force along the skin's normal", "N", times_s, values, whole_s)
    names = [name for name, kind in run.manifest.labels.items() if kind == "number"]
    names.sort(key=lambda name: not name.endswith("_N"))
    for name in names:
        values = pd.to_numeric(run.labels[name], errors="coerce").to_numpy(np.float64)
        if np.isfinite(values).any():
            quantity, unit = (name, "")
            if has_unit(name):
                quantity, found = split_column(name)
                unit = found.symbol
            return RecordedCurve(f"{quantity} by the labels", unit, run.times_s, values, whole_s)
    return None


def curve_svg(curve: RecordedCurve | None, notes: Sequence[RunNote] = ()) -> str:
    """A run's curve, with a mark at each note and a line at the frame shown, which a script moves."""
    if curve is None:
        return '<p class="empty">This run holds no force and no number in its labels that could be drawn.</p>'
    times_s, values = _binned(curve)
    ticks = [(t, f"{t:g} s") for t in round_numbers(0.0, curve.whole_s)]
    name = f"{curve.name} [{curve.unit}]" if curve.unit else curve.name
    y = with_room(values.tolist(), 1e-3)
    plot = Plot((WIDTH, 190), (0.0, curve.whole_s), y, y_name=name, x_ticks=ticks)
    deep = plot.bottom - TOP
    plot.parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - RIGHT}" height="{deep}" fill="transparent"/>'
    )
    plot.line(zip(times_s.tolist(), values.tolist(), strict=True), ACCENT)
    for note in notes:
        x = plot.at(note.time_s, 0.0)[0]
        plot.parts.append(
            f'<g><title>{escape(note.text)}</title><path d="M{x:.1f} {TOP}v{deep}" stroke="{WARN}" '
            f'stroke-dasharray="2 3"/><path d="M{x - 5:.1f} {TOP}h10l-5 8z" fill="{WARN}"/></g>'
        )
    plot.parts.append(f'<path class="cursor" d="M{LEFT} {TOP}v{deep}" stroke="{INK}" stroke-width="1.6"/>')
    said = f"{number(float(values.min()), 2)} to {number(float(values.max()), 2)} {curve.unit}"
    words = f"{said} over {curve.whole_s:.1f} s; {len(notes)} notes"
    where = f' data-left="{LEFT}" data-right="{WIDTH - RIGHT}" data-whole="{curve.whole_s:.6f}"'
    return plot.svg(f"{curve.name} over the run", words, where)


def split_svg(found: Split, frames: int) -> str:
    """Frames of a run from left to right, a row a fold; a bar where the fold holds them out."""
    folds = found.folds[:MAX_FOLDS]
    height = ROW * len(folds) + 22
    begin = (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img"><title>Frames that each fold holds out</title>'
        f"<desc>{len(found.folds)} folds of {frames} frames, {escape(found.reason)}</desc>"
    )
    parts = [begin]
    scale = (WIDTH - LEFT - RIGHT) / max(frames, 1)
    for k, rows in enumerate(folds):
        y = k * ROW + 3
        parts.append(
            f'<text x="{LEFT - 7}" y="{y + 9}" text-anchor="end">{k + 1}</text>'
            f'<path d="M{LEFT} {y + ROW / 2 - 1}H{WIDTH - RIGHT}" stroke="{LINE}"/>'
        )
        bars = "".join(
            f"M{LEFT + first * scale:.1f} {y}h{max((end - first) * scale, 0.7):.1f}v{ROW - 4}h"
            f"-{max((end - first) * scale, 0.7):.1f}z"
            for first, end in _stretches(np.sort(rows))
        )
        parts.append(f'<path d="{bars}" fill="{ACCENT}"/>')
    named = f'<text x="{WIDTH - RIGHT}" y="{height - 5}" text-anchor="end">frames, first to last</text>'
    return "".join([*parts, named, "</svg>"])


def label_ranges(run: Run) -> Mapping[str, str]:
    """Each label with the range of its numbers, or how many different texts or flags it has."""
    told = {}
    for name, kind in run.manifest.labels.items():
        column = run.labels[name].dropna()
        if not len(column):
            told[name] = "nothing"
        elif kind == "number":
            told[name] = f"{column.min():.4g} to {column.max():.4g}".replace("-", "−")
        else:
            told[name] = f"{column.nunique()} different"
        if 0 < len(column) < len(run):
            told[name] += f", in {len(column)} of {len(run)} frames"
    return told


def _binned(curve: RecordedCurve) -> tuple[Samples, Samples]:
    good = np.isfinite(curve.values)
    times_s, values = curve.times_s[good], curve.values[good]
    if len(times_s) <= 2 * MAX_BINS:
        return times_s, values
    edges = np.linspace(0, len(times_s), MAX_BINS + 1).astype(int)[:-1]
    both = np.stack([np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)], axis=1)
    return np.repeat(times_s[edges], 2), both.reshape(-1)


def _stretches(rows: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of consecutive rows, as first and end."""
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) > 1)
    firsts, lasts = [0, *(breaks + 1)], [*breaks, len(rows) - 1]
    return [(int(rows[a]), int(rows[b]) + 1) for a, b in zip(firsts, lasts, strict=True)]


MAX_TIMES = 1500
"""Times of frames that a page is told; those between are evenly spaced."""
WORDS_OF_STATE = {
    "whole": "",
    "being written": "warn",
    "not closed": "warn",
    "empty": "warn",
    "damaged": "bad",
}
NOTHING = (
    '<h2>No runs yet</h2><p class="empty">Nothing is recorded in this folder. Record on the page '
    '<a href="/rig">Rig</a>, collect presses on <a href="/">Start</a>, or import images by <code>palpate '
    "import images</code>. No file is uploaded here: put a run's folder into the workspace instead.</p>"
)
LINK = (
    '<label class="soft"><input type="checkbox" data-link checked> move both together, by the same share of '
    "their lengths</label>"
)
SELECT = 'dense outlined options-dense stack-label id="split" aria-label="kind of split"'
TARGETS = 'dense outlined options-dense stack-label use-chips id="targets" aria-label="what shall be read"'
LOOK_S = 0.3
HEADS = ("run", "frames", "length", "labels", "sensor", "size", "state")
SPLITS = ("auto", "random", "session", "blocks")


class RecordingsPage:
    """Page of recordings in one tab.

    Args:
        name: Selected run; "" for the list.
        frames: Initial frame numbers of both runs.
        spec: Split of the frames; "" for none.
    """

    def __init__(
        self, workspace: Workspace, jobs: BackgroundJobs, name: str, beside: str, frames: tuple[int, int],
        spec: str,
    ) -> None:  # fmt: skip
        self._workspace, self._name, self._beside = workspace, name, beside
        self._jobs = jobs
        self._job: BackgroundJob | None = None
        self._at, self._spec = frames, spec
        page_shell("recordings")
        ui.add_body_html(text_of("player.html"))
        PageBeat()
        page_title("Recordings", f"runs in {workspace.folder}")
        with ui.element("main").classes("sheet") as self._sheet:
            self._wait = ui.label("Looking at the runs …").classes("soft").props('role="status"')
        ui.timer(0.01, self._fill, once=True)

    async def _fill(self) -> None:
        try:
            shown = await asyncio.to_thread(self._read)
        except PalpateError as e:
            with self._sheet:
                ui.html(f'<p class="trouble" role="alert">{escape(str(e))}</p>', sanitize=False)
                ui.html('<a href="/recordings">All runs</a>', sanitize=False)
            self._wait.delete()
            return
        self._wait.delete()
        with self._sheet:
            self._list(shown) if not self._name else self._one(shown)

    def _read(self) -> list[RunSummary]:
        if self._name:
            chosen = [self._name, self._beside] if self._beside else [self._name]
            for one in chosen:
                self._workspace.run(one)  # refused in words where it cannot be opened
        return [self._workspace.summary(one) for one in self._workspace.found("run")]

    def _list(self, runs: list[RunSummary]) -> None:
        with ui.element("section").classes("card").props('aria-label="Runs"'):
            if not runs:
                ui.html(NOTHING, sanitize=False)
                return
            ui.html(f"<h2>{len(runs)} run{'s' * (len(runs) != 1)}</h2>{runs_table(runs)}", sanitize=False)

    def _one(self, runs: list[RunSummary]) -> None:
        ui.html('<a href="/recordings">← All runs</a>', sanitize=False)
        known = {one.name: one for one in runs}
        with ui.element("div").classes("pair").props("data-linked"):
            for name, frame, param in zip(
                (self._name, self._beside), self._at, ("frame", "beside_frame"), strict=True
            ):
                if name:
                    self._player(name, frame, param)
            if self._beside:
                ui.html(LINK, sanitize=False)
            else:
                with ui.element("div").classes("pair"):
                    self._notes_card()
        if self._beside:
            self._comparison([known.get(self._name), known.get(self._beside)])
        with ui.element("div").classes("pair"):
            self._choose_other(sorted(known))
            if not self._beside:
                self._split_card()
                self._calibrate_card()

    def _player(self, name: str, frame: int, param: str) -> None:
        opened = self._workspace.run(name)
        notes = read_notes(opened.path)
        with (
            ui.element("section").classes("card").props(f'aria-label="Player of {escape(name, quote=True)}"')
        ):
            badge = simulated_badge(opened.manifest.is_simulated)
            ui.html(f"<h2>{escape(name)}{badge}</h2>", sanitize=False)
            if not len(opened):
                ui.html('<p class="empty">This run holds no frame.</p>', sanitize=False)
                return
            html = player_html(name, opened, notes, frame, param)
            ui.html(html, sanitize=False)

    def _notes_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Notes"'):
            ui.html("<h2>Notes</h2>", sanitize=False)
            notes = read_notes(self._workspace.resolve(self._name))
            self._notes = ui.html(notes_html(notes), sanitize=False).props('id="notes"')
            self._text = ui.input("note on the frame that is shown").classes("w-full")
            self._text.props(
                f'dense outlined maxlength={MAX_NOTE} aria-label="note on the frame that is shown"'
            )
            ui.button("Note it", on_click=self._note).props('outline no-caps id="note"')
            ui.label(
                "Notes are kept beside the run, in notes.jsonl; the run itself is never altered."
            ).classes("soft")

    async def _note(self) -> None:
        index = await ui.run_javascript("document.querySelector('.player')?.index ?? 0")
        try:
            await asyncio.to_thread(self._keep_note, int(index), str(self._text.value or ""))
        except (PalpateError, IndexError) as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)
            return
        self._text.set_value("")
        notes = await asyncio.to_thread(read_notes, self._workspace.resolve(self._name))
        self._notes.set_content(notes_html(notes))

    def _keep_note(self, index: int, text: str) -> None:
        opened = self._workspace.run(self._name)
        add_note(opened.path, float(opened.times_s[index]), text)

    def _split_card(self) -> None:
        with ui.element("section").classes("card").props('aria-label="Split"'):
            ui.html("<h2>Split</h2>", sanitize=False)
            why = "Which frames are held out together, so that a score says something about new presses."
            ui.label(why).classes("soft")
            opened = self._workspace.run(self._name)
            groups = [f"group:{name}" for name in opened.manifest.labels]
            kinds = ui.select([*SPLITS, *groups], value=None, label="kind", on_change=self._split)
            kinds.classes("w-full").props(
                'dense outlined options-dense stack-label id="split" aria-label="kind of split"'
            )
            self._split_shown = ui.html("", sanitize=False).classes("plot")
            if self._spec:
                kinds.set_options([*dict.fromkeys([*SPLITS, *groups, self._spec])], value=self._spec)

    def _calibrate_card(self) -> None:
        about = self._workspace.run(self._name).manifest
        columns = [name for name, kind in about.labels.items() if kind == "number" and has_unit(name)]
        if not columns:
            return
        with ui.element("section").classes("card").props('aria-label="Calibrate"'):
            ui.html("<h2>Calibrate on this run</h2>", sanitize=False)
            chosen = [name for name in about.targets if name in columns]
            chosen = chosen or [name for name in columns if name.endswith("_N")][:1] or columns[:1]
            self._targets = ui.select(columns, value=chosen, label="what shall be read", multiple=True)
            self._targets.classes("w-full").props(TARGETS)
            self._out = ui.input("folder in the workspace", value=f"cal-{Path(self._name).name}")
            self._out.classes("w-full q-my-sm").props(
                'dense outlined id="cal-out" aria-label="calibration folder"'
            )
            ui.button("Calibrate", on_click=self._calibrate).props('unelevated no-caps id="calibrate"')
            self._job_shown = ui.html("", sanitize=False).props('id="calibration-job"')
        ui.timer(LOOK_S, self._watch)

    async def _calibrate(self) -> None:
        try:
            out, targets = (
                self._workspace.resolve(str(self._out.value or "")),
                list(self._targets.value or ()),
            )
            refuse_existing(out)
            if not targets:
                raise InputError("nothing is chosen that shall be read; choose one label or more")
            what = (self._workspace.resolve(self._name), ",".join(targets))
            self._job = self._jobs.begin(f"Calibration {out.name}", "calibrate", *what, out=out)
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)

    def _watch(self) -> None:
        if self._job is None:
            return
        text = job_html(self._job)
        if self._job.state == "done":
            link = calibration_address(self._workspace.name_of(self._job.out))
            text += f'<p><a href="{link}">Look at it among the calibrations</a></p>'
        if text != self._job_shown.content:
            self._job_shown.set_content(text)

    async def _split(self, event: object) -> None:
        spec = str(getattr(event, "value", "") or "")
        if not spec:
            return
        keep_in_address(run=self._name, split=spec)
        self._split_shown.set_content(await asyncio.to_thread(self._split_html, spec))

    def _split_html(self, spec: str) -> str:
        opened = self._workspace.run(self._name)
        try:
            found = split(opened.labels, spec)
        except PalpateError as e:
            return f'<p class="trouble">{escape(str(e))}</p>'
        sizes = ", ".join(str(len(fold)) for fold in found.folds[:MAX_FOLDS])
        groups = f"{len(np.unique(found.groups))} groups; " if found.groups is not None else ""
        said = f"{found.kind}: {found.reason}; {groups}{len(found.folds)} folds of {sizes} frames"
        return f"<p>{escape(said)}</p>{split_svg(found, len(opened))}"

    def _choose_other(self, names: list[str]) -> None:
        with ui.element("section").classes("card").props('aria-label="Compare"'):
            ui.html("<h2>Set beside another run</h2>", sanitize=False)
            others = [one for one in names if one != self._name]
            if not others:
                ui.html('<p class="empty">There is no other run in the workspace.</p>', sanitize=False)
                return
            links = "".join(
                f'<li><a href="{address(self._name, one)}">{escape(one)}</a></li>' for one in others[:50]
            )
            ui.html(f"<ul>{links}</ul>", sanitize=False)

    def _comparison(self, two: list[RunSummary | None]) -> None:
        with ui.element("section").classes("card").props('aria-label="Comparison"'):
            columns = [facts_of(self._workspace.run(one.name), one) for one in two if one is not None]
            names = list(dict.fromkeys(name for facts in columns for name in facts))
            heads = ["", *(one.name for one in two if one is not None)]
            rows = [[escape(name), *(escape(f.get(name, "–")) for f in columns)] for name in names]
            ui.html(f"<h2>Beside each other</h2>{table_html(heads, rows)}", sanitize=False)


def address(name: str, beside: str = "") -> str:
    """Address of a run on the page, alone or beside another."""
    asked = {"run": name, "beside": beside} if beside else {"run": name}
    return f"/recordings?{urlencode(asked)}"


def runs_table(runs: list[RunSummary]) -> str:
    """The runs, a row each."""
    rows = []
    for one in runs:
        link = f'<a href="{address(one.name)}">{escape(one.name)}</a>'
        rows.append((
            (link if one.frames else escape(one.name)) + simulated_badge(one.simulated),
            f"{one.frames:,}",
            duration(one.length_s) if one.length_s is not None else "only an order",
            escape(", ".join(one.labels) or "none"),
            escape(one.sensor or "–"),
            f"{one.size_bytes / 1e6:.1f} MB",
            f"{state_word(one.state, WORDS_OF_STATE[one.state])} {escape(one.why)}",
        ))  # fmt: skip
    return table_html(HEADS, rows, "runs")


def player_html(name: str, opened: Run, notes: list[RunNote], frame: int, param: str) -> str:
    """A player of a run: the page's script fills in its picture."""
    shown = np.unique(np.linspace(0, len(opened) - 1, min(len(opened), MAX_TIMES)).round().astype(int))
    times = json.dumps([round(float(opened.times_s[i]), 4) for i in shown])
    at = min(max(frame, 0), len(opened) - 1)
    curve = curve_svg(curve_of(opened), notes)
    return (
        f'<div class="player" data-run="{escape(name, quote=True)}" data-frames="{len(opened)}" '
        f'data-at="{at}" data-param="{param}" data-times="{times}"><img alt="frame {at}">'
        f'<input type="range" min="0" max="{len(opened) - 1}" value="{at}" aria-label="frame">'
        '<div class="bar"><button class="button" type="button" data-play aria-pressed="false">Play</button>'
        '<button class="button" type="button" data-step="-1" aria-label="one frame back">‹</button>'
        '<button class="button" type="button" data-step="1" aria-label="one frame on">›</button>'
        f'<output>frame {at}</output></div><div class="soft" data-labels></div>'
        f'<div class="plot">{curve}</div></div>'
    )


def notes_html(notes: list[RunNote]) -> str:
    """The notes, in the order of their times."""
    if not notes:
        return '<p class="empty">No notes yet.</p>'
    rows = [(f"{note.time_s:.2f} s", escape(note.text)) for note in notes]
    return table_html(("time", "note"), rows)


def facts_of(opened: Run, about: RunSummary) -> dict[str, str]:
    """What is told of a run beside another."""
    rate = ""
    if about.length_s and about.frames > 1:
        rate = f"{(about.frames - 1) / about.length_s:.2f} Hz"
    facts = {
        "sensor": about.sensor or "–",
        "begun, UTC": about.begun[:19].replace("T", " "),
        "frames": f"{about.frames:,}",
        "length": duration(about.length_s) if about.length_s is not None else "only an order",
        "frame rate, mean": rate or "–",
        "state": about.state,
        "targets": ", ".join(about.targets) or "none",
    }
    return facts | {f"label {name}": words for name, words in label_ranges(opened).items()}
