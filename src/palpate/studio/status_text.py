"""Words of the page: the rig process's status as text.

Age of each displayed number: rig process, page server, and browser each add their part.

The process reports its part, this module adds the server's, and `ages.html` the browser's and marks old
values, so no number looks current for longer than `MAX_FRESH_S` when any of the three is silent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from nicegui import ui

from palpate.rig.plans import RecordingPlan, Size
from palpate.rig.plans.press_places import ROUNDING_MM

WISHES = {"pause": "pausing", "stop": "stops after this press", "abort": "aborting", "estop": "stopping"}


def duration(seconds: float | None) -> str:
    """Duration in words, such as "3 min 20 s"."""
    if seconds is None:
        return "–"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def time_left(status: Mapping[str, Any]) -> str:
    """Measured where shots have come, else by the plan; nothing where all is done."""
    if status["state"] == "done":
        return "complete"
    if not status["recording"] and status["shots"]:
        return f"{status['planned'] - status['shots']:,} left"
    if not status["recording"] or status["left_s"] is None:
        return f"about {duration(status['size']['seconds'])} in all"
    return f"about {duration(status['left_s'])} left"


def state_of(status: Mapping[str, Any] | None) -> tuple[str, str]:
    """State of the rig in a word or two, and its look: "calm", "busy", "warn" or "bad"."""
    if status is None:
        return "no connection", "bad"
    if status["held"]:
        return "emergency stop", "bad"
    state = str(status["state"])
    if status["recording"]:
        wish = WISHES.get(str(status["asked"]), "") if state != "paused" or status["asked"] != "pause" else ""
        return (wish, "warn") if wish else (state, "warn" if state == "paused" else "busy")
    if state in ("failed", "e-stopped"):
        return state, "bad"
    return ("ready" if state == "running" else state), ("warn" if state == "aborted" else "calm")


def failure(status: Mapping[str, Any] | None, lost: str) -> str:
    """What has to be read out at once: a rig that is lost, held or has failed; empty otherwise."""
    if status is None:
        return lost
    if status["held"]:
        return "Emergency stop: the stage is held."
    failed = status["state"] == "failed" and not status["recording"]
    return f"The recording failed: {status['message']}" if failed else ""


def doing(status: Mapping[str, Any]) -> str:
    """Activity of the rig; where it was when it was paused."""
    message = str(status["message"])
    if status["state"] == "paused" and ", cycle " in message:
        return f"the probe is lifted and waits; it was at {message.rpartition(':')[0]}"
    return message


def done_by_place(plan: RecordingPlan, shots: int) -> dict[str, float]:
    """Return the recorded fraction of each location's presses.

    Shots are recorded in the plan's order and a resumed recording starts at the first missing one, so their
    count identifies them.
    """
    done: dict[str, list[bool]] = {}
    for press in plan.presses():
        shots -= len(plan.shots(press))
        done.setdefault(press.place.name, []).append(shots >= 0)
    return {name: sum(whole) / len(whole) for name, whole in done.items()}


def clearance_mm(plan: RecordingPlan) -> float:
    """Between the probe and the skin's rim, at the place where it is least."""
    places, outline = plan.places, plan.places.outline
    nearest_m = min(outline.clearance_m(1e-3 * p.x_mm, 1e-3 * p.y_mm) for p in places.places())
    return 1e3 * nearest_m - places.sizes_mm()[1] / 2


def clearance(plan: RecordingPlan) -> str:
    """The same in words."""
    clear = clearance_mm(plan)
    if clear < -ROUNDING_MM:
        return f"its edge reaches {-clear:.2f} mm over the rim"
    return f"its edge stays {max(clear, 0.0):.2f} mm or more from the rim"


def plan_facts(plan: RecordingPlan, size: Size) -> str:
    """Size of a plan, in a line."""
    shots = sum(len(plan.shots(press)) for press in plan.presses())
    return (
        f"{size.points} place{'s' * (size.points != 1)} × {plan.cycles} · {shots:,} shots, "
        f"{shots - size.shots:,} of them untouched · "
        f"{size.frames + size.reference_frames:,} frames · about {duration(size.seconds)}"
    )


def number(value: float, digits: int) -> str:
    """Number with a true minus, and none before a zero."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


MAX_FRESH_S = 1.0
"""Age from when on a number is marked as old, with its age [s]."""
MAX_SILENT_S = 2.0
"""Silence from when on a banner says for how long nothing has been heard [s]."""

Ages = dict[str, float | None]
PARTS = ("force", "position", "camera")


def ages_at(now_s: float, status: Mapping[str, Any] | None, told_s: float | None) -> Ages:
    """Return the age of each displayed part of a status by name; None for parts never received [s].

    "process" counts from its last message, "engine" from the recorder's (else as "process"); further "force",
    "position", "camera".

    Args:
        now_s: Monotonic time now [s].
        status: Last status received; None if not kept.
        told_s: Time of its arrival on the same clock; None for never.
    """
    if told_s is None:
        return dict.fromkeys(("process", "engine", *PARTS))
    since_s = max(now_s - told_s, 0.0)
    own = (status or {}).get(
        "ages_s", {}
    )  # of a process begun by an older version, nothing but its silence is known
    ages: Ages = {"process": since_s, "engine": since_s + (own.get("engine") or 0.0)}
    for part in PARTS:
        age_s = own.get(part)
        ages[part] = None if age_s is None else age_s + since_s
    return ages


def ages_attribute(ages: Ages, beat: int) -> str:
    """The ages as the page's script reads them, with the limits; no two beats are alike."""
    rounded = {name: None if age_s is None else round(age_s, 2) for name, age_s in ages.items()}
    return json.dumps({"ages": rounded, "beat": beat, "fresh_s": MAX_FRESH_S, "silent_s": MAX_SILENT_S})


def age_note(part: str, what: str) -> ui.element:
    """Place where the page's script says how old something is, where that is too much."""
    return ui.element("span").classes("age").props(f'data-says-age-of="{part}" data-what="{what} "')
