"""Trials: the workspace's experiments on people, how far each participant is, and the commands that go on.

Nobody is asked anything here: a sitting is run in a terminal by the experimenter, and no key is shown.
"""

from __future__ import annotations

import asyncio
import shlex
from dataclasses import dataclass
from html import escape

from nicegui import ui

from palpate.core import PalpateError
from palpate.psychophysics.experiments import (
    ExperimentDesign,
    ParticipantRecord,
    make_schedule,
    read_design,
    records,
)
from palpate.psychophysics.experiments.sitting import REHEARSAL, participant_folder
from palpate.psychophysics.judgements import RESPONSES, read_judgements
from palpate.studio.library.background_jobs import BackgroundJob, BackgroundJobs
from palpate.studio.library.calibrations_page import job_html
from palpate.studio.library.workspace import Workspace
from palpate.studio.page_shell import (
    PageBeat,
    commands_html,
    page_shell,
    page_title,
    state_word,
    table_html,
    trouble_html,
)

AGAIN_S, LOOK_S = 5.0, 0.3


@dataclass(frozen=True, slots=True)
class ParticipantProgress:
    """Progress of one participant.

    Attributes:
        kept, most: judgements that are kept, and the most that the schedule may ask for.
    """

    code: str
    group: str
    kept: int
    most: int
    state: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class ExperimentSummary:
    """Summary of an experiment's folder, for a list.

    Attributes:
        name: of the folder, from the workspace.
        participants: those who have begun, or did not consent.
        why: what is wrong with it; "" for a sound one.
    """

    name: str
    title: str
    wanted: int
    participants: tuple[ParticipantProgress, ...]
    commands: tuple[str, ...]
    why: str = ""

    @property
    def answered(self) -> tuple[str, ...]:
        """Folders whose answers can be analysed, from the workspace; a rehearsal's is its own."""
        kinds = {one.simulated for one in self.participants if one.kept}
        return tuple(f"{self.name}/{REHEARSAL}" if simulated else self.name for simulated in sorted(kinds))


def experiment_summary(workspace: Workspace, name: str) -> ExperimentSummary:
    """Summary of an experiment; one that is damaged says so."""
    try:
        folder = workspace.resolve(name)
        design = read_design(folder)
        people = [_progress(design, one) for kind in (False, True) for one in records(design, kind)]
    except PalpateError as e:
        return ExperimentSummary(name, name, 0, (), (), str(e))
    wanted = sum(group.participants for group in design.file.group)
    typed = shlex.quote(name)
    open_ones = [one for one in people if one.state == "goes on" and not one.simulated]
    begun = sum(not one.simulated for one in people)
    commands = [f"palpate experiment run {typed} --participant {one.code}" for one in open_ones]
    if begun < wanted:
        commands.append(f"palpate experiment run {typed} --participant P{begun + 1:02d}")
    if not people:
        rehearsal = "--participant R01 --noise 0.3   # a rehearsal: nobody is asked"
        commands.append(f"palpate experiment run {typed} {rehearsal}")
    if any(one.kept and not one.simulated for one in people):
        commands.append(f"palpate experiment analyze {typed} --out {shlex.quote(name)}.html")
        commands.append(f"palpate experiment export {typed} {shlex.quote(name)}-bids")
    if any(one.kept and one.simulated for one in people):
        rehearsed = shlex.quote(f"{name}/{REHEARSAL}")
        commands.append(f"palpate experiment analyze {rehearsed} --out rehearsal.html   # simulated")
    return ExperimentSummary(name, design.file.name, wanted, tuple(people), tuple(commands))


def _progress(design: ExperimentDesign, one: ParticipantRecord) -> ParticipantProgress:
    if one.consent == "no":
        return ParticipantProgress(one.participant, "–", 0, 0, "did not consent", one.simulated)
    folder = participant_folder(design, one.participant, one.simulated)
    # Rows that end: one that is being written is none yet. Nothing else of the table is looked at.
    kept = max((folder / RESPONSES).read_bytes().count(b"\n") - 1, 0)
    schedule = make_schedule(design, one.number, one.simulated)
    answered = kept >= schedule.max_trials
    if not answered and not schedule.is_fixed:
        answered = schedule.next(list(read_judgements(folder / RESPONSES))) is None
    state = "complete" if answered else "goes on"
    return ParticipantProgress(one.participant, one.group, kept, schedule.max_trials, state, one.simulated)


class TrialsPage:
    """Page of experiments in one tab."""

    def __init__(self, workspace: Workspace, jobs: BackgroundJobs) -> None:
        self._workspace, self._jobs = workspace, jobs
        self._job: BackgroundJob | None = None
        page_shell("trials")
        PageBeat()
        page_title("Trials", f"experiments on people in {workspace.folder}")
        with ui.element("main").classes("sheet"):
            self._shown = ui.html(
                '<p class="soft" role="status">Looking at the experiments …</p>', sanitize=False
            )
            with ui.element("section").classes("card").props('aria-label="Analysis"') as self._analysis:
                ui.html("<h2>Analysis as a page</h2>", sanitize=False)
                self._choice = ui.select([], label="answers of").classes("w-full q-mb-sm")
                self._choice.props(
                    'dense outlined options-dense stack-label id="answers-of" aria-label="answers of"'
                )
                ui.button("Analyse", on_click=self._begin).props('unelevated no-caps id="analyse"')
                self._job_shown = ui.html("", sanitize=False).props('id="analysis-job"')
            self._analysis.set_visibility(False)
        ui.timer(0.01, self._refresh, once=True)
        ui.timer(AGAIN_S, self._refresh)
        ui.timer(LOOK_S, self._watch)

    async def _refresh(self) -> None:
        found = await asyncio.to_thread(self._read)
        text = "".join(experiment_html(one) for one in found) or NOTHING
        if text == self._shown.content:
            return
        self._shown.set_content(text)
        answered = [name for one in found for name in one.answered]
        self._analysis.set_visibility(bool(answered))
        kept = self._choice.value if self._choice.value in answered else next(iter(answered), None)
        self._choice.set_options(answered, value=kept)

    def _read(self) -> list[ExperimentSummary]:
        return [experiment_summary(self._workspace, name) for name in self._workspace.found("experiment")]

    async def _begin(self) -> None:
        name = str(self._choice.value)
        try:
            self._job = self._jobs.begin(
                f"Analysis of {name}", "analyse", self._workspace.resolve(name), suffix=".html"
            )
        except PalpateError as e:
            ui.notify(str(e), type="negative", position="top", timeout=9000, multi_line=True)

    def _watch(self) -> None:
        if self._job is not None and (text := job_html(self._job)) != self._job_shown.content:
            self._job_shown.set_content(text)


NOTHING = (
    '<section class="card" aria-label="Experiments"><h2>No experiments yet</h2><p class="empty">An '
    "experiment is a folder with a design in it. Make one in the workspace, edit it before the first "
    'participant, and it is listed here:</p><pre class="commands">palpate experiment new jelly --preset jelly'
    "</pre></section>"
)
HEADS = ("participant", "group", "judgements", "state")


def experiment_html(one: ExperimentSummary) -> str:
    """An experiment: who is how far, and what can be typed next."""
    head = f'<section class="card" aria-label="{escape(one.name, quote=True)}"><h2>{escape(one.title)}</h2>'
    if one.why:
        return f"{head}<p>{state_word('damaged', 'bad')}</p>{trouble_html(one.why)}</section>"
    measured = [p for p in one.participants if not p.simulated]
    complete = sum(p.state == "complete" for p in measured)
    begun = f"{len(measured)} of {one.wanted} participants have begun"
    rows = [_participant_cells(p) for p in one.participants]
    table = table_html(HEADS, rows) if rows else '<p class="empty">Nobody has begun.</p>'
    return (
        f'{head}<p class="soft">folder {escape(one.name)}; {begun}, {complete} are complete</p>{table}'
        f"<h3>In a terminal, in the workspace</h3>{commands_html(one.commands)}</section>"
    )


def _participant_cells(one: ParticipantProgress) -> tuple[str, ...]:
    return (
        escape(one.code) + (f" {state_word('simulated', 'warn')}" if one.simulated else ""),
        escape(one.group),
        f"{one.kept} of at most {one.most}" if one.most else "none",
        state_word(one.state),
    )
