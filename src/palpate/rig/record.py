"""Record a plan on a rig into a run, or go on with one that was interrupted."""

from __future__ import annotations

from pathlib import Path

from palpate.core.files import PathText
from palpate.recordings.manifest import Manifest
from palpate.recordings.reader import Run
from palpate.recordings.writer import RunWriter
from palpate.rig.control import Control
from palpate.rig.engine import Engine, Watch, nobody
from palpate.rig.outcome import Outcome
from palpate.rig.plans.plan import Plan
from palpate.rig.plans.steps import Done
from palpate.rig.progress import check_same_plan, done_in
from palpate.rig.rig import Rig
from palpate.rig.shooting import LABELS
from palpate.rig.walking import check_plan


def record(
    rig: Rig, plan: Plan, out: PathText, *, control: Control | None = None, watch: Watch = nobody
) -> Outcome:
    """Record all of a plan that a run does not hold yet.

    A new run is begun where there is none. Where there is one of the same plan, the next segment begins at
    its first missing shot; what is there is never touched, repeated or skipped.

    Args:
        rig: the devices; the caller closes them.
        plan: what to record.
        out: the run.
        control: through which the operator interrupts.
        watch: told how far it is, a few times a second.

    Raises:
        Tripped: the plan leaves the rig's limits; nothing has moved and nothing is written.
        RecordingError: the run has another plan, or another writer records into it.
        StorageError: the disk refused before anything moved.
    """
    out = Path(out)
    check_plan(rig, plan)
    done: Done = {}
    if out.exists():
        run = Run.open(out)
        check_same_plan(run, plan)
        done = done_in(run)
        writer = RunWriter.resume(out, clock=rig.clock, overflow="wait")
    else:
        writer = RunWriter.create(out, manifest_of(rig, plan), clock=rig.clock, overflow="wait")
    with writer:
        return Engine(rig, plan, writer, done, control or Control(), watch).run()


def manifest_of(rig: Rig, plan: Plan) -> Manifest:
    """What a run of this rig and plan says of itself."""
    truths = dict.fromkeys(rig.truths, "number")
    return Manifest.new(
        sensor=rig.sensor,
        rig=f"{rig.name}, plan {plan.name}",
        licence=rig.licence,
        origin=rig.origin,
        labels={**LABELS, **truths},  # type: ignore[dict-item]
        targets=targets_of(plan),
        regions=dict(rig.regions),
        seed=rig.seed,
    )


def targets_of(plan: Plan) -> tuple[str, ...]:
    """The labels that differ between a plan's presses, and so can be learnt from them."""
    if plan.deepest_mm == 0:
        return ()
    targets = ["depth_mm", "force_N"]
    if len(plan.places.places()) > 1:
        targets += ["x_mm", "y_mm"]
    if getattr(plan, "lateral", None):
        targets += ["force_x_N", "force_y_N"]
    return tuple(targets)
