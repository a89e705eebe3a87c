"""A rig that is not there: stage, force sensor and camera around any sensor, in real or faster time.

The names here load when they are first used: a rig's file names the kinds of faults without a rig.
"""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use

if TYPE_CHECKING:
    from palpate.rig.virtual.disturbances import Fault, Variation
    from palpate.rig.virtual.virtual_bench import virtual_rig

_MODULES = {"Fault": "disturbances", "Variation": "disturbances", "virtual_rig": "virtual_bench"}

__all__ = ["Fault", "Variation", "virtual_rig"]

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _MODULES, __all__)
