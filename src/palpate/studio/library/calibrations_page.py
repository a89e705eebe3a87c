"""Calibrations: the workspace's, with their scores; their reports, two compared, one scored on another run.

All that takes time is done by processes of their own; what is chosen stands in the page's address.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from palpate.core import PalpateError, half_width_text, rounded
from palpate.estimators.model_card import Card, TargetCard
from palpate.reports.evaluation_text import day_text
from palpate.studio.library.background_jobs import BackgroundJob, BackgroundJobs
from palpate.studio.library.workspace import Workspace
from palpate.studio.page_shell import (
    PageBeat,
    commands_html,
    keep_in_address,
    page_shell,
    page_title,
    progress_html,
    simulated_badge,
    state_word,
    table_html,
    trouble_html,
)

LOOK_S = 0.3
SELECT = 'dense outlined options-dense stack-label id="{}" aria-label="{}"'
HEADS = ("target", "mean error", "half width", "range", "held")
CARDS = dict[str, Card | str]
NOTHING = (
    '<h2>No calibrations yet</h2><p class="empty">Nothing is calibrated in this folder. Go through '
    '<a href="/">Start</a>, or run <code>palpate calibrate RUN --out cal</code> in it.</p>'
)


class CalibrationsPage:
    """Page of calibrations in one tab.

    Args:
        chosen: Calibration, second calibration, and run in the address; "" for none.
    """

    def __init__(self, workspace: Workspace, jobs: BackgroundJobs, chosen: tuple[str, str, str]) -> None:
        self._workspace, self._jobs = workspace, jobs
        self._chosen = chosen
        self._shown: dict[int, ui.html] = {}
        self._useless: set[str] = set()
        page_shell("calibrations")
        PageBeat()
        page_title("Calibrations", f"in {workspace.folder}")
        with ui.element("main").classes("sheet") as self._sheet:
            self._wait = ui.label("Looking at the calibrations …").classes("soft").props('role="status"')
        ui.timer(0.01, self._fill, once=True)
        ui.timer(LOOK_S, self._watch)

    async def _fill(self) -> None:
        cards, runs = await asyncio.to_thread(self._read)
        self._wait.delete()
        with self._sheet:
            self._list(cards)
            good = [name for name, card in cards.items() if isinstance(card, Card)]
            if good:
                self._work(good, runs)

    def _read(self) -> tuple[CARDS, list[str]]:
        cards: CARDS = {}
        for name in self._workspace.found("calibration"):
            try:
                card = cards[name] = self._workspace.card(name)
            except PalpateError as e:
                cards[name] = str(e)
                continue
            if self._workspace.is_useless(name, card):
                self._useless.add(name)
        return cards, self._workspace.found("run")

    def _list(self, cards: CARDS) -> None:
        with ui.element("section").classes("card").props('aria-label="Calibrations"'):
            if not cards:
                ui.html(NOTHING, sanitize=False)
                return
            count = f"{len(cards)} calibration{'s' * (len(cards) != 1)}"
            ui.html(f"<h2>{count}</h2>", sanitize=False)
            for name, card in cards.items():
                self._row(name, card)

    def _row(self, name: str, card: Card | str) -> None:
        with ui.element("article").classes("calibration").props(f'aria-label="{escape(name, quote=True)}"'):
            if isinstance(card, str):
                damaged = f"<h3>{escape(name)} {state_word('damaged', 'bad')}</h3>{trouble_html(card)}"
                ui.html(damaged, sanitize=False)
                return
            ui.html(f"{heading_html(name, card, name in self._useless)}{card_html(card)}", sanitize=False)
            ui.button("Report", on_click=lambda: self._begin_report(name)).props(
                f'outline dense no-caps aria-label="Report of {escape(name, quote=True)}"'
            ).classes("report-button q-px-md")

    def _work(self, names: list[str], runs: list[str]) -> None:
        first, second, on = self._chosen
        with ui.element("div").classes("pair"):
            with ui.element("section").classes("card").props('aria-label="Compare two"'):
                ui.html("<h2>Compare two</h2>", sanitize=False)
                self._first = self._select(names, first, "compare-first", "calibration")
                self._second = self._select(names, second, "compare-second", "other calibration", 1)
                ui.button("Compare", on_click=self._begin_comparison).props('unelevated no-caps id="compare"')
            with ui.element("section").classes("card").props('aria-label="Score on another run"'):
                ui.html("<h2>Score on another run</h2>", sanitize=False)
                self._scored = self._select(names, first, "score-calibration", "calibration to score")
                self._on = self._select(runs, on, "score-run", "labelled run")
                ui.button("Score", on_click=self._begin_score).props('unelevated no-caps id="score"')
        with ui.element("section").classes("card").props('aria-label="Jobs" role="log"'):
            ui.html("<h2>Jobs</h2>", sanitize=False)
            self._empty = ui.label("Nothing has been asked for.").classes("soft")
            self._list_of_jobs = ui.element("div").props('id="jobs"')

    def _select(self, names: list[str], chosen: str, key: str, label: str, index: int = 0) -> ui.select:
        value = chosen if chosen in names else names[min(index, len(names) - 1)] if names else None
        made = ui.select(names, value=value, label=label, on_change=self._keep).classes("w-full q-mb-sm")
        return made.props(SELECT.format(key, label))

    def _keep(self) -> None:
        keep_in_address(cal=self._first.value, beside=self._second.value, run=self._on.value)

    async def _begin_report(self, name: str) -> None:
        await self._begin(f"Report of {name}", "report", (name,), ".html")

    async def _begin_comparison(self) -> None:
        first, second = str(self._first.value), str(self._second.value)
        await self._begin(f"{first} compared with {second}", "compare", (first, second), ".html")

    async def _begin_score(self) -> None:
        if self._on.value:
            what = str(self._scored.value), str(self._on.value)
            await self._begin(f"{what[0]} scored on {what[1]}", "evaluate", what, ".json")

    async def _begin(self, title: str, do: str, names: tuple[str, ...], suffix: str) -> None:
        def begun() -> BackgroundJob:
            paths: list[Path] = [self._workspace.resolve(name) for name in names]
            return self._jobs.begin(title, do, *paths, suffix=suffix)

        try:
            job = await asyncio.to_thread(begun)
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)
            return
        self._empty.set_visibility(False)
        with self._list_of_jobs:
            self._shown[job.number] = ui.html(job_html(job), sanitize=False)
            ui.button("Cancel", on_click=lambda: self._jobs.cancel(job.number)).props(
                "flat dense no-caps"
            ).bind_visibility_from(job, "state", value="running")
        self._shown[job.number].run_method("scrollIntoView", {"block": "nearest"})

    def _watch(self) -> None:
        for number, shown in self._shown.items():
            job = self._jobs.get(number)
            text = job_html(job) if job else '<p class="soft">This job is kept no longer.</p>'
            if text != shown.content:
                shown.set_content(text)


def heading_html(name: str, card: Card, useless: bool) -> str:
    """A calibration's name, and what is to be known of it before its numbers are read."""
    unsure = f" {state_word('not surely better than the mean', 'bad')}" if useless else ""
    return f"<h3>{escape(name)}{simulated_badge(card.is_simulated)}{unsure}</h3>"


def card_html(card: Card) -> str:
    """A calibration in short: id, what it was made of, and a row a target."""
    rows = [target_cells(one) for one in card.targets]
    for one in card.classes or ():
        rows.append((f"{escape(one.column)}: {len(one.values)} classes", "–", "–", "–", "–"))
    conditions = [
        f"id {card.id}",
        card.model_name,
        card.sensor or "a sensor",
        f"{card.split.rows_scored} rows held out {card.split.kind}",
        f"{card.split.groups} groups" if card.split.groups else "",
        "read as the difference to the untouched sensor" if card.input.delta else "read as the frame itself",
        f"frames of {card.input.frame_px[1]} × {card.input.frame_px[0]} px",
    ]
    audit = "" if card.split.clean else f" {state_word('audit failed', 'bad')}"
    said = escape(" · ".join(filter(None, conditions)))
    return f'<p class="soft">{said}{audit}</p>{table_html(HEADS, rows)}'


def target_cells(one: TargetCard) -> tuple[str, ...]:
    """A target's row: its errors, its intervals, its range and how often the intervals held."""
    score, unit = one.score, escape(one.unit)
    read = "" if one.is_read else f" {state_word('not read', 'warn')}"
    ends = f"{100 * score.coverage_90_low:.0f} to {100 * score.coverage_90_high:.0f} %"
    return (
        escape(one.quantity) + read,
        f"{rounded(score.mae, score.mae)} {unit}",
        f"± {half_width_text(score.half_width)} {unit}",
        f"{one.least:.3g} to {one.greatest:.3g} {unit}".replace("-", "−"),
        f"{100 * score.coverage_90:.0f} % of {score.n} (95 % interval {ends})",
    )


def job_html(job: BackgroundJob) -> str:
    """A job: what it does, how far it is, and what came of it."""
    looks = {"failed": "bad", "cancelled": "warn"}
    told = f"<h3>{escape(job.title)} {state_word(job.state, looks.get(job.state, ''))}</h3>"
    if job.state == "running":
        return told + progress_html(job.step, job.done, job.total, job.title)
    if job.state != "done":
        return told + trouble_html(job.why)
    if job.out.suffix == ".html":
        link = f'<a href="/sheet/{job.number}" target="_blank" rel="noopener">'
        told += f"<p>{link}Open the page in a tab of its own</a></p>"
    if "text" in job.found:
        told += commands_html([str(job.found["text"])])
    told += "".join(f"<p>{_score_text(*one)}</p>" for one in job.found.get("targets", {}).items())
    told += "".join(trouble_html(one) for one in job.found.get("findings", ()))
    return told + (_day_html(job.found) if "learnt_from_this_run" in job.found else "")


def _day_html(scores: Mapping[str, Any]) -> str:
    """Whether a score is of another day, which no score tells of itself."""
    other = not (scores["learnt_from_this_run"] or scores["same_session"])
    return f'<p class="soft">{escape(day_text(scores))}</p>' if other else trouble_html(day_text(scores))


def _score_text(name: str, score: Mapping[str, Any]) -> str:
    held = f"{100 * score['coverage_90']:.1f} % (95 % interval {100 * score['coverage_90_low']:.0f} to "
    return (
        f"{escape(name)}: mean error {score['mae']:.3g} {escape(score['unit'])} over {score['n']} frames; "
        f"intervals held the truth in {held}{100 * score['coverage_90_high']:.0f} %)"
    )


def calibration_address(name: str) -> str:
    """Address of a calibration on the page."""
    return f"/calibrations?{urlencode({'cal': name})}"
