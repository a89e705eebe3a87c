"""Supervisor of guarded motion in a process of its own; here its client's end, what serves it beside."""

from palpate.devices.supervisor.supervised_guard import SupervisedGuard
from palpate.devices.supervisor.supervisor_link import SupervisedForce, SupervisedStage, SupervisorLink

__all__ = ["SupervisedForce", "SupervisedGuard", "SupervisedStage", "SupervisorLink"]
