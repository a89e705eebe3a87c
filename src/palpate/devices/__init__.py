"""Holds devices safely: limits, guarded motion, the operator's commands, conformance checks, a process.

Nothing here knows a rig, a plan or a recording: an actuator that moves and a force that is measured do.
"""

from palpate.devices.device_plugins import open_device
from palpate.devices.force_bias import ForceBias, Mounting
from palpate.devices.motion_guard import Clearance, ForceReached, MotionGuard, Subscribers
from palpate.devices.motion_limits import Limits, Reason, Tripped
from palpate.devices.operator_control import OperatorCommand, OperatorControl, OperatorInterrupt
from palpate.devices.supervisor import SupervisedGuard, SupervisorLink

Guard = MotionGuard | SupervisedGuard
"""Guard of a motion: in this process, or the client of a supervisor's."""

__all__ = [
    "Clearance",
    "ForceBias",
    "ForceReached",
    "Guard",
    "Limits",
    "MotionGuard",
    "Mounting",
    "OperatorCommand",
    "OperatorControl",
    "OperatorInterrupt",
    "Reason",
    "Subscribers",
    "SupervisedGuard",
    "SupervisorLink",
    "Tripped",
    "open_device",
]
