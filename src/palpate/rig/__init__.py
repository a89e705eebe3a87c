"""Moves, measures and records: plans, guards, drivers of real devices and their virtual twin."""

from palpate.rig.control import Ask, Control
from palpate.rig.limits import Limits
from palpate.rig.outcome import Outcome, Reason, State, Tripped
from palpate.rig.plans import PLANS, plan_of, size_of
from palpate.rig.progress import Status, done_in
from palpate.rig.record import record
from palpate.rig.rig import FrameSource, Rig
from palpate.rig.rig_file import open_rig
from palpate.rig.tare import Mounting

__all__ = [
    "PLANS",
    "Ask",
    "Control",
    "FrameSource",
    "Limits",
    "Mounting",
    "Outcome",
    "Reason",
    "Rig",
    "State",
    "Status",
    "Tripped",
    "done_in",
    "open_rig",
    "plan_of",
    "record",
    "size_of",
]
