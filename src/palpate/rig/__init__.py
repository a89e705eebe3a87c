"""Motion, measurement and recording: plans, guards, drivers of real devices and their virtual twin."""

from palpate.core import FrameSource
from palpate.devices import Limits, Mounting, OperatorCommand, OperatorControl, Reason, Tripped
from palpate.rig.engine import record
from palpate.rig.plans import PLANS, plan_of, plan_of_sensor, size_of
from palpate.rig.rig import Rig
from palpate.rig.rig_file import open_rig
from palpate.rig.run_progress import Outcome, State, Status, done_in

__all__ = [
    "PLANS",
    "FrameSource",
    "Limits",
    "Mounting",
    "OperatorCommand",
    "OperatorControl",
    "Outcome",
    "Reason",
    "Rig",
    "State",
    "Status",
    "Tripped",
    "done_in",
    "open_rig",
    "plan_of",
    "plan_of_sensor",
    "record",
    "size_of",
]
