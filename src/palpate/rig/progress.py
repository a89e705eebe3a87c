"""What is recorded already, read from the recording itself, and how far a recording is."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass

import pandas as pd

from palpate.core.errors import RecordingError
from palpate.recordings.reader import Run
from palpate.rig.outcome import State
from palpate.rig.plans.plan import Plan
from palpate.rig.plans.steps import Done

PLAN = "plan"
SHOT = "shot"
ZERO = "zero"
SWEEPS = "sweep"


@dataclass(frozen=True, slots=True)
class Status:
    """How far a recording is, for whoever watches.

    Attributes:
        state: of the engine.
        message: what it does, or what stopped it.
        shots, planned: recorded, and in all.
        left_s: about so long still; None where that is not known yet.
        force_n: the newest, in the skin's axes.
        position_mm: of the stage, from the layer's centre at its expected surface.
    """

    state: State
    message: str
    shots: int
    planned: int
    left_s: float | None
    force_n: tuple[float, float, float] | None = None
    position_mm: tuple[float, float, float] | None = None


def done_in(run: Run) -> Done:
    """Which frames of which shots a run holds. A frame counts that has its label; a sweep, when it ended.

    Nothing but the recording is asked: there is no ledger that could say otherwise.
    """
    labels = run.labels
    found: dict[str, set[int]] = defaultdict(set)
    known = labels["shot"].notna() & labels["frame_in_shot"].notna()
    stepped = known & (labels["phase"] != SWEEPS)
    for key, k in zip(labels["shot"][stepped], labels["frame_in_shot"][stepped], strict=True):
        found[str(key)].add(int(k))
    for fields in fields_of(run, SHOT):
        if fields.get("whole"):
            found[str(fields["key"])].add(0)
    return {key: frozenset(frames) for key, frames in found.items()}


def check_same_plan(run: Run, plan: Plan) -> None:
    """Refuse to go on with another plan than the one that a run was begun with.

    Raises:
        RecordingError: the run has another plan, or none.
    """
    begun = fields_of(run, PLAN)
    if not begun:
        raise RecordingError(f"{run.path} was not recorded by a plan; name a new run")
    if begun[0]["hash"] != plan.hash:
        raise RecordingError(
            f"{run.path} was begun with another plan ({str(begun[0]['hash'])[:12]}) than this one, "
            f"{plan.name!r} ({plan.hash[:12]}); give that one, or name a new run"
        )


def fields_of(run: Run, kind: str) -> list[dict[str, object]]:
    """The fields of all events of a kind, in order."""
    events: pd.DataFrame = run.events()
    return [json.loads(text) for text in events.loc[events["kind"] == kind, "fields"]]
