"""Ages of what the page shows: how old each number of the machine is, by the clock of whoever shows it.

A number ages three times: in the rig's process until it is told, in the page's server until it is sent, and
in the browser until something newer comes. The process tells its share; this module adds the server's, and
`ages.html` the browser's, which also marks what is old. So no number looks current for longer than
`MAX_FRESH_S`, whoever of the three has fallen silent.
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
    """Age of each part of a status that is shown [s]; None of what there never was.

    Args:
        now_s: the monotonic time now [s].
        status: the last that was told, however long ago; None where it was not kept.
        told_s: when that was, on the same clock; None where nothing ever was.

    Returns:
        By name: "process", since its process told anything; "engine", since whoever records did, or the
        former where nothing is recorded; "force", "position", "camera".
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
    """Place where the page's script says how old something is, where that is too much.

    Args:
        part: whose age it is.
        what: begins the words, such as "force".
    """
    return ui.element("span").classes("age").props(f'data-says-age-of="{part}" data-what="{what} "')
