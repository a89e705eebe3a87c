"""Motion, measurement and recording: plans, guards, drivers of real devices and their virtual twin.

The names here load when they are first used, so that the process that guards a rig loads no engine.
"""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use

if TYPE_CHECKING:
    from palpate.core import FrameSource
    from palpate.devices import Limits, Mounting, OperatorCommand, OperatorControl, Reason, Tripped
    from palpate.rig.engine import record
    from palpate.rig.plans import PLANS, plan_of, plan_of_sensor, size_of
    from palpate.rig.rig import Rig
    from palpate.rig.rig_file import open_rig
    from palpate.rig.run_progress import Outcome, State, Status, done_in

_MODULES = {
    name: module
    for module, names in {
        ".core": ("FrameSource",),
        ".devices": ("Limits", "Mounting", "OperatorCommand", "OperatorControl", "Reason", "Tripped"),
        "engine": ("record",),
        "plans": ("PLANS", "plan_of", "plan_of_sensor", "size_of"),
        "rig": ("Rig",),
        "rig_file": ("open_rig",),
        "run_progress": ("Outcome", "State", "Status", "done_in"),
    }.items()
    for name in names
}

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

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _MODULES, __all__)
