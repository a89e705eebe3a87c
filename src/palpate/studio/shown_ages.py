"""Age of each displayed number: rig process, page server, and browser each add their part.

The process reports its part, this module adds the server's, and `ages.html` the browser's and marks old
values, so no number looks current for longer than `MAX_FRESH_S` when any of the three is silent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from nicegui import ui

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
