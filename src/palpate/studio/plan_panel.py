"""The plan: choose one, change its numbers, see its places, give it to the rig."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from copy import deepcopy
from html import escape
from typing import Any

from nicegui import run, ui

from palpate.core import PalpateError
from palpate.rig.plans import PLANS, RecordingPlan, size_of
from palpate.rig.service.rig_service import checked_plan
from palpate.studio import status_text, svg_drawing
from palpate.studio.status_text import age_note

FIELDS: tuple[tuple[str, str, str, bool], ...] = (
    ("places.layer_mm", "layer diameter", "mm", False),
    ("places.probe_mm", "indenter diameter", "mm", False),
    ("places.pitch_mm", "grid pitch", "mm", False),
    ("places.per_side", "candidates a side", "", True),
    ("places.count", "places", "", True),
    ("places.apart_mm", "least distance", "mm", False),
    ("cycles", "presses a place", "", True),
    ("depth_mm", "depth", "mm", False),
    ("step_mm", "depth step", "mm", False),
    ("until_N", "turn round at", "N", False),
    ("frames", "frames a depth", "", True),
    ("reference_frames", "reference frames", "", True),
    ("threshold_N", "contact threshold", "N", False),
    ("seek_mm_s", "search speed", "mm/s", False),
    ("press_mm_s", "press speed", "mm/s", False),
    ("speed_mm_s", "sweep speed", "mm/s", False),
    ("clearance_mm", "lift between presses", "mm", False),
)
"""A plan's field, its name on the page, its unit, whether it is a whole number."""

Act = Callable[..., Coroutine[Any, Any, bool]]


class PlanPanel:
    """A draft of a plan that is this tab's own until it is used; otherwise what the rig has.

    Args:
        use: gives a plan to the rig; whether it took it.
    """

    def __init__(self, use: Act) -> None:
        self._use = use
        self._rigs: dict[str, Any] = {}
        self._draft: dict[str, Any] | None = None
        self._shown: tuple[Any, ...] = ()
        self._plan: RecordingPlan | None = None
        with ui.element("section").classes("card").props('aria-label="Plan"'):
            with ui.row().classes("w-full items-center justify-between no-wrap"):
                ui.html("<h2>Plan</h2>", sanitize=False)
                self._choice = (
                    ui.select(list(PLANS), label="begin from", on_change=self._chosen)
                    .props("dense outlined options-dense stack-label")
                    .classes("grow plan-choice")
                )
            self._drawing = ui.html("", sanitize=False).classes("grid-preview")
            self._drawing.props('id="grid" data-age-of="position"')
            age_note("position", "stage position")
            self._facts = ui.html("", sanitize=False).classes("facts")
            self._fields = ui.element("div").classes("fields")
            self._trouble = ui.html("", sanitize=False).classes("trouble").props('role="alert"')
            with ui.row().classes("w-full justify-end"):
                self._back = ui.button("Undo", on_click=self._undo).props(
                    'flat no-caps id="plan-undo" aria-label="Undo the changes of the plan"'
                )
                self._button = ui.button("Use this plan", on_click=self._submit)
                self._button.props('unelevated no-caps id="plan-use"')

    async def refresh(self, status: Mapping[str, Any], *, may_use: bool = True) -> None:
        """Show the rig's plan, unless there is a draft; `may_use` of an operator who may give the rig one."""
        if status["plan"] != self._rigs:
            self._rigs = status["plan"]
            if self._draft is None or self._draft == self._rigs:
                self._draft = None
                await self._fill(self._rigs)
        dirty = self._draft is not None
        self._back.set_visibility(dirty)
        self._button.set_enabled(may_use and dirty and not status["recording"] and self._plan is not None)
        self._draw(status)

    @property
    def _current(self) -> dict[str, Any]:
        return self._rigs if self._draft is None else self._draft

    async def _chosen(self) -> None:
        if self._choice.value in PLANS and self._choice.value != self._current["name"]:
            self._draft = PLANS[self._choice.value].model_dump(mode="json")
            await self._fill(self._draft)

    async def _undo(self) -> None:
        self._draft = None
        await self._fill(self._rigs)

    async def _submit(self) -> None:
        if self._draft is not None and await self._use("plan", self._draft):
            self._rigs, self._draft = self._draft, None
            await self._fill(self._rigs)

    async def _fill(self, fields: dict[str, Any]) -> None:
        """Inputs for the numbers that this kind of plan has."""
        self._choice.value = fields["name"] if fields["name"] in PLANS else None
        self._fields.clear()
        with self._fields:
            for name, label, unit, whole in FIELDS:
                value = _get(fields, name)
                if value is not None:
                    self._field(name, label, unit, whole, value)
        await self._judge(fields)

    def _field(self, name: str, label: str, unit: str, whole: bool, value: float) -> None:
        ui.number(
            label,
            value=value,
            format="%d" if whole else "%.6g",
            suffix=unit or None,
            on_change=lambda event: self._changed(name, event.value, whole),
        ).props(f'dense outlined aria-label="{label}{f", in {unit}" if unit else ""}"').classes(
            f"field-{name.replace('.', '-')}"
        )

    async def _changed(self, name: str, value: float | None, whole: bool) -> None:
        number = int(value) if whole and value is not None and value == int(value) else value
        if number == _get(self._current, name):
            return
        draft = deepcopy(self._current)
        _set(draft, name, number)
        draft["name"] = "by-hand" if draft["name"] in PLANS else draft["name"]
        self._draft = draft
        await self._judge(draft)

    async def _judge(self, fields: dict[str, Any]) -> None:
        """Judge the draft in a thread: nothing here may hold up an emergency stop that comes in meanwhile."""
        try:
            laid_out = await run.io_bound(_laid_out, fields)
        except PalpateError as e:
            self._plan = None
            self._trouble.set_content(escape(str(e)))
            return
        if laid_out is not None and fields is self._current:  # and not an older one, late
            (self._plan, facts), self._shown = laid_out, ()
            self._trouble.set_content("")
            self._facts.set_content(facts)

    def _draw(self, status: Mapping[str, Any]) -> None:
        if self._plan is None:
            return
        own = self._draft is None
        at = status["position_mm"] if own else None
        place = str(status["place"]).split(",")[0] if own else ""
        shots = int(status["shots"]) if own else 0
        shown = (shots, place, None if at is None else tuple(round(d, 1) for d in at[:2]))
        if shown == self._shown:
            return
        self._shown = shown
        self._drawing.set_content(
            svg_drawing.grid_svg(
                self._plan.places.places(),
                self._plan.places.outline,
                self._plan.places.sizes_mm()[1],
                done=status_text.done_by_place(self._plan, shots),
                now=place,
                at_mm=at,
            )
        )


def _laid_out(fields: Mapping[str, Any]) -> tuple[RecordingPlan, str]:
    plan = checked_plan(fields)
    layer, probe = plan.places.sizes_mm()
    skin = "a polygon within " if plan.places.corners_mm else ""
    facts = (
        f"<b>{escape(status_text.plan_facts(plan, size_of(plan)))}</b><br>"
        f"indenter of {probe:g} mm on a layer of "
        f"{skin}{layer:g} mm: {status_text.clearance(plan)}"
    )
    return plan, facts


def _get(fields: Mapping[str, Any], name: str) -> Any:
    value: Any = fields
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _set(fields: dict[str, Any], name: str, value: Any) -> None:
    *groups, last = name.split(".")
    for group in groups:
        fields = fields[group]
    fields[last] = value
