"""Supervisor of guarded motion in a process of its own, and its client."""

from palpate.devices.supervisor.guard_supervisor import GuardSupervisor
from palpate.devices.supervisor.supervised_guard import SupervisedGuard
from palpate.devices.supervisor.supervisor_link import SupervisedForce, SupervisedStage, SupervisorLink

__all__ = ["GuardSupervisor", "SupervisedForce", "SupervisedGuard", "SupervisedStage", "SupervisorLink"]
