"""Supervisor of guarded motion in a process of its own; here its client's end, what serves it beside."""

from palpate.devices.supervisor.supervised_guard import (
    SupervisedForce,
    SupervisedGuard,
    SupervisedStage,
    SupervisorLink,
)

__all__ = ["SupervisedForce", "SupervisedGuard", "SupervisedStage", "SupervisorLink"]
