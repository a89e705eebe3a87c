"""Progress of a run: the engine's data on their way into it, its state, and what it holds already."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import pandas as pd

from palpate.core import NS_PER_S, Frame, Position, RecordingError, Wrench
from palpate.devices import ForceBias, Reason, Tripped
from palpate.recordings import Manifest, Offset, Run, RunWriter
from palpate.recordings.label_tables import Label
from palpate.recordings.run_reader import VOID
from palpate.rig.plans.recording_plan import Done, RecordingPlan


class Recorder:
    """Writes what the rig sees; what the disk refuses is raised where the next thing is recorded.

    Attributes:
        muted: record events alone: the disk has refused, or a write must not hold up lifting the probe.
    """

    def __init__(self, writer: RunWriter, bias: ForceBias, begun_ns: int) -> None:
        """Args: of what was before `begun_ns` nothing is recorded."""
        self._begun_ns = begun_ns
        self._writer = writer
        self._bias = bias
        self.muted = False
        self._force_ns = 0
        self._ran_back = False

    def force(self, samples: Sequence[Wrench]) -> None:
        """Record every good sample; faulty ones hold no numbers."""
        for one in samples:
            if not one.fault and not self.muted and self._follows(one.time_ns):
                force, torque = self._bias.force(one), self._bias.torque(one)
                self._writer.force((*force, *torque), time_ns=one.time_ns)
                self._writer.force((*one.force_n, *one.torque_nm), time_ns=one.time_ns, raw=True)

    def _follows(self, time_ns: int) -> bool:
        """Whether a sample is to be recorded: not from before the run, nor before the last."""
        if time_ns >= self._force_ns:
            self._force_ns = time_ns
            return time_ns >= self._begun_ns
        if not self._ran_back:
            self._ran_back = True
            raise Tripped(
                Reason.FORCE_FAULT,
                f"a force sample is stamped {(self._force_ns - time_ns) / NS_PER_S:.3f} s before the one "
                "that it follows: the force sensor's clock jumped or runs backwards",
            )
        return False

    def stage(self, position_m: Position, time_ns: int) -> None:
        """Record where the stage is."""
        if not self.muted:
            self._writer.stage(position_m, time_ns=time_ns)

    def frame(self, frame: Frame, time_ns: int, labels: Mapping[str, Label]) -> bool:
        """A frame and what is known of it; False where it was dropped."""
        return self._writer.frame(frame.image, time_ns=time_ns, exposure_s=frame.exposure_s, labels=labels)

    def event(self, kind: str, **fields: Any) -> None:
        """Record that something happened."""
        self._writer.event(kind, **fields)

    def sync(self) -> None:
        """Wait until the disk holds all that was recorded so far."""
        self._writer.sync()


class State(StrEnum):
    """State of the engine."""

    READY = "ready"
    RUNNING = "running"
    PAUSED = "paused"
    DONE = "done"  # every shot of the plan is recorded
    STOPPED = "stopped"  # the operator ended it after a press; to be resumed
    ABORTED = "aborted"  # the operator ended it at once; to be resumed
    ESTOPPED = "e-stopped"  # the operator's emergency stop: nothing moves, also not away
    FAILED = "failed"  # a guard or a device ended it; the reason says which


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a recording.

    Attributes:
        state: done, stopped, aborted, e-stopped or failed.
        reason: of a failure.
        message: what happened, with numbers and units.
        shots: recorded so far, over all segments; planned: all of the plan's.
        clocks: how far the frames run behind the force, from taps; None where there were none.
        zero_moved_n: most that the force sensor's zero moved over a press, now [N]; None where none was
            pressed.
        void_shots: shots that were taken back now: the zero moved too far, or their attempt was rejected.
        retries: presses that were repeated now after a transient fault.
    """

    state: State
    shots: int
    planned: int
    reason: Reason | None = None
    message: str = ""
    clocks: Offset | None = None
    zero_moved_n: float | None = None
    void_shots: int = 0
    retries: int = 0


PLAN = "plan"
SHOT = "shot"
TOUCH = "sign-touch"  # gentle touch, before the first press and after each change of tool
ZERO = "zero"  # height of contact in one press; the event is called so in runs
SWEEPS = "sweep"


@dataclass(frozen=True, slots=True)
class Status:
    """Status of a recording, for whoever watches.

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
    """Frames of each shot that a run holds. A frame counts that has its label; a sweep, when it ended.

    Nothing but the recording is asked: there is no ledger that could say otherwise.
    """
    labels = run.labels
    recorded: dict[str, set[int]] = defaultdict(set)
    known = labels["shot"].notna() & labels["frame_in_shot"].notna()
    stepped = known & (labels["phase"] != SWEEPS)
    for key, k in zip(labels["shot"][stepped], labels["frame_in_shot"][stepped], strict=True):
        recorded[str(key)].add(int(k))
    events = run.events()
    for kind, text in zip(events["kind"], events["fields"], strict=True):
        fields = json.loads(text) or {}
        if kind == SHOT and fields.get("whole"):
            recorded[str(fields["key"])].add(0)
        if kind == VOID:
            for key in fields.get("whole", ()):
                recorded[str(key)].discard(0)
    return {key: frozenset(frames) for key, frames in recorded.items()}


def note_of(plan: RecordingPlan) -> dict[str, str]:
    """What each segment's files begin with, before anything is recorded into them."""
    return {PLAN: plan.hash}


def check_same_plan(run: Run, plan: RecordingPlan, manifest: Manifest) -> None:
    """Refuse to go on with another plan than the one that a run was begun with.

    A run that was cut before it held its plan or a frame of one is gone on with if it is of the same sensor,
    rig and labels; `manifest` is what it would be begun with now.
    """
    begun = [str(segment.note[PLAN]) for segment in run.segments if PLAN in segment.note]
    begun += [str(fields["hash"]) for fields in fields_of(run, PLAN)]
    if not begun:
        _check_same_beginning(run, manifest)
    elif begun[0] != plan.hash:
        raise RecordingError(
            f"{run.path} was begun with another plan ({begun[0][:12]}) than this one, "
            f"{plan.name!r} ({plan.hash[:12]}); give that one, or name a new run"
        )


OWN_FIELDS = {"run_id", "created_utc", "software", "seed"}
"""Fields of a manifest in which two recordings of one plan on one rig may differ; a seed is judged apart."""


def _check_same_beginning(run: Run, manifest: Manifest) -> None:
    if "shot" in run.labels and run.labels["shot"].notna().any():
        raise RecordingError(
            f"{run.path} holds frames of a plan that cannot be read any more, so that nothing says which it "
            "was; name a new run",
            code="plan-unreadable",
        )
    there, here = (one.model_dump(exclude=OWN_FIELDS) for one in (run.manifest, manifest))
    if other := [name for name in here if there[name] != here[name]]:
        raise RecordingError(
            f"{run.path} was not recorded by a plan, or by another: its {other[0]} is "
            f"{there[other[0]]!r:.60}, and of this rig and plan it is {here[other[0]]!r:.60}; name a new run",
            code="rig-differs",
        )


def fields_of(run: Run, kind: str) -> list[dict[str, object]]:
    """The fields of all events of a kind, in order."""
    events: pd.DataFrame = run.events()
    return [json.loads(text) for text in events.loc[events["kind"] == kind, "fields"]]
